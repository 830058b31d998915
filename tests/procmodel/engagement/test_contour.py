"""Contours: areas and lengths in closed form, polygons of shapely, finite differences, errors."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from procmodel.engagement.contour import (
    Contour,
    contour,
    corner_turns,
    from_segments,
    oriented,
    stations,
)
from procmodel.engagement.segments import (
    Segments,
    advance,
    boxes,
    distance_to,
    end_directions,
    half_sweeps,
    lengths,
    place_along,
)
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import (
    box,
    circle,
    d_shape,
    polygonal,
    rounded_rectangle,
    sagitta,
    sampled,
    stars,
)

KNOWN = [
    (circle(3.0), 9 * math.pi, 6 * math.pi),
    (circle(3.0, (7.0, -2.0), -1.0), -9 * math.pi, 6 * math.pi),
    (rounded_rectangle(20, 12, 3), 240 - (4 - math.pi) * 9, 2 * (14 + 6) + 6 * math.pi),
    (d_shape(4.0), 8 * math.pi, 8 + 4 * math.pi),
    (box(5, 3), 15.0, 16.0),
]


@pytest.mark.parametrize(("path", "area", "length"), KNOWN)
def test_area_and_length_in_closed_form(path, area, length):
    assert path.area == pytest.approx(area, rel=1e-13)
    assert path.length == pytest.approx(length, rel=1e-13)
    assert path.reversed().area == pytest.approx(-area, rel=1e-13)
    assert path.reversed().length == pytest.approx(length, rel=1e-13)


@given(walls=stars())
def test_area_and_length_against_polygons(walls):
    for wall in walls:
        points = sampled(wall)
        ring = Polygon(points)
        off = sagitta(wall)
        sign = 1.0 if ring.exterior.is_ccw else -1.0
        # Between chords and arcs: at most the sagitta all along; lengths differ by its square.
        assert abs(wall.area - sign * ring.area) <= off * wall.length + 1e-9
        assert ring.length <= wall.length * (1 + 1e-12)
        assert wall.length == pytest.approx(ring.length, rel=1e-5)


@given(walls=stars(), tolerance=st.floats(1e-4, 0.5))
def test_flattened_stays_within_the_tolerance(walls, tolerance):
    wall = walls[0]
    flat = wall.flattened(tolerance)
    ring = LineString([*flat, flat[0]])
    # Every point of the curve is that near to the chords, and the chords' ends are on the curve.
    fine = sampled(wall)
    dense = LineString([*fine, fine[0]])
    off = sagitta(wall)
    assert ring.hausdorff_distance(dense) <= tolerance + off + 1e-12
    assert max(dense.distance(p) for p in map(Point, flat)) <= off + 1e-12


def test_flattened_takes_no_more_points_than_needed():
    # A chord over 2 acos(1 - tol / R) has just the tolerance for its sagitta.
    expected = 2 * math.ceil(math.pi / (2 * math.acos(1 - 0.01 / 3)))
    assert len(circle(3.0).flattened(0.01)) == expected
    assert len(box(5, 3).flattened(1e-6)) == 4


def test_open_flattened_ends_at_the_last_vertex():
    path = contour([[0, 0], [1, 0], [2, 1]], [0.0, math.tan(math.pi / 8)], closed=False)
    flat = path.flattened(1e-4)
    np.testing.assert_allclose(flat[[0, -1]], [[0, 0], [2, 1]], atol=1e-15)
    # The quarter circle is around (1, 1).
    np.testing.assert_allclose(np.hypot(*(flat[1:] - [1, 1]).T), 1.0, atol=1e-14)


@given(walls=stars())
def test_reversed_walks_the_same_way(walls):
    for wall in walls:
        back = wall.reversed()
        np.testing.assert_allclose(back.points[0], wall.points[0])
        a, b = wall.segments.on_host(), back.segments.on_host()
        np.testing.assert_allclose(b.start, a.start[(-np.arange(len(a))) % len(a)])
        np.testing.assert_allclose(b.curvature, -a.curvature[::-1], rtol=1e-12)
        np.testing.assert_allclose(b.direction, -end_directions(a, np)[::-1], atol=1e-12)
        np.testing.assert_allclose(back.reversed().bulges, wall.bulges)


def test_reversed_open_path():
    path = contour([[0, 0], [1, 0], [2, 1]], [0.0, 0.5], closed=False)
    back = path.reversed()
    np.testing.assert_array_equal(back.points, [[2, 1], [1, 0], [0, 0]])
    np.testing.assert_array_equal(back.bulges, [-0.5, 0.0])
    assert back.length == pytest.approx(path.length, rel=1e-14)


@pytest.mark.parametrize("bulge", [1.5, -1.5, 3.0, 20.0, -20.0])
def test_arcs_beyond_a_half_circle_are_split(bulge):
    path = contour([[0, 0], [2, 0]], [bulge], closed=False)
    # Chord 2, sweep 4 atan(bulge): R = 1 / sin(half the sweep).
    half = 2 * math.atan(bulge)
    radius = 1 / abs(math.sin(half))
    assert np.all(np.abs(path.bulges) <= 1)
    assert path.length == pytest.approx(radius * 2 * abs(half), rel=1e-12)
    np.testing.assert_allclose(
        path.segments.curvature, np.sign(bulge) / radius, rtol=1e-9, atol=1e-12
    )
    # An arc to the left of its chord's end turns left, and bulges to the right of the chord.
    centre = np.array([1.0, (1 - bulge**2) / (2 * bulge)])
    np.testing.assert_allclose(np.hypot(*(np.asarray(path.points) - centre).T), radius, rtol=1e-9)
    middle = path.flattened(1e-5)
    deepest = middle[np.argmax(np.abs(middle[:, 1]))]
    assert np.sign(deepest[1]) == -np.sign(bulge)
    assert abs(deepest[1]) == pytest.approx(abs(bulge), abs=1e-4)


def test_a_closed_contour_of_one_large_arc_and_a_chord():
    path = contour([[-1, 0], [1, 0]], [0.0, math.tan(1.5 * math.pi / 4)])
    # Chord 2 under an arc of 270 degrees: R = sqrt(2); three quarters of the disc and a triangle.
    assert path.area == pytest.approx(1.5 * math.pi + 1.0, rel=1e-12)


def test_segments_join_tangents_and_curvatures():
    pieces = rounded_rectangle(20, 12, 3).segments
    np.testing.assert_allclose(pieces.curvature, [0, 1 / 3] * 4, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(corner_turns(rounded_rectangle(20, 12, 3)), 0.0, atol=1e-12)
    np.testing.assert_allclose(corner_turns(box(5, 3)), math.pi / 2, atol=1e-12)
    np.testing.assert_allclose(corner_turns(d_shape(4.0)), math.pi / 2, atol=1e-12)
    zigzag = contour([[0, 0], [1, 0], [1, 1]], closed=False)
    np.testing.assert_allclose(corner_turns(zigzag), [math.pi / 2], atol=1e-12)


@given(walls=stars())
def test_a_contour_comes_back_from_its_segments(walls):
    for wall in walls:
        again = from_segments(wall.segments, True, "again")
        np.testing.assert_allclose(again.points, wall.points)
        np.testing.assert_allclose(again.bulges, wall.bulges, atol=1e-14)


@given(walls=stars(islands=False), seed=st.integers(0, 2**16))
def test_segments_are_differentiable_in_points_and_bulges(walls, seed):
    wall = walls[0]
    rng = np.random.default_rng(seed)
    weights = [rng.normal(size=np.shape(f)) for f in wall.segments.fields]
    toward = (rng.normal(size=wall.points.shape), rng.normal(size=wall.bulges.shape))

    def measured(points, bulges):
        pieces = Contour(points, bulges, True).segments
        total = sum(jnp.sum(w * f) for w, f in zip(weights, pieces.fields, strict=True))
        return total + jnp.sum(lengths(pieces)) + jnp.sum(end_directions(pieces) * weights[0])

    _, slope = jax.jvp(measured, (jnp.asarray(wall.points), jnp.asarray(wall.bulges)), toward)
    h = 1e-6
    differences = [
        measured(wall.points + s * h * toward[0], wall.bulges + s * h * toward[1]) for s in (1, -1)
    ]
    central = (differences[0] - differences[1]) / (2 * h)
    assert float(slope) == pytest.approx(float(central), rel=1e-6, abs=1e-6)


def test_gradient_on_a_straight_piece_is_that_of_the_sagitta():
    # An arc over the chord c with a small bulge b has curvature 4 b / c to first order.
    chord = jnp.array([[0.0, 0], [2, 0]])
    slope = jax.grad(lambda bulge: Contour(chord, bulge, False).segments.curvature[0])
    assert float(slope(jnp.zeros(1))[0]) == pytest.approx(2.0, rel=1e-12)


@given(walls=stars(), seed=st.integers(0, 2**16))
def test_distance_and_place_against_shapely(walls, seed):
    pieces = walls[0].segments.on_host()
    rng = np.random.default_rng(seed)
    asked = rng.uniform(-12, 12, size=(20, 2))
    middle, _ = advance(
        pieces.start, pieces.direction, pieces.curvature, 0.5 * lengths(pieces, np), np
    )
    for i in range(len(pieces)):
        bend = np.tan(0.5 * half_sweeps(pieces[i : i + 1], np))
        alone = contour([pieces.start[i], pieces.end[i]], bend, closed=False)
        curve = LineString(sampled(alone))
        off = sagitta(alone) + 1e-9
        many = pieces[np.full(len(asked), i)]
        expected = np.array([curve.distance(p) for p in map(Point, asked)])
        np.testing.assert_allclose(distance_to(many, asked, np), expected, atol=off)
        assert curve.distance(Point(middle[i])) <= off
        low_x, low_y, high_x, high_y = boxes(pieces)[i]
        x0, y0, x1, y1 = curve.bounds
        assert low_x <= x0 + 1e-9 and low_y <= y0 + 1e-9
        assert high_x >= x1 - 1e-9 and high_y >= y1 - 1e-9
        way = rng.uniform(0.0, lengths(pieces, np)[i], len(asked))
        on, _ = advance(many.start, many.direction, many.curvature, way, np)
        np.testing.assert_allclose(place_along(many, on, np), way, atol=1e-9)
        assert max(curve.distance(p) for p in map(Point, on)) <= off


@pytest.mark.parametrize("bend", [0.0, 3.7e-18, -3.7e-18, 1e-15, -1e-15, 1e-12, -1e-12])
def test_distances_from_lines_that_are_straight_to_rounding(bend):
    # Lengths and directions that are no round numbers, so that rounding shows.
    heading = 0.3
    tangent = np.array([math.cos(heading), math.sin(heading)])
    normal = np.array([-tangent[1], tangent[0]])
    start, length = np.array([-22.1, -19.9]), 44.3
    piece = Segments(start, start + length * tangent, tangent, np.asarray(bend))
    for side in (-5.5, 0.01, 5.5):
        for way in np.linspace(0.5, 43.5, 44):
            found = distance_to(piece, start + way * tangent + side * normal, np)
            assert found == pytest.approx(abs(side), abs=1e-9)


def test_stations():
    path = rounded_rectangle(20, 12, 3)
    found = stations(path, 0.5)
    assert found.way[0] == 0.0
    assert found.way[-1] == pytest.approx(path.length, rel=1e-13)
    # Both pieces see each vertex; elsewhere the spacing is kept.
    assert np.all(np.diff(found.way) <= 0.5 + 1e-12)
    assert np.sum(np.diff(found.way) == 0.0) >= 7
    np.testing.assert_allclose(np.hypot(*found.direction.T), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.unique(np.round(found.curvature, 12)), [0.0, round(1 / 3, 12)])
    chord = np.hypot(*np.diff(found.point, axis=0).T)
    assert np.all(chord <= np.diff(found.way) + 1e-12)


def test_orientation_of_pocket_islands_and_bosses():
    wall, hole, post = box(20, 20), circle(4.0), box(2, 2)
    for drawn in ((wall, hole, post), (wall.reversed(), hole.reversed(), post.reversed())):
        pocket = oriented(drawn, "inside")
        # A post in a pocket in an island's hole: to the left of each is where the tool is.
        assert [np.sign(c.area) for c in pocket] == [1, -1, 1]
        assert [np.sign(c.area) for c in oriented(drawn, "outside")] == [-1, 1, -1]
        assert [abs(c.area) for c in pocket] == pytest.approx([400, 16 * math.pi, 4])
    beside = oriented([box(2, 2, (9, 0)), box(2, 2)], "inside")
    assert [np.sign(c.area) for c in beside] == [1, 1]


def test_orientation_of_open_walls():
    wall = contour([[0, 0], [1, 0]], closed=False)
    assert oriented([wall], "left")[0] is wall
    np.testing.assert_array_equal(oriented([wall], "right")[0].points, [[1, 0], [0, 0]])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: oriented([contour([[0, 0], [3, 4]], closed=False, name="rim")], "inside"),
         r"rim is open.*5 mm apart.*left or right"),
        (lambda: oriented([circle(1.0)], "left"), "circle is closed: choose side inside"),
        (lambda: oriented([circle(1.0)], "middle"), "side is 'middle': choose"),
        (lambda: oriented([box(4, 4), box(4, 4, (3, 1))], "inside"), "two walls cross each other"),
        (lambda: contour([[0, 0], [1, 0], [1, 0], [0, 1]], name="rim"),
         r"rim: the edge from vertex 2 at \(1, 0\) has no length"),
        (lambda: contour([[0, 0], [1, 0], [1, 1], [0, 0]]), "vertex 4.*has no length"),
        (lambda: contour([[0, 0], [1, np.nan], [1, 1]]), "not finite"),
        (lambda: contour([[0, 0], [1, 0], [1, 1]], [0, np.inf, 0]), "not finite"),
        (lambda: contour([[0, 0], [1, 0], [1, 1]], [0, 0]), "2 bulges for 3 pieces"),
        (lambda: contour([[0, 0], [1, 0], [1, 1]], [0, 0, 0], closed=False), "3 bulges for 2"),
        (lambda: contour([[0, 0], [1, 0]]), "enclose nothing"),
        (lambda: contour([[0, 0]], closed=False), "two or more points"),
        (lambda: contour([[0, 0, 0], [1, 0, 0]], closed=False), "two or more points"),
    ],
)  # fmt: skip
def test_errors_say_what_to_do(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_crossing_is_told_from_touching_corners():
    # Walls one inside the other, however near, are no crossing.
    inner = polygonal([[-1.999, -1], [1, -1], [1, 1], [-1.999, 1]])
    assert [np.sign(c.area) for c in oriented([box(4, 4), inner], "inside")] == [1, -1]
