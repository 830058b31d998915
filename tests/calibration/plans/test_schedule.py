"""Feed schedules: exact ones, rounding, bounds, uncertainty, prices, electrodes and touch-offs."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats
import xarray
from hypothesis import example, given, settings
from hypothesis import strategies as st

from calibration import Parameter, Problem, fit
from calibration.plans.schedule import (
    Machine,
    Trade,
    exact_schedule,
    optimised_schedule,
    plan_cost,
)
from procmodel.errors import InputError
from procmodel.wear import Hemisphere, pyramid, slice_solid

AREA = math.pi * 50.0**2
FINE = Machine(resolution=1e-6)
# A pyramid of 20 layers: 10 um each, half width 300 um at the top, 45 deg.
LAYERS = slice_solid(pyramid(300.0, math.pi / 4), 10.0, 200.0)
WIDTHS = 300.0 - 10.0 * np.arange(20)


def constant(params, x):
    return params["wear_ratio"] * x


def belief(value=0.3, std=0.02, **options):
    """A fit whose wear ratio is normal with the given spread."""
    parameter = Parameter(value, bounds=(0.0, 10.0), **options)
    x, y = np.ones(4), np.full(4, value)
    return fit(Problem.from_function(constant, {"wear_ratio": parameter}, x, y, 2.0 * std))


def posterior(draws):
    data = xarray.Dataset({"wear_ratio": (("chain", "draw"), np.asarray(draws).reshape(2, -1))})
    return xarray.DataTree.from_dict({"posterior": data})


@pytest.fixture(scope="module")
def uncertain():
    return belief()


def depths_of(feeds, ratio):
    """Depth after every layer, written out by hand."""
    return np.cumsum(np.asarray(feeds) / (1.0 + ratio * 4.0 * WIDTHS**2 / AREA))


def test_known_schedule(wear_reference):
    case = wear_reference["schedule_45_deg"]
    layers = slice_solid(pyramid(case["half_width"], math.pi / 4), case["layer_depth"])
    plan = exact_schedule(layers, case["wear_ratio"], AREA, FINE)
    assert plan.feeds[0] == pytest.approx(case["first_feed"], abs=1e-6)
    assert plan.feeds[-1] == pytest.approx(case["last_feed"], abs=1e-6)
    assert plan.total_feed == pytest.approx(case["total_feed"], abs=1e-6)
    assert plan.electrode_length == pytest.approx(case["total_feed"] - 250.0, abs=2e-6)
    np.testing.assert_allclose(plan.depths, layers.bottom, atol=1e-6)
    assert plan.max_wall_error < 1e-6 and plan.expected_wall_error < 1e-6


def test_known_ten_layers(wear_reference):
    case = wear_reference["ten_layers"]
    layers = slice_solid(pyramid(case["half_width"], math.pi / 4), case["wanted_depth"])
    plan = exact_schedule(layers, case["wear_ratio"], case["electrode_area"])
    np.testing.assert_allclose(plan.feeds, case["compensated_feeds"], atol=1e-6)
    # Given to a hundredth, told to a tenth.
    assert plan.cumulative_feed[-1] == pytest.approx(case["compensated_total"])


@given(resolution=st.floats(0.011, 3.0), ratio=st.floats(0.01, 1.0))
@example(resolution=1.0, ratio=0.3)
def test_rounding_never_adds_up(resolution, ratio):
    plan = exact_schedule(LAYERS, ratio, AREA, Machine(resolution=resolution))
    exact = np.cumsum(plan.feeds)
    assert np.max(np.abs(plan.cumulative_feed - exact)) <= 0.5 * resolution * (1 + 1e-9)
    steps = plan.cumulative_feed / resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.all(np.diff(plan.cumulative_feed) > 0)
    # What is expected is expected of the rounded feeds.
    told = np.diff(plan.cumulative_feed, prepend=0.0)
    np.testing.assert_allclose(plan.depths, depths_of(told, ratio), rtol=1e-9)


def test_rounding_every_feed_by_itself_would_drift():
    plan = exact_schedule(LAYERS, 0.3, AREA, Machine(resolution=1.0))
    one_by_one = np.cumsum(np.round(plan.feeds))
    assert np.max(np.abs(one_by_one - np.cumsum(plan.feeds))) > 0.5


def test_optimised_plan_without_bounds_and_doubt_is_the_exact_one():
    exact = exact_schedule(LAYERS, 0.3, AREA, FINE)
    plan = optimised_schedule(LAYERS, 0.3, AREA, FINE)
    np.testing.assert_allclose(plan.feeds, exact.feeds, rtol=1e-6)
    assert plan.max_wall_error < 1e-5
    assert "20 layers optimised" in plan.status


def least_squares_plan(ratios, least, most):
    """The same problem handed to scipy: rows are depth errors for every believed ratio."""
    rows, right = [], []
    for ratio in ratios:
        share = 1.0 / (1.0 + ratio * 4.0 * WIDTHS**2 / AREA)
        rows.append(np.tril(np.ones((20, 20))) * share)
        right.append(np.asarray(LAYERS.bottom))
    matrix = np.concatenate(rows) / math.sqrt(20 * len(ratios))
    target = np.concatenate(right) / math.sqrt(20 * len(ratios))
    best = scipy.optimize.lsq_linear(matrix, target, (least, most), method="bvls", tol=1e-14)
    return best.x, 2.0 * best.cost


@settings(max_examples=40)
@given(ratio=st.floats(0.05, 0.6), least=st.integers(2, 120), span=st.integers(3, 600))
def test_bounded_plan_against_scipy(ratio, least, span):
    # In tenths: bounds are taken inwards to whole steps of the resolution.
    least, span = least / 10, span / 10
    plan = optimised_schedule(LAYERS, ratio, AREA, FINE, feed_bounds=(least, least + span))
    _, cost = least_squares_plan([ratio], least, least + span)
    assert np.all((plan.feeds >= least - 1e-9) & (plan.feeds <= least + span + 1e-9))
    found = float(np.mean((depths_of(plan.feeds, ratio) - np.asarray(LAYERS.bottom)) ** 2))
    assert found == pytest.approx(cost, rel=1e-6, abs=1e-9)
    if cost > 1e-6:
        assert plan.expected_wall_error == pytest.approx(math.sqrt(cost), rel=1e-3)


def test_rounded_feeds_keep_the_bounds_too():
    machine = Machine(resolution=0.3)
    plan = optimised_schedule(LAYERS, 0.3, AREA, machine, feed_bounds=(40.1, 100.1))
    told = np.diff(plan.cumulative_feed, prepend=0.0)
    # Whole steps of 0.3 um inside the bounds.
    assert told.min() >= 40.1 and told.max() == pytest.approx(99.9)
    # Bounds that are no whole steps would be passed: 100.1 um is told as 99.9 or 100.2.
    unbounded = 0.3 * np.round(np.cumsum(np.full(20, 100.1)) / 0.3)
    assert np.max(np.diff(unbounded)) > 100.15


def test_a_bound_that_holds_back_layers_is_named():
    plan = optimised_schedule(LAYERS, 0.3, AREA, FINE, feed_bounds=(0.0, 60.0))
    held = np.flatnonzero(plan.feeds >= 60.0 * (1 - 1e-9))
    assert held.size > 0
    warning = next(w for w in plan.warnings if "greatest feed" in w)
    assert f"60 um holds back {held.size} layers (the first is {held[0] + 1})" in warning
    free = optimised_schedule(LAYERS, 0.3, AREA, FINE)
    assert not any("greatest feed" in w for w in free.warnings)


@jax.jit
def cost_and_slope_compiled(feeds, ratios, prices):
    return jax.value_and_grad(plan_cost)(feeds, LAYERS, ratios, AREA, *prices)


def cost_and_slope(feeds, ratios, prices):
    cost, slope = cost_and_slope_compiled(jnp.asarray(feeds), jnp.asarray(ratios), prices)
    return float(cost), np.asarray(slope)


@pytest.mark.parametrize(
    ("trade", "bounds"),
    [
        (Trade(), (0.0, math.inf)),
        (Trade(), (15.0, 70.0)),
        (Trade(per_length=0.05), (0.0, 70.0)),
        (Trade(per_minute=3.0, per_length=0.01), (20.0, 110.0)),
    ],
)
def test_optimality_conditions(uncertain, trade, bounds):
    machine = Machine(resolution=1e-6, removal_rate=2e4)
    plan = optimised_schedule(LAYERS, uncertain, AREA, machine, feed_bounds=bounds, trade=trade)
    ratios = uncertain.quantiles("wear_ratio", (np.arange(33) + 0.5) / 33)
    prices = (trade.per_minute / 60.0, trade.per_length, 2e4)
    best, slope = cost_and_slope(plan.feeds, ratios, prices)
    scale = np.max(np.abs(cost_and_slope(np.zeros(20), ratios, prices)[1]))
    least, most = max(bounds[0], 1e-6), bounds[1]
    at_least = plan.feeds <= least * (1 + 1e-9)
    at_most = plan.feeds >= most * (1 - 1e-9)
    assert np.all(slope[at_least] >= -1e-7 * scale)
    assert np.all(slope[at_most] <= 1e-7 * scale)
    assert np.max(np.abs(slope[~at_least & ~at_most]), initial=0.0) < 1e-6 * scale
    # No neighbour inside the bounds is cheaper.
    rng = np.random.default_rng(0)
    for _ in range(20):
        moved = np.clip(plan.feeds * (1 + 0.02 * rng.normal(size=20)), least, most)
        assert cost_and_slope(moved, ratios, prices)[0] > best


def test_uncertain_bounded_plan_against_scipy(uncertain):
    ratios = uncertain.quantiles("wear_ratio", (np.arange(33) + 0.5) / 33)
    plan = optimised_schedule(LAYERS, uncertain, AREA, FINE, feed_bounds=(15.0, 70.0))
    _, cost = least_squares_plan(ratios, 15.0, 70.0)
    assert plan.expected_wall_error == pytest.approx(math.sqrt(cost), rel=1e-5)


def test_robust_plan_beats_the_exact_one_where_the_wear_ratio_is_uncertain():
    doubt = belief(std=0.06)
    exact = exact_schedule(LAYERS, doubt, AREA, FINE)
    robust = optimised_schedule(LAYERS, doubt, AREA, FINE)
    assert robust.expected_wall_error < exact.expected_wall_error
    # Independent draws agree on which is better, and by about how much.
    ratios = np.abs(np.random.default_rng(1).normal(0.3, 0.06, 20_000))
    share = 1.0 / (1.0 + np.outer(ratios, 4.0 * WIDTHS**2) / AREA)
    errors = {
        name: np.mean((np.cumsum(plan.feeds * share, axis=1) - np.asarray(LAYERS.bottom)) ** 2)
        for name, plan in (("exact", exact), ("robust", robust))
    }
    assert errors["robust"] < errors["exact"]
    for name, plan in (("exact", exact), ("robust", robust)):
        assert plan.expected_wall_error == pytest.approx(math.sqrt(errors[name]), rel=0.05)
    # Without doubt there is nothing to gain.
    assert not np.allclose(robust.feeds, exact.feeds, rtol=1e-3)


def test_dearer_electrode_and_time_make_shorter_plans(uncertain):
    machine = Machine(resolution=1e-6, removal_rate=2e4)
    lengths, times, errors = [], [], []
    for price in (0.0, 0.05, 0.2, 0.8):
        by_length = optimised_schedule(
            LAYERS, uncertain, AREA, machine, trade=Trade(per_length=price)
        )
        by_time = optimised_schedule(
            LAYERS, uncertain, AREA, machine, trade=Trade(per_minute=20.0 * price)
        )
        lengths.append(by_length.electrode_length)
        errors.append(by_length.expected_wall_error)
        times.append(by_time.time)
    assert np.all(np.diff(lengths) < 0) and np.all(np.diff(times) < 0)
    assert np.all(np.diff(errors) > 0)


def test_number_fit_and_posterior_agree(uncertain):
    number = exact_schedule(LAYERS, 0.3, AREA, FINE)
    draws = np.random.default_rng(2).normal(0.3, 0.02, 40_000)
    plans = {
        "fit": exact_schedule(LAYERS, uncertain, AREA, FINE),
        "posterior": exact_schedule(LAYERS, posterior(draws), AREA, FINE),
        "draws": exact_schedule(LAYERS, draws, AREA, FINE),
    }
    for plan in plans.values():
        np.testing.assert_allclose(plan.feeds, number.feeds, rtol=1e-3)
        reference = plans["fit"]
        np.testing.assert_allclose(plan.depth_spread, reference.depth_spread, rtol=0.03)
        assert plan.electrode_length_limit == pytest.approx(
            reference.electrode_length_limit, rel=2e-3
        )
    assert np.all(number.depth_spread == 0.0)
    assert number.electrode_length_limit == pytest.approx(number.electrode_length)
    # Certain all the same, in three forms.
    fixed = fit(
        Problem.from_function(
            lambda p, x: p["wear_ratio"] + p["other"] * x,
            {"wear_ratio": 0.3, "other": Parameter(0.0)},
            np.arange(3.0),
            np.full(3, 0.3),
        )
    )
    for certain in (fixed, posterior(np.full(10, 0.3)), np.float64(0.3)):
        plan = exact_schedule(LAYERS, certain, AREA, FINE)
        np.testing.assert_allclose(plan.feeds, number.feeds, rtol=1e-12)
        np.testing.assert_allclose(plan.depth_spread, 0.0, atol=1e-9)


def test_spread_and_length_limit_are_quantiles(uncertain):
    # Depth falls with the wear ratio, so its quantiles are those of the ratio.
    plan = exact_schedule(LAYERS, uncertain, AREA, FINE)
    low, high = scipy.stats.norm(0.3, 0.02).ppf([0.025, 0.975])
    exact = 0.5 * (depths_of(plan.feeds, low) - depths_of(plan.feeds, high))
    np.testing.assert_allclose(plan.depth_spread, exact, rtol=0.04)
    worst = plan.total_feed - depths_of(plan.feeds, high)[-1]
    worn = plan.electrode_length_limit - plan.electrode_length
    assert worn == pytest.approx(worst - plan.electrode_length, rel=0.04)


def test_predicted_time():
    plan = exact_schedule(
        LAYERS, 0.3, AREA, Machine(resolution=1e-6, removal_rate=5e3, layer_overhead=4.0)
    )
    assert plan.time == pytest.approx(float(LAYERS.volume) / 5e3 + 20 * 4.0, rel=1e-6)
    assert exact_schedule(LAYERS, 0.3, AREA).time is None


@pytest.mark.parametrize("usable", [150.0, 300.0, 700.0, 1e5])
@pytest.mark.parametrize("doubt", [False, True])
def test_electrodes_recounted(uncertain, usable, doubt):
    ratio = uncertain if doubt else 0.3
    plan = exact_schedule(LAYERS, ratio, AREA, Machine(resolution=1e-6, usable_length=usable))
    told = np.diff(plan.cumulative_feed, prepend=0.0)
    high = scipy.stats.norm(0.3, 0.02).ppf(0.975) if doubt else 0.3
    at_most = told - np.diff(depths_of(told, high), prepend=0.0)
    # Layers on each electrode, as planned.
    starts = [1, *plan.new_electrode_before, 21]
    groups = [range(a - 1, b - 1) for a, b in itertools.pairwise(starts)]
    assert [i for g in groups for i in g] == list(range(20))
    assert plan.electrodes == len(groups)
    slack = 0.02 * usable if doubt else 1e-6
    for group, following in zip(groups, [*groups[1:], None], strict=True):
        needed = sum(at_most[i] for i in group)
        assert needed <= usable + slack
        if following is not None:
            # One layer more would not have fitted.
            assert needed + at_most[following[0]] > usable - slack
        left = usable - np.cumsum(plan.wear[list(group)])
        np.testing.assert_allclose(plan.electrode_left[list(group)], left, rtol=1e-9)
    assert plan.electrode_length / plan.electrodes <= usable
    if usable == 1e5:
        assert plan.electrodes == 1


def test_touch_offs_recounted():
    doubt = belief(std=0.05)
    machine = Machine(resolution=1e-6, tolerance=12.0)
    plan = exact_schedule(LAYERS, doubt, AREA, machine)
    ratios = doubt.quantiles("wear_ratio", (np.arange(33) + 0.5) / 33)
    depths = np.stack([depths_of(plan.feeds, r) for r in ratios])

    def spread(first, last):
        """Of the depth between two touch-offs, after layers counted from 1."""
        before = depths[:, first - 1] if first else 0.0
        low, high = np.quantile(depths[:, last - 1] - before, [0.025, 0.975], method="hazen")
        return 0.5 * (high - low)

    assert 2 < len(plan.touch_off_after) < 12
    stops = [0, *plan.touch_off_after, 20]
    for first, last in itertools.pairwise(stops):
        assert spread(first, last) <= 12.0 or last == first + 1
    for first, last in itertools.pairwise(stops[:-1]):
        # Waiting a layer longer would have been too long.
        assert spread(first, last + 1) > 12.0
    # Known wear needs none; a stricter tolerance needs more.
    assert exact_schedule(LAYERS, 0.3, AREA, machine).touch_off_after == ()
    strict = exact_schedule(LAYERS, doubt, AREA, Machine(resolution=1e-6, tolerance=6.0))
    assert len(strict.touch_off_after) > len(plan.touch_off_after)


def test_layers_smaller_than_the_electrode_are_cautioned():
    plan = exact_schedule(slice_solid(Hemisphere(200.0), 5.0, 199.0), 0.2, AREA)
    caution = next(w for w in plan.warnings if "smaller than the electrode's own section" in w)
    narrow = np.flatnonzero(np.asarray(plan.layers.area) < AREA)
    assert caution.startswith(f"{narrow.size} layers from layer {narrow[0] + 1} on")


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Machine(resolution=0.0), "resolution 0 must be above 0"),
        (lambda: Machine(removal_rate=-1.0), "removal rate -1 must be above 0"),
        (lambda: Machine(usable_length=math.nan), "usable length nan"),
        (lambda: Machine(tolerance=0.0), "tolerance 0 must"),
        (lambda: Machine(layer_overhead=-1.0), "layer overhead -1 s must not be below 0"),
        (lambda: Trade(per_length=-1.0), "trade per_length is -1"),
        (lambda: Trade(per_minute=math.inf), "trade per_minute is inf"),
        (lambda: exact_schedule(LAYERS, -0.1, AREA), "wear ratio -0.1 is below 0"),
        (lambda: exact_schedule(LAYERS, math.nan, AREA), "wear_ratio is nan"),
        (lambda: exact_schedule(LAYERS, "0,3", AREA), "must be a number, a FitResult or a post"),
        (lambda: exact_schedule(LAYERS, 0.3, 0.0), r"electrode area 0 um\^2 must be above 0"),
        (
            lambda: exact_schedule(LAYERS, 0.0, AREA, Machine(resolution=10.5)),
            "feed of layer 1 is 10 um, below the machine's resolution of 10.5 um",
        ),
        (
            lambda: exact_schedule(LAYERS, 0.3, AREA, Machine(usable_length=50.0)),
            "layer 1 alone may wear 137.* more than its usable length of 50 um",
        ),
        (
            lambda: optimised_schedule(LAYERS, 0.3, AREA, feed_bounds=(5.0, 5.0)),
            r"feed bounds \(5, 5\) um must be increasing",
        ),
        (
            lambda: optimised_schedule(LAYERS, 0.3, AREA, feed_bounds=(0.0, 0.05)),
            "above the machine's resolution of 0.1 um",
        ),
        (
            lambda: optimised_schedule(LAYERS, 0.3, AREA, trade=Trade(per_minute=1.0)),
            "needs the removal rate",
        ),
        (
            lambda: exact_schedule(
                LAYERS,
                xarray.DataTree.from_dict({"posterior": xarray.Dataset({"rho": ("draw", [1.0])})}),
                AREA,
            ),
            "posterior has no 'wear_ratio'; it has rho",
        ),
    ],
)
def test_refusals(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


def test_fits_that_cannot_be_planned_on():
    def other(params, x):
        return params["rho"] * x

    fitted = fit(Problem.from_function(other, {"rho": Parameter(0.1)}, np.ones(3), np.ones(3), 0.1))
    with pytest.raises(InputError, match="the fit has no 'wear_ratio'; it has rho"):
        exact_schedule(LAYERS, fitted, AREA)

    def ridge(params, x):
        return params["wear_ratio"] * params["rho"] * x

    free = {"wear_ratio": Parameter(0.3), "rho": Parameter(1.0)}
    flat = fit(Problem.from_function(ridge, free, np.ones(3), np.full(3, 0.3), 0.1))
    with pytest.raises(InputError, match="leaves 'wear_ratio' without a standard deviation"):
        exact_schedule(LAYERS, flat, AREA)
