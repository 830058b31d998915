"""Path of the wire and finished electrode: there and back, brute force, gradients, passes."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.electrode import (
    Line,
    Profile,
    cone_frustum,
    dimensions_with_gap,
    from_bulges,
    ground_radius,
    index_angles,
    interpolate_profile,
    least_hollow_radius,
    parallel,
    radius_after_passes,
    radius_at,
    section_area,
    wire_path,
    with_leads,
)
from procmodel.electrode.profile import directions, ends
from procmodel.errors import InputError
from tests.procmodel.electrode.shapes import PROFILES, radius_by_discs

WIRE, GAP = 10.0, 5.0


def heights_of(name, count=41):
    top = 129.0 if name == "corners" else 149.0
    return np.linspace(0.3, top, count)


@pytest.mark.parametrize("name", PROFILES)
def test_path_and_back(name):
    """The wanted profile comes out where the gap is the one counted on."""
    profile, z = PROFILES[name], heights_of(name)
    path = wire_path(profile, WIRE, GAP)
    left = ground_radius(path, WIRE, GAP, z)
    # At its edge a disc is steep: a height that rounds by 1e-13 moves its x by the square root.
    np.testing.assert_allclose(left, radius_at(profile, z), atol=1e-6)


@pytest.mark.parametrize("gap", [2.0, 5.0, 7.5])
@pytest.mark.parametrize("name", PROFILES)
def test_finished_radius_is_what_the_discs_leave(name, gap):
    path = wire_path(PROFILES[name], WIRE, GAP)
    z = np.linspace(-20.0, 200.0, 83)
    left = np.asarray(ground_radius(path, WIRE, gap, z))
    expected = radius_by_discs(path, WIRE + gap, z)
    np.testing.assert_array_equal(np.isinf(left), np.isinf(expected))
    cut = np.isfinite(left)
    # Of 20,001 centres the best misses the least x by little, and never undercuts it.
    assert np.all(left[cut] <= expected[cut] + 1e-9)
    np.testing.assert_allclose(left[cut], expected[cut], atol=2e-4)


def test_a_line_moves_by_the_error_of_the_gap():
    """On a flank the radius changes by the gap's error over the cosine of the half angle."""
    path = wire_path(PROFILES["cone"], WIRE, GAP)
    stretch = math.hypot(30.0, 150.0) / 150.0
    for gap in (3.0, 8.0):
        got = ground_radius(path, WIRE, gap, jnp.array([60.0, 75.0]))
        expected = np.array([42.0, 45.0]) + (GAP - gap) * stretch
        np.testing.assert_allclose(got, expected, atol=1e-10)


def test_with_a_lead_in_the_tip_gets_its_size_from_the_flank():
    path = wire_path(PROFILES["cone"], WIRE, GAP)
    stretch = math.hypot(30.0, 150.0) / 150.0
    tip = jnp.asarray(0.0)
    wanted = 30.0 - 3.0 * stretch
    assert float(ground_radius(with_leads(path, 5.0), WIRE, GAP + 3.0, tip)) == pytest.approx(
        wanted
    )
    # Without one a wire with a wider gap starts above the place that it should touch.
    assert float(ground_radius(path, WIRE, GAP + 3.0, tip)) > wanted + 1e-3
    led = with_leads(path, 5.0, 7.0)
    lengths = [math.dist(*np.asarray(ends(piece))) for piece in led.pieces]
    assert lengths == pytest.approx([5.0, math.hypot(30.0, 150.0), 7.0])
    along = [np.asarray(directions(piece)[0]) for piece in led.pieces]
    np.testing.assert_allclose(along[0], along[1])
    np.testing.assert_allclose(along[2], along[1])
    with pytest.raises(InputError, match="lead in is -1"):
        with_leads(path, -1.0)


def test_the_blank_stays_where_the_wire_does_not_reach():
    path = wire_path(PROFILES["cone"], WIRE, GAP)
    got = ground_radius(path, WIRE, GAP, jnp.array([75.0, 400.0]), 150.0)
    np.testing.assert_allclose(got, [45.0, 150.0])
    assert float(ground_radius(path, WIRE, 100.0, jnp.asarray(75.0))) == 0.0


def test_the_finishing_pass_decides():
    paths = [wire_path(PROFILES["cone"], WIRE, GAP, left) for left in (20.0, 0.0)]
    z = jnp.array([50.0, 75.0])
    alone = ground_radius(paths[1], WIRE, 6.0, z)
    for rough in (2.0, 5.0, 20.0):
        gaps = jnp.array([rough, 6.0])
        np.testing.assert_array_equal(radius_after_passes(paths, WIRE, gaps, z), alone)
    # Unless roughing was so wild that it went through what it should leave.
    wild = radius_after_passes(paths, WIRE, jnp.array([28.0, 6.0]), z)
    np.testing.assert_allclose(wild, ground_radius(paths[0], WIRE, 28.0, z))
    assert np.all(np.asarray(wild) < np.asarray(alone))


def test_dimensions_for_draws_of_the_gap():
    gaps = np.random.default_rng(1).normal(GAP, 1.0, (20, 2))
    paths = [wire_path(PROFILES["hollow"], WIRE, GAP, left) for left in (20.0, 0.0)]
    z = np.array([10.0, 75.0, 140.0])
    got = dimensions_with_gap(paths, z, gaps, WIRE)
    assert got.shape == (20, 3)
    one = [2.0 * ground_radius(paths[1], WIRE, gap, z) for gap in gaps[:, 1]]
    np.testing.assert_allclose(got, one, atol=1e-12)
    single = dimensions_with_gap(paths[1], z, gaps[:, 1], WIRE)
    np.testing.assert_allclose(single, got, atol=1e-12)
    np.testing.assert_allclose(dimensions_with_gap(paths, z, gaps[:, 1], WIRE), got, atol=1e-12)
    # A hollow's circle grows by the gap: x = x_c - sqrt((R + dg)^2 - (z - z_c)^2).
    arc = paths[1].pieces[0]
    radius = 200.0 + gaps[:, 1, None] - GAP
    off = z - float(arc.centre[1])
    closed = 2.0 * (float(arc.centre[0]) - np.sqrt(radius**2 - off**2))
    np.testing.assert_allclose(got[:, 1], closed[:, 1], atol=1e-9)


def test_flats_have_a_gap_each():
    path = wire_path(PROFILES["cone"], WIRE, GAP)
    gaps = np.random.default_rng(2).normal(GAP, 1.0, (500, 1, 2))
    z = np.array([75.0])
    width = np.asarray(dimensions_with_gap(path, z, gaps, WIRE))
    stretch = math.hypot(30.0, 150.0) / 150.0
    np.testing.assert_allclose(
        width[:, 0], 90.0 + stretch * (2 * GAP - gaps[:, 0].sum(axis=1)), atol=1e-9
    )
    with pytest.raises(ValueError, match="do not fit 1 passes"):
        dimensions_with_gap(path, z, gaps[:, :, :1], WIRE)


@pytest.mark.parametrize("name", ["hollow", "steps", "corners"])
def test_gradient_in_gap_and_wire_radius(name):
    path = wire_path(PROFILES[name], WIRE, GAP)
    # Heights away from the corners and joints, where the radius has a kink in the gap.
    z = np.array([22.0, 60.5, 84.0, 117.0])

    @jax.jit
    def size(values):
        return dimensions_with_gap(path, z, values[:1], values[1])[0]

    at = jnp.array([6.0, WIRE])
    slopes = jax.jacrev(size)(at)
    for i in range(2):
        step = np.eye(2)[i] * 1e-5
        expected = (size(at + step) - size(at - step)) / 2e-5
        np.testing.assert_allclose(slopes[:, i], expected, rtol=1e-6, atol=1e-6)
    # Wire radius and gap only matter together.
    np.testing.assert_allclose(slopes[:, 0], slopes[:, 1], rtol=1e-12)
    assert np.all(np.asarray(slopes) < 0.0)


def test_gradient_in_the_end_points_through_path_and_grinding():
    @jax.jit
    def size(ends):
        profile = Profile((Line(ends[:2], ends[2:4]), Line(ends[2:4], ends[4:])))
        path = parallel(profile, WIRE + GAP)
        return ground_radius(path, WIRE, GAP + 1.0, jnp.array([20.0, 90.0]))

    ends = jnp.array([20.0, 0.0, 40.0, 60.0, 45.0, 150.0])
    slopes = jax.jacfwd(size)(ends)
    for i in range(6):
        step = np.eye(6)[i] * 1e-5
        expected = (size(ends + step) - size(ends - step)) / 2e-5
        np.testing.assert_allclose(slopes[:, i], expected, atol=1e-6)
    # The size at a height belongs to its own piece.
    assert np.all(np.asarray(slopes)[0, 4:] == 0.0) and np.any(np.asarray(slopes)[1, 4:] != 0.0)


def test_gradient_stays_finite_at_the_reach_of_the_wire():
    path = wire_path(PROFILES["cone"], WIRE, GAP)
    lowest = float(np.asarray(path.pieces[0].start)[1]) - WIRE - GAP

    def size(gap):
        return jnp.sum(ground_radius(path, WIRE, gap, jnp.array([lowest, lowest - 50.0]), 90.0))

    assert np.isfinite(jax.grad(size)(GAP))


def test_arcs_of_a_path_are_differentiable_in_their_radius():
    path = wire_path(PROFILES["hollow"], WIRE, GAP)

    def size(radius):
        moved = eqx.tree_at(lambda p: p.pieces[0].radius, path, radius)
        return ground_radius(moved, WIRE, GAP, jnp.asarray(75.0))

    radius = float(path.pieces[0].radius)
    expected = (size(radius + 1e-5) - size(radius - 1e-5)) / 2e-5
    assert float(jax.grad(size)(radius)) == pytest.approx(float(expected), rel=1e-6)


def test_section_area():
    assert float(section_area(50.0)) == pytest.approx(math.pi * 2500.0)
    assert float(section_area(50.0, 4)) == pytest.approx(100.0**2)
    # An equilateral triangle about a circle of radius r has the area 3 sqrt(3) r^2.
    assert float(section_area(2.0, 3)) == pytest.approx(12.0 * math.sqrt(3.0))
    corners = np.exp(2j * np.pi * np.arange(6) / 6) * 7.0 / math.cos(math.pi / 6)
    shoelace = 0.5 * np.sum((corners.conj() * np.roll(corners, -1)).imag)
    assert float(section_area(7.0, 6)) == pytest.approx(shoelace)
    np.testing.assert_allclose(np.degrees(index_angles(4)), [0.0, 90.0, 180.0, 270.0])


def test_least_hollow():
    assert float(least_hollow_radius(WIRE, GAP)) == 15.0
    # As tight as that can just be cut; the profile of the tests has a hollow of 25.
    z = np.array([115.0, 125.0, 135.0])
    path = wire_path(PROFILES["steps"], 20.0, 5.0)
    got = ground_radius(path, 20.0, 5.0, z)
    np.testing.assert_allclose(got, radius_at(PROFILES["steps"], z), atol=1e-6)


def test_a_profile_that_hangs_over_is_refused():
    mushroom = from_bulges([[30, 0], [60, 40], [60, 60], [40, 50], [40, 90]])
    for profile, piece in (
        (from_bulges([[60, 40], [60, 60], [40, 50], [20, 60]]), 2),
        (from_bulges([[60, 0], [60, 60], [20, 60]], [0, 1.5]), 2),
        (from_bulges([[60, 0], [60, 60], [50, 60]], [0, 1.0]), 2),
    ):
        with pytest.raises(InputError, match=f"piece {piece} of the profile hangs over"):
            wire_path(profile, 0.0, 0.0)
    with pytest.raises(InputError, match="hollow corner"):
        wire_path(mushroom, 8.0, 1.0)


def test_half_a_circle_between_two_shoulders_just_fits():
    slot = from_bulges([[100, 0], [100, 40], [70, 40], [70, 70], [100, 70], [100, 99]],
                       [0, 0, -1, 0, 0])  # fmt: skip
    z = np.array([20.0, 41.0, 55.0, 69.0, 85.0])
    path = wire_path(slot, 10.0, 5.0)
    np.testing.assert_allclose(ground_radius(path, 10.0, 5.0, z), radius_at(slot, z), atol=1e-6)
    with pytest.raises(InputError, match="radius 15 um, tighter"):
        wire_path(slot, 10.0, 5.1)


@pytest.mark.parametrize("bulge", [-0.4142, -0.4143])
def test_bulges_with_four_decimals_are_smooth(bulge):
    """Either way off the quarter circle: a slight corner, or one that slightly falls."""
    shape = from_bulges([[30, 0], [50, 60], [50, 160], [80, 190]], [0, 0, bulge])
    path = wire_path(shape, 15.0, 10.0)
    z = np.linspace(1.0, 189.0, 95)
    np.testing.assert_allclose(ground_radius(path, 15.0, 10.0, z), radius_at(shape, z), atol=1e-4)
    points, _ = interpolate_profile(path, 0.3)
    assert np.hypot(*np.diff(points, axis=0).T).max() < 0.31
    coarse = from_bulges([[30, 0], [50, 60], [50, 160], [80, 190]], [0, 0, -0.413])
    with pytest.raises(InputError, match="pieces 2 and 3"):
        wire_path(coarse, 15.0, 10.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((-1.0, 5.0), ("wire radius", "-1")),
        ((10.0, -0.5), ("gap", "-0.5")),
        ((10.0, math.nan), ("gap", "finite")),
        ((10.0, 5.0, -2.0), ("allowance", "-2")),
        ((24.0, 1.5), ("hollow of radius 25", "25.5", "thinner wire")),
    ],
)
def test_bad_input_is_one_sentence(arguments, words):
    with pytest.raises(InputError) as caught:
        wire_path(PROFILES["steps"], *arguments)
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".")
    assert all(word in text for word in words), text


def test_no_wire_leaves_the_path_itself():
    profile = cone_frustum(30.0, 60.0, 150.0)
    np.testing.assert_allclose(wire_path(profile, 0.0, 0.0).pieces[0].end, [60.0, 150.0])
