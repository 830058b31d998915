"""Wald, profile and posterior intervals hold the truth as often as they say, for the same data."""

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import Parameter, Problem, fit, profile
from calibration.sampling import draws_alone

X = np.linspace(0.0, 4.0, 16)
TRUE = {"height": 2.0, "rate": 0.8}
SETS = 400


def decay(params, x):
    return params["height"] * jnp.exp(-params["rate"] * x)


@pytest.fixture(scope="module")
def held():
    """Whether each interval of each set of readings holds the truth, shape (sets, parameters)."""
    rng = np.random.default_rng(21)
    exact = np.asarray(decay(TRUE, X))
    found = {"wald": [], "profile": [], "posterior": [], "posterior 68 %": []}
    for number in range(SETS):
        y = exact + rng.normal(0.0, 0.1, len(X))
        parameters = {
            "height": Parameter(1.0, bounds=(0.0, 50.0)),
            "rate": Parameter(1.0, bounds=(0.0, 20.0)),
        }
        result = fit(Problem.from_function(decay, parameters, X, y, 0.1))
        curves = profile(result).parameters
        _, draws = draws_alone(result.problem, result, number, "stretch", 600, 250)
        for name in ("wald", "profile", "posterior", "posterior 68 %"):
            found[name].append([])
        for i, (parameter, true) in enumerate(TRUE.items()):
            low, high = result.parameters[parameter].interval95
            found["wald"][-1].append(low <= true <= high)
            low, high = curves[parameter].interval
            found["profile"][-1].append(low <= true <= high)
            low, high = np.quantile(draws[:, i], [0.025, 0.975])
            found["posterior"][-1].append(low <= true <= high)
            low, high = np.quantile(draws[:, i], [0.16, 0.84])
            found["posterior 68 %"][-1].append(low <= true <= high)
    return {name: np.array(rows) for name, rows in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wald", "profile", "posterior"])
def test_coverage(held, kind):
    # Three standard errors of a share of 0.95 in 400 sets: 0.033.
    assert np.mean(held[kind], axis=0) == pytest.approx(0.95, abs=0.033)


@pytest.mark.slow
def test_intervals_of_one_standard_deviation_would_be_caught(held):
    assert np.all(np.mean(held["posterior 68 %"], axis=0) < 0.95 - 0.033)
    assert np.mean(held["posterior 68 %"], axis=0) == pytest.approx(0.68, abs=0.07)
