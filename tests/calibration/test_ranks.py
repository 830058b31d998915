"""Simulation-based calibration: right samplers pass, wrong simulations do not."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from calibration import Custom, Dataset, Normal, Parameter, Problem, simulation_check
from calibration.ranks import uniformity
from procmodel.errors import InputError

X = np.linspace(0.0, 4.0, 8)
SIGMA = 0.5
REPEATS = {"stretch": 150, "emcee": 40, "nuts": 80}
STEPS = {
    "stretch": {"steps": 200, "warmup": 150},
    "emcee": {"steps": 50, "warmup": 30},
    "nuts": {"steps": 100, "warmup": 80},
}

SHORT = {"steps": 200, "warmup": 100}


def problem(models, **changed):
    parameters = {
        "a": Parameter(1.0, prior=Normal(1.0, 0.5)),
        "b": Parameter(0.5, bounds=(-1.0, 2.0), prior=Normal(0.5, 1.0)),
    }
    return Problem.from_function(models.line, parameters | changed, X, 0.0 * X, SIGMA)


def readings(noise=1.0, offset=0.0):
    """Readings by NumPy alone, with so many times the noise that sigma says."""

    def simulate(rng, values):
        exact = values["a"] + values["b"] * X + offset
        return {"data": exact + noise * SIGMA * rng.normal(size=len(X))}

    return simulate


@pytest.mark.slow
@pytest.mark.parametrize("sampler", REPEATS)
def test_right_samplers_pass(models, sampler):
    check = simulation_check(problem(models), REPEATS[sampler], 1, sampler, **STEPS[sampler])
    assert check.passed, check.report()
    assert check.sampler == sampler and check.failed == 0
    for ranks in check.ranks.values():
        assert len(ranks) == REPEATS[sampler]
        assert ranks.min() >= 0 and ranks.max() <= check.draws
    assert f"{REPEATS[sampler]} simulated calibrations, sampler {sampler}" in check.report()
    assert "uniform within the band" in check.report()


def test_a_simulation_of_ones_own_passes_where_it_is_right(models):
    check = simulation_check(problem(models), 100, 2, "stretch", simulate=readings(), **SHORT)
    assert check.passed, check.report()


@pytest.mark.parametrize("wrong", [{"noise": 1.6}, {"noise": 0.5}, {"offset": 0.3}])
def test_wrong_simulations_do_not_pass(models, wrong):
    check = simulation_check(
        problem(models), 100, 1, "stretch", simulate=readings(**wrong), **SHORT
    )
    assert not check.passed, check.report()
    assert "NOT uniform" in check.report()


def test_uniform_ranks_give_uniform_answers():
    rng = np.random.default_rng(0)
    answers = [uniformity(rng.integers(0, 33, 100), 32, seed) for seed in range(200)]
    # The statistic takes few values, so that its answers are at least as large as uniform ones.
    for level in (0.01, 0.05, 0.2, 0.5):
        expected = 200 * level
        assert np.sum(np.array(answers) <= level) <= scipy.stats.binom.ppf(0.9999, 200, level)
        assert np.sum(np.array(answers) <= 2.0 * level) >= 0.4 * expected


CLUSTERED = {
    "in the middle": lambda rng: rng.binomial(32, 0.5, 100),
    "at the ends": lambda rng: np.where(rng.uniform(size=100) < 0.5, 1, 31),
    "low": lambda rng: rng.binomial(32, 0.35, 100),
    "all the same": lambda rng: np.full(100, 16),
    "narrower by a third": lambda rng: np.round(32 * rng.beta(2.0, 2.0, 100)).astype(int),
}


@pytest.mark.parametrize("shape", CLUSTERED)
def test_clustered_ranks_are_caught(shape):
    assert uniformity(CLUSTERED[shape](np.random.default_rng(0)), 32) < 0.005


def test_ranks_at_either_end_count(models):
    # All posteriors above, or below, the truth.
    assert uniformity(np.zeros(50, int), 32) < 0.001
    assert uniformity(np.full(50, 32), 32) < 0.001


def test_progress_reaches_the_total(models):
    told = []
    simulation_check(
        problem(models), 3, 1, "stretch", steps=50, warmup=20,
        progress=lambda *report: told.append(report),
    )  # fmt: skip
    assert told == [("calibrations", None, 0)] + [("calibrations", i, 3) for i in (1, 2, 3)]


def test_same_seed_same_check(models):
    options = {"steps": 50, "warmup": 20}
    one, same, other = (
        simulation_check(problem(models), 5, seed, "stretch", **options).ranks["a"]
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def flat(value):
    return -0.5 * value**2


def double(params):
    return 2.0 * params["b"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"a": Parameter(1.0)}, "'a' has neither a prior nor finite bounds"),
        ({"a": Parameter(1.0, prior=Custom(flat))}, "has no way to draw from it"),
        (
            {"twice": Parameter(0.0, prior=Normal(1.0, 1.0), tied=double)},
            "'twice' is tied and has a prior",
        ),
    ],
)
def test_priors_that_cannot_be_drawn_from_are_refused(models, changed, words):
    with pytest.raises(InputError, match=words):
        simulation_check(problem(models, **changed), 5)


def test_other_refusals(models):
    unknown = Problem(problem(models).parameters, {"data": Dataset(X, 0.0 * X)}, models.line)
    with pytest.raises(InputError, match="needs to know the noise"):
        simulation_check(unknown, 5)
    with pytest.raises(InputError, match="repeats is 0"):
        simulation_check(problem(models), 0)
    # A run too short for a single draw would rank nothing among nothing, and pass.
    with pytest.raises(InputError, match="steps is 40, too few to keep a draw"):
        simulation_check(problem(models), 3, sampler="stretch", steps=40)


def rooted(params, x):
    return params["a"] + jnp.sqrt(params["b"]) * x


def test_data_sets_keep_their_own_models_and_failed_repeats_are_counted(models):
    """One with a model of its own, which has no value below 0, beside one with the problem's."""
    datasets = {
        "own": Dataset(X, 0.0 * X, SIGMA, function=rooted),
        "shared": Dataset(X, 0.0 * X, SIGMA),
    }
    parameters = {
        "a": Parameter(1.0, prior=Normal(1.0, 0.5)),
        "b": Parameter(0.5, prior=Normal(1.0, 0.8)),
    }
    both = Problem(parameters, datasets, models.line)
    truths, told = [], []

    def simulate(rng, values):
        truths.append(values["b"])
        a, b = values["a"], values["b"]
        return {
            "own": a + np.sqrt(abs(b)) * X + SIGMA * rng.normal(size=len(X)),
            "shared": a + b * X + SIGMA * rng.normal(size=len(X)),
        }

    check = simulation_check(
        both, 60, 1, "stretch", simulate=simulate, **SHORT,
        progress=lambda *report: told.append(report),
    )  # fmt: skip
    # Fits start at the truth; below 0 there is none to start from.
    assert check.failed == np.sum(np.array(truths) < 0.0) > 2
    assert len(check.ranks["a"]) == 60 - check.failed
    assert f"{check.failed} failed" in check.report()
    assert told[-1] == ("calibrations", 60, 60)
    # The draws that failed are those of small slopes: what is left of the intercept's is uniform.
    assert check.p_values["a"] > 0.005, check.report()
