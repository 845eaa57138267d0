"""A bound that does not hold."""

from harness import load_experiment, run_trial
from harness.testing.assertions import assert_density

outcome = run_trial(load_experiment("small.toml").planned[0].trial)
assert_density(outcome, at_least=0.99, reason="an example that fails")
