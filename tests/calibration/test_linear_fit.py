"""Fits of straight lines, where everything has a closed form."""

import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration import Dataset, Parameter, Problem, fit
from procmodel.errors import InputError

N = 15
X = np.linspace(-2.0, 7.0, N)
DESIGN = np.stack([np.ones(N), X], axis=1)


def regression(y, weights):
    """Weighted normal equations: coefficients, inverse of X'WX, sum of squares."""
    inverse = np.linalg.inv(DESIGN.T @ (weights[:, None] * DESIGN))
    beta = inverse @ DESIGN.T @ (weights * y)
    return beta, inverse, float(np.sum(weights * (y - DESIGN @ beta) ** 2))


def line_fit(models, y, sigma, **changed):
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0)} | changed
    return fit(Problem.from_function(models.line, parameters, X, y, sigma))


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32 - 1),
    a=st.floats(-100.0, 100.0),
    b=st.floats(-10.0, 10.0),
    scale=st.floats(1e-3, 10.0),
)
def test_weighted_regression_with_known_noise(models, seed, a, b, scale):
    rng = np.random.default_rng(seed)
    sigma = scale * rng.uniform(0.2, 3.0, N)
    y = a + b * X + sigma * rng.normal(size=N)
    beta, covariance, square = regression(y, 1.0 / sigma**2)
    result = line_fit(models, y, sigma)
    assert result.converged
    std = np.sqrt(np.diag(covariance))
    for i, name in enumerate("ab"):
        estimate = result.parameters[name]
        assert abs(estimate.value - beta[i]) < 1e-5 * std[i] + 1e-10 * abs(beta[i])
        assert estimate.std == pytest.approx(std[i], rel=1e-9)
        reach = scipy.stats.norm.ppf(0.975) * std[i]
        assert estimate.interval95[1] - estimate.value == pytest.approx(reach, rel=1e-9)
        assert estimate.value - estimate.interval95[0] == pytest.approx(reach, rel=1e-9)
        assert estimate.verdict == "identified"
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-9)
    assert result.degrees_of_freedom == N - 2
    assert result.reduced_chi2 == pytest.approx(square / (N - 2), rel=1e-9)
    assert result.noise == {"data": None}


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), noise=st.floats(1e-3, 10.0))
def test_regression_with_estimated_noise(models, seed, noise):
    y = 4.0 - 0.3 * X + noise * np.random.default_rng(seed).normal(size=N)
    beta, inverse, square = regression(y, np.ones(N))
    level = math.sqrt(square / (N - 2))
    result = line_fit(models, y, None)
    reference = scipy.stats.linregress(X, y)
    assert result.noise["data"] == pytest.approx(level, rel=1e-8)
    assert result.parameters["b"].std == pytest.approx(reference.stderr, rel=1e-8)
    assert result.parameters["a"].std == pytest.approx(reference.intercept_stderr, rel=1e-8)
    for i, name in enumerate("ab"):
        estimate = result.parameters[name]
        reach = scipy.stats.t.ppf(0.975, N - 2) * level * math.sqrt(inverse[i, i])
        ends = (beta[i] - reach, beta[i] + reach)
        assert estimate.interval95 == pytest.approx(ends, abs=1e-6 * reach)
    assert result.reduced_chi2 is None
    assert result.residual_rms == pytest.approx(math.sqrt(square / N), rel=1e-8)


def test_the_t_interval_covers_and_the_normal_one_does_not(models):
    # With 5 readings Student's t matters: 3 degrees of freedom.
    x = np.linspace(0.0, 1.0, 5)
    rng = np.random.default_rng(2024)
    covered = short = 0
    runs = 600
    for _ in range(runs):
        y = 1.0 + 2.0 * x + 0.3 * rng.normal(size=5)
        problem = Problem.from_function(
            models.line, {"a": Parameter(0.0), "b": Parameter(0.0)}, x, y
        )
        b = fit(problem).parameters["b"]
        covered += b.interval95[0] <= 2.0 <= b.interval95[1]
        short += abs(b.value - 2.0) <= 1.96 * b.std
    assert covered / runs == pytest.approx(0.95, abs=0.03)
    assert short / runs < 0.91


def product(params):
    return params["a"] * params["b"]


def test_tied_parameters_have_propagated_intervals(models):
    y = 4.0 - 0.3 * X + 0.1 * np.random.default_rng(1).normal(size=N)
    result = line_fit(
        models,
        y,
        0.1,
        twin=Parameter(0.0, tied="b"),
        product=Parameter(0.0, tied=product),
        idle=Parameter(7.0, "um", fixed=True),
    )
    a, b = result.parameters["a"], result.parameters["b"]
    assert result.parameters["twin"].interval95 == pytest.approx(b.interval95)
    gradient = np.array([b.value, a.value])
    expected = math.sqrt(gradient @ result.covariance @ gradient)
    assert result.parameters["product"].std == pytest.approx(expected, rel=1e-9)
    assert result.parameters["product"].value == pytest.approx(a.value * b.value)
    assert result.free == ("a", "b")
    assert "7 um  fixed" in result.report()


def exponential(params, x):
    return params["a"] * jnp.exp(-params["b"] * x)


def test_transforms_change_the_interval_but_not_the_optimum():
    x = np.linspace(0.0, 3.0, 12)
    y = 5.0 * np.exp(-0.8 * x) + 0.2 * np.random.default_rng(3).normal(size=12)

    def fitted(transform):
        parameters = {
            "a": Parameter(2.0, bounds=(1e-3, 100.0), transform=transform),
            "b": Parameter(0.5, bounds=(1e-3, 10.0), transform=transform),
        }
        return fit(Problem.from_function(exponential, parameters, x, y, 0.2))

    plain, log, logit = fitted("identity"), fitted("log"), fitted("logit")
    for name in "ab":
        p = plain.parameters[name]
        for q in (log.parameters[name], logit.parameters[name]):
            assert q.value == pytest.approx(p.value, rel=1e-7)
            assert q.std == pytest.approx(p.std, rel=1e-6)
            assert q.interval95[0] > p.interval95[0] and q.interval95[1] > p.interval95[1]
    b = log.parameters["b"]
    factor = math.exp(scipy.stats.norm.ppf(0.975) * b.std / b.value)
    assert b.interval95 == pytest.approx((b.value / factor, b.value * factor), rel=1e-9)


def two_noises(models, rng, levels):
    datasets = {}
    for name, level, size in zip(("fine", "coarse"), levels, (8, 20), strict=True):
        x = np.linspace(0.0, 5.0, size)
        datasets[name] = Dataset(x, 1.0 + 0.5 * x + level * rng.normal(size=size))
    return Problem({"a": Parameter(0.0), "b": Parameter(0.0)}, datasets, models.line)


def test_two_unknown_noise_levels_are_a_fixed_point_of_reweighting(models):
    problem = two_noises(models, np.random.default_rng(8), (0.1, 2.0))
    result = fit(problem)
    # Independent reweighting by hand to the same fixed point.
    design = [np.stack([np.ones(len(d.y)), d.x], 1) for d in problem.datasets.values()]
    readings = [d.y for d in problem.datasets.values()]
    levels = [1.0, 1.0]
    for _ in range(200):
        information = sum(m.T @ m / level**2 for m, level in zip(design, levels, strict=True))
        inverse = np.linalg.inv(information)
        right = sum(
            m.T @ y / level**2 for m, y, level in zip(design, readings, levels, strict=True)
        )
        beta = inverse @ right
        levels = [
            math.sqrt(
                np.sum((y - m @ beta) ** 2) / (len(y) - np.trace(m @ inverse @ m.T) / level**2)
            )
            for m, y, level in zip(design, readings, levels, strict=True)
        ]
    assert result.noise["fine"] == pytest.approx(levels[0], rel=1e-6)
    assert result.noise["coarse"] == pytest.approx(levels[1], rel=1e-6)
    np.testing.assert_allclose(result.covariance, inverse, rtol=1e-6)
    np.testing.assert_allclose([p.value for p in result.parameters.values()], beta, rtol=1e-6)


def test_two_unknown_noise_levels_are_recovered(models):
    rng = np.random.default_rng(77)
    results = [fit(two_noises(models, rng, (0.1, 2.0))) for _ in range(300)]
    found = [result.noise for result in results]
    squares = {name: np.array([f[name] ** 2 for f in found]) for name in ("fine", "coarse")}
    for name, truth in (("fine", 0.1), ("coarse", 2.0)):
        error = squares[name].std() / math.sqrt(len(found))
        assert abs(squares[name].mean() - truth**2) < 3.5 * error
        # n instead of n - p would be seen on the fine set, which takes up both parameters.
    biased = squares["fine"] * 6.0 / 8.0
    assert abs(biased.mean() - 0.1**2) > 3.5 * biased.std() / math.sqrt(len(found))
    # The slope hangs on the fine set's 6 degrees of freedom: its interval covers all the same,
    # which a normal one does not.
    slopes = [result.parameters["b"] for result in results]
    covered = np.mean([b.interval95[0] <= 0.5 <= b.interval95[1] for b in slopes])
    normal = np.mean([abs(b.value - 0.5) <= 1.96 * b.std for b in slopes])
    assert covered == pytest.approx(0.95, abs=0.035)
    assert normal < 0.925


def offset_line(params, x):
    return params["own"] + params["slope"] * x


def test_one_reading_alone_shows_no_noise():
    # The second set has an offset of its own and a single reading: nobody knows how noisy it is.
    x = np.linspace(0.0, 5.0, 20)
    y = 1.0 + 0.5 * x + 0.1 * np.random.default_rng(0).normal(size=20)
    parameters = {name: Parameter(0.0) for name in ("first", "second", "slope")}
    long = Dataset(x, y, own={"own": "first"})
    single = Dataset([2.0], [7.0], own={"own": "second"})
    with pytest.raises(InputError, match=r"'single' has 1 readings.* give its sigma"):
        fit(Problem(parameters, {"long": long, "single": single}, offset_line))
    # Its sigma given, the slope is what the long set alone says.
    single = Dataset([2.0], [7.0], 0.5, own={"own": "second"})
    result = fit(Problem(parameters, {"long": long, "single": single}, offset_line))
    slope, alone = result.parameters["slope"], scipy.stats.linregress(x, y)
    assert slope.value == pytest.approx(alone.slope, rel=1e-6)
    assert slope.std == pytest.approx(alone.stderr, rel=1e-6)
    assert result.parameters["second"].std == pytest.approx(
        math.hypot(0.5, 2.0 * alone.stderr), rel=1e-6
    )


def test_a_misfit_beyond_sigma_is_a_warning(models):
    y = 4.0 - 0.3 * X + 1.0 * np.random.default_rng(9).normal(size=N)
    warned = line_fit(models, y, 0.2)
    assert any("times what sigma allows" in w for w in warned.warnings)
    assert not line_fit(models, y, 1.0).warnings


def test_report_and_dictionary(models):
    y = 4.0 - 0.3 * X + 0.1 * np.random.default_rng(1).normal(size=N)
    result = line_fit(models, y, None)
    report = result.report()
    for part in (
        "model     line",
        f"data      {result.problem.data_hash} (data 15 readings)",
        "solver    box_lm",
        "status    converged",
        "noise estimated from the residuals: data",
        "(13 degrees of freedom)",
        "bounds hit  none",
        "correlations  a, b",
    ):
        assert part in report
    b = result.parameters["b"]
    assert f"{b.value:.6g} +- {b.std:.2g} [95 %: {b.interval95[0]:.6g}" in report
    data = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert data["parameters"]["b"]["interval95"] == list(b.interval95)
    assert data["correlations"]["a,b"] == pytest.approx(result.correlation[0, 1])
    assert data["data_hash"] == result.problem.data_hash


def test_quantiles_are_students(models):
    y = 4.0 - 0.3 * X + 0.1 * np.random.default_rng(1).normal(size=N)
    result = line_fit(models, y, None)
    b = result.parameters["b"]
    levels = np.array([0.025, 0.3, 0.5, 0.975])
    expected = scipy.stats.t(N - 2, b.value, b.std).ppf(levels)
    np.testing.assert_allclose(result.quantiles("b", levels), expected, rtol=1e-9)
