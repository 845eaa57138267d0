"""For the test suites of matchers' authors: the fixture `omnirange_check`, which comes with the installed program.

A test that asks for it runs once for each check of `harness.testing.conformity`::

    def test_my_matcher(omnirange_check):
        omnirange_check("my_module:my_function", window=5)

pytest loads this file in every suite of an environment in which the program is installed. So it has a name that nobody
else has, also where a folder `harness` of another project comes first, and imports nothing until a test asks for the
fixture.
"""

from collections.abc import Callable
from typing import Any

import pytest

_FIXTURE = "omnirange_check"


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test for each check."""
    if _FIXTURE in metafunc.fixturenames:
        try:
            from harness.testing.conformity import CHECKS
        except ModuleNotFoundError as error:
            import harness

            where = getattr(harness, "__file__", None) or next(iter(harness.__path__))
            raise pytest.UsageError(f"{_FIXTURE}: {where} hides omnirange's package of the same name") from error
        metafunc.parametrize(_FIXTURE, CHECKS, ids=[check.name for check in CHECKS], indirect=True)


@pytest.fixture(scope="session")
def _omnirange_subjects() -> dict[Any, Any]:
    """Matchers and what they have answered: kept for all checks."""
    return {}


@pytest.fixture
def omnirange_check(request: pytest.FixtureRequest, _omnirange_subjects: dict[Any, Any]) -> Callable[..., None]:
    """`omnirange_check(kind, **parameters)`: fails when the matcher breaks the check, and says how.

    `kind` is what `matching.kind` is in an experiment, or the path of a TOML file with a table `[matching]`. A check
    that cannot be carried out, because another one is broken, is skipped.
    """
    check = request.param

    def carry_out(kind: str, **parameters: Any) -> None:
        __tracebackhide__ = True
        from harness.errors import InputError
        from harness.runs.load import load_matcher
        from harness.testing.conformity import Subject, examine

        try:
            matcher = load_matcher(kind, parameters=parameters)
        except InputError as error:
            pytest.fail(str(error), pytrace=False)
        subject = _omnirange_subjects.setdefault(matcher, Subject(matcher))
        finding = examine(subject, check)
        if finding.passed is None:
            pytest.skip(finding.text)
        if not finding.passed:
            pytest.fail(f"{kind}: {check.title}: {finding.text}", pytrace=False)

    return carry_out
