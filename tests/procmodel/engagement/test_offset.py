"""Parallel curves against polygons of shapely, closed forms and finite differences.

What a distance leaves is compared with polygons that are put together piece by piece from capsules,
sectors of rings and discs. Their arcs are chords, off by at most e = (R + d) (1 - cos(step / 2)),
so each of them lies between the exact sets for d - e and d + e. Both the exact result and the
polygon for d therefore lie between the polygons for d - 2 e and d + 2 e: the area between these two
bounds the symmetric difference, with no assumption on the shape.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import LineString, Point

from procmodel.engagement.contour import Contour, contour
from procmodel.engagement.offset import meeting_points, offset, parallel, traced
from procmodel.engagement.segments import Segments, advance, joined, lengths
from tests.procmodel.engagement.shapes import (
    box,
    circle,
    d_shape,
    dilated,
    dumbbell,
    eroded,
    polygonal,
    region,
    rounded_rectangle,
    sagitta,
    sampled,
    stars,
    total_length,
)


def base_of(contours):
    return joined([c.segments.on_host() for c in contours])


def compare(contours, distance):
    """The result, after comparing it with the polygons."""
    found = offset(contours, distance)
    by_polygons = partial(eroded if distance > 0 else dilated, contours)
    reach = abs(distance)
    off = max(sagitta(c, reach) for c in contours)
    ours = region(found)
    low, high = by_polygons(max(reach - 2 * off, 0.0)), by_polygons(reach + 2 * off)
    own = max((sagitta(c) for c in found), default=0.0) * (total_length(found) + 1.0)
    bound = abs(high.area - low.area) + own + 1e-6
    expected = by_polygons(reach)
    assert abs(ours.area - expected.area) <= bound
    assert ours.symmetric_difference(expected).area <= bound
    # The bound itself says something: it is far below what a wrong piece would make.
    assert bound <= 0.01 * region(contours).area
    area = sum(c.area for c in found)
    assert area == pytest.approx(ours.area, abs=own + 1e-6)
    keeps_distance(contours, found, reach)
    return found


def keeps_distance(contours, found, reach):
    walls = shapely.union_all([LineString([*p, p[0]]) for p in map(sampled, contours)])
    off = max(sagitta(c) for c in contours)
    for c in found:
        away = np.array([walls.distance(Point(p)) for p in sampled(c)[::3]])
        # Nowhere nearer, and, being parallel, nowhere farther either.
        assert away.min() >= reach - off - 1e-7
        assert away.max() <= reach + off + 1e-7


@settings(max_examples=25)
@given(walls=stars(), share=st.floats(0.01, 0.4))
def test_shrinking_against_polygons(walls, share):
    compare(walls, 10.0 * share)


@settings(max_examples=15)
@given(walls=stars(), share=st.floats(0.01, 0.3))
def test_growing_against_polygons(walls, share):
    # Growing into the material beside a pocket, and over an island smaller than the distance.
    compare(walls, -10.0 * share)


@pytest.mark.parametrize("corner", [0.5, 2.0, 3.0, 5.0])
@pytest.mark.parametrize("distance", [2.0, 3.0, -1.5])
def test_rounded_rectangle_in_closed_form(corner, distance):
    (found,) = offset([rounded_rectangle(20, 12, corner)], distance)
    width, height, bend = 20 - 2 * distance, 12 - 2 * distance, max(corner - distance, 0.0)
    assert found.area == pytest.approx(width * height - (4 - math.pi) * bend**2, rel=1e-9)
    assert found.length == pytest.approx(2 * (width + height) - (8 - 2 * math.pi) * bend, rel=1e-9)
    # Growing keeps the corners round about the same centres; no piece is made twice.
    assert len(found.bulges) == (8 if bend > 0 else 4)


def test_circles_in_closed_form():
    (inner,) = offset([circle(5.0, (1, 2))], 1.5)
    assert inner.area == pytest.approx(math.pi * 3.5**2, rel=1e-12)
    (outer,) = offset([circle(5.0, (1, 2), -1.0)], 1.5)
    assert outer.area == pytest.approx(-math.pi * 6.5**2, rel=1e-12)
    np.testing.assert_allclose(np.hypot(*(np.asarray(outer.points) - [1, 2]).T), 6.5, rtol=1e-12)
    assert offset([circle(5.0)], 5.5) == []


def test_a_convex_corner_of_the_material_is_walked_round():
    # Around a square boss: four sides and four quarter circles.
    (found,) = offset([box(4, 4).reversed()], 1.0)
    assert found.area == pytest.approx(-(16 + 16 + math.pi), rel=1e-12)
    assert found.length == pytest.approx(16 + 2 * math.pi, rel=1e-12)


def test_the_d_shape_in_closed_form():
    # Inside: the disc of R - d cut by a line at d above the middle.
    radius, d = 4.0, 1.0
    (found,) = offset([d_shape(radius)], d)
    inner, half = radius - d, math.acos(d / (radius - d))
    assert found.area == pytest.approx(
        inner**2 * (half - math.sin(half) * math.cos(half)), rel=1e-9
    )
    assert found.length == pytest.approx(2 * inner * (math.sin(half) + half), rel=1e-9)


@pytest.mark.parametrize("half", [0.4, 0.9])
def test_a_narrow_neck_splits_the_region(half):
    found = compare([dumbbell(half, 2 * half, 6.0, 8.0)], 1.0)
    assert len(found) == 2
    # Chambers of 6 by 6, and a little more in the mouths of the neck.
    assert all(c.area >= 36.0 for c in found)


def test_a_wide_neck_leaves_one():
    assert len(compare([dumbbell(1.2, 2.4, 6.0, 8.0)], 1.0)) == 1


def test_a_neck_of_twice_the_distance():
    # All of the neck's middle line is exactly that far from both sides, and encloses nothing.
    found = offset([dumbbell(1.0, 2.0, 6.0, 8.0)], 1.0)
    # Beside each mouth, the corners leave 2 (r^2 - pi r^2 / 4) beyond the square of 6.
    expected = 2 * (36 + 2 * (1 - math.pi / 4))
    assert sum(c.area for c in found) == pytest.approx(expected, rel=1e-6)
    keeps_distance([dumbbell(1.0, 2.0, 6.0, 8.0)], found, 1.0)


@pytest.mark.parametrize("excess", [1e-3, 1e-6, -1e-3, -1e-5])
def test_a_neck_of_nearly_twice_the_distance(excess):
    half = 1.0 + excess
    found = offset([dumbbell(half, 2 * half, 6.0, 8.0)], 1.0)
    assert len(found) == (1 if excess > 0 else 2)
    # Each mouth, 1 deep, and if it is open the neck, 6 - 2 + 2 long, are wider by 2 excess; where
    # the mouth ends in a cusp, the last sqrt(2 excess) of it is missing.
    wider = 4 * excess + (12 * excess if excess > 0 else 0.0)
    expected = 2 * (36 + 2 * (1 - math.pi / 4)) + wider
    cusp = 0.0 if excess > 0 else 4 * abs(excess) * math.sqrt(2 * abs(excess))
    assert sum(c.area for c in found) == pytest.approx(expected, abs=cusp + 1e-9)


def test_arcs_smaller_than_the_tool_vanish():
    # Concave corners of 0.5 in a pocket, at a distance of 1: square corners are left.
    (found,) = compare([rounded_rectangle(20, 12, 0.5)], 1.0)
    assert np.all(np.asarray(found.bulges) == 0.0)


def test_a_slot_narrower_than_the_tool_is_not_entered():
    slot = contour(
        [[-6, -4], [6, -4], [6, 4], [0.5, 4], [0.5, 6], [-0.5, 6], [-0.5, 4], [-6, 4]],
        [0, 0, 0, 0, 1.0, 0, 0, 0],
    )
    (found,) = compare([slot], 1.0)
    # It dips between the two corners of the mouth: up to 1 - sqrt(1 - 0.5^2) beyond y = 3.
    assert np.asarray(found.points)[:, 1].max() == pytest.approx(4 - math.sqrt(0.75), abs=1e-9)


@pytest.mark.parametrize("distance", [3.1, 4.0, 10.0])
def test_nothing_is_left_of_a_narrow_pocket(distance):
    assert offset([box(20, 6)], distance) == []
    assert offset([rounded_rectangle(20, 6, 2)], distance) == []
    assert offset([d_shape(6.0)], distance) == []


def test_no_distance_and_no_contours():
    walls = [box(4, 4)]
    assert offset(walls, 0.0) == walls
    assert offset([], 1.0) == []


def test_an_island_that_swallows_the_pocket():
    assert offset([circle(5.0), circle(4.0, turn=-1.0)], 0.6) == []
    found = offset([circle(5.0), circle(4.0, turn=-1.0)], 0.4)
    assert sum(c.area for c in found) == pytest.approx(math.pi * (4.6**2 - 4.4**2), rel=1e-9)


def test_islands_grow_together():
    walls = [box(30, 20), circle(2.0, (-2.5, 0), -1.0), circle(2.0, (2.5, 0), -1.0)]
    assert len(compare(walls, 0.4)) == 3
    assert len(compare(walls, 1.0)) == 2


@pytest.mark.parametrize("distance", [0.7, -0.7])
def test_collinear_vertices_change_nothing(distance):
    corners = np.array([[0, 0], [8, 0], [8, 5], [4, 2], [0, 5]], float)
    share = np.linspace(0, 1, 7, endpoint=False)[:, None]
    sides = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    plain, fine = (offset([polygonal(p)], distance) for p in (corners, np.concatenate(sides)))
    assert [c.area for c in fine] == pytest.approx([c.area for c in plain], rel=1e-9)
    assert [c.length for c in fine] == pytest.approx([c.length for c in plain], rel=1e-9)


@pytest.mark.parametrize("distance", [2.0, -2.0])
def test_many_tiny_arcs(distance):
    # An ellipse through 400 arcs, each of the circle through a point, its neighbour and between.
    angle = np.linspace(0, 2 * np.pi, 801)
    fine = np.column_stack([10 * np.cos(angle), 6 * np.sin(angle)])
    a, b, middle = fine[:-1:2], fine[2::2], fine[1::2]
    chord = b - a
    rise = np.cross(np.pad(chord, ((0, 0), (0, 1))), np.pad(a - middle, ((0, 0), (0, 1))))[:, 2]
    bulge = rise / np.hypot(*chord.T) / (0.5 * np.hypot(*chord.T))
    path = contour(a, bulge)
    (found,) = offset([path], distance)
    # Steiner: A - d L + pi d^2 while no curvature radius (3.6 at least) is exceeded. The joints
    # turn by the third power of the spacing, so the arcs are smooth to about 1e-5.
    expected = path.area - distance * path.length + math.pi * distance**2
    assert found.area == pytest.approx(expected, rel=1e-6)
    assert path.area == pytest.approx(60 * math.pi, rel=1e-6)
    keeps_distance([path], [found], abs(distance))


@settings(max_examples=20)
@given(walls=stars(), share=st.floats(0.02, 0.25))
def test_opening_is_idempotent(walls, share):
    d = 10.0 * share
    once = offset(offset(walls, d), -d)
    assume(once)
    twice = offset(offset(once, d), -d)
    assert sum(c.area for c in twice) == pytest.approx(sum(c.area for c in once), abs=1e-5)
    off = sum(sagitta(c) * total_length([c]) for c in [*once, *twice])
    assert region(once).symmetric_difference(region(twice)).area <= off + 1e-5
    # And takes nothing away from the material.
    walls_off = sum(sagitta(c) * c.length for c in walls)
    assert region(once).difference(region(walls)).area <= off + walls_off + 1e-5


@settings(max_examples=10)
@given(walls=stars(), share=st.floats(0.02, 0.25))
def test_traced_gives_the_pieces_again(walls, share):
    found = parallel(walls, 10.0 * share)
    assume(found.contours)
    again = traced(base_of(walls), found.origin, 10.0 * share)
    ours = base_of(found.contours)
    np.testing.assert_allclose(again.start, ours.start, atol=1e-6)
    np.testing.assert_allclose(again.end, ours.end, atol=1e-6)
    np.testing.assert_allclose(again.curvature, ours.curvature, rtol=1e-5, atol=1e-6)


def carriers_off(moved, at):
    """How far points are from the curves that carry pieces, to the left positive."""
    q = at - moved.start
    normal = jnp.stack([-moved.direction[:, 1], moved.direction[:, 0]], axis=-1)
    across = jnp.sum(normal * q, axis=-1)
    level = across - 0.5 * moved.curvature * jnp.sum(q * q, axis=-1)
    return 2 * level / (1 + jnp.sqrt(1 - 2 * moved.curvature * level))


@settings(max_examples=6)
@given(walls=stars(), share=st.floats(0.05, 0.2), seed=st.integers(0, 2**16))
def test_traced_against_differences_of_parallel(walls, share, seed):
    """Seen from a fixed point on the middle of a piece, its curve moves as the derivative says."""
    d, h = 10.0 * share, 1e-5
    rng = np.random.default_rng(seed)
    toward = [
        (rng.normal(size=w.points.shape), 0.1 * rng.normal(size=w.bulges.shape)) for w in walls
    ]
    toward = [
        (p, np.where(w.bulges == 0.0, 0.0, b)) for (p, b), w in zip(toward, walls, strict=True)
    ]

    def varied(step):
        return [
            Contour(w.points + step * p, w.bulges + step * b, True)
            for w, (p, b) in zip(walls, toward, strict=True)
        ]

    here = parallel(walls, d)
    assume(here.contours)
    pieces = base_of(here.contours)
    # Short pieces have ends that move as fast as the crossing of nearly parallel curves does.
    long = lengths(pieces, np) > 0.2
    middle = jnp.asarray(_middles(pieces))

    @jax.jit
    def seen(step, more):
        base = joined([c.segments for c in varied(step)], jnp)
        return carriers_off(traced(base, here.origin, d + more), middle)

    one, none = jnp.asarray(1.0), jnp.asarray(0.0)
    by_shape = jax.jvp(lambda s: seen(s, none), (none,), (one,))[1]
    by_distance = jax.jvp(lambda m: seen(none, m), (none,), (one,))[1]
    # The curve of each piece moves to the left at the speed of the distance.
    around = here.origin.kind == 1
    np.testing.assert_allclose(by_distance[~around], -1.0, atol=1e-6)
    for slope, vary in (
        (by_shape, lambda s: parallel(varied(s), d)),
        (by_distance, lambda s: parallel(walls, d + s)),
    ):
        plus, minus = vary(h), vary(-h)
        assume(len(plus.origin.kind) == len(minus.origin.kind) == len(pieces))
        assume(np.array_equal(plus.origin.piece, here.origin.piece))
        assume(np.array_equal(minus.origin.piece, here.origin.piece))
        central = carriers_off(base_of(plus.contours), middle)
        central = (central - carriers_off(base_of(minus.contours), middle)) / (2 * h)
        np.testing.assert_allclose(slope[long], central[long], rtol=1e-4, atol=1e-4)


def _middles(pieces):
    half = 0.5 * lengths(pieces, np)
    return advance(pieces.start, pieces.direction, pieces.curvature, half, np)[0]


def test_traced_in_closed_form_under_jit():
    """A pocket moved by d: straight sides move by d, corners of R keep their centres."""
    walls = [rounded_rectangle(20, 12, 3)]
    found = parallel(walls, 1.0)

    @jax.jit
    def pieces(corner, d):
        a, b = 10.0, 6.0
        c, e = a - corner, b - corner
        points = jnp.array([[-c, -b], [c, -b], [a, -e], [a, e], [c, b], [-c, b], [-a, e], [-a, -e]])
        moved = traced(Contour(points, walls[0].bulges, True).segments, found.origin, d)
        return moved.curvature, moved.start

    bend, _ = pieces(3.0, 1.0)
    np.testing.assert_allclose(np.unique(np.round(bend, 9)), [0.0, 0.5], atol=1e-9)
    # kappa = 1 / (R - d): derivatives -kappa^2 in R and +kappa^2 in d, on arcs only.
    arcs = np.asarray(bend) > 0.1
    for order, sign in ((0, -1.0), (1, 1.0)):
        slope, moving = jax.jacfwd(pieces, order)(3.0, 1.0)
        np.testing.assert_allclose(slope, np.where(arcs, sign * 0.25, 0.0), atol=1e-9)
    # Piece starts lie d inside the wall: along the normal they move with d by one.
    assert np.hypot(*np.asarray(moving).T) == pytest.approx(1.0, abs=1e-9)


def test_open_contours():
    wall = contour([[0, 0], [10, 0]], closed=False)
    (found,) = offset([wall], 2.0)
    np.testing.assert_allclose(found.points, [[0, 2], [10, 2]], atol=1e-12)
    (other,) = offset([wall], -2.0)
    np.testing.assert_allclose(other.points, [[0, -2], [10, -2]], atol=1e-12)
    step = contour([[0, 0], [10, 0], [10, 6]], closed=False)
    (inner,) = offset([step], 2.0)
    np.testing.assert_allclose(inner.points, [[0, 2], [8, 2], [8, 6]], atol=1e-9)
    (outer,) = offset([step], -2.0)
    assert outer.length == pytest.approx(16 + math.pi, rel=1e-12)


def test_meeting_points_of_lines_and_circles():
    # x axis; unit circle from (1, 0); circle of 1 around (1, 0) clockwise from (0, 0).
    line = Segments(*(np.array(v, float) for v in ([[0, 0]], [[1, 0]], [[1, 0]], [0])))
    disc = Segments(*(np.array(v, float) for v in ([[1, 0]], [[-1, 0]], [[0, 1]], [1])))
    other = Segments(*(np.array(v, float) for v in ([[0, 0]], [[2, 0]], [[0, 1]], [-1])))
    for pair in ((line, disc), (disc, line)):
        found = np.sort(np.concatenate(meeting_points(*pair))[:, 0])
        np.testing.assert_allclose(found, [-1, 1], atol=1e-12)
    for pair in ((other, disc), (disc, other)):
        found = np.concatenate(meeting_points(*pair))
        np.testing.assert_allclose(found[:, 0], 0.5, atol=1e-12)
        np.testing.assert_allclose(np.sort(found[:, 1]), [-math.sqrt(0.75), math.sqrt(0.75)])
    up = np.array([0.0, 2.0])
    high = Segments(line.start + up, line.end + up, line.direction, line.curvature)
    assert np.all(np.isnan(meeting_points(high, disc)))
    with np.errstate(all="ignore"):
        assert not np.any(np.isfinite(meeting_points(high, line)))
