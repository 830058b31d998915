"""Priors: their densities, and what they do to a fit."""

import math

import jax
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from calibration import Dataset, HalfNormal, LogNormal, Normal, Parameter, Problem, Uniform, fit
from procmodel.errors import InputError

X = np.linspace(0.0, 4.0, 9)
RNG = np.random.default_rng(5)
Y = 1.5 + 0.7 * X + 0.4 * RNG.normal(size=9)
DESIGN = np.stack([np.ones(9), X], axis=1)

DENSITIES = {
    "normal": (Normal(2.0, 0.5), scipy.stats.norm(2.0, 0.5), (0.1, 3.3)),
    "log-normal": (LogNormal(3.0, 0.4), scipy.stats.lognorm(0.4, scale=3.0), (0.2, 7.0)),
    "half-normal": (HalfNormal(1.7), scipy.stats.halfnorm(scale=1.7), (0.0, 4.0)),
    "uniform": (Uniform(-1.0, 3.0), scipy.stats.uniform(-1.0, 4.0), (-1.0, 2.9)),
}


@pytest.mark.parametrize("name", DENSITIES)
def test_log_density_up_to_a_constant(name):
    prior, reference, (low, high) = DENSITIES[name]
    found = float(prior.log_density(np.float64(high))) - float(prior.log_density(np.float64(low)))
    assert found == pytest.approx(reference.logpdf(high) - reference.logpdf(low), abs=1e-12)


@pytest.mark.parametrize("name", DENSITIES)
def test_support(name):
    prior, reference, _ = DENSITIES[name]
    assert prior.support == reference.support()
    for edge, outwards in zip(prior.support, (-1.0, 1.0), strict=True):
        if math.isfinite(edge):
            outside = edge + outwards * 0.1
            assert float(prior.log_density(np.float64(outside))) == -math.inf
            assert float(jax.grad(prior.log_density)(outside)) == 0.0


@pytest.mark.parametrize(
    ("prior", "offset"),
    [(Normal(2.0, 0.5), 0.0), (HalfNormal(1.7), 0.0), (LogNormal(3.0, 0.4), 1.0)],
)
def test_half_the_squared_residual_is_minus_the_log_density(prior, offset):
    # The log-normal's is per unit of log(value): log(value) apart from that of the value.
    at = np.array([0.7, 2.9])
    misfit = 0.5 * np.array([float(prior.residual(v)) ** 2 for v in at])
    density = np.array([float(prior.log_density(v)) for v in at]) + offset * np.log(at)
    assert np.diff(misfit) == pytest.approx(-np.diff(density), rel=1e-12)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Normal(0.0, 0.0), "std is 0.0, but must be a number above 0"),
        (lambda: Normal(0.0, math.nan), "std is nan"),
        (lambda: HalfNormal(-1.0), "std is -1.0"),
        (lambda: LogNormal(0.0, 1.0), "median is 0.0"),
        (lambda: LogNormal(1.0, math.inf), "log_std is inf"),
        (lambda: Uniform(1.0, 1.0), "finite low < high"),
        (lambda: Uniform(0.0, math.inf), "finite low < high"),
    ],
)
def test_refusals(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


def problem(models, a=None, b=None, sigma=0.4):
    parameters = {"a": a or Parameter(0.0), "b": b or Parameter(0.0)}
    return Problem(parameters, {"data": Dataset(X, Y, sigma)}, models.line)


def test_normal_priors_on_a_line_give_the_closed_form_posterior(models):
    mean, std = np.array([1.0, 0.2]), np.array([0.3, 0.15])
    a, b = (Parameter(0.0, prior=Normal(m, s)) for m, s in zip(mean, std, strict=True))
    result = fit(problem(models, a, b))
    precision = DESIGN.T @ DESIGN / 0.4**2 + np.diag(1.0 / std**2)
    covariance = np.linalg.inv(precision)
    expected = covariance @ (DESIGN.T @ Y / 0.4**2 + mean / std**2)
    for i, name in enumerate("ab"):
        estimate = result.parameters[name]
        assert estimate.value == pytest.approx(expected[i], rel=1e-10)
        assert estimate.std == pytest.approx(np.sqrt(covariance[i, i]), rel=1e-10)
        reach = scipy.stats.norm.ppf(0.975) * estimate.std
        assert estimate.interval95 == pytest.approx((expected[i] - reach, expected[i] + reach))
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-9)
    # The priors pull: without them the answer is another.
    free = fit(problem(models))
    assert abs(free.parameters["b"].value - expected[1]) > 0.05


def test_a_parameter_that_only_its_prior_knows_is_called_flat(models):
    def without_a(params, x):
        return params["b"] * x

    parameters = {"a": Parameter(3.0, prior=Normal(2.0, 0.5)), "b": Parameter(0.0)}
    result = fit(Problem.from_function(without_a, parameters, X, Y, 0.4))
    a = result.parameters["a"]
    assert a.value == pytest.approx(2.0) and a.std == pytest.approx(0.5)
    assert a.verdict == "flat" and "prior alone" in a.reason
    assert "a has no effect on any reading" in result.report()
    assert result.parameters["b"].verdict == "identified"


def objective(prior_term):
    """Least squares with another prior on b, minimised by scipy on the profile over a."""

    def misfit(v):
        return np.sum(((Y - v[0] - v[1] * X) / 0.4) ** 2) + prior_term(v[1])

    found = scipy.optimize.minimize(
        misfit, [1.0, 0.5], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13}
    )
    return found.x


def test_log_normal_prior_pulls_to_the_optimum_of_its_residual(models):
    b = Parameter(0.5, prior=LogNormal(0.2, 0.3))
    found = fit(problem(models, b=b)).parameters["b"].value
    expected = objective(lambda v: (np.log(max(v, 1e-12) / 0.2) / 0.3) ** 2)[1]
    assert found == pytest.approx(expected, rel=1e-6)
    assert abs(found - fit(problem(models)).parameters["b"].value) > 0.05


def test_half_normal_prior_pulls_to_zero_and_never_below(models):
    b = Parameter(0.5, prior=HalfNormal(0.1))
    found = fit(problem(models, b=b)).parameters["b"].value
    precision = DESIGN.T @ DESIGN / 0.4**2 + np.diag([0.0, 1.0 / 0.1**2])
    expected = np.linalg.solve(precision, DESIGN.T @ Y / 0.4**2)[1]
    assert found == pytest.approx(expected, rel=1e-7)
    # Readings that fall leave it at 0, which is said.
    falling = Problem(
        {"a": Parameter(0.0), "b": Parameter(0.5, prior=HalfNormal(0.1))},
        {"data": Dataset(X, -Y, 0.4)},
        models.line,
    )
    held = fit(falling).parameters["b"]
    assert held.value == 0.0
    assert held.verdict == "one-sided" and "lower bound 0" in held.reason


def test_an_interval_does_not_reach_where_the_prior_is_zero(models):
    weak = Problem(
        {"a": Parameter(0.0), "b": Parameter(0.5, prior=HalfNormal(0.1))},
        {"data": Dataset(X, 0.1 * X, 2.0)},
        models.line,
    )
    estimate = fit(weak).parameters["b"]
    assert estimate.interval95[0] >= 0.0
    assert estimate.verdict != "identified"


def test_a_wide_uniform_prior_changes_nothing(models):
    # Inside its range it says nothing, so it is no reading: value, std and Student's t stay.
    with_prior = fit(problem(models, b=Parameter(0.0, prior=Uniform(-50.0, 50.0)), sigma=None))
    without = fit(problem(models, sigma=None))
    assert with_prior.degrees_of_freedom == without.degrees_of_freedom == 7
    for name in "ab":
        one, other = with_prior.parameters[name], without.parameters[name]
        assert one.value == pytest.approx(other.value, rel=1e-7)
        assert one.std == pytest.approx(other.std, rel=1e-7)
        assert one.interval95 == pytest.approx(other.interval95, rel=1e-7)


def test_a_uniform_prior_bounds_the_fit(models):
    result = fit(problem(models, b=Parameter(0.2, prior=Uniform(0.0, 0.3))))
    b = result.parameters["b"]
    assert b.value == pytest.approx(0.3) and b.verdict == "one-sided"
    assert "upper bound 0.3" in b.reason


def test_a_uniform_prior_does_not_stand_for_a_reading(models):
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0, prior=Uniform(-1.0, 1.0))}
    one_reading = {"data": Dataset(X[:1], Y[:1], 0.4)}
    with pytest.raises(InputError, match="1 readings cannot fit 2"):
        fit(Problem(parameters, one_reading, models.line))
