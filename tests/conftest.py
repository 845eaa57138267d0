"""What many tests share: the paper's experiment, modules to import, and the rule that long tests are marked."""

import gc
import itertools
import os
import signal

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

# The same examples in every run: a change is never blamed for what luck has found. `HYPOTHESIS_PROFILE=explore` draws
# others; what fails there belongs into the suite as an example of its own.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("explore", print_blob=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

_numbers = itertools.count()

TIMINGS = 3
"""Times that a test which seems slow is run before it is called so."""


@pytest.fixture(scope="session")
def paper():
    """The paper's experiment with its shipped settings, but for two of its seeds alone, rendered in this session."""
    # Imported here, so that tests which do not ask for it are independent of the whole chain.
    from harness.runs.load import load_experiment
    from harness.runs.run import run_experiment

    return run_experiment(load_experiment("paper", axes={"seed": [1, 2]}))


@pytest.fixture(scope="session")
def small_set(tmp_path_factory):
    """Gives the folder of a small data set by the name of its specification; made once, and not to be written to."""
    from small_sets import made, small

    folders = {}

    def of(name):
        if name not in folders:
            folders[name] = made(small(name), tmp_path_factory.mktemp("sets") / name)
        return folders[name]

    return of


@pytest.fixture
def undrawn():
    """Figures of pages stay blank in a test of what is said, or written beside the page."""
    from undrawn import undrawn

    with undrawn():
        yield


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module that can be imported, and gives its name: a new one each time, as modules are loaded once."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def write(source):
        name = f"mine_{next(_numbers)}"
        (tmp_path / f"{name}.py").write_text(source, encoding="utf-8")
        return name

    return write


def pytest_configure():
    # A shell has what it runs in the background ignore Ctrl-C, and so all that is started there: tests press it.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish():
    # All tests and libraries stay to the end: to look through them for garbage again and again takes a twentieth of the
    # time of the tests.
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


# --- A test is slow by measured time ------------------------------------------------------------------------------


def pytest_addoption(parser):
    parser.addoption(
        "--most-cpu-s",
        type=float,
        metavar="SECONDS",
        help="fail when a test that is not marked `slow` takes more CPU time than this in each run, fixtures apart",
    )


def cpu_s():
    """CPU time of this process and of the children that it has waited for: unlike the clock's, not the neighbours'."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    begin = cpu_s()
    try:
        return (yield)
    finally:
        item.user_properties[:] = [("cpu_s", cpu_s() - begin)]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    """Times a test again that seems slow: the first one in a process pays for what all import and load."""
    most = item.config.getoption("--most-cpu-s")
    if most is None or "slow" in item.keywords:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for _ in range(TIMINGS):
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if any(report.failed for report in reports) or all(cpu_of(report) <= most for report in reports):
            break
        item._initrequest()  # as plugins that run a test again do: there is no public way
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter, config):
    most = config.getoption("--most-cpu-s")
    if most is None:
        return
    for report, spent in unmarked(terminalreporter, most):
        terminalreporter.write_line(f"not marked slow, {spent:.1f} s of CPU time: {report.nodeid}", red=True)


def pytest_sessionfinish(session, exitstatus):
    most = session.config.getoption("--most-cpu-s")
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if most is not None and reporter is not None and exitstatus == pytest.ExitCode.OK and unmarked(reporter, most):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def unmarked(reporter, most):
    """Reports of tests that should be marked, with their time."""
    passed = [(each, cpu_of(each)) for each in reporter.stats.get("passed", ())]
    return [(each, spent) for each, spent in passed if spent > most and "slow" not in each.keywords]


def cpu_of(report):
    """CPU time of the test that this is a report of, in seconds; zero where it was not run."""
    return dict(report.user_properties).get("cpu_s", 0.0)
