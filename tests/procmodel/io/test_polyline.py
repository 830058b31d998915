"""Contours of lines and arcs: their pieces, and edges joined to contours."""

import math
import time

import numpy as np
import pytest
from ezdxf.math import bulge_to_arc
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import BulgePolyline, join_edges
from procmodel.io.polyline import arc_bulge, arc_middle, checked, full_circle
from tests.procmodel.io.contour_shapes import (
    PLATE,
    PLATE_AREA,
    arc,
    area,
    pieces,
    polyline,
    stars,
    traced,
)


def edges_of(shape):
    """Its pieces as edges of their own, named by their number."""
    return [
        polyline([start, end], [bulge], closed=False, name=f"edge {k}")
        for k, (start, end, bulge) in enumerate(pieces(shape))
    ]


def test_known_area_of_a_rounded_plate():
    assert area(PLATE) == pytest.approx(PLATE_AREA, rel=1e-14)
    assert area(PLATE.reversed()) == pytest.approx(-PLATE_AREA, rel=1e-14)
    assert PLATE.length == pytest.approx(40 + 15 + 5 * math.pi / 2 + 35 + 20, rel=1e-14)


@pytest.mark.parametrize("clockwise", [False, True])
def test_full_circle(clockwise):
    circle = full_circle((3.0, -2.0), (3.0, 5.0), clockwise, "hole")
    sign = -1 if clockwise else 1
    assert circle.closed and circle.name == "hole"
    np.testing.assert_array_equal(circle.points, [(3, 5), (3, -9)])
    assert area(circle) == pytest.approx(sign * 49 * math.pi, rel=1e-14)
    assert circle.length == pytest.approx(14 * math.pi, rel=1e-14)


@given(
    centre=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
    radius=st.floats(0.1, 50),
    first=st.floats(-math.pi, math.pi),
    sweep=st.floats(0.05, 2 * math.pi - 0.05),
    clockwise=st.booleans(),
)
def test_bulge_of_an_arc_about_a_centre(centre, radius, first, sweep, clockwise):
    last = first + (-sweep if clockwise else sweep)
    start, end = (
        (centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle))
        for angle in (first, last)
    )
    bulge = arc_bulge(start, end, centre, clockwise)
    # Rounding of coordinates up to 100 with a radius of 0.1 turns the spokes by 3e-13; near a
    # full turn the bulge grows by the square of itself.
    expected = math.tan(sweep / 4) * (-1 if clockwise else 1)
    assert bulge == pytest.approx(expected, abs=1e-11 * (1 + expected**2))
    # The formulas of ezdxf are independent of ours.
    its_centre, _, _, its_radius = bulge_to_arc(start, end, bulge)
    assert (its_centre.x, its_centre.y) == pytest.approx(centre, abs=1e-8)
    assert its_radius == pytest.approx(radius, abs=1e-8)
    middle = (first + last) / 2
    expected_middle = (
        centre[0] + radius * math.cos(middle),
        centre[1] + radius * math.sin(middle),
    )
    assert arc_middle(start, end, bulge).tolist() == pytest.approx(expected_middle, abs=1e-8)


@given(stars(largest_bulge=20.0))
def test_halved_arcs_lie_on_the_same_circles(shape):
    halved = shape.with_arcs_halved()
    wide = np.abs(shape.bulges) > 1
    assert len(halved.points) == len(shape.points) + wide.sum()
    assert np.all(np.abs(halved.bulges) <= 1)
    scale = shape.length**2
    assert area(halved) == pytest.approx(area(shape), abs=1e-10 * scale)
    assert halved.length == pytest.approx(shape.length, rel=1e-12)


@given(stars(largest_bulge=3.0), st.booleans())
def test_reversed_runs_through_the_same_points(shape, closed):
    if not closed:
        shape = BulgePolyline(shape.points, shape.bulges[:-1], False, "open")
    back = shape.reversed()
    np.testing.assert_allclose(
        sorted(traced(back).round(7).tolist()), sorted(traced(shape).round(7).tolist()), atol=2e-7
    )
    if closed:
        assert area(back) == pytest.approx(-area(shape), abs=1e-9 * shape.length**2)
    twice = back.reversed()
    np.testing.assert_array_equal(twice.points, shape.points)
    np.testing.assert_array_equal(twice.bulges, shape.bulges)


def test_arrays_are_checked_and_cannot_be_changed():
    with pytest.raises(ValueError, match=r"bulges have shape \(2,\), not \(1,\)"):
        BulgePolyline(np.zeros((2, 2)), np.zeros(2), False, "line")
    with pytest.raises(ValueError, match=r"points have shape \(2,\), not \(n, 2\)"):
        BulgePolyline(np.zeros(2), np.zeros(1), False, "line")
    given_points = np.array([[0.0, 0.0], [1.0, 0.0]])
    line = BulgePolyline(given_points, [0], False, "line")
    given_points[0] = 7.0
    assert line.points[0].tolist() == [0, 0]
    with pytest.raises(ValueError, match="read-only"):
        line.points[0] = 1.0


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (
            polyline([(0, 0), (1, 0), (1, 0), (0, 1)]),
            "shape, vertex 2 and vertex 3: the points coincide at (1, 0) mm: "
            "delete one of the two points",
        ),
        (
            polyline([(0, 0), (1, 0), (1, 1), (0, 1e-12)]),
            "shape, vertex 4 and vertex 1: the points coincide at (0, 1e-12) mm: "
            "delete one of the two points",
        ),
        (
            polyline([(0, 0), (1, 0)]),
            "shape: a closed contour of two points and no arc encloses nothing: "
            "delete a line drawn twice, or add a point",
        ),
        (
            polyline([(0, 0)], closed=False),
            "shape: a contour of one point has no length: add a point or delete it",
        ),
        (
            polyline([(0, 0), (math.nan, 0), (1, 1)]),
            "shape, vertex 2: a coordinate or bulge is not a finite number: "
            "correct it or delete the point",
        ),
        (
            polyline([(0, 0), (1, 0), (1, 1)], [0, 0, math.inf]),
            "shape, vertex 3: a coordinate or bulge is not a finite number: "
            "correct it or delete the point",
        ),
    ],
)
def test_faulty_contours(shape, message):
    with pytest.raises(InputError) as raised:
        checked(shape)
    assert str(raised.value) == message


@pytest.mark.parametrize(
    "shape",
    [
        PLATE,
        polyline([(0, 0), (1, 0)], [1, 0]),
        polyline([(0, 0), (1, 0)], closed=False),
        full_circle((0, 0), (1, 0), False, "circle"),
    ],
)
def test_sound_contours_pass(shape):
    assert checked(shape) is shape


@settings(deadline=None)
@given(shape=stars(largest_bulge=1.0), data=st.data())
def test_shuffled_and_reversed_edges_make_the_contour_again(shape, data):
    edges = edges_of(shape)
    order = data.draw(st.permutations(range(len(edges))))
    turned = data.draw(st.lists(st.booleans(), min_size=len(edges), max_size=len(edges)))
    mixed = [edges[k].reversed() if turned[k] else edges[k] for k in order]
    (joined,) = join_edges(mixed)
    assert joined.closed
    assert joined.name == mixed[0].name
    # The first edge decides where the contour begins and which way it runs.
    np.testing.assert_array_equal(joined.points[:2], mixed[0].points)
    if turned[order[0]]:
        joined = joined.reversed()
    assert area(joined) == pytest.approx(area(shape), abs=1e-12 * shape.length**2)
    assert sorted(joined.points.tolist()) == sorted(shape.points.tolist())
    assert sorted(joined.bulges.tolist()) == sorted(shape.bulges.tolist())


@settings(deadline=None)
@given(shape=stars(), seed=st.integers(0, 2**32 - 1), left_out=st.integers(0, 11))
def test_a_missing_edge_leaves_the_contour_open(shape, seed, left_out):
    rng = np.random.default_rng(seed)
    edges = edges_of(shape)
    gone = left_out % len(edges)
    # Each end is off by less than half the tolerance.
    apart = [
        polyline(edge.points + rng.uniform(-3e-4, 3e-4, (2, 2)), edge.bulges, closed=False)
        for k, edge in enumerate(edges)
        if k != gone
    ]
    mixed = [
        apart[k].reversed() if rng.random() < 0.5 else apart[k] for k in rng.permutation(len(apart))
    ]
    (joined,) = join_edges(mixed)
    assert not joined.closed
    assert len(joined.points) == len(shape.points)
    expected = np.roll(shape.points, -(gone + 1), axis=0)
    if np.hypot(*(joined.points[0] - expected[0])) > 1e-3:
        joined = joined.reversed()
    np.testing.assert_allclose(joined.points, expected, rtol=0, atol=3e-4)
    np.testing.assert_array_equal(joined.bulges, np.roll(shape.bulges, -(gone + 1))[:-1])


def test_joined_ends_become_the_point_between_them():
    first = polyline([(0, 0), (1, 0)], closed=False)
    second = polyline([(2, 0), (1.0006, 0.0008)], closed=False)
    assert len(join_edges([first, second])) == 1
    (joined,) = join_edges([first, second], tolerance=1e-3)
    np.testing.assert_allclose(joined.points, [(0, 0), (1.0003, 0.0004), (2, 0)], atol=1e-15)
    assert len(join_edges([first, second], tolerance=0.9e-3)) == 2


def test_several_contours_keep_the_order_of_their_first_edges():
    square = polyline([(0, 0), (1, 0), (1, 1), (0, 1)], name="square")
    circle = full_circle((5, 5), (6, 5), False, "circle")
    triangle = polyline([(10, 0), (11, 0), (10, 1)], name="triangle")
    squares, triangles = edges_of(square), edges_of(triangle)
    mixed = [triangles[1], squares[2], circle, triangles[0], squares[0], squares[1], triangles[2]]
    joined = join_edges([*mixed, squares[3]])
    assert [area(each) for each in joined] == pytest.approx([0.5, 1.0, math.pi], rel=1e-14)


def test_one_arc_that_nearly_is_a_circle_closes_without_changing_its_radius():
    sweep = 2 * math.pi - 1e-5
    nearly = polyline(
        [(50, 0), (50 * math.cos(sweep), 50 * math.sin(sweep))], [math.tan(sweep / 4)], closed=False
    )
    (circle,) = join_edges([nearly])
    assert circle.closed and len(circle.points) == 2
    # The gap is 5e-4 long, half of which each end moves.
    assert area(circle) == pytest.approx(2500 * math.pi, abs=0.03)
    for start, end, bulge in pieces(circle):
        assert arc(start, end, bulge)[1] == pytest.approx(50, abs=5e-4)


def test_three_ends_in_one_point_are_refused():
    edges = edges_of(polyline([(0, 0), (1, 0), (1, 1)]))
    branch = polyline([(1, 0.0004), (3, 3)], closed=False, name="branch")
    with pytest.raises(InputError) as raised:
        join_edges([*edges, branch])
    assert str(raised.value) == (
        "edge 0: 3 ends meet at (1, 0) mm (edge 0, edge 1, branch): delete a line drawn twice or "
        "the branch, so that two ends remain"
    )


def test_an_edge_drawn_twice_is_refused():
    edges = edges_of(polyline([(0, 0), (1, 0), (1, 1)]))
    with pytest.raises(InputError, match=r"3 ends meet at \(0, 0\) mm .*delete a line drawn twice"):
        join_edges([*edges, edges[0]])


@pytest.mark.parametrize("length", [0.0, 0.0005])
def test_edges_without_length_are_refused(length):
    edge = polyline([(2, 3), (2 + length, 3)], closed=False, name="wall.dxf, LINE 2F")
    with pytest.raises(InputError) as raised:
        join_edges([edge])
    assert str(raised.value) == (
        f"wall.dxf, LINE 2F: the edge at (2, 3) mm is {length:.3g} mm long, not more than the "
        "0.001 mm within which ends are joined: delete it, or lower the tolerance"
    )


def test_a_crowd_of_ends_is_refused_at_once():
    rays = [
        polyline([(0, 0), (math.cos(k), math.sin(k))], closed=False, name=f"ray {k}")
        for k in range(20_000)
    ]
    begin = time.perf_counter()
    with pytest.raises(InputError, match=r"20000 ends meet at \(0, 0\) mm .* and others"):
        join_edges(rays)
    assert time.perf_counter() - begin < 20


@pytest.mark.slow
def test_a_hundred_thousand_edges_join_in_seconds():
    count = 100_000
    angles = 2 * np.pi * np.arange(count) / count
    ring = polyline(1000 * np.column_stack([np.cos(angles), np.sin(angles)]))
    rng = np.random.default_rng(1)
    edges = edges_of(ring)
    mixed = [
        edges[k].reversed() if turned else edges[k]
        for k, turned in zip(rng.permutation(count), rng.random(count) < 0.5, strict=True)
    ]
    begin = time.perf_counter()
    (joined,) = join_edges(mixed)
    # Ten times what it takes alone on one core; comparing each with each would take an hour.
    assert time.perf_counter() - begin < 40
    assert joined.closed
    assert abs(area(joined)) == pytest.approx(area(ring), rel=1e-12)
