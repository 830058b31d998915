"""The no-U-turn sampler: bounded and correlated posteriors in closed form, coordinates, trouble."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from calibration import Normal, Parameter, Problem, sample
from calibration.samplers.unbounded import Unbounded
from calibration.sampling import NUTS_FROM
from procmodel.errors import InputError

EYE = np.eye(4)
# Where readings alone would put each parameter, in deviations of 0.5 from its bound.
PULLS = {"between": -0.4, "above": -1.0, "below": 0.3, "line": 0.7}
BOUNDS = {
    "between": (0.0, 0.8),
    "above": (0.0, np.inf),
    "below": (-np.inf, 0.0),
    "line": (-np.inf, np.inf),
}
NAMES = tuple(f"c{i}" for i in range(8))


def each_its_own(params, x):
    """One reading for each parameter, so that the posterior falls apart into its marginals."""
    return x @ jnp.stack([params[name] for name in BOUNDS])


def linear(params, x):
    return x @ jnp.stack([params[name] for name in NAMES])


def funnel(params, x):
    """The width of x, y and z is exp(v), over many orders of magnitude."""
    return jnp.stack([params[name] for name in "xyz"]) * jnp.exp(-params["v"]) * x


def effective(tree, name):
    """Independent draws, by the variance of batch means: an algorithm other than the library's."""
    draws = np.asarray(tree["posterior"][name])
    batches = draws[:, : draws.shape[1] // 25 * 25].reshape(draws.shape[0], 25, -1)
    error = np.var(batches.mean(axis=-1), ddof=1) / (batches.shape[0] * 25)
    return min(float(np.var(draws) / error), draws.size)


def assert_moments(draws, mean, std, count, deviations=4.0):
    draws = np.asarray(draws)
    assert abs(draws.mean() - mean) < deviations * std / math.sqrt(count)
    # The batches give `count` to a fifth or so; a spread's error is that of a normal's or less.
    assert abs(draws.std() / std - 1.0) < deviations / math.sqrt(1.2 * count)


@pytest.fixture(scope="module")
def bounded():
    """A parameter between two bounds, one above one, one below one and one free."""
    starts = {"between": 0.4, "above": 0.3, "below": -0.3, "line": 0.0}
    parameters = {n: Parameter(starts[n], bounds=BOUNDS[n]) for n in BOUNDS}
    y = np.array([0.5 * PULLS[n] for n in BOUNDS])
    problem = Problem.from_function(each_its_own, parameters, EYE, y, 0.5)
    return problem, sample(problem, seed=1, draws=1500, sampler="nuts")


def cut_normal(problem, name):
    centre = float(problem.datasets["data"].y[list(BOUNDS).index(name)])
    low, high = ((bound - centre) / 0.5 for bound in BOUNDS[name])
    return scipy.stats.truncnorm(low, high, loc=centre, scale=0.5)


@pytest.mark.parametrize("name", BOUNDS)
def test_bounded_parameters_follow_the_cut_normal(bounded, name):
    problem, tree = bounded
    assert tree.attrs["converged"] == 1, tree.attrs["status"]
    expected = cut_normal(problem, name)
    draws = tree["posterior"][name].values.ravel()
    count = effective(tree, name)
    assert count > 1000
    assert draws.min() > BOUNDS[name][0] and draws.max() < BOUNDS[name][1]
    # The densities are flatter than a normal's at their ends, so that spreads err no more.
    assert_moments(draws, expected.mean(), expected.std(), 0.6 * count)
    # Mass right at the bound, where a missing volume ratio would double it or drive it away.
    for end, share in ((BOUNDS[name][0], 0.05), (BOUNDS[name][1], 0.95)):
        if np.isfinite(end):
            edge = expected.ppf(share)
            found = np.mean(draws < edge) if share < 0.5 else np.mean(draws > edge)
            assert found == pytest.approx(0.05, abs=4 * math.sqrt(0.05 * 0.95 / (0.5 * count)))
    with pytest.raises(AssertionError):
        assert_moments(draws, expected.mean() + 0.3 * expected.std(), expected.std(), 0.6 * count)


def test_log_density_is_that_of_natural_values(bounded):
    # Without the volume ratio of the coordinates that the sampler works in.
    problem, tree = bounded
    draws = {n: tree["posterior"][n].values[1, :40] for n in BOUNDS}
    misfit = [(draws[n] - y) / 0.5 for n, y in zip(BOUNDS, problem.datasets["data"].y, strict=True)]
    expected = -0.5 * np.sum(np.square(misfit), axis=0)
    found = tree["sample_stats"]["lp"].values[1, :40]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), atol=1e-9)


@pytest.fixture(scope="module")
def correlated():
    """Eight strongly correlated parameters, noise unknown: a t in eight dimensions."""
    rng = np.random.default_rng(2)
    design = rng.normal(size=(30, 8)) + 2.0 * rng.normal(size=(30, 1))
    y = design @ np.arange(1.0, 9.0) + 0.7 * rng.normal(size=30)
    parameters = {name: Parameter(0.0) for name in NAMES}
    problem = Problem.from_function(linear, parameters, design, y)
    return design, y, sample(problem, seed=2, draws=1500)


def test_auto_takes_nuts_for_many_parameters_and_says_so(correlated):
    attrs = correlated[2].attrs
    assert attrs["sampler"] == "nuts"
    assert attrs["sampler_reason"] == (
        f"auto: 8 free parameters, and gradients pay from {NUTS_FROM} on"
    )
    assert NUTS_FROM <= 8
    assert attrs["walkers"] == 1 and attrs["divergences"] == 0
    assert 0.6 < attrs["acceptance"] < 0.98


def test_eight_correlated_parameters_with_unknown_noise(correlated):
    design, y, tree = correlated
    assert tree.attrs["converged"] == 1, tree.attrs["status"]
    inverse = np.linalg.inv(design.T @ design)
    best = inverse @ design.T @ y
    freedom = 30 - 8
    level2 = float(np.sum((y - design @ best) ** 2)) / freedom
    covariance = level2 * inverse * freedom / (freedom - 2)
    count = min(effective(tree, name) for name in NAMES)
    assert count > 500
    for i, name in enumerate(NAMES):
        assert_moments(tree["posterior"][name], best[i], math.sqrt(covariance[i, i]), 0.6 * count)
    flat = np.stack([tree["posterior"][name].values.ravel() for name in NAMES])
    found, expected = (
        np.corrcoef(flat),
        covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance))),
    )
    assert np.min(expected) < -0.3
    np.testing.assert_allclose(found, expected, atol=5 / math.sqrt(0.6 * count))
    noise = tree["posterior"]["noise"].values
    precision = scipy.stats.gamma(freedom / 2, scale=2.0 / (level2 * freedom))
    assert_moments(noise**-2.0, precision.mean(), precision.std(), 0.5 * count)
    # Squared distances from the best fit follow an F distribution; a normal with the same
    # covariance of least squares would have the mean 1.
    away = flat - best[:, None]
    distance = np.einsum("in,ij,jn->n", away, design.T @ design / level2, away) / 8
    expected_f = scipy.stats.f(8, freedom)
    error = expected_f.std() / math.sqrt(0.5 * count)
    assert distance.mean() == pytest.approx(expected_f.mean(), abs=4 * error)
    assert abs(distance.mean() - 1.0) > 4 * error


@pytest.mark.slow
def test_divergences_are_named():
    parameters = {
        **{name: Parameter(0.1, bounds=(-1e6, 1e6)) for name in "xyz"},
        "v": Parameter(0.0, prior=Normal(0.0, 3.0)),
    }
    problem = Problem.from_function(funnel, parameters, np.ones(3), np.zeros(3), 1.0)
    tree = sample(problem, seed=3, draws=100, sampler="nuts", warmup=40)
    assert tree.attrs["divergences"] == int(tree["sample_stats"]["diverging"].sum()) > 4
    assert tree.attrs["converged"] == 0
    status = tree.attrs["status"]
    assert "of the moves diverged: another transform or sampler='stretch'" in status


KINDS = ("between", "above", "below", "line")
LOWER = np.array([-1.0, 2.0, -np.inf, -np.inf])
UPPER = np.array([4.0, np.inf, -3.0, np.inf])


@pytest.mark.parametrize("seed", range(5))
def test_volume_ratio_is_the_determinant(seed):
    coordinates = Unbounded.of(LOWER, UPPER)
    assert coordinates.kinds == KINDS
    point = np.random.default_rng(seed).normal(0.0, 3.0, 4)
    natural = jax.jit(lambda u: coordinates.natural(u, LOWER, UPPER)[0])
    volume = float(coordinates.natural(jnp.asarray(point), LOWER, UPPER)[1])
    matrix = np.asarray(jax.jacfwd(natural)(point))
    assert volume == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-12, abs=1e-12)
    # Central differences of second order: 1e-5 squared, and 1e-16 / 1e-5 of rounding.
    differences = [(natural(point + 1e-5 * e) - natural(point - 1e-5 * e)) / 2e-5 for e in EYE]
    assert volume == pytest.approx(np.linalg.slogdet(np.stack(differences))[1], abs=1e-6)
    back = coordinates.free(np.asarray(natural(point)), LOWER, UPPER)
    np.testing.assert_allclose(back, point, rtol=1e-9, atol=1e-9)
    # Without the bound's width it would be another number.
    assert abs(volume - math.log(5.0) - np.linalg.slogdet(matrix)[1]) > 0.1


@pytest.mark.parametrize("far", [-700.0, 700.0])
def test_far_out_coordinates_stay_finite_where_the_bounds_are(far):
    coordinates = Unbounded.of(LOWER[:1], UPPER[:1])
    value, volume = coordinates.natural(jnp.array([far]), LOWER[:1], UPPER[:1])
    assert LOWER[0] <= float(value[0]) <= UPPER[0]
    assert float(volume) == pytest.approx(math.log(5.0) - abs(far), rel=1e-12)
    slope = jax.grad(lambda u: coordinates.natural(u, LOWER[:1], UPPER[:1])[1])(jnp.array([far]))
    assert float(slope[0]) == pytest.approx(-np.sign(far))


def test_a_warm_up_too_short_to_adapt_is_refused(models):
    problem = Problem.from_function(
        models.line, {"a": Parameter(0.0), "b": Parameter(0.0)}, np.arange(4.0), np.arange(4.0), 1.0
    )
    with pytest.raises(InputError, match="warmup is 19, but must be at least 20 for nuts"):
        sample(problem, sampler="nuts", warmup=19)
