"""Area of an electrode ground blind or measured, and its way into wear ratio and feeds."""

import math

import numpy as np
import pytest
import scipy.stats

from calibration.electrode import GapData
from calibration.electrode_area import electrode_area, wear_ratio_draws, wear_ratio_for
from calibration.electrode_gap import GapPosterior, fit_gap
from calibration.plans.schedule import exact_schedule
from calibration.wear import TestCavity, fit_cavity
from procmodel.errors import InputError
from procmodel.wear import LayeredCavity, SquareSection, pyramid, slice_solid

WIRE, PATH = 100.0, 165.0
NOMINAL = math.pi * 50.0**2


@pytest.fixture(scope="module")
def posterior():
    return fit_gap(GapData(np.random.default_rng(7).normal(15.0, 2.3, 10), 0.41))


def certain(spread=2.3, mean=15.0):
    """A gap whose mean and spread are known."""
    return GapPosterior(np.array([spread]), np.zeros(1), np.array([mean]), np.array([1e-9]))


def test_a_single_electrode_of_100_um_is_known_to_nine_per_cent():
    area = electrode_area(certain(), PATH, WIRE, count=40_000)
    # d = 2 (r_p - r_w - g): std 4.6 um of 100 um, and twice that share of the area.
    assert area.relative == pytest.approx(0.092, abs=0.002)
    # E[d^2] = 100^2 + 4.6^2.
    assert area.mean == pytest.approx(math.pi / 4 * (1e4 + 4.6**2), rel=0.002)
    diameter = np.sqrt(4 * area.draws / math.pi)
    assert scipy.stats.kstest(diameter, scipy.stats.norm(100, 4.6).cdf).pvalue > 1e-3
    low, high = area.interval(0.9)
    expected = math.pi / 4 * (100 + 4.6 * scipy.stats.norm.ppf([0.05, 0.95])) ** 2
    np.testing.assert_allclose([low, high], expected, rtol=0.01)


def test_what_is_not_known_of_mean_and_spread_widens_it(posterior):
    known = certain(float(posterior.spread_quantile(0.5)), posterior.mean.mean)
    assert (
        electrode_area(posterior, PATH, WIRE, count=20_000).relative
        > electrode_area(known, PATH, WIRE, count=20_000).relative * 1.05
    )


def test_four_flats_average_their_gaps():
    area = electrode_area(certain(), PATH, WIRE, shape="square", count=40_000)
    # Two independent widths, each of the mean of two gaps: std 2 * 2.3 / sqrt(2) um.
    assert area.mean == pytest.approx(1e4, rel=0.002)
    share = 2 * 2.3 / math.sqrt(2) / 100
    assert area.relative == pytest.approx(math.sqrt(2 * share**2 + share**4), rel=0.02)


def test_measuring_leaves_the_measuring_error(posterior):
    area = electrode_area(posterior, PATH, WIRE, measured=98.0, diameter_error=1.0, count=20_000)
    diameter = np.sqrt(4 * area.draws / math.pi)
    assert np.all(np.abs(diameter - 98.0) <= 1.0 + 1e-9)
    # Nearly even inside, so about 2 / sqrt(3) per cent of the area.
    assert area.relative == pytest.approx(2 / math.sqrt(3) / 98.0, rel=0.03)
    assert "measured as 98 um" in area.status


def test_mean_and_spread_after_measuring_are_those_of_an_update(posterior):
    found = electrode_area(posterior, PATH, WIRE, measured=92.0, diameter_error=0.05, count=20_000)
    updated = posterior.updated(GapData([165 - 100 - 46.0], 0.5 * 0.05 / math.sqrt(3)))
    error = 4 * updated.mean.deviation / math.sqrt(20_000)
    assert np.mean(found.gap_mean) == pytest.approx(updated.mean.mean, abs=error)
    shares = np.mean(found.gap_spread < updated.spread_quantile(0.5))
    assert shares == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(20_000))
    assert abs(updated.mean.mean - posterior.mean.mean) > 20 * error


def test_electrodes_beside_each_other_share_mean_and_spread_but_not_the_gap(posterior):
    first = electrode_area(posterior, PATH, WIRE, count=20_000)
    second = electrode_area(posterior, PATH, WIRE, beside=first)
    np.testing.assert_array_equal(first.gap_mean, second.gap_mean)
    share = posterior.mean.deviation**2 / posterior.next_gap().deviation ** 2
    found = float(np.corrcoef(first.draws, second.draws)[0, 1])
    assert found == pytest.approx(share, abs=0.03)
    third = electrode_area(posterior, PATH, WIRE, beside=second)
    assert abs(np.corrcoef(second.draws, third.draws)[0, 1] - share) < 0.03


def test_the_draws_are_a_posterior_that_plans_take(posterior):
    tree = electrode_area(posterior, PATH, WIRE).as_tree()
    assert tree["posterior"]["electrode_area"].shape == (4, 1000)
    assert tree["posterior"]["electrode_area"].attrs["unit"] == "um^2"


@pytest.fixture(scope="module")
def fit():
    """A test cavity cut by a round electrode of 100 um with R = 0.3, fitted with that area."""
    half_widths = 250.0 - 2.0 * np.arange(100)
    depths = np.asarray(LayeredCavity(half_widths, 2.0, SquareSection(), 0.3, NOMINAL, 0.0).depths)
    cavity = TestCavity("square", 250.0, 2.0, 2.0, NOMINAL, layers=100)
    x = np.linspace(55.0, 245.0, 96)
    z = np.interp(x, half_widths[::-1], depths[::-1])
    noise = np.random.default_rng(1).normal(0.0, 0.5, 96)
    return fit_cavity(x, z + noise, cavity, 0.5, reach="half").result


def test_the_wear_ratio_is_as_uncertain_as_fit_and_area_together(posterior, fit):
    area = electrode_area(posterior, PATH, WIRE, count=20_000)
    ratio = wear_ratio_draws(fit, area)
    per_area = fit.parameters["wear_per_area"]
    share = per_area.std / per_area.value
    expected = math.sqrt(share**2 + area.relative**2 + (share * area.relative) ** 2)
    assert np.std(ratio) / np.mean(ratio) == pytest.approx(expected, rel=0.02)
    assert np.mean(ratio) == pytest.approx(per_area.value * area.mean, rel=0.005)


def test_the_same_electrode_again_needs_no_area(posterior, fit):
    area = electrode_area(posterior, PATH, WIRE)
    ratio = wear_ratio_for(fit, area, None, NOMINAL)
    estimate = fit.parameters["wear_ratio"]
    assert np.mean(ratio) == pytest.approx(estimate.value, rel=1e-4)
    assert np.std(ratio) == pytest.approx(estimate.std, rel=0.01)


def test_another_electrode_brings_the_ratio_of_both_areas(posterior, fit):
    first = electrode_area(posterior, PATH, WIRE, count=20_000)
    second = electrode_area(posterior, PATH, WIRE, beside=first)
    ratio = wear_ratio_for(fit, first, second, NOMINAL)
    per_area = fit.parameters["wear_per_area"]
    logs = math.sqrt(
        np.var(np.log(first.draws / second.draws)) + (per_area.std / per_area.value) ** 2
    )
    assert np.std(np.log(ratio)) == pytest.approx(logs, rel=0.02)


def test_the_schedule_carries_the_area_to_the_depth(posterior, fit):
    layers = slice_solid(pyramid(200.0, math.pi / 4), 2.0, depth=100.0)
    first = electrode_area(posterior, PATH, WIRE)
    plans = {
        "same": exact_schedule(layers, wear_ratio_for(fit, first, None, NOMINAL), NOMINAL),
        "measured": exact_schedule(
            layers,
            wear_ratio_for(
                fit,
                electrode_area(posterior, PATH, WIRE, measured=100.0),
                electrode_area(posterior, PATH, WIRE, measured=100.0, seed=1),
                NOMINAL,
            ),
            NOMINAL,
        ),
        "another": exact_schedule(
            layers,
            wear_ratio_for(
                fit, first, electrode_area(posterior, PATH, WIRE, beside=first), NOMINAL
            ),
            NOMINAL,
        ),
    }
    spread = {name: float(plan.depth_spread[-1]) for name, plan in plans.items()}
    assert spread["same"] < 0.2 * spread["measured"] < 0.2 * spread["another"]
    # Depth of the last layer when the true ratio is at the ends of the plan's 95 %.
    ratio = wear_ratio_for(fit, first, electrode_area(posterior, PATH, WIRE, beside=first), NOMINAL)
    area = np.asarray(layers.area)
    ends = np.quantile(ratio, [0.025, 0.975])
    middle = np.median(ratio)
    depth = [np.sum(2 * (NOMINAL + middle * area) / (NOMINAL + r * area)) for r in ends]
    assert spread["another"] == pytest.approx(0.5 * abs(depth[1] - depth[0]), rel=0.1)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"shape": "hexagon"}, "shape 'hexagon' is unknown"),
        ({"path_radius": 118.0}, "leaves nothing of the electrode with probability"),
        ({"count": 1}, "count is 1"),
        ({"measured": 300.0}, "cannot come from path radius"),
        ({"measured": 40.0}, "too far from what the known gaps leave"),
        ({"measured": 99.0, "shape": "square"}, "measured is for a round, straight electrode"),
        ({"measured": 99.0, "diameter_error": 0.0}, "error of a measured diameter is 0"),
    ],
)
def test_faulty_numbers_are_named(posterior, changed, said):
    given = {"posterior": posterior, "path_radius": PATH, "wire_radius": WIRE} | changed
    with pytest.raises(InputError, match=said):
        electrode_area(**given)


def test_draws_that_do_not_fit_together_are_refused(posterior, fit):
    first = electrode_area(posterior, PATH, WIRE, count=100)
    second = electrode_area(posterior, PATH, WIRE, count=200)
    with pytest.raises(InputError, match="100 and 200 draws"):
        wear_ratio_for(fit, first, second, NOMINAL)
    with pytest.raises(InputError, match="planned area is 0"):
        wear_ratio_for(fit, first, None, 0.0)
