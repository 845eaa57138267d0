"""What many tests share: the paper's experiment, run once."""

import pytest


@pytest.fixture(scope="session")
def paper():
    """The paper's experiment with its shipped settings, rendered in this session."""
    # Imported here, so that tests which do not ask for it are independent of the whole chain.
    from harness.runs.experiment import load_experiment
    from harness.runs.run import run_experiment

    return run_experiment(load_experiment("paper"))
