"""Errors in x: Deming's line, curves against an explicit fit of every true x, and refusals."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from calibration import Dataset, Parameter, Problem, StudentT, fit
from procmodel.errors import InputError

N = 25
TRUE_X = np.linspace(0.0, 4.0, N)
FREE = {"a": Parameter(0.5), "b": Parameter(0.5)}


def readings(curve, x_sigma, sigma, seed):
    rng = np.random.default_rng(seed)
    return TRUE_X + x_sigma * rng.normal(size=N), curve(TRUE_X) + sigma * rng.normal(size=N)


def deming(x, y, ratio):
    """Intercept and slope, with the variance of y's errors over that of x's."""
    (xx, xy), (_, yy) = np.cov(x, y, bias=True)
    slope = (yy - ratio * xx + math.hypot(yy - ratio * xx, 2 * math.sqrt(ratio) * xy)) / (2 * xy)
    return y.mean() - slope * x.mean(), slope


@pytest.mark.parametrize(("x_sigma", "sigma"), [(0.4, 0.5), (0.8, 0.1)])
def test_a_straight_line_is_demings(models, x_sigma, sigma):
    x, y = readings(lambda x: 1.0 + 2.0 * x, x_sigma, sigma, 3)
    result = fit(Problem.from_function(models.line, FREE, x, y, sigma, x_sigma=x_sigma))
    expected = deming(x, y, (sigma / x_sigma) ** 2)
    for estimate, value in zip(result.parameters.values(), expected, strict=True):
        assert estimate.value == pytest.approx(value, abs=1e-6 * estimate.std)
    # Half the sum of squares is that of the distances to the line in units of both errors.
    a, b = expected
    distance = (y - a - b * x) / math.hypot(sigma, b * x_sigma)
    assert result.reduced_chi2 == pytest.approx(np.sum(distance**2) / (N - 2), rel=1e-9)


def york(x, y, x_sigma, sigma):
    """Intercept and slope by York's iteration (Am. J. Phys. 72, 367, 2004), errors of each own."""
    slope = np.polyfit(x, y, 1)[0]
    for _ in range(500):
        weight = 1.0 / (sigma**2 + (slope * x_sigma) ** 2)
        u, v = x - np.average(x, weights=weight), y - np.average(y, weights=weight)
        beta = weight * (u * sigma**2 + slope * v * x_sigma**2)
        slope = np.sum(weight * beta * v) / np.sum(weight * beta * u)
    return np.average(y, weights=weight) - slope * np.average(x, weights=weight), slope


def test_errors_of_their_own_for_each_reading_are_yorks(models):
    x_sigma, sigma = np.linspace(0.1, 0.6, N), np.linspace(0.7, 0.2, N)
    x, y = readings(lambda x: 1.0 + 2.0 * x, x_sigma, sigma, 5)
    result = fit(Problem.from_function(models.line, FREE, x, y, sigma, x_sigma=x_sigma))
    for estimate, value in zip(result.parameters.values(), york(x, y, x_sigma, sigma), strict=True):
        assert estimate.value == pytest.approx(value, abs=1e-6 * estimate.std)


def decay(params, x):
    return params["h"] * jnp.exp(-params["k"] * x) + params["c"]


CURVED = {"h": Parameter(4.0), "k": Parameter(0.8), "c": Parameter(0.2)}
TRUTH = {"h": 5.0, "k": 1.0, "c": 0.5}


def in_numpy(v, x):
    return v[0] * np.exp(-v[1] * x) + v[2]


@pytest.mark.parametrize(("x_sigma", "sigma"), [(0.05, 0.1), (0.15, 0.1)])
def test_a_curve_is_fitted_as_with_every_true_x_a_parameter(x_sigma, sigma):
    x, y = readings(lambda x: in_numpy(list(TRUTH.values()), x), x_sigma, sigma, 8)

    def distances(v):
        return np.concatenate([(in_numpy(v[:3], v[3:]) - y) / sigma, (v[3:] - x) / x_sigma])

    start = np.concatenate([list(TRUTH.values()), TRUE_X])
    options = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-13}
    latent = scipy.optimize.least_squares(distances, start, jac="3-point", **options)
    # The curvature of the misfit over the parameters once every x has followed: what is left of
    # the whole information after the x have been taken out.
    whole = np.linalg.inv(latent.jac.T @ latent.jac)[:3, :3]
    result = fit(Problem.from_function(decay, CURVED, x, y, sigma, x_sigma=x_sigma))
    assert result.converged, result.status
    for i, estimate in enumerate(result.parameters.values()):
        assert estimate.value == pytest.approx(latent.x[i], abs=1e-5 * estimate.std)
        # Both are first-order in the errors of x, taken at different points: they agree so far.
        assert estimate.std == pytest.approx(math.sqrt(whole[i, i]), rel=0.05)
    assert result.reduced_chi2 * (N - 3) == pytest.approx(2 * latent.cost, rel=1e-9)
    for name, residual in result.residuals.items():
        expected = y - in_numpy([p.value for p in result.parameters.values()], x)
        np.testing.assert_allclose(residual, expected, atol=1e-9, err_msg=name)


def test_a_fit_with_errors_in_x_is_not_attenuated_and_covers(models):
    slopes, covered, ordinary, ordinary_covered = [], [], [], []
    for seed in range(300):
        x, y = readings(lambda x: 1.0 + 2.0 * x, 0.5, 0.3, seed)
        b = fit(Problem.from_function(models.line, FREE, x, y, 0.3, x_sigma=0.5)).parameters["b"]
        slopes.append(b.value)
        covered.append(b.interval95[0] <= 2.0 <= b.interval95[1])
        centred = x - x.mean()
        slope = centred @ y / (centred @ centred)
        rms = math.sqrt(np.sum((y - y.mean() - slope * centred) ** 2) / (N - 2))
        ordinary.append(slope)
        ordinary_covered.append(abs(slope - 2.0) < 2.07 * rms / math.sqrt(centred @ centred))
    error = np.std(slopes) / math.sqrt(300)
    # Deming's slope is skew in small samples by about its variance over the slope.
    assert abs(np.mean(slopes) - 2.0) < 4 * error + np.var(slopes)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.04)
    # Negative control: without errors in x the slope is too small by var / (var + 0.25).
    shrunk = 2.0 * np.var(TRUE_X) / (np.var(TRUE_X) + 0.25)
    assert np.mean(ordinary) == pytest.approx(shrunk, abs=4 * error + 0.02)
    assert np.mean(ordinary) < 2.0 - 10 * error
    assert np.mean(ordinary_covered) < 0.85


def test_small_errors_in_x_change_nothing(models):
    x, y = readings(lambda x: 1.0 + 2.0 * x, 0.0, 0.3, 2)
    found = fit(Problem.from_function(models.line, FREE, x, y, 0.3, x_sigma=1e-9))
    beta = np.linalg.lstsq(np.stack([np.ones(N), x], axis=1), y)[0]
    assert [p.value for p in found.parameters.values()] == pytest.approx(list(beta), rel=1e-9)


def summed(params, x):
    return params["a"] + params["b"] * jnp.cumsum(x)


def shifted(params, x):
    return params["a"] + params["b"] * jnp.roll(x, 1)


@pytest.mark.parametrize("model", [summed, shifted])
def test_a_model_that_looks_at_other_readings_is_refused(model):
    with pytest.raises(InputError, match=r"'data' has errors in x, .* point by point") as found:
        fit(Problem.from_function(model, FREE, TRUE_X, TRUE_X, 0.1, x_sigma=0.1))
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"sigma": None}, "errors in x need normal noise with sigma given as a number"),
        ({"sigma": "s"}, "errors in x need normal noise with sigma given as a number"),
        ({"noise": StudentT()}, "errors in x need normal noise"),
        ({"x": {"t": [0.0, 1.0, 2.0]}}, "errors in x need x to be one array with a value per"),
        ({"x": np.ones((3, 2))}, "errors in x need x to be one array with a value per"),
        ({"x_sigma": [0.1, 0.2]}, "x_sigma has shape .2,. for 3 readings: give one, or one each"),
        ({"x_sigma": [0.1, 0.0, 0.2]}, "x_sigma of reading 2 is not above 0: .* leave x_sigma out"),
        ({"x_sigma": -0.1}, "x_sigma of reading 1 is not above 0"),
        ({"x_sigma": [0.1, math.nan, 0.2]}, "x_sigma has 1 values that are NaN .* reading 2"),
    ],
)
def test_refusals(arguments, sentence):
    given = {"x": [0.0, 1.0, 2.0], "y": [1.0, 2.0, 3.0], "sigma": 0.1, "x_sigma": 0.1}
    with pytest.raises(InputError, match=sentence) as found:
        Dataset(**(given | arguments))
    assert "\n" not in str(found.value)


def test_x_that_are_whole_numbers_may_have_errors(models):
    result = fit(
        Problem.from_function(
            models.line, FREE, np.arange(N), 1.0 + 2.0 * np.arange(N), 0.1, x_sigma=0.1
        )
    )
    assert result.parameters["b"].value == pytest.approx(2.0, rel=1e-9)
