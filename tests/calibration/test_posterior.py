"""What is said of draws, and what they predict: closed forms and draws made by NumPy."""

import math

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from calibration import Dataset, Parameter, Problem, StudentT, sample, with_predictions
from calibration.posterior import as_tree
from calibration.progress import reporting
from calibration.samplers import driver
from calibration.samplers.driver import Steps
from calibration.sampling import _engine
from procmodel.errors import InputError

N = 12
X = np.linspace(0.0, 4.0, N)
SIGMA = np.linspace(0.2, 0.5, N)
Y = 1.0 + 0.5 * X + SIGMA * np.random.default_rng(0).normal(size=N)
DESIGN = np.stack([np.ones(N), X], axis=1)
X2 = np.linspace(1.0, 3.0, 20)
Y2 = -1.0 + 0.5 * X2 + 0.1 * np.random.default_rng(1).normal(size=20)


def plain(models, y=Y):
    return Problem.from_function(
        models.line, {"a": Parameter(0.0), "b": Parameter(0.0)}, X, y, SIGMA
    )


def tree_of(problem, positions, trouble=None):
    """What is made of positions of shape (steps, ensembles, walkers, p)."""
    shape = positions.shape[:-1]
    trouble = np.zeros(shape, bool) if trouble is None else trouble
    steps = Steps(positions, np.zeros(shape), np.ones(shape, bool), trouble)
    return as_tree(problem, steps, np.random.default_rng(0), {"sampler": "test"})


def independent(steps, ensembles, walkers, seed=0):
    return np.random.default_rng(seed).normal(size=(steps, ensembles, walkers, 2))


def autoregressive(steps, ensembles, walkers, share):
    """Normal draws, each keeping a share of the last: (1 + share) / (1 - share) steps apart."""
    innovations = independent(steps + 2000, ensembles, walkers) * math.sqrt(1 - share**2)
    return scipy.signal.lfilter([1.0], [1.0, -share], innovations, axis=0)[2000:]


def failings(attrs):
    """Which criteria are missed, by the status sentence, which has to agree with `converged`."""
    words = {
        "autocorrelation times are wanted": "length",
        "R-hat of at most": "R-hat",
        "effective draws are wanted": "effective",
        "diverged": "divergences",
    }
    assert attrs["converged"] == int(attrs["status"].startswith("converged: "))
    missed = attrs["status"].partition("where ")[2]
    return {short for text, short in words.items() if text in missed}


def test_independent_draws_are_converged(models):
    assert failings(tree_of(plain(models), independent(2000, 2, 8)).attrs) == set()
    chains = tree_of(plain(models), independent(1000, 4, 1)).attrs
    assert failings(chains) == set()
    assert chains["ess_bulk"] == pytest.approx(4000, rel=0.15)


def test_a_slow_walk_is_too_short_until_it_is_as_long_as_said(models):
    # The closed form: (1 + 0.99) / (1 - 0.99) = 199 steps, so that 4000 are 20 times that.
    attrs = tree_of(plain(models), autoregressive(4000, 2, 16, 0.99)).attrs
    assert "length" in failings(attrs)
    assert attrs["autocorrelation_steps"] == pytest.approx(199, rel=0.35)
    needed = int(attrs["status"].split("raise draws to ")[1])
    assert 0.65 * 50 * 199 < needed / 16 < 3 * 50 * 199
    long = tree_of(plain(models), autoregressive(3 * 50 * 199 // 2, 2, 16, 0.99)).attrs
    assert failings(long) == set(), long["status"]
    assert long["autocorrelation_steps"] == pytest.approx(199, rel=0.15)


def test_one_ensemble_elsewhere_is_seen_by_r_hat(models):
    positions = independent(2000, 3, 8)
    positions[:, 1] += 0.5
    attrs = tree_of(plain(models), positions).attrs
    assert "R-hat" in failings(attrs) and attrs["rhat"] > 1.03
    # The same draws, each ensemble with its share of those elsewhere, would do.
    mixed = np.random.default_rng(1).permutation(positions.swapaxes(0, 1).reshape(6000, 8, 2))
    assert failings(tree_of(plain(models), mixed.reshape(2000, 3, 8, 2)).attrs) == set()


def test_a_different_spread_is_seen_too(models):
    positions = independent(2000, 3, 8)
    positions[:, 1] *= 2.0
    assert "R-hat" in failings(tree_of(plain(models), positions).attrs)


def test_few_effective_draws_are_too_few(models):
    attrs = tree_of(plain(models), independent(60, 4, 1)).attrs
    assert "effective" in failings(attrs)
    assert "400 effective draws are wanted" in attrs["status"]
    assert int(attrs["status"].split("raise draws to ")[1]) > 60


@pytest.mark.parametrize(("share", "said"), [(0.05, {"divergences"}), (0.0005, set())])
def test_divergences_count(models, share, said):
    trouble = np.zeros((1000, 4, 1), bool)
    trouble.ravel()[: int(share * 4000)] = True
    tree = tree_of(plain(models), independent(1000, 4, 1), trouble)
    assert failings(tree.attrs) == said
    assert tree.attrs["divergences"] == int(share * 4000)
    assert int(tree["sample_stats"]["diverging"].sum()) == int(share * 4000)


def sum_of_squares(params, x):
    return params["r"] ** 2 + 0.0 * x


def test_ensembles_in_different_modes_are_not_converged():
    """r and -r explain the readings alike: walkers that start in one never see the other."""
    problem = Problem.from_function(
        sum_of_squares, {"r": Parameter(2.0, bounds=(-5.0, 5.0))}, X, np.full(N, 4.0), 0.1
    )
    cloud = np.random.default_rng(0).normal(0.0, 0.01, size=(2, 16, 1))
    rng = np.random.default_rng(0)

    def draws(centres):
        engine = _engine(problem, "stretch", cloud + np.reshape(centres, (2, 1, 1)), 500, 0)
        with reporting(None) as told:
            steps = driver.run(engine, 1500, None, told)
        return as_tree(problem, steps, rng, {})

    apart = draws([-2.0, 2.0])
    assert failings(apart.attrs) >= {"R-hat"} and apart.attrs["rhat"] > 1.5
    assert failings(draws([2.0, 2.0]).attrs) == set()


@pytest.fixture(scope="module")
def predicted(models):
    tree = sample(plain(models), seed=1, draws=32_000, ensembles=2)
    return tree, with_predictions(plain(models), tree, draws=4000, seed=5)


def test_predictions_of_a_linear_model(predicted):
    _, tree = predicted
    covariance = np.linalg.inv(DESIGN.T @ (DESIGN / SIGMA[:, None] ** 2))
    mean = DESIGN @ covariance @ DESIGN.T @ (Y / SIGMA**2)
    model = np.sqrt(np.einsum("ni,ij,nj->n", DESIGN, covariance, DESIGN))
    whole = np.sqrt(model**2 + SIGMA**2)
    # 8000 draws; those of the model are as independent as the walkers' steps.
    count = tree.attrs["steps"] * 16 * 2 / tree.attrs["autocorrelation_steps"]
    for group, spread in (("predictions_mean", model), ("posterior_predictive", whole)):
        draws = tree[group]["data"].values.reshape(-1, N)
        assert draws.shape == (8000, N)
        np.testing.assert_allclose(draws.mean(axis=0), mean, atol=4.5 * np.max(whole) / count**0.5)
        np.testing.assert_allclose(draws.std(axis=0) / spread, 1.0, atol=4.5 / (2 * count) ** 0.5)
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(draws.std(axis=0) / SIGMA, 1.0, atol=4.5 / (2 * count) ** 0.5)


def test_log_likelihood_against_scipy(predicted):
    before, tree = predicted
    picked = np.unique(np.linspace(0, before["posterior"].sizes["draw"] - 1, 4000).round())
    a, b = (before["posterior"][n].values[:, picked.astype(int), None] for n in "ab")
    expected = scipy.stats.norm.logpdf(Y, a + b * X, SIGMA)
    np.testing.assert_allclose(tree["log_likelihood"]["data"], expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(tree["predictions_mean"]["data"], a + b * X, atol=1e-12)
    assert "log_likelihood" not in before.children  # the draws given stay as they were


def test_seed_of_predictions(models, predicted):
    before, _ = predicted
    one, same, other = (
        with_predictions(plain(models), before, draws=50, seed=s)["posterior_predictive"]["data"]
        for s in (1, 1, 2)
    )
    assert one.shape == (2, 50, N)
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def two_sets(models, noise=None, sigma=None):
    options = {} if noise is None else {"noise": noise}
    datasets = {
        "first": Dataset(X, Y, sigma, own={"a": "a1"}),
        "second": Dataset(X2, Y2, sigma, own={"a": "a2"}, **options),
    }
    parameters = {"a1": Parameter(0.0), "a2": Parameter(0.0), "b": Parameter(0.0)}
    return Problem(parameters, datasets, models.line)


@pytest.fixture(scope="module")
def shared(models):
    problem = two_sets(models)
    tree = sample(problem, seed=2, draws=24_000, ensembles=2)
    return with_predictions(problem, tree, draws=6_000, seed=3), tree


def test_two_data_sets_with_a_noise_level_each(shared):
    tree, before = shared
    posterior = before["posterior"].dataset
    assert set(posterior.data_vars) == {"a1", "a2", "b", "noise_first", "noise_second"}
    picked = np.unique(np.linspace(0, posterior.sizes["draw"] - 1, 6_000).round()).astype(int)
    at = {name: posterior[name].values[:, picked, None] for name in posterior}
    for name, x, y, own in (("first", X, Y, "a1"), ("second", X2, Y2, "a2")):
        expected = scipy.stats.norm.logpdf(y, at[own] + at["b"] * x, at[f"noise_{name}"])
        np.testing.assert_allclose(tree["log_likelihood"][name], expected, rtol=1e-10, atol=1e-10)


def test_noise_levels_and_predictions_by_quadrature(shared):
    """The posterior of the slope alone is a product of two t densities; the rest follows from it.

    With the intercepts integrated out, each data set leaves S_i(b)^(-(n_i - 1) / 2), and given the
    slope sigma_i^-2 is a gamma variate of n_i - 1 degrees of freedom about S_i(b).
    """
    tree, before = shared
    slopes = np.linspace(0.0, 1.0, 4001)
    log_density, squares, centres = np.zeros(4001), {}, {}
    for name, x, y in (("first", X, Y), ("second", X2, Y2)):
        away = (y - y.mean())[:, None] - slopes * (x - x.mean())[:, None]
        squares[name] = np.sum(away**2, axis=0)
        log_density -= 0.5 * (len(y) - 1) * np.log(squares[name])
        centres[name] = y.mean() - slopes * x.mean()
    weights = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    count = 0.6 * before.attrs["steps"] * 32 / before.attrs["autocorrelation_steps"]
    mean = float(weights @ slopes)
    spread = math.sqrt(weights @ (slopes - mean) ** 2)
    assert before["posterior"]["b"].values.mean() == pytest.approx(
        mean, abs=4 * spread / count**0.5
    )
    for name, x, y in (("first", X, Y), ("second", X2, Y2)):
        freedom = len(y) - 1
        variance = weights @ squares[name] / (freedom - 2)
        found = before["posterior"][f"noise_{name}"].values ** 2
        assert found.mean() == pytest.approx(variance, abs=4 * found.std() / count**0.5)
        # A new reading: noise, intercept about its centre, slope.
        middle = centres[name][:, None] + slopes[:, None] * x
        mean_of_each = weights @ middle
        between = weights @ (middle - mean_of_each) ** 2
        expected = variance * (1.0 + 1.0 / len(y)) + between
        draws = tree["posterior_predictive"][name].values.reshape(-1, len(y))
        np.testing.assert_allclose(
            draws.mean(axis=0), mean_of_each, atol=4.5 * np.sqrt(expected.max() / count)
        )
        # The tails of t with 11 degrees of freedom make its variance err by 1.2 times a normal's.
        ratio = draws.var(axis=0) / expected
        np.testing.assert_allclose(ratio, 1.0, atol=5 * 1.2 * math.sqrt(2 / count))
    assert np.mean(before["posterior"]["noise_first"]) > 2 * np.mean(
        before["posterior"]["noise_second"]
    )


def test_predictions_follow_each_data_sets_own_noise(models):
    problem = two_sets(models, StudentT(3.0), 0.3)
    # Whatever the draws are, what they predict follows.
    tree = tree_of(problem, np.random.default_rng(4).normal(0.5, 0.1, size=(2000, 2, 1, 3)))
    found = with_predictions(problem, tree, draws=2000, seed=3)
    scatter = {
        name: (found["posterior_predictive"][name] - found["predictions_mean"][name]).values.ravel()
        for name in problem.datasets
    }
    # Kolmogorov and Smirnov, on draws of which each has its own noise.
    assert scipy.stats.kstest(scatter["first"] / 0.3, "norm").pvalue > 1e-3
    assert scipy.stats.kstest(scatter["second"] / 0.3, "t", (3.0,)).pvalue > 1e-3
    assert scipy.stats.kstest(scatter["second"] / 0.3, "norm").pvalue < 1e-6
    last = tree["posterior"].sizes["draw"] - 1
    at = {n: tree["posterior"][n].values[:, [0, last], None] for n in ("a2", "b")}
    expected = scipy.stats.t.logpdf((Y2 - at["a2"] - at["b"] * X2) / 0.3, 3.0) - math.log(0.3)
    likely = found["log_likelihood"]["second"].values[:, [0, -1]]
    np.testing.assert_allclose(likely, expected, rtol=1e-9)


def test_other_data_are_refused(models, predicted):
    with pytest.raises(InputError, match="the draws are of other data than the problem"):
        with_predictions(plain(models, Y + 0.01), predicted[0])


def test_a_parameter_called_noise_keeps_its_draws():
    """The estimated noise level must not take the name of a parameter."""
    problem = Problem.from_function(
        noise_and_slope, {"noise": Parameter(0.0), "b": Parameter(0.0)}, X, Y
    )
    positions = independent(200, 2, 4)
    tree = tree_of(problem, positions)
    assert set(tree["posterior"].data_vars) == {"noise", "b", "noise_level"}
    np.testing.assert_array_equal(
        np.sort(tree["posterior"]["noise"].values.ravel()), np.sort(positions[..., 0].ravel())
    )
    found = with_predictions(problem, tree, draws=800)
    at = {name: tree["posterior"][name].values[..., None] for name in tree["posterior"]}
    expected = scipy.stats.norm.logpdf(Y, at["noise"] + at["b"] * X, at["noise_level"])
    np.testing.assert_allclose(found["log_likelihood"]["data"], expected, rtol=1e-10)


def noise_and_slope(params, x):
    return params["noise"] + params["b"] * x
