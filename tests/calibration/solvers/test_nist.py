"""Certified nonlinear regressions of NIST: values, standard deviations, sums of squares."""

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import Parameter, Problem, fit


def misra1a(p, x):
    return p["b1"] * (1 - jnp.exp(-p["b2"] * x))


def roszman1(p, x):
    return p["b1"] - p["b2"] * x - jnp.arctan(p["b3"] / (x - p["b4"])) / jnp.pi


def mgh09(p, x):
    return p["b1"] * (x**2 + x * p["b2"]) / (x**2 + x * p["b3"] + p["b4"])


def thurber(p, x):
    above = p["b1"] + p["b2"] * x + p["b3"] * x**2 + p["b4"] * x**3
    return above / (1 + p["b5"] * x + p["b6"] * x**2 + p["b7"] * x**3)


def eckerle4(p, x):
    return p["b1"] / p["b2"] * jnp.exp(-0.5 * ((x - p["b3"]) / p["b2"]) ** 2)


MODELS = {
    "Misra1a": misra1a,
    "Roszman1": roszman1,
    "MGH09": mgh09,
    "Thurber": thurber,
    "Eckerle4": eckerle4,
}


@pytest.mark.parametrize("name", MODELS)
def test_certified_values_from_both_starts(nist_reference, name):
    case = nist_reference[name]
    x, y = np.array(case["x"]), np.array(case["y"])
    for start in case["starts"]:
        parameters = {f"b{i + 1}": Parameter(value) for i, value in enumerate(start)}
        result = fit(Problem.from_function(MODELS[name], parameters, x, y))
        assert result.converged, result.status
        found = list(result.parameters.values())
        # Six digits of the parameters, as graded by NIST for the harder problems.
        np.testing.assert_allclose([p.value for p in found], case["certified"], rtol=2e-6)
        np.testing.assert_allclose([p.std for p in found], case["standard_deviations"], rtol=5e-6)
        square = float(np.sum(result.residuals["data"] ** 2))
        assert square == pytest.approx(case["residual_sum_of_squares"], rel=1e-9)
        assert result.degrees_of_freedom == case["degrees_of_freedom"]
