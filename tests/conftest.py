"""What many tests share: the paper's experiment, run once."""

import pytest

from harness.experiments.run import Result, run_experiment
from harness.experiments.spec import load_experiment


@pytest.fixture(scope="session")
def paper() -> Result:
    """The paper's experiment with its shipped settings, rendered in this session."""
    return run_experiment(load_experiment("paper"))
