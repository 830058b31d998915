"""The corrected path: closed forms, gradients, Monte Carlo, and what a bad number says."""

import math

import jax
import numpy as np
import pytest
import scipy.stats

from calibration.electrode import GapData
from calibration.electrode_gap import GapPosterior, NormalMixture, fit_gap
from calibration.plans.electrode import (
    corrected_path,
    expected_size_error,
    predict_sizes,
)
from procmodel.errors import InputError

WIRE = 100.0


@pytest.fixture(scope="module")
def posterior():
    gaps = np.random.default_rng(7).normal(14.75, 2.3, 10)
    return fit_gap(GapData(gaps, 0.41))


def parts(mixture):
    return mixture.weight, mixture.centre, mixture.std


@pytest.mark.parametrize("loss", ["absolute", "squared", "outside"])
def test_expected_error_is_the_mean_over_draws(posterior, loss):
    ahead = posterior.next_gap()
    off = 2.0 * (15.8 - ahead.draws(400_000, np.random.default_rng(0)))
    each = {"absolute": np.abs(off), "squared": off**2, "outside": np.abs(off) > 3.0}[loss]
    found = float(expected_size_error(15.8, *parts(ahead), loss, 3.0))
    assert found == pytest.approx(np.mean(each), abs=4 * np.std(each) / math.sqrt(400_000))


@pytest.mark.parametrize("loss", ["absolute", "squared", "outside"])
def test_gradient_agrees_with_finite_differences(posterior, loss):
    ahead = posterior.next_gap()

    def error(gap):
        return expected_size_error(gap, *parts(ahead), loss, 3.0)

    for gap in (13.0, 15.0, 18.0):
        slope = (float(error(gap + 1e-5)) - float(error(gap - 1e-5))) / 2e-5
        assert float(jax.grad(error)(gap)) == pytest.approx(slope, rel=1e-6, abs=1e-9)


def test_of_a_normal_gap_the_expected_absolute_error_is_known():
    mixture = NormalMixture(np.ones(1), np.array([15.0]), np.array([2.3]))
    found = float(expected_size_error(15.0, *parts(mixture), "absolute"))
    assert found == pytest.approx(2 * 2.3 * math.sqrt(2 / math.pi), rel=1e-12)


def test_the_best_gap_is_median_mean_and_middle_of_the_window(posterior):
    ahead = posterior.next_gap()
    best = {
        loss: corrected_path(100.0, posterior, WIRE, loss=loss).counted_gap
        for loss in ("absolute", "squared", "outside")
    }
    assert best["absolute"] == pytest.approx(float(ahead.quantile(0.5)), abs=1e-8)
    assert best["squared"] == pytest.approx(ahead.mean, abs=1e-8)
    # The best window has the same density at both ends.
    ends = ahead.density([best["outside"] - 1.0, best["outside"] + 1.0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-7)


@pytest.mark.parametrize("loss", ["absolute", "squared", "outside"])
def test_no_other_gap_is_better(posterior, loss):
    found = corrected_path([60.0, 120.0], posterior, WIRE, loss=loss)
    ahead = posterior.next_gap()
    others = np.linspace(10.0, 20.0, 401)
    errors = [
        float(expected_size_error(gap, *parts(ahead), loss, 0.02 * 60.0)) for gap in others[::20]
    ]
    assert found.expected_error <= min(errors) + 1e-12
    assert loss == found.loss and "when a gap of" in found.status


def test_the_path_is_rounded_and_its_sizes_follow(posterior):
    found = corrected_path([60.0, 120.0], posterior, WIRE, resolution=0.5)
    np.testing.assert_allclose(found.path_radius / 0.5, np.round(found.path_radius / 0.5))
    exact = np.array([30.0, 60.0]) + WIRE + found.counted_gap
    assert np.max(np.abs(found.path_radius - exact)) <= 0.25 + 1e-12
    gap = posterior.next_gap()
    expected = 2 * (found.path_radius - WIRE - gap.mean)
    np.testing.assert_allclose(found.prediction.size, expected, rtol=1e-12)
    low, high = gap.interval(0.9)
    np.testing.assert_allclose(found.prediction.interval[0, 1], expected[0] + 2 * (gap.mean - low))
    np.testing.assert_allclose(found.prediction.interval[0, 0], expected[0] + 2 * (gap.mean - high))


def test_intervals_and_chances_agree_with_simulated_electrodes(posterior):
    found = corrected_path([80.0, 160.0], posterior, WIRE).prediction
    mean, spread = posterior.draws(200_000, seed=4)
    gap = np.random.default_rng(5).normal(mean, spread)
    sizes = 2 * (found.path_radius[:, None] - WIRE - gap)
    inside = (sizes > found.interval[:, :1]) & (sizes < found.interval[:, 1:])
    np.testing.assert_allclose(np.mean(inside, axis=1), 0.9, atol=0.003)
    within = np.abs(sizes / np.array([[80.0], [160.0]]) - 1) < 0.02
    np.testing.assert_allclose(np.mean(within, axis=1), found.within, atol=0.005)
    # One gap for the whole electrode: the smaller size decides.
    assert np.mean(np.all(within, axis=0)) == pytest.approx(found.all_within, abs=0.005)
    assert found.all_within == pytest.approx(np.min(found.within), rel=1e-3)
    assert found.std == pytest.approx([np.std(sizes[0])] * 2, rel=0.02)


def test_on_a_cone_the_gap_lies_across_the_surface(posterior):
    # Independent: the flank as a line in (radius, height), moved along its normal.
    slope = math.radians(30.0)
    plan = corrected_path(100.0, posterior, WIRE, slope=slope, resolution=1e-6)
    flank = np.array([[50.0, 0.0], [50.0 + math.tan(slope), 1.0]])
    normal = np.array([math.cos(slope), -math.sin(slope)])
    moved = flank + (WIRE + plan.counted_gap) * normal
    at_height = moved[0, 0] - moved[0, 1] * math.tan(slope)
    assert plan.path_radius[0] == pytest.approx(at_height, abs=1e-5)
    straight = corrected_path(100.0, posterior, WIRE, resolution=1e-6)
    assert plan.prediction.std == pytest.approx(straight.prediction.std / math.cos(slope))
    assert plan.prediction.within[0] < straight.prediction.within[0]
    for given, said in ((math.pi / 2, "80 deg"), ([0.1, 0.2], "one each")):
        with pytest.raises(InputError, match=said):
            corrected_path(100.0, posterior, WIRE, slope=given)


def test_two_pairs_of_flats_are_within_together_as_simulated(posterior):
    found = corrected_path([100.0], posterior, WIRE, passes=2).prediction
    mean, spread = posterior.draws(200_000, seed=4)
    gaps = np.random.default_rng(6).normal(mean, spread, (2, 2, 200_000)).mean(axis=1)
    widths = 2 * (found.path_radius - WIRE - gaps)
    within = np.abs(widths - 100.0) < 2.0
    assert np.mean(within[0]) == pytest.approx(found.within[0], abs=0.005)
    assert np.mean(np.all(within, axis=0)) == pytest.approx(found.all_within, abs=0.005)


def test_what_is_measured_scatters_more_than_the_size(posterior):
    size = predict_sizes([165.0], posterior, WIRE)
    seen = predict_sizes([165.0], posterior, WIRE, diameter_error=3.0, wanted=[100.0])
    assert seen.std[0] ** 2 - size.std[0] ** 2 == pytest.approx(3.0, rel=1e-10)
    assert size.within is None and seen.all_within is None and seen.within.shape == (1,)


def test_an_electrode_that_is_measured_improves_the_next_path():
    rng, truth, before, after = np.random.default_rng(8), 17.0, [], []
    for _ in range(40):
        known = fit_gap(GapData(rng.normal(truth, 2.0, 2), 0.3))
        first = corrected_path(100.0, known, WIRE)
        before.append(abs(first.counted_gap - truth))
        for _ in range(8):
            path = corrected_path(100.0, known, WIRE).path_radius
            diameter = 2 * (path - WIRE - rng.normal(truth, 2.0)) + rng.uniform(-1, 1)
            known = known.updated(GapData.from_electrodes(path, diameter, WIRE))
        after.append(abs(corrected_path(100.0, known, WIRE).counted_gap - truth))
    # From 2 readings to 10 the error of the mean shrinks by sqrt(5).
    assert np.mean(after) < 0.6 * np.mean(before)


def test_the_prior_alone_plans_and_says_so():
    found = corrected_path(100.0, GapPosterior.before(), WIRE)
    assert "no gap was measured" in found.status
    assert found.counted_gap == pytest.approx(20.0, abs=1e-6)


def test_a_window_wider_than_any_gap_takes_the_median(posterior):
    found = corrected_path(1e6, posterior, WIRE, loss="outside", tolerance=0.5)
    assert found.counted_gap == pytest.approx(float(posterior.next_gap().quantile(0.5)), abs=1e-9)
    assert found.prediction.all_within == pytest.approx(1.0, abs=1e-12)


def test_two_per_cent_of_a_normal_gap_is_an_error_function():
    # A gap known to scatter by 2.3 um about a known mean.
    known = GapPosterior(np.array([2.3]), np.zeros(1), np.array([15.0]), np.array([1e-9]))
    found = predict_sizes([165.0], known, WIRE, wanted=[100.0])
    assert found.all_within == pytest.approx(2 * scipy.stats.norm.cdf(1 / 2.3) - 1, rel=1e-8)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"wanted": [100.0, 0.0]}, "wanted size is 0 um"),
        ({"wanted": []}, "wanted size must be"),
        ({"wanted": math.nan}, "wanted size is nan um"),
        ({"wire_radius": -1.0}, "wire radius is -1 um"),
        ({"loss": "absolut"}, "did you mean 'absolute'"),
        ({"tolerance": 2.0}, "tolerance is 2, but must be a share"),
        ({"resolution": 0.0}, "resolution is 0 um"),
        ({"level": 1.0}, "level is 1"),
    ],
)
def test_faulty_numbers_are_named(posterior, changed, said):
    given = {"wanted": 100.0, "posterior": posterior, "wire_radius": WIRE} | changed
    with pytest.raises(InputError, match=said):
        corrected_path(**given)


def test_a_path_through_the_axis_and_another_number_of_sizes_are_refused(posterior):
    with pytest.raises(InputError, match="the wire would cut through the axis"):
        predict_sizes([90.0], posterior, WIRE)
    with pytest.raises(InputError, match="2 sizes are wanted of 1 path radii"):
        predict_sizes([165.0], posterior, WIRE, wanted=[100.0, 50.0])
