"""Draws from posteriors with a closed form; the DataTree; what is refused or not yet converged."""

import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import xarray

from calibration import BlackBox, Dataset, Normal, Parameter, Problem, fit, sample
from calibration.sampling import NUTS_FROM, _choice
from procmodel.errors import InputError

N = 12
X = np.linspace(0.0, 4.0, N)
Y = 1.0 + 0.5 * X + 0.3 * np.random.default_rng(0).normal(size=N)
DESIGN = np.stack([np.ones(N), X], axis=1)


def double_slope(params):
    return 2.0 * params["b"]


def problem(models, sigma, **changed):
    parameters = {
        "a": Parameter(0.0),
        "b": Parameter(0.0, "um/s", prior=Normal(0.6, 0.1)),
        "double": Parameter(0.0, tied=double_slope),
        "idle": Parameter(3.0, fixed=True),
    }
    return Problem(parameters | changed, {"data": Dataset(X, Y, sigma)}, models.line)


@pytest.fixture(scope="module")
def known(models):
    """A long run with known noise and a normal prior on the slope."""
    return sample(problem(models, 0.3), seed=3, draws=32_000, ensembles=2)


@pytest.fixture(scope="module")
def unknown(models):
    """A shorter run with the noise integrated out."""
    return sample(problem(models, None, b=Parameter(0.0)), seed=4, draws=12_000, ensembles=2)


def effective(tree):
    """Independent draws: all of them over the autocorrelation time."""
    steps = tree.attrs["steps"] * tree.attrs["walkers"] * tree.posterior.sizes["chain"]
    return steps / tree.attrs["autocorrelation_steps"]


def assert_moments(draws, mean, std, count, deviations=4.0):
    """Mean and standard deviation within Monte Carlo error of `count` independent draws."""
    draws = np.asarray(draws)
    assert abs(draws.mean() - mean) < deviations * std / math.sqrt(count)
    assert abs(draws.std() / std - 1.0) < deviations / math.sqrt(2.0 * count)


def test_known_noise_and_normal_prior_against_the_closed_form(known):
    covariance = np.linalg.inv(DESIGN.T @ DESIGN / 0.3**2 + np.diag([0.0, 1.0 / 0.1**2]))
    mean = covariance @ (DESIGN.T @ Y / 0.3**2 + [0.0, 0.6 / 0.1**2])
    std = np.sqrt(np.diag(covariance))
    count = effective(known)
    assert count > 500
    for i, name in enumerate("ab"):
        assert_moments(known.posterior[name], mean[i], std[i], count)
    correlation = np.corrcoef(
        known.posterior["a"].values.ravel(), known.posterior["b"].values.ravel()
    )
    expected = covariance[0, 1] / (std[0] * std[1])
    assert correlation[0, 1] == pytest.approx(
        expected, abs=4 * (1 - expected**2) / math.sqrt(count)
    )
    # A posterior a fifth too wide, or half a deviation off, would be seen.
    for wrong in ((mean[1], 1.2 * std[1]), (mean[1] + 0.5 * std[1], std[1])):
        with pytest.raises(AssertionError):
            assert_moments(known.posterior["b"], *wrong, count)


def test_unknown_noise_gives_students_spread(unknown):
    beta, inverse = np.linalg.lstsq(DESIGN, Y)[0], np.linalg.inv(DESIGN.T @ DESIGN)
    square = float(np.sum((Y - DESIGN @ beta) ** 2))
    freedom = N - 2
    level = math.sqrt(square / freedom)
    count = effective(unknown)
    for i, name in enumerate("ab"):
        scale = level * math.sqrt(inverse[i, i])
        expected = scipy.stats.t(freedom, beta[i], scale)
        draws = unknown.posterior[name].values.ravel()
        # The tails make the spread of the spread larger than a normal's.
        assert_moments(draws, beta[i], expected.std(), 0.6 * count)
        # The normal's spread is too narrow: 10 degrees of freedom widen it by a ninth.
        share = np.mean(np.abs(draws - beta[i]) > 1.96 * scale)
        exact = 2 * scipy.stats.t(freedom).sf(1.96)
        assert share == pytest.approx(exact, abs=4 * math.sqrt(exact / count))
    precision = 1.0 / unknown.posterior["noise"].values ** 2
    expected = scipy.stats.gamma(freedom / 2, scale=2.0 / square)
    assert_moments(precision, expected.mean(), expected.std(), 0.6 * count)


def test_groups_attributes_and_tied_parameters(known, unknown, models):
    assert {"posterior", "sample_stats", "observed_data"} <= set(known.children)
    posterior = known["posterior"].dataset
    assert set(posterior.data_vars) == {"a", "b", "double"}
    assert set(unknown["posterior"].dataset.data_vars) == {"a", "b", "double", "noise"}
    assert posterior["a"].dims == ("chain", "draw") and posterior.sizes["chain"] == 2
    assert posterior.sizes["draw"] == known.attrs["steps"] * known.attrs["walkers"] >= 32_000
    np.testing.assert_allclose(posterior["double"], 2.0 * posterior["b"], rtol=1e-14)
    np.testing.assert_array_equal(known["observed_data"].dataset["data"], Y)
    assert known.attrs["data_hash"] == problem(models, 0.3).data_hash
    assert known.attrs["sampler"] == "stretch" and known.attrs["seed"] == 3
    assert 0.2 < known.attrs["acceptance"] < 0.9
    json.dumps(known.attrs)


def test_log_density_of_the_draws(known):
    draws = {name: known.posterior[name].values[0, :50] for name in "ab"}
    misfit = (Y[:, None] - draws["a"] - X[:, None] * draws["b"]) / 0.3
    expected = -0.5 * np.sum(misfit**2, axis=0) - 0.5 * ((draws["b"] - 0.6) / 0.1) ** 2
    found = known["sample_stats"].dataset["lp"].values[0, :50]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), atol=1e-9)


def test_long_run_is_converged_and_a_short_one_is_not(known, models):
    assert known.attrs["converged"] == 1
    assert known.attrs["status"].startswith("converged: ")
    assert known.attrs["rhat"] <= 1.01
    assert min(known.attrs["ess_bulk"], known.attrs["ess_tail"]) >= 2 * 100
    short = sample(problem(models, 0.3), seed=3, draws=800, ensembles=2)
    assert short.attrs["converged"] == 0
    status = short.attrs["status"]
    assert status.startswith("not converged: ")
    assert "50 autocorrelation times are wanted" in status
    # Doing what it says works, though a short run, which cannot tell how slow it is, has to say it
    # more than once.
    attrs, wanted = short.attrs, 0
    for _ in range(4):
        if not attrs["converged"]:
            wanted = int(attrs["status"].split("raise draws to ")[1])
            attrs = sample(problem(models, 0.3), 3, wanted, ensembles=2).attrs
    assert attrs["converged"] == 1 and 4000 < wanted < 100_000


@pytest.mark.parametrize("sampler", ["stretch", "emcee"])
def test_same_seed_same_draws(models, sampler):
    def draws(seed):
        tree = sample(problem(models, 0.3), seed, 800, sampler, ensembles=2)
        return tree.posterior["a"].values

    one = draws(7)
    np.testing.assert_array_equal(one, draws(7))
    assert not np.array_equal(one, draws(8))
    # The two ensembles are independent of each other.
    assert not np.array_equal(one[0], one[1])


def test_save_and_load(known, tmp_path):
    path = tmp_path / "posterior.nc"
    known.to_netcdf(path, engine="h5netcdf")
    with xarray.open_datatree(path, engine="h5netcdf") as loaded:
        np.testing.assert_array_equal(loaded["posterior"]["b"], known["posterior"]["b"])
        np.testing.assert_array_equal(loaded["sample_stats"]["lp"], known["sample_stats"]["lp"])
        np.testing.assert_array_equal(loaded["observed_data"]["data"], Y)
        assert set(loaded.attrs) == set(known.attrs)
        for name, value in known.attrs.items():
            assert loaded.attrs[name] == value


def slope_only(params, x):
    return params["b"] * x


def test_draws_stay_inside_the_bounds_and_follow_the_cut_normal():
    # Free optimum at -0.2 deviations: the posterior on b >= 0 is a cut normal.
    std = 0.5 / math.sqrt(float(X @ X))
    y = -0.2 * std * X
    parameters = {"b": Parameter(0.1, bounds=(0.0, 10.0))}
    tree = sample(
        Problem.from_function(slope_only, parameters, X, y, 0.5), seed=5, draws=8000, ensembles=2
    )
    draws = tree.posterior["b"].values
    assert draws.min() >= 0.0
    cut = scipy.stats.truncnorm(0.2, np.inf, loc=-0.2 * std, scale=std)
    assert_moments(draws, cut.mean(), cut.std(), 0.6 * effective(tree))


def product(params, x):
    return params["a"] * params["b"] * jnp.asarray(x)


def test_a_posterior_that_cannot_be_normalised_is_refused():
    open_ended = {"a": Parameter(1.0), "b": Parameter(1.0, bounds=(0.1, 10.0))}
    with pytest.raises(InputError, match=r"posterior of 'a' cannot be normalised.* finite bounds"):
        sample(Problem.from_function(product, open_ended, X, 2.0 * X, 0.1), draws=64)


def test_bounds_belong_to_the_problem_and_not_to_what_was_compiled():
    for lowest in (0.0, -1.0):
        parameters = {"b": Parameter(0.1, bounds=(lowest, 10.0))}
        tree = sample(
            Problem.from_function(slope_only, parameters, X, 0.0 * X, 0.5),
            seed=5, draws=8000, ensembles=2,
        )  # fmt: skip
        least = tree.posterior["b"].values.min()
        assert least >= lowest and (least < -0.05) == (lowest < 0.0)


def test_emcee_draws_the_same_posterior(known, models):
    tree = sample(problem(models, 0.3), 6, 8000, "emcee", ensembles=2)
    assert tree.attrs["sampler"] == "emcee"
    for name in "ab":
        draws = known.posterior[name].values
        assert_moments(tree.posterior[name], draws.mean(), draws.std(), 0.6 * effective(tree))


def eight_columns(params, x):
    return x @ jnp.stack([params[f"c{i}"] for i in range(8)])


def eight(free):
    """A linear model of eight parameters, correlated, of which some are fixed at what they are."""
    rng = np.random.default_rng(1)
    design = rng.normal(size=(25, 8)) + 1.5 * rng.normal(size=(25, 1))
    truth = np.arange(8.0)
    y = design @ truth + 0.4 * rng.normal(size=25)
    parameters = {f"c{i}": Parameter(truth[i], fixed=i >= free) for i in range(8)}
    return design, y, Problem.from_function(eight_columns, parameters, design, y, 0.4)


def test_five_correlated_parameters():
    design, y, linear = eight(free=5)
    tree = sample(linear, seed=2, draws=80_000, sampler="stretch", ensembles=2)
    assert tree.attrs["converged"] == 1, tree.attrs["status"]
    assert tree.attrs["sampler_reason"] == "asked for"
    covariance = 0.4**2 * np.linalg.inv(design[:, :5].T @ design[:, :5])
    mean = covariance @ design[:, :5].T @ (y - design[:, 5:] @ np.arange(5.0, 8.0)) / 0.4**2
    count = effective(tree)
    flat = np.stack([tree.posterior[f"c{i}"].values.ravel() for i in range(5)])
    for i in range(5):
        assert_moments(flat[i], mean[i], math.sqrt(covariance[i, i]), count)
    expected = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.min(expected) < -0.3
    np.testing.assert_allclose(np.corrcoef(flat), expected, atol=4 / math.sqrt(count))
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(np.corrcoef(flat), np.eye(5), atol=4 / math.sqrt(count))


def test_auto_changes_over_at_so_many_parameters():
    # test_nuts.py has a run of eight; two more fits would only cost time here.
    below, above = eight(free=NUTS_FROM - 1)[2], eight(free=NUTS_FROM)[2]
    said = f"auto: {NUTS_FROM - 1} free parameters, fewer than {NUTS_FROM}"
    assert _choice(below, "auto") == ("stretch", said)
    said = f"auto: {NUTS_FROM} free parameters, and gradients pay from {NUTS_FROM} on"
    assert _choice(above, "auto") == ("nuts", said)
    assert _choice(above, "emcee") == ("emcee", "asked for")


def numpy_line(params, x):
    assert isinstance(params["a"], float)
    return params["a"] + params["b"] * np.asarray(x)


def test_auto_takes_emcee_for_a_black_box(models):
    black = Problem.from_function(
        BlackBox(numpy_line), {"a": Parameter(0.0), "b": Parameter(0.0)}, X, Y, 0.3
    )
    tree = sample(black, draws=320, ensembles=2)
    assert tree.attrs["sampler"] == "emcee"
    assert tree.attrs["sampler_reason"] == "auto: the model is a black box"


def test_refusals(models):
    with pytest.raises(InputError, match="sampler 'emce' is unknown; did you mean 'emcee'"):
        sample(problem(models, 0.3), sampler="emce")
    with pytest.raises(InputError, match="walkers is 3, but must be even and at least 4"):
        sample(problem(models, 0.3), walkers=3)
    with pytest.raises(InputError, match="ensembles must be at least 2"):
        sample(problem(models, 0.3), ensembles=1)
    with pytest.raises(InputError, match="draws at least 16"):
        sample(problem(models, 0.3), draws=5)
    failed = fit(problem(models, 0.3), max_steps=1)
    with pytest.raises(InputError, match="the fit that sampling starts from failed"):
        sample(problem(models, 0.3), start=failed)
    other = fit(problem(models, 0.4))
    with pytest.raises(InputError, match="start is the fit of another problem"):
        sample(problem(models, 0.3), start=other)
