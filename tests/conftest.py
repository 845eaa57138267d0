"""What many tests share: the paper's experiment, modules to import, and the rule that long tests are marked."""

import itertools
import os
import signal

import pytest
from hypothesis import settings

# The same examples in every run: a change is never blamed for what luck has found. `HYPOTHESIS_PROFILE=explore` draws
# others; what fails there belongs into the suite as an example of its own.
settings.register_profile("same", derandomize=True)
settings.register_profile("explore", print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

_numbers = itertools.count()


@pytest.fixture(scope="session")
def paper():
    """The paper's experiment with its shipped settings, rendered in this session."""
    # Imported here, so that tests which do not ask for it are independent of the whole chain.
    from harness.runs.load import load_experiment
    from harness.runs.run import run_experiment

    return run_experiment(load_experiment("paper"))


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


# --- A test is slow by measured time ------------------------------------------------------------------------------


def pytest_addoption(parser):
    parser.addoption(
        "--most-cpu-s",
        type=float,
        metavar="SECONDS",
        help="fail when a test that is not marked `slow` takes more CPU time than this, fixtures apart",
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
        item.user_properties.append(("cpu_s", cpu_s() - begin))


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
    passed = [(each, dict(each.user_properties).get("cpu_s", 0.0)) for each in reporter.stats.get("passed", ())]
    return [(each, spent) for each, spent in passed if spent > most and "slow" not in each.keywords]
