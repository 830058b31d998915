"""Fits from many starts: the global optimum, the waterfall, and what is said when it fails."""

import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from calibration import Dataset, LogNormal, Normal, Parameter, Problem, fit
from calibration.solvers.multistart import draw_starts, multistart, started_at
from procmodel.errors import InputError

X = np.linspace(0.0, 10.0, 40)
NOISE = 0.3 * np.random.default_rng(3).normal(size=40)


def sine(params, x):
    return params["a"] * jnp.sin(params["w"] * x)


def two_decays(params, x):
    return jnp.exp(-params["fast"] * x) + jnp.exp(-params["slow"] * x)


def logarithm(params, x):
    """Not a number where shift + x is below 0."""
    return params["scale"] * jnp.log(params["shift"] + x)


def nowhere(params, x):
    return jnp.sqrt(-1.0 - params["a"] ** 2) * x


def in_numpy(params, x):
    return np.sin(params["a"]) * x


def sine_problem(sigma=0.3, start=0.5, noise=NOISE):
    parameters = {
        "a": Parameter(1.0, bounds=(0.0, 10.0)),
        "w": Parameter(start, "rad/s", bounds=(0.1, 6.0)),
    }
    return Problem.from_function(sine, parameters, X, 2.0 * np.sin(2.7 * X) + noise, sigma)


def global_frequency():
    """The best frequency by a fine scan with the amplitude solved for, then Brent's method."""
    y = 2.0 * np.sin(2.7 * X) + NOISE

    def misfit(w):
        wave = np.sin(w * X)
        return float(np.sum((y - max(wave @ y / (wave @ wave), 0.0) * wave) ** 2))

    scan = np.linspace(0.1, 6.0, 4001)
    near = scan[int(np.argmin([misfit(w) for w in scan]))]
    found = scipy.optimize.minimize_scalar(
        misfit, (near - 2e-3, near, near + 2e-3), options={"xtol": 1e-12}
    )
    return found.x


@pytest.mark.parametrize("sigma", [0.3, None], ids=["known noise", "estimated noise"])
def test_the_best_frequency_of_a_sine_is_found(sigma):
    problem = sine_problem(sigma)
    # Negative control: from its own start the fit ends elsewhere, and converges there.
    alone = fit(problem)
    assert alone.converged and abs(alone.parameters["w"].value - 2.7) > 1.0
    found = multistart(problem)
    assert found.best.converged
    assert found.best.parameters["w"].value == pytest.approx(global_frequency(), rel=1e-6)
    assert found.best.problem is problem
    assert found.optima > 3 and 0.0 < found.share < 1.0
    assert found.share == np.mean(np.abs(found.values[:, 1] - 2.7) < 0.05)
    # The waterfall is sorted, and every start stands in it once.
    assert np.all(np.diff(found.costs) >= 0) and np.all(np.diff(found.optimum) >= 0)
    assert sorted(found.numbers) == list(range(1, 33))
    own = found.starts[found.numbers == 1][0]
    np.testing.assert_allclose(own, [1.0, 0.5])
    assert found.status.startswith(f"converged: {round(32 * found.share)} of 32 starts reached")
    assert not found.warnings


def test_the_report_and_the_dictionary():
    told = []
    found = multistart(sine_problem(), progress=lambda *seen: told.append(seen))
    lines = found.report().splitlines()
    assert lines[0] == "multistart of sine, 32 starts"
    assert "best of" in lines[1]
    head = next(i for i, line in enumerate(lines) if line.startswith("optimum"))
    rows = [line.split() for line in lines[head + 1 : head + 1 + found.optima]]
    assert [int(row[0]) for row in rows] == list(range(1, found.optima + 1))
    assert sum(int(row[1]) for row in rows) == 32
    assert float(rows[0][2]) == pytest.approx(found.costs[0], rel=1e-5)
    assert float(rows[0][5]) == pytest.approx(2.7, abs=0.05)
    assert told == [("starts", None, 0), ("starts", 32, 32)]
    data = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert data["optimum"] == found.optimum.tolist() and len(data["costs"]) == 32


def test_starts_fill_the_bounds_and_continue():
    few, many = draw_starts(sine_problem(), 31), draw_starts(sine_problem(), 64)
    for starts in (few, many):
        assert np.all((starts >= [0.0, 0.1]) & (starts <= [10.0, 6.0]))
    # More starts begin with the fewer.
    np.testing.assert_array_equal(many[:31], few)
    # Every eighth of the range has its share, which independent draws would not give.
    counts = np.histogram(many[:, 1], np.linspace(0.1, 6.0, 9))[0]
    assert np.all(counts == 8)
    np.testing.assert_array_equal(draw_starts(sine_problem(), 31), few)
    assert not np.array_equal(draw_starts(sine_problem(), 31, seed=1), few)
    found = multistart(sine_problem())
    np.testing.assert_allclose(found.starts[np.argsort(found.numbers)][1:], few)


def test_an_optimum_found_once_is_a_warning():
    # With 4 starts only one of them falls near the frequency.
    seeds = range(20)
    found = [multistart(sine_problem(), starts=4, seed=seed) for seed in seeds]
    once = [f for f in found if np.sum(f.optimum == 1) == 1]
    more = [f for f in found if np.sum(f.optimum == 1) > 1]
    assert once and more
    assert all(
        any("only once" in w and "raise starts to 16" in w for w in f.warnings) for f in once
    )
    assert not any("only once" in w for f in more for w in f.warnings)


def test_a_start_out_of_the_models_range_is_counted():
    x = np.linspace(0.0, 4.0, 12)
    y = 2.0 * np.log(1.5 + x)
    parameters = {
        "scale": Parameter(1.0, bounds=(0.1, 10.0)),
        "shift": Parameter(1.0, bounds=(-2.0, 4.0)),
    }
    found = multistart(Problem.from_function(logarithm, parameters, x, y, 0.1))
    bad = np.sum(found.starts[:, 1] <= 0.0)
    assert 5 < bad < 20
    assert np.sum(~np.isfinite(found.costs)) == bad
    assert np.all(found.optimum[~np.isfinite(found.costs)] == 0)
    (warning,) = found.warnings
    assert f"not finite at {bad} of 32 starts (number " in warning
    named = warning.split("number ")[1].split(",")[0]
    assert found.starts[found.numbers == int(named)][0, 1] <= 0.0
    assert found.best.parameters["shift"].value == pytest.approx(1.5, rel=1e-6)
    assert "not started" in found.report()
    json.dumps(found.as_dict(), allow_nan=False)


def test_when_all_starts_fail_the_status_says_so():
    x = np.linspace(0.1, 1.0, 5)
    problem = Problem.from_function(nowhere, {"a": Parameter(1.0)}, x, x, 0.1)
    found = multistart(problem, starts=4)
    assert found.status.startswith("failed: the model or its derivative is not finite at any of 4")
    assert not found.best.converged and found.share == 0.0 and found.optima == 0
    assert "failed" in found.report()


def test_parameters_that_change_places_are_told():
    x = np.linspace(0.0, 3.0, 15)
    y = np.exp(-0.4 * x) + np.exp(-3.0 * x)
    parameters = {
        name: Parameter(1.0, bounds=(1e-2, 1e2), transform="log") for name in ("fast", "slow")
    }
    found = multistart(Problem.from_function(two_decays, parameters, x, y, 0.01), starts=16)
    assert any("different values of fast, slow" in warning for warning in found.warnings)
    best = np.sort(found.values[found.optimum == 1], axis=1)
    np.testing.assert_allclose(best, np.tile([0.4, 3.0], (len(best), 1)), rtol=1e-5)
    # A log transform spreads the starts over the decades of the bounds.
    assert np.median(found.starts[1:, 0]) == pytest.approx(1.0, rel=0.5)


def drawn(models, **given):
    """Natural values of the starts of a and b."""
    options = given.pop("options", {})
    slope = Parameter(1.0, bounds=(0.0, math.inf), transform="log")
    parameters = {"a": Parameter(2.0), "b": slope} | given
    x = np.linspace(0.0, 1.0, 10)
    problem = Problem.from_function(models.line, parameters, x, 2.0 + x, 0.1)
    starts = draw_starts(problem, 32, **options)
    return np.array([problem.layout.free_values(start) for start in starts])


def test_where_starts_are_drawn_without_bounds(models):
    starts = drawn(models)
    # Ten times the size of the start to either side.
    assert np.all(np.abs(starts[:, 0] - 2.0) <= 20.0) and np.ptp(starts[:, 0]) > 36.0
    # In a logarithm, a factor of ten.
    assert np.all((starts[:, 1] >= 0.1) & (starts[:, 1] <= 10.0))
    assert np.sum(starts[:, 1] < 1.0) == pytest.approx(16, abs=1)
    near = drawn(models, options={"spread": 2.0})
    assert np.all((near[:, 1] >= 0.5) & (near[:, 1] <= 2.0))
    assert np.all(np.abs(near[:, 0] - 2.0) <= 4.0) and np.ptp(near[:, 0]) > 7.0
    # One bound: ten times the distance from it, on its own side.
    half = drawn(models, a=Parameter(2.0, bounds=(1.0, math.inf)))
    assert np.all((half[:, 0] >= 1.0) & (half[:, 0] <= 12.0)) and np.ptp(half[:, 0]) > 9.0
    chosen = drawn(models, options={"ranges": {"a": (-3.0, -1.0)}})
    assert np.all((chosen[:, 0] >= -3.0) & (chosen[:, 0] <= -1.0)) and np.ptp(chosen[:, 0]) > 1.8


def test_where_starts_are_drawn_by_a_prior(models):
    given = {
        "a": Parameter(2.0, prior=Normal(5.0, 0.1)),
        "b": Parameter(1.0, prior=LogNormal(2.0, 0.5)),
    }
    starts = drawn(models, **given)
    for distance in ((starts[:, 0] - 5.0) / 0.1, np.log(starts[:, 1] / 2.0) / 0.5):
        assert np.all(np.abs(distance) < 4.0) and np.max(distance) > 2.0
    assert np.min(starts[:, 0]) < 4.8 and np.min(starts[:, 1]) > 0.0


def test_two_unknown_noise_levels(models):
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 5.0, 30)
    datasets = {
        name: Dataset(x, 2.0 * np.sin(2.7 * x) + level * rng.normal(size=30))
        for name, level in (("fine", 0.05), ("coarse", 1.0))
    }
    parameters = {
        "a": Parameter(1.0, bounds=(0.1, 10.0)),
        "w": Parameter(0.5, bounds=(0.1, 6.0)),
    }
    found = multistart(Problem(parameters, datasets, sine))
    assert found.best.parameters["w"].value == pytest.approx(2.7, abs=0.01)
    assert found.best.noise["fine"] == pytest.approx(0.05, rel=0.4)
    assert found.best.noise["coarse"] == pytest.approx(1.0, rel=0.4)


def test_exact_readings_have_one_best_optimum():
    found = multistart(sine_problem(None, noise=0.0))
    assert found.best.parameters["w"].value == pytest.approx(2.7, rel=1e-9)
    assert np.sum(found.optimum == 1) > 1


def test_a_start_moved_onto_the_end_of_a_transform_stays_inside():
    parameters = {
        "fast": Parameter(1.0, bounds=(0.0, math.inf), transform="log"),
        "slow": Parameter(1.0, bounds=(0.0, 2.0), transform="logit"),
        "held": 3.0,
    }
    x = np.linspace(0.0, 1.0, 5)
    problem = Problem.from_function(two_decays, parameters, x, x)
    moved = started_at(problem, np.array([-800.0, 60.0]))
    assert moved.parameters["fast"].value > 0.0 and moved.parameters["slow"].value < 2.0
    assert np.all(np.isfinite(moved.start))
    assert moved.structure is problem.structure and moved.data_hash == problem.data_hash
    assert problem.parameters["fast"].value == 1.0
    np.testing.assert_allclose(started_at(problem, np.array([0.3, -0.2])).start, [0.3, -0.2])


def test_what_cannot_be_used_is_an_error():
    problem = sine_problem()
    with pytest.raises(InputError, match="starts must be at least 2"):
        multistart(problem, starts=1)
    with pytest.raises(InputError, match="no option 'max_step'; did you mean 'max_steps'"):
        multistart(problem, max_step=3)
    plain = Problem.from_function(in_numpy, {"a": Parameter(1.0)}, X, X, 1.0)
    with pytest.raises(InputError, match="in_numpy needs its parameters as plain numbers"):
        multistart(plain)
    with pytest.raises(InputError, match="ranges names 'ww'"):
        multistart(problem, ranges={"ww": (1.0, 2.0)})
    with pytest.raises(InputError, match=r"range \(1, 7\) of 'w' must be .* inside its bounds"):
        multistart(problem, ranges={"w": (1.0, 7.0)})
