"""From a measured profile to the wear ratio: halves, full sections, gaps, layers, refusals."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.wear import TestCavity, fit_cavity
from procmodel.errors import InputError

AREA = math.pi * 50.0**2
CAVITY = TestCavity("square", 250.0, 2.0, 2.0, AREA, layers=100)
UNCOUNTED = replace(CAVITY, layers=None)
HALF = np.linspace(0.0, 249.5, 100)
FULL = np.linspace(-330.0, 390.0, 361)
FRAME = {"centre": 37.0, "zero": -4.0, "tilt": 2e-3}


def profile(x, layers=100, gap=0.0, ratio=0.3, factor=4.0, centre=0.0, zero=0.0, tilt=0.0):
    """Wall through the outer bottom corners of the layers, written out independently."""
    half_widths = 250.0 - 2.0 * np.arange(layers)
    thickness = 2.0 / (1.0 + ratio * factor * (half_widths + gap) ** 2 / AREA)
    corners, depth = (half_widths + gap)[::-1], np.cumsum(thickness)[::-1]
    across = np.asarray(x) - centre
    inside = np.interp(np.abs(across), corners, depth)
    wall = np.where(np.abs(across) > half_widths[0] + gap, 0.0, inside)
    return wall + zero + tilt * across


def noise(size, seed, level=0.3):
    return level * np.random.default_rng(seed).normal(size=size)


def within(estimate, truth, deviations=4.0):
    return abs(estimate.value - truth) <= deviations * estimate.std


@pytest.fixture(scope="module")
def full_depths():
    return profile(FULL, **FRAME) + noise(361, 0)


@pytest.fixture(scope="module")
def full(full_depths):
    return fit_cavity(FULL, full_depths, CAVITY)


def test_exact_half_profile():
    found = fit_cavity(HALF, profile(HALF), CAVITY)
    assert found.reach == "half" and not found.flipped
    assert found.result.parameters["wear_ratio"].value == pytest.approx(0.3, rel=1e-8)
    assert found.result.parameters["wear_per_area"].value == pytest.approx(0.3 / AREA, rel=1e-8)
    for name in ("centre", "zero", "tilt", "gap", "electrode_area"):
        assert found.result.parameters[name].verdict == "fixed"


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("upwards", [False, True])
def test_half_profile_either_side_and_either_sign_of_z(side, upwards):
    depths = profile(HALF) + noise(100, 1)
    x, z = side * HALF, -depths if upwards else depths
    found = fit_cavity(x[::side], z[::side], CAVITY)
    assert found.flipped == upwards
    assert within(found.result.parameters["wear_ratio"], 0.3)
    assert found.result.noise["data"] == pytest.approx(0.3, rel=0.15)
    np.testing.assert_array_equal(found.depth, depths[::side])


def test_full_profile_finds_centre_zero_and_tilt(full):
    assert full.reach == "full" and full.result.converged
    for name, truth in ({"wear_ratio": 0.3} | FRAME).items():
        estimate = full.result.parameters[name]
        assert estimate.verdict == "identified"
        assert within(estimate, truth)
    assert full.result.noise["data"] == pytest.approx(0.3, rel=0.1)
    predicted = full.predict(full.position)
    np.testing.assert_allclose(full.depth - predicted, full.result.residuals["data"], atol=1e-9)
    exact = {"wear_ratio": 0.3, "electrode_area": AREA, "gap": 0.0, **FRAME}
    wall = np.abs(np.abs(FULL - 37.0) - 251.0) > 2.5  # away from the edge's ramp
    np.testing.assert_allclose(full.predict(FULL, exact)[wall], profile(FULL, **FRAME)[wall])


def test_turning_the_instrument_round_changes_nothing(full, full_depths):
    upwards = fit_cavity(FULL, -full_depths, CAVITY)
    mirrored = fit_cavity(-FULL[::-1], full_depths[::-1], CAVITY)
    assert upwards.flipped and not mirrored.flipped
    for name, sign in {"wear_ratio": 1, "zero": 1, "centre": -1, "tilt": -1}.items():
        expected = full.result.parameters[name]
        turned = mirrored.result.parameters[name]
        assert upwards.result.parameters[name].value == pytest.approx(expected.value, rel=1e-6)
        assert turned.value == pytest.approx(sign * expected.value, rel=1e-5)
        assert turned.std == pytest.approx(expected.std, rel=1e-4)


def test_reach_can_be_forced(full_depths):
    forced = fit_cavity(FULL, full_depths, CAVITY, reach="full")
    assert forced.reach == "full"
    with pytest.raises(InputError, match=r"both sides of 0 but only one wall.*centre"):
        fit_cavity(FULL, full_depths, CAVITY, reach="half", source="scan.csv")


def test_known_gap_ignored_gap_and_fitted_gap():
    depths = profile(FULL, gap=3.0, **FRAME) + noise(361, 2)
    known = fit_cavity(FULL, depths, CAVITY, gap=3.0)
    assert within(known.result.parameters["wear_ratio"], 0.3)
    ignored = fit_cavity(FULL, depths, CAVITY)
    assert not within(ignored.result.parameters["wear_ratio"], 0.3)
    fitted = fit_cavity(FULL, depths, CAVITY, fit_gap=True)
    assert within(fitted.result.parameters["gap"], 3.0)
    assert within(fitted.result.parameters["wear_ratio"], 0.3)
    # The wall's position shows the gap: not the trade-off of depths alone.
    assert fitted.result.parameters["gap"].std < 0.2
    assert not fitted.result.trades


def test_depths_of_layers_show_the_gap_only_in_the_area():
    widths = 250.0 - 2.0 * np.arange(100)
    depths = profile(widths + 3.0, gap=3.0)
    ignored = fit_cavity(widths[::-1], depths[::-1], CAVITY, readings="depths")
    bias = ignored.result.parameters["wear_ratio"].value / 0.3 - 1.0
    assert bias == pytest.approx(0.044, abs=0.001)
    assert ignored.result.residual_rms == pytest.approx(0.12, abs=0.005)
    noisy = depths + noise(100, 3, level=1.0)
    fitted = fit_cavity(widths[::-1], noisy[::-1], CAVITY, 1.0, readings="depths", fit_gap=True)
    assert fitted.result.correlation[0, 1] == pytest.approx(-0.987, abs=0.003)
    assert "trade off" in fitted.result.report()
    known = fit_cavity(widths[::-1], depths[::-1], CAVITY, readings="depths", gap=3.0)
    assert known.result.parameters["wear_ratio"].value == pytest.approx(0.3, rel=1e-7)


def test_layers_are_counted_from_the_floor(full_depths):
    counted = fit_cavity(FULL, full_depths, UNCOUNTED)
    assert counted.cavity.layers == 100
    assert 100 in counted.possible_layers
    assert within(counted.result.parameters["wear_ratio"], 0.3)
    shallow = profile(FULL, layers=37, **FRAME) + noise(361, 4)
    assert fit_cavity(FULL, shallow, UNCOUNTED).cavity.layers == 37
    # Believing that all 125 layers were cut gives another wear ratio altogether.
    everything = fit_cavity(FULL, full_depths, replace(CAVITY, layers=125))
    assert not within(everything.result.parameters["wear_ratio"], 0.3)


def test_a_cavity_cut_to_its_point_has_all_its_layers():
    depths = profile(HALF, layers=125) + noise(100, 5)
    found = fit_cavity(HALF, depths, UNCOUNTED)
    assert found.cavity.layers == 125
    assert within(found.result.parameters["wear_ratio"], 0.3)


def test_a_doubtful_count_is_noted():
    # A profile that ends above the floor's edge: noise hides where the floor begins.
    depths = profile(HALF) + noise(100, 6, level=3.0)
    found = fit_cavity(HALF, depths, UNCOUNTED)
    assert len(found.possible_layers) > 1
    low, high = min(found.possible_layers), max(found.possible_layers)
    assert low <= 100 <= high
    note = next(n for n in found.notes if "number of layers" in n)
    assert f"{low} to {high}" in note


def test_circular_cavity_and_given_sigma():
    circle = replace(CAVITY, section="circle")
    depths = profile(HALF, factor=math.pi) + noise(100, 7)
    found = fit_cavity(HALF, depths, circle, 0.3)
    assert within(found.result.parameters["wear_ratio"], 0.3)
    assert found.result.noise["data"] is None
    assert found.result.reduced_chi2 == pytest.approx(1.0, abs=0.3)
    assert not any("corner" in note for note in found.notes)


def test_round_electrode_in_a_square():
    widths = 250.0 - 2.0 * np.arange(100)
    area = 4.0 * widths**2 - (4.0 - math.pi) * 50.0**2
    corners = np.cumsum(2.0 / (1.0 + 0.3 * area / AREA))
    depths = np.interp(HALF, widths[::-1], corners[::-1])
    rounded = fit_cavity(HALF, depths, replace(CAVITY, corner_radius=50.0))
    assert rounded.result.parameters["wear_ratio"].value == pytest.approx(0.3, rel=1e-6)
    sharp = fit_cavity(HALF, depths, CAVITY)
    change = 0.3 / sharp.result.parameters["wear_ratio"].value - 1.0
    # The note says what the round electrode would change: the right size and sign.
    note = next(n for n in sharp.notes if "corners are taken as sharp" in n)
    assert f"{100 * change:+.2g} %" in note


def test_the_note_on_the_gap_says_what_it_would_change():
    depths = profile(HALF) + noise(100, 8)
    found = fit_cavity(HALF, depths, CAVITY)
    wider = fit_cavity(HALF, depths, CAVITY, gap=1.0)
    change = 100 * (
        wider.result.parameters["wear_ratio"].value / found.result.parameters["wear_ratio"].value
        - 1
    )
    note = next(n for n in found.notes if "side gap is taken as 0 um" in n)
    assert f"{change:+.2g} %" in note


def test_electrode_area_cannot_be_fitted_beside_the_wear_ratio():
    found = fit_cavity(HALF, profile(HALF) + noise(100, 9), CAVITY, fit_electrode_area=True)
    for name in ("wear_ratio", "electrode_area"):
        assert found.result.parameters[name].verdict == "flat"
    assert found.result.parameters["wear_per_area"].verdict == "identified"
    assert within(found.result.parameters["wear_per_area"], 0.3 / AREA)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"section": "hexagon"}, "section 'hexagon' is unknown; known are square, circle"),
        ({"half_width": 0.0}, "half width 0 must be above 0"),
        ({"step": -2.0}, "step -2 must be above 0"),
        ({"feed": math.nan}, "feed nan must be above 0"),
        ({"electrode_area": math.inf}, "electrode area inf"),
        ({"step": 251.0}, "step 251 um is greater than the half width 250 um"),
        ({"layers": 126}, "layers is 126, .* there can be 1 to 125"),
        ({"layers": 0}, "layers is 0"),
    ],
)
def test_a_cavity_refuses(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        replace(CAVITY, **changes)


def test_most_layers():
    assert CAVITY.most_layers == 125
    assert replace(CAVITY, step=3.0, layers=None).most_layers == 84
    assert replace(CAVITY, step=250.0, layers=None).most_layers == 1


def test_impossible_depths_are_refused():
    with pytest.raises(InputError, match=r"scan\.csv is 300 um deep, but 100 layers"):
        fit_cavity(HALF, np.full(100, 300.0), CAVITY, source="scan.csv")
    with pytest.raises(InputError, match=r"200 um.*unit of z"):
        fit_cavity(HALF, profile(HALF) * 1000.0, CAVITY)  # nanometres
    # All of the feed, to the noise, is an electrode that does not wear.
    unworn = fit_cavity(HALF, profile(HALF, ratio=0.0) + noise(100, 10), CAVITY)
    assert unworn.result.parameters["wear_ratio"].value < 1e-3


def test_readings_that_are_not_numbers_are_refused():
    broken = profile(HALF)
    broken[7] = np.nan
    with pytest.raises(InputError, match=r"not finite|NaN"):
        fit_cavity(HALF, broken, CAVITY)
