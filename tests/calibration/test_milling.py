"""Force coefficients from forces: against linear algebra, simulated readings, and verdicts."""

import math

import numpy as np
import pytest

from calibration import LogNormal, Parameter, sample
from calibration.milling import AXES, COEFFICIENTS, fit_force_coefficients
from procmodel.engagement import ForceCoefficients, instantaneous_force, mean_force
from procmodel.errors import InputError
from procmodel.io import ForceReadings

TRUTH = ForceCoefficients(796.0, 168.8, 222.0, 27.7, 30.8, 1.4)
NAMES = list(COEFFICIENTS)
FLUTES, RADIUS, HELIX = 4, 5.0, math.radians(30.0)
TOOL = {"radius": RADIUS, "helix": HELIX}


def design(feeds, starts, exits, depths):
    """Mean force per coefficient from the integrals of the definition, by hand: (3, n, 6)."""
    columns = np.zeros((3, len(feeds), 6))
    for limit, sign in ((exits, 1.0), (starts, -1.0)):
        cut = sign * FLUTES * depths / (2.0 * np.pi)
        chip = cut * feeds / 4.0
        double, plain = 2.0 * limit, limit
        columns[0, :, 0] += chip * np.cos(double)
        columns[0, :, 1] -= chip * (double - np.sin(double))
        columns[1, :, 0] += chip * (double - np.sin(double))
        columns[1, :, 1] += chip * np.cos(double)
        columns[2, :, 2] -= cut * feeds * np.cos(plain)
        columns[0, :, 3] -= cut * np.sin(plain)
        columns[0, :, 4] += cut * np.cos(plain)
        columns[1, :, 3] -= cut * np.cos(plain)
        columns[1, :, 4] -= cut * np.sin(plain)
        columns[2, :, 5] += cut * plain
    return columns


def means(rng, sigma, feeds=(0.02, 0.04, 0.06, 0.08), starts=(0.0, 1.6, 2.6), repeats=2):
    """Mean forces of every feed at every engagement, down milling."""
    feed, start = (np.repeat(g.ravel(), repeats) for g in np.meshgrid(feeds, starts))
    exact = np.asarray(
        mean_force(TRUTH, start, np.full(feed.size, np.pi), FLUTES, np.full(feed.size, 3.0), feed)
    )
    noisy = exact + rng.normal(size=exact.shape) * sigma
    return ForceReadings(feed, 3.0, start, np.pi, dict(zip(AXES, noisy.T, strict=True)))


def record(rng, sigma, offset, count=400, noise=None):
    """Forces along two turns, at two feeds and engagements."""
    rotation = np.linspace(0.0, 4.0 * np.pi, count, endpoint=False)
    feed = np.where(rotation < 2.0 * np.pi, 0.04, 0.08)
    start = np.where(rotation % (2.0 * np.pi) < np.pi, 2.4, 2.9)
    exact = np.asarray(
        instantaneous_force(
            TRUTH,
            (rotation + offset) % (2.0 * np.pi),
            start,
            np.full(count, np.pi),
            FLUTES,
            np.full(count, 5.0),
            feed,
            RADIUS,
            HELIX,
        )
    )
    noisy = exact + (rng.normal(size=exact.shape) * sigma if noise is None else noise)
    forces = dict(zip(AXES, noisy.T, strict=True))
    return ForceReadings(feed, 5.0, start, np.pi, forces, rotation=rotation)


def test_mean_forces_are_a_linear_problem():
    readings = means(np.random.default_rng(1), 5.0)
    found = fit_force_coefficients(readings, FLUTES, sigma=5.0).result
    matrix = design(
        readings.feed_per_tooth, readings.start, readings.exit, readings.axial_depth
    ).reshape(-1, 6)
    measured = np.concatenate([readings.forces[axis] for axis in AXES])
    expected = np.linalg.lstsq(matrix, measured)[0]
    covariance = 25.0 * np.linalg.inv(matrix.T @ matrix)
    for i, name in enumerate(NAMES):
        estimate = found.parameters[name]
        assert estimate.value == pytest.approx(expected[i], rel=1e-9)
        assert estimate.std == pytest.approx(math.sqrt(covariance[i, i]), rel=1e-9)
        assert estimate.verdict == "identified"


def test_every_axis_has_its_own_noise():
    readings = means(np.random.default_rng(2), np.array([1.0, 10.0, 0.1]), repeats=20)
    noise = fit_force_coefficients(readings, FLUTES).result.noise
    for axis, level in zip(AXES, (1.0, 10.0, 0.1), strict=True):
        # 240 readings: 4.6 % of standard deviation each.
        assert noise[axis] == pytest.approx(level, rel=0.15)


def test_one_feed_at_one_engagement_leaves_shearing_and_edge_open_by_name():
    readings = means(np.random.default_rng(3), 1.0, feeds=(0.04,), starts=(2.6,), repeats=8)
    found = fit_force_coefficients(readings, FLUTES).result
    assert {found.parameters[name].verdict for name in NAMES} == {"flat"}
    told = " ".join(found.directions)
    assert "axial_shear and axial_edge cannot be told apart" in told
    for name in NAMES:
        assert name in told


def test_a_second_feed_parts_them():
    readings = means(np.random.default_rng(3), 1.0, feeds=(0.04, 0.08), starts=(2.6,), repeats=8)
    found = fit_force_coefficients(readings, FLUTES).result
    assert {found.parameters[name].verdict for name in NAMES} == {"identified"}
    assert found.directions == ()


def test_one_reading_is_one_reading():
    readings = means(np.random.default_rng(3), 1.0, feeds=(0.04,), starts=(2.6,), repeats=1)
    with pytest.raises(InputError, match=r"^3 readings cannot fit 6 free parameters"):
        fit_force_coefficients(readings, FLUTES, sigma=1.0)


def test_known_coefficients_can_be_given():
    readings = means(np.random.default_rng(4), 1.0, feeds=(0.04,), starts=(2.6,), repeats=8)
    known = {
        "tangential_edge": 27.7,
        "radial_edge": 30.8,
        "axial_edge": Parameter(1.4, "N/mm", prior=LogNormal(1.4, 0.01), bounds=(0.0, math.inf)),
    }
    found = fit_force_coefficients(readings, FLUTES, sigma=1.0, parameters=known).result
    assert found.parameters["tangential_edge"].verdict == "fixed"
    shear = found.parameters["tangential_shear"]
    assert shear.value == pytest.approx(796.0, abs=4 * shear.std)
    assert shear.verdict == "identified"


def test_without_fz_the_axial_ones_are_left_out_and_said():
    readings = means(np.random.default_rng(5), 1.0)
    plane = {axis: readings.forces[axis] for axis in AXES[:2]}
    readings = ForceReadings(readings.feed_per_tooth, 3.0, readings.start, np.pi, plane)
    found = fit_force_coefficients(readings, FLUTES)
    assert "axial_shear" not in found.result.parameters
    assert found.coefficients.axial_shear == 0.0
    assert "no Fz was measured" in found.notes[0]
    assert found.as_dict()["warnings"][-1] == found.notes[-1]


def test_flipped_axes_are_noticed():
    readings = means(np.random.default_rng(6), 1.0)
    flipped = {axis: -force for axis, force in readings.forces.items()}
    readings = ForceReadings(readings.feed_per_tooth, 3.0, readings.start, np.pi, flipped)
    notes = fit_force_coefficients(readings, FLUTES).notes
    assert any("tangential_shear is below 0: check the signs of the axes" in n for n in notes)


@pytest.mark.parametrize("offset", [0.0, 0.7, 1.4])
def test_instantaneous_forces_and_where_the_rotation_counts_from(offset):
    readings = record(np.random.default_rng(7), 3.0, offset)
    fitted = fit_force_coefficients(readings, FLUTES, **TOOL, fit_rotation_offset=True)
    found = fitted.result
    assert found.converged
    for name in NAMES:
        estimate = found.parameters[name]
        assert estimate.value == pytest.approx(getattr(TRUTH, name), abs=4.5 * estimate.std)
        assert estimate.verdict == "identified"
    estimate = found.parameters["rotation_offset"]
    distance = (estimate.value - offset + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert abs(distance) < 4.5 * estimate.std
    assert estimate.std < 0.01
    assert any("pitch of 90 deg" in note for note in fitted.notes)
    assert not any("alike (" in note for note in fitted.notes)


def test_a_wrong_offset_shows_in_neighbouring_residuals():
    readings = record(np.random.default_rng(8), 3.0, 0.2)
    notes = fit_force_coefficients(readings, FLUTES, **TOOL, rotation_offset=0.0).notes
    assert any("neighbouring residuals of Fy are alike" in note for note in notes)


def test_runout_shows_in_neighbouring_residuals():
    # One flute of four cuts 40 % more: a force that repeats once a turn, not four times.
    rotation = np.linspace(0.0, 4.0 * np.pi, 400, endpoint=False)
    ripple = 10.0 * np.sin(rotation)[:, None] * np.ones(3)
    readings = record(
        None, None, 0.2, noise=ripple + np.random.default_rng(9).normal(size=(400, 3))
    )
    notes = fit_force_coefficients(readings, FLUTES, **TOOL, rotation_offset=0.2).notes
    assert sum("are alike" in note for note in notes) == 3


def share_covered(cases, **options):
    """Share of 95 % intervals that hold the truth."""
    rng = np.random.default_rng(2024)
    inside = []
    for _ in range(cases):
        readings = means(rng, np.array([4.0, 8.0, 2.0]))
        found = fit_force_coefficients(readings, FLUTES, **options).result
        for name in NAMES:
            low, high = found.parameters[name].interval95
            inside.append(low <= getattr(TRUTH, name) <= high)
    return float(np.mean(inside))


@pytest.mark.parametrize("options", [{"sigma": {"Fx": 4.0, "Fy": 8.0, "Fz": 2.0}}, {}])
def test_intervals_cover(options):
    # 400 cases of 6 coefficients in 3 correlated pairs: 0.7 % of standard deviation.
    assert share_covered(400, **options) == pytest.approx(0.95, abs=0.02)


def test_halved_sigma_does_not_cover():
    halved = {"sigma": {"Fx": 2.0, "Fy": 4.0, "Fz": 1.0}}
    # Negative control: half of 1.96 standard deviations hold 67.3 %.
    assert share_covered(100, **halved) == pytest.approx(0.673, abs=0.06)


def test_posterior_agrees_with_the_fit():
    readings = means(np.random.default_rng(11), 4.0)
    found = fit_force_coefficients(readings, FLUTES, sigma=4.0).result
    tree = sample(found.problem, seed=1, start=found)
    assert tree.attrs["converged"]
    for name in NAMES:
        draws, estimate = np.asarray(tree["posterior"][name]), found.parameters[name]
        assert float(draws.mean()) == pytest.approx(estimate.value, abs=0.15 * estimate.std)
        assert float(draws.std()) == pytest.approx(estimate.std, rel=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flutes": 0}, r"^flutes is 0, but must be a whole number"),
        (
            {"parameters": {"radial_edgy": 1.0}},
            r"'radial_edgy' is unknown; did you mean 'radial_edge",
        ),
        ({"sigma": {"thrust": 1.0}}, r"^sigma names unknown force 'thrust'; known are Fx, Fy, Fz"),
        ({"sigma": -1.0}, r"^sigma of reading 1 is not above 0"),
        ({"fit_rotation_offset": True}, r"^a rotation offset shows in instantaneous forces alone"),
    ],
)
def test_faulty_options_of_mean_forces(options, message):
    readings = means(np.random.default_rng(0), 1.0)
    with pytest.raises(InputError, match=message):
        fit_force_coefficients(readings, **{"flutes": FLUTES} | options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"helix": HELIX}, r"^radius is missing: instantaneous forces depend"),
        ({"radius": RADIUS}, r"^helix is missing: "),
        ({"radius": -1.0, "helix": HELIX}, r"^radius is -1 mm, but must be above 0\.$"),
        ({"radius": RADIUS, "helix": 0.0}, r"^helix is 0 deg, but must be above 0"),
    ],
)
def test_faulty_options_of_instantaneous_forces(options, message):
    readings = record(np.random.default_rng(0), 1.0, 0.0, count=20)
    with pytest.raises(InputError, match=message):
        fit_force_coefficients(readings, FLUTES, **options)
