"""Priors: their densities, and what they do to a fit."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from calibration import (
    Beta,
    Custom,
    Dataset,
    HalfNormal,
    LogNormal,
    Normal,
    Parameter,
    Problem,
    Truncated,
    Uniform,
    fit,
)
from procmodel.errors import InputError

X = np.linspace(0.0, 4.0, 9)
RNG = np.random.default_rng(5)
Y = 1.5 + 0.7 * X + 0.4 * RNG.normal(size=9)
DESIGN = np.stack([np.ones(9), X], axis=1)


def log_gamma(value):
    """Of the gamma distribution with shape 3 and scale 0.5."""
    return 2.0 * jnp.log(value) - value / 0.5


def log_exponential(value):
    return -value / 0.1


def log_cauchy(value):
    return -jnp.log1p(((value - 0.2) / 0.15) ** 2)


def log_normal_law(value):
    return -0.5 * ((value - 0.2) / 0.15) ** 2


DENSITIES = {
    "normal": (Normal(2.0, 0.5), scipy.stats.norm(2.0, 0.5), (0.1, 3.3)),
    "log-normal": (LogNormal(3.0, 0.4), scipy.stats.lognorm(0.4, scale=3.0), (0.2, 7.0)),
    "half-normal": (HalfNormal(1.7), scipy.stats.halfnorm(scale=1.7), (0.0, 4.0)),
    "uniform": (Uniform(-1.0, 3.0), scipy.stats.uniform(-1.0, 4.0), (-1.0, 2.9)),
    "beta": (Beta(2.0, 5.0, -1.0, 3.0), scipy.stats.beta(2.0, 5.0, -1.0, 4.0), (-0.9, 2.5)),
    "beta that falls": (Beta(1.0, 3.0), scipy.stats.beta(1.0, 3.0), (0.0, 0.95)),
    "beta that is flat": (Beta(1.0, 1.0), scipy.stats.beta(1.0, 1.0), (0.0, 1.0)),
    "truncated": (
        Truncated(Normal(2.0, 0.5), 1.8, 3.0),
        scipy.stats.truncnorm(-0.4, 2.0, 2.0, 0.5),
        (1.8, 2.9),
    ),
    "truncated on one side": (
        Truncated(Normal(-1.0, 0.5), low=0.0),
        scipy.stats.truncnorm(2.0, math.inf, -1.0, 0.5),
        (0.0, 1.4),
    ),
    "custom": (Custom(log_gamma, low=0.0), scipy.stats.gamma(3.0, scale=0.5), (0.1, 4.0)),
    "custom on a line": (Custom(log_cauchy), scipy.stats.cauchy(0.2, 0.15), (-3.0, 5.0)),
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


@pytest.mark.parametrize("name", DENSITIES)
def test_draws_follow_the_density(name):
    prior, reference, _ = DENSITIES[name]
    if isinstance(prior, Custom):
        with pytest.raises(InputError, match="no way to draw from it: use one of the named"):
            prior.draw(np.random.default_rng(0), 3)
        return
    drawn = prior.draw(np.random.default_rng(1), 5000)
    assert drawn.shape == (5000,)
    assert scipy.stats.kstest(drawn, reference.cdf).pvalue > 1e-3
    # Negative control: a twentieth of the spread further up is seen.
    assert scipy.stats.kstest(drawn + 0.1 * reference.std(), reference.cdf).pvalue < 1e-3


@pytest.mark.parametrize("name", DENSITIES)
def test_the_row_times_its_slope_is_the_gradient_of_the_cost(name):
    prior, reference, _ = DENSITIES[name]
    for value in reference.ppf([0.02, 0.3, 0.6, 0.97]):
        row, slope = jax.value_and_grad(prior.residual)(value)
        gradient = float(jax.grad(prior.cost)(value))
        assert float(row * slope) == pytest.approx(gradient, rel=1e-9, abs=1e-12)
        # The cost of a log-normal is per unit of the log; of all others it is the density's.
        step = 1e-5 * reference.std() if math.isfinite(reference.std()) else 1e-6
        ends = reference.logpdf([value - step, value + step])
        if not isinstance(prior, LogNormal):
            expected = -(ends[1] - ends[0]) / (2 * step)
            assert gradient == pytest.approx(expected, rel=1e-5, abs=1e-5)
        # A row that is not finite, or has no slope though there is a gradient, stops a solver.
        assert math.isfinite(row) and (slope != 0 or gradient == 0)


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
        (lambda: Normal(math.nan, 1.0), "mean is nan, but must be a finite number"),
        (lambda: Beta(0.5, 2.0), "shape a is 0.5, but must be at least 1"),
        (lambda: Beta(2.0, math.nan), "shape b is nan"),
        (lambda: Beta(2.0, 2.0, 1.0, 1.0), "beta prior needs finite low < high, not 1.0, 1.0"),
        (lambda: Beta(2.0, 2.0, 0.0, math.inf), "beta prior needs finite low < high"),
        (lambda: Truncated("normal", 0.0), "'normal' is not a prior: cut one such as Normal"),
        (lambda: Truncated(Uniform(0.0, 1.0), 2.0, 3.0), "zero between 2 and 3: cut elsewhere"),
        (lambda: Truncated(Normal(0.0, 1.0), 1.0, 1.0), "zero between 1 and 1"),
        (lambda: Truncated(Normal(0.0, 1.0), math.nan, 1.0), "needs numbers, not nan, 1.0"),
        (lambda: Custom(3.0), "prior function 3.0 cannot be called"),
        (lambda: Custom(log_gamma, 1.0, 0.0), "custom prior needs low < high, not 1.0, 0.0"),
        (
            lambda: Truncated(Normal(0.0, 1.0), 50.0).draw(np.random.default_rng(0), 2),
            "keeps almost none of its draws: cut it less far out",
        ),
    ],
)
def test_refusals(make, sentence):
    with pytest.raises(InputError, match=sentence) as found:
        make()
    assert "\n" not in str(found.value) and str(found.value).endswith(".")


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


def most_probable(a_prior, b_prior, start):
    """Mode of the posterior of the line and its standard deviations by the curvature there."""

    def cost(v):
        misfit = 0.5 * np.sum(((Y - v[0] - v[1] * X) / 0.4) ** 2)
        return misfit - a_prior.logpdf(v[0]) - b_prior.logpdf(v[1])

    options = {"xatol": 1e-10, "fatol": 1e-14, "maxiter": 2000}
    found = scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options).x
    steps, curvature = np.diag([1e-3, 1e-3]), np.empty((2, 2))
    for i, one in enumerate(steps):
        for j, other in enumerate(steps):
            corners = [
                cost(found + one + other),
                cost(found + one - other),
                cost(found - one + other),
                cost(found - one - other),
            ]
            curvature[i, j] = (corners[0] - corners[1] - corners[2] + corners[3]) / 4e-6
    return found, np.sqrt(np.diag(np.linalg.inv(curvature)))


BOTH = {
    "gamma and beta": (
        (Custom(log_gamma, low=0.0), scipy.stats.gamma(3.0, scale=0.5)),
        (Beta(2.0, 9.0, 0.0, 2.0), scipy.stats.beta(2.0, 9.0, 0.0, 2.0)),
    ),
    "truncated and exponential": (
        (Truncated(Normal(1.0, 0.2), 0.0, 2.0), scipy.stats.truncnorm(-5.0, 5.0, 1.0, 0.2)),
        (Custom(log_exponential, low=0.0), scipy.stats.expon(scale=0.1)),
    ),
    "truncated and Cauchy": (
        (Truncated(Normal(1.0, 0.2), 0.0, 2.0), scipy.stats.truncnorm(-5.0, 5.0, 1.0, 0.2)),
        (Custom(log_cauchy), scipy.stats.cauchy(0.2, 0.15)),
    ),
}


@pytest.mark.parametrize("name", BOTH)
def test_a_fit_ends_at_the_mode_of_the_posterior(models, name):
    (a_prior, a_law), (b_prior, b_law) = BOTH[name]
    result = fit(
        problem(models, Parameter(1.0, prior=a_prior), Parameter(0.5, prior=b_prior)),
    )
    assert result.converged, result.status
    expected, std = most_probable(a_law, b_law, [1.0, 0.5])
    for i, parameter in enumerate("ab"):
        found = result.parameters[parameter]
        assert found.value == pytest.approx(expected[i], abs=1e-5 * std[i])
        # A density that bends upwards, as Cauchy's does out here, takes information away; the
        # rows leave that out.
        assert found.std == pytest.approx(std[i], rel=1e-3 if "Cauchy" not in name else 0.1)
    # Without priors the optimum is another.
    free = [p.value for p in fit(problem(models)).parameters.values()]
    assert np.max(np.abs(expected - free) / std) > 0.3


def test_a_custom_prior_that_is_normal_is_the_normal_prior(models):
    result = fit(problem(models, b=Parameter(0.0, prior=Custom(log_normal_law))))
    covariance = np.linalg.inv(DESIGN.T @ DESIGN / 0.4**2 + np.diag([0.0, 1.0 / 0.15**2]))
    expected = covariance @ (DESIGN.T @ Y / 0.4**2 + [0.0, 0.2 / 0.15**2])
    for i, estimate in enumerate(result.parameters.values()):
        assert estimate.value == pytest.approx(expected[i], rel=1e-9)
        assert estimate.std == pytest.approx(math.sqrt(covariance[i, i]), rel=1e-9)


def test_a_truncated_prior_bounds_the_fit_where_it_ends(models):
    prior = Truncated(Normal(1.0, 0.3), 0.0, 0.4)
    b = fit(problem(models, b=Parameter(0.2, prior=prior))).parameters["b"]
    assert b.value == pytest.approx(0.4) and b.verdict == "one-sided"
    assert "upper bound 0.4" in b.reason
