"""What 100 readings of a test cavity tell of the wear ratio, and what they cannot."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import Dataset, Parameter, Problem, fit


@pytest.fixture(scope="module")
def readings(wear):
    return wear.readings(seed=1)


def by_depths(wear, readings, *free, sigma=1.0, **changed):
    parameters = wear.parameters(*free, **changed)
    return Problem.from_function(wear.depths, parameters, wear.half_widths, readings, sigma)


def linearised(wear, *, with_gap, walls=False):
    """Covariance of (wear ratio[, gap]) by hand: derivative of eq. (4), 1 um of noise."""
    area = 4.0 * wear.half_widths**2
    u = 0.3 * area / wear.electrode_area
    by_ratio = np.cumsum(-2.0 / (1 + u) ** 2 * area / wear.electrode_area)
    columns = [by_ratio]
    if with_gap:
        columns.append(
            np.cumsum(-2.0 / (1 + u) ** 2 * 0.3 * 8.0 * wear.half_widths / wear.electrode_area)
        )
    jacobian = np.stack(columns, axis=1)
    if walls:
        jacobian = np.concatenate([jacobian, np.stack([np.zeros(100), np.ones(100)], axis=1)])
    return np.linalg.inv(jacobian.T @ jacobian)


def test_spread_of_the_wear_ratio(wear, readings):
    result = fit(by_depths(wear, readings, "wear_ratio"))
    estimate = result.parameters["wear_ratio"]
    assert 0.560e-2 <= estimate.std / estimate.value <= 0.58e-2
    by_hand = math.sqrt(linearised(wear, with_gap=False)[0, 0])
    assert 0.0056 < by_hand / 0.3 < 0.0058
    assert estimate.std == pytest.approx(by_hand, rel=0.02)
    # rho = R / S_e has the same relative spread.
    rho = result.parameters["wear_per_area"]
    assert rho.std / rho.value == pytest.approx(estimate.std / estimate.value, rel=1e-9)
    assert rho.interval95[0] < 0.3 / wear.electrode_area < rho.interval95[1]


def test_scatter_of_fits_is_the_reported_spread(wear):
    values, stds = [], []
    for seed in range(200):
        estimate = fit(by_depths(wear, wear.readings(seed=seed), "wear_ratio"))
        values.append(estimate.parameters["wear_ratio"].value)
        stds.append(estimate.parameters["wear_ratio"].std)
    # The scatter of 200 values is known to 1 / sqrt(400) = 5 %.
    assert np.std(values, ddof=1) == pytest.approx(np.mean(stds), rel=0.15)
    assert abs(np.mean(values) - 0.3) < 3.5 * np.mean(stds) / math.sqrt(200)


def test_gap_and_wear_ratio_from_depths_alone(wear, readings):
    result = fit(by_depths(wear, readings, "wear_ratio", "gap"))
    assert result.correlation[0, 1] == pytest.approx(-0.987, abs=0.002)
    covariance = linearised(wear, with_gap=True)
    by_hand = covariance[0, 1] / math.sqrt(covariance[0, 0] * covariance[1, 1])
    assert by_hand == pytest.approx(-0.987, abs=0.002)
    sentence = next(t for t in result.trades)
    assert sentence.startswith("wear_ratio and gap trade off: correlation -0.98")
    assert sentence in result.report()
    # The price: the wear ratio is known about six times worse than with a known gap.
    alone = fit(by_depths(wear, readings, "wear_ratio"))
    worse = result.parameters["wear_ratio"].std / alone.parameters["wear_ratio"].std
    assert worse == pytest.approx(1.0 / math.sqrt(1.0 - 0.987**2), rel=0.1)


def test_positions_of_the_wall_restore_the_wear_ratio(wear, readings):
    walls = wear.half_widths + np.random.default_rng(2).normal(size=100)
    datasets = {
        "depth": Dataset(wear.half_widths, readings, 1.0, function=wear.depths),
        "wall": Dataset(wear.half_widths, walls, 1.0, function=wear.walls),
    }
    result = fit(Problem(wear.parameters("wear_ratio", "gap"), datasets))
    estimate = result.parameters["wear_ratio"]
    by_hand = math.sqrt(linearised(wear, with_gap=True, walls=True)[0, 0]) / 0.3
    assert 0.575e-2 < by_hand < 0.59e-2
    assert estimate.std / estimate.value == pytest.approx(by_hand, rel=0.02)
    assert not result.trades
    assert abs(result.parameters["gap"].value) < 4 * result.parameters["gap"].std
    assert result.parameters["gap"].std == pytest.approx(0.1, rel=0.02)


def test_wear_ratio_and_electrode_area_cannot_be_told_apart(wear, readings):
    result = fit(by_depths(wear, readings, "wear_ratio", "electrode_area"))
    assert result.converged
    for name in ("wear_ratio", "electrode_area"):
        estimate = result.parameters[name]
        assert estimate.verdict == "flat"
        assert estimate.std is None and estimate.interval95 is None
    (sentence,) = result.directions
    assert "wear_ratio and electrode_area cannot be told apart" in sentence
    assert "+1 % in wear_ratio with +1 % in electrode_area changes no reading" in sentence
    assert sentence in result.report() and "condition number inf" in result.report()
    assert result.as_dict()["condition"] is None
    # What they make together is known as well as ever.
    alone = fit(by_depths(wear, readings, "wear_ratio")).parameters["wear_per_area"]
    rho = result.parameters["wear_per_area"]
    assert rho.verdict == "identified"
    assert rho.value == pytest.approx(alone.value, rel=1e-6)
    assert rho.std == pytest.approx(alone.std, rel=1e-5)


def test_ignoring_a_gap_biases_the_wear_ratio_and_hardly_shows(wear):
    # Depth after every layer at its programmed half width; 3 um on a square of 500 um.
    exact = wear.readings(gap=3.0)
    result = fit(by_depths(wear, exact, "wear_ratio"))
    bias = result.parameters["wear_ratio"].value / 0.3 - 1.0
    assert bias == pytest.approx(0.044, abs=0.001)
    assert result.residual_rms == pytest.approx(0.12, abs=0.005)
    known = fit(by_depths(wear, exact, "wear_ratio", gap=3.0))
    assert known.parameters["wear_ratio"].value == pytest.approx(0.3, rel=1e-7)
    assert known.residual_rms < 1e-6


def slope_from_bound(params, x):
    return params["slope"] * x


SLOPE_X = np.full(4, 0.5)  # one reading of unit noise, in effect


def held_slope(y):
    parameters = {"slope": Parameter(0.5, bounds=(0.0, 100.0))}
    return fit(Problem.from_function(slope_from_bound, parameters, SLOPE_X, y, 1.0))


@pytest.mark.parametrize("estimate", [-0.3, -1.0, -2.5])
def test_one_sided_limit_is_where_the_misfit_has_risen(estimate):
    slope = held_slope(np.full(4, 0.5 * estimate)).parameters["slope"]
    assert slope.value == 0.0 and slope.std is None
    assert slope.verdict == "one-sided" and slope.reason == "held at its lower bound 0"
    low, high = slope.interval95
    assert low == 0.0
    # Squared misfit (s - estimate)^2 above that at 0, to the 95 % point of one side.
    rise = (high - estimate) ** 2 - estimate**2
    assert rise == pytest.approx(1.6448536**2, rel=1e-6)


def test_one_sided_limits_cover(wear):
    # The true slope is one standard deviation above its bound: 16 % of fits are held there.
    rng = np.random.default_rng(31)
    runs, truth = 300, 1.0
    covered = shrunk = held = 0
    for _ in range(runs):
        slope = held_slope(SLOPE_X * truth + rng.normal(size=4)).parameters["slope"]
        low, high = slope.interval95
        held += slope.value == 0.0
        covered += low <= truth <= high
        half = 0.5 * (high - slope.value)
        shrunk += max(0.0, slope.value - half) <= truth <= slope.value + half
    assert 0.10 * runs < held < 0.22 * runs
    # 300 runs know a share of 95 % to 1.3 %.
    assert 0.92 <= covered / runs <= 0.98
    assert shrunk / runs < 0.85


def test_the_gap_at_its_bound_gets_a_one_sided_limit(wear):
    # Depths of a cavity without gap, noise that asks for a negative one.
    parameters = wear.parameters("wear_ratio", "gap", gap=1.0, gap_bounds=(0.0, 50.0))
    seeds = iter(range(20))
    while True:
        y = wear.readings(seed=next(seeds))
        result = fit(Problem.from_function(wear.depths, parameters, wear.half_widths, y, 1.0))
        if result.parameters["gap"].value == 0.0:
            break
    gap = result.parameters["gap"]
    assert gap.verdict == "one-sided" and "lower bound 0" in gap.reason
    assert gap.interval95[0] == 0.0
    # Its spread from depths alone is 2.4 um: the limit is of that size.
    spread = math.sqrt(linearised(wear, with_gap=True)[1, 1])
    assert 0.3 * spread < gap.interval95[1] <= 1.645 * spread * 1.05
    assert "bounds hit  gap" in result.report()
    known = fit(by_depths(wear, y, "wear_ratio")).parameters["wear_ratio"]
    assert result.parameters["wear_ratio"].value == pytest.approx(known.value, rel=1e-6)
    # Profile by hand: with the gap at its limit the best misfit is the 95 % point worse.
    grid = {"gap": gap.interval95[1]}
    moved = fit(by_depths(wear, y, "wear_ratio", gap=grid["gap"]))
    rise = 100 * (moved.residual_rms**2 - result.residual_rms**2)
    assert rise == pytest.approx(1.645**2, rel=0.05)


def test_upper_bounds_are_one_sided_too():
    parameters = {"slope": Parameter(0.5, bounds=(0.0, 1.0))}
    result = fit(Problem.from_function(slope_from_bound, parameters, SLOPE_X, np.full(4, 1.0), 1.0))
    slope = result.parameters["slope"]
    # The free optimum is 2, one beyond the bound.
    assert slope.value == 1.0 and slope.reason == "held at its upper bound 1"
    assert slope.interval95[1] == 1.0
    assert (2.0 - slope.interval95[0]) ** 2 - 1.0 == pytest.approx(1.6448536**2, rel=1e-6)


def test_an_interval_that_reaches_past_a_bound_is_one_sided():
    slope = held_slope(np.full(4, 0.5)).parameters["slope"]
    assert slope.value == pytest.approx(1.0) and slope.verdict == "one-sided"
    assert "lower bound 0" in slope.reason
    assert slope.interval95 == pytest.approx((0.0, 1.0 + 1.959964), rel=1e-6)


def test_a_parameter_without_effect_is_flat():
    def ignores(params, x):
        return params["a"] * x + 0.0 * jnp.asarray(params["idle"])

    parameters = {"a": Parameter(1.0), "idle": Parameter(3.0)}
    result = fit(
        Problem.from_function(ignores, parameters, np.arange(5.0), 2 * np.arange(5.0), 1.0)
    )
    assert result.parameters["idle"].verdict == "flat"
    assert result.parameters["idle"].value == 3.0
    assert result.directions == ("idle has no effect on any reading",)
    assert result.parameters["a"].verdict == "identified"
