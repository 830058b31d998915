"""Pairs of arcs through points: orders measured on an ellipse, exactness on circles, tolerances."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Point

from procmodel.engagement.biarcs import simplified, through
from procmodel.engagement.contour import contour, corner_turns
from procmodel.engagement.segments import advance, lengths
from tests.procmodel.engagement.shapes import box, circle, rounded_rectangle, sampled

A, B = 10.0, 6.0


def ellipse(count, first=0.0, turn=2 * np.pi):
    angle = first + turn * np.arange(count) / count
    point = np.column_stack([A * np.cos(angle), B * np.sin(angle)])
    tangent = np.column_stack([-A * np.sin(angle), B * np.cos(angle)])
    return point, tangent / np.hypot(*tangent.T)[:, None]


def off_ellipse(points):
    """Distance from the ellipse: by Newton's method for the foot's parameter."""
    t = np.arctan2(points[:, 1] / B, points[:, 0] / A)
    for _ in range(50):
        c, s = np.cos(t), np.sin(t)
        f = (A**2 - B**2) * c * s - points[:, 0] * A * s + points[:, 1] * B * c
        slope = (A**2 - B**2) * (c**2 - s**2) - points[:, 0] * A * c - points[:, 1] * B * s
        t -= f / slope
    return np.hypot(points[:, 0] - A * np.cos(t), points[:, 1] - B * np.sin(t)), t


def dense(path, count=9):
    """Points and directions along every piece."""
    pieces = path.segments.on_host()
    many = pieces[np.repeat(np.arange(len(pieces)), count)]
    way = np.repeat(lengths(pieces, np), count) * np.tile(np.linspace(0, 1, count), len(pieces))
    return advance(many.start, many.direction, many.curvature, way, np)


def test_orders_on_an_ellipse():
    """Third in distance and second in direction: halving divides by 8 and by 4."""
    distance, direction = [], []
    for count in (32, 64, 128, 256):
        path = through(*ellipse(count), True, "ellipse")
        points, heading = dense(path)
        off, t = off_ellipse(points)
        tangent = np.column_stack([-A * np.sin(t), B * np.cos(t)])
        sine = tangent[:, 0] * heading[:, 1] - tangent[:, 1] * heading[:, 0]
        distance.append(off.max())
        direction.append(np.max(np.abs(sine) / np.hypot(*tangent.T)))
    np.testing.assert_allclose(np.log2(np.divide(distance[:-1], distance[1:]))[-2:], 3, atol=0.15)
    np.testing.assert_allclose(np.log2(np.divide(direction[:-1], direction[1:]))[-2:], 2, atol=0.15)
    assert distance[-1] < 2e-5


@pytest.mark.parametrize("closed", [True, False])
def test_it_goes_through_the_points_along_the_tangents(closed):
    points, tangents = ellipse(24)
    path = through(points, tangents, closed, "ellipse")
    assert path.closed is closed
    pieces = path.segments.on_host()
    assert len(pieces) == (48 if closed else 46)
    count = 24 if closed else 23
    np.testing.assert_allclose(pieces.start[::2], points[:count], atol=1e-12)
    np.testing.assert_allclose(pieces.direction[::2], tangents[:count], atol=1e-9)
    np.testing.assert_allclose(corner_turns(path), 0.0, atol=1e-9)
    if closed:
        assert path.area == pytest.approx(math.pi * A * B, rel=1e-3)
    else:
        np.testing.assert_allclose(np.asarray(path.points)[-1], points[-1], atol=1e-12)


@given(
    radius=st.floats(0.1, 100.0), count=st.integers(3, 40), left=st.booleans(),
    x=st.floats(-100, 100),
)  # fmt: skip
def test_circles_are_exact(radius, count, left, x):
    angle = (1 if left else -1) * 2 * np.pi * np.arange(count) / count
    arm = np.column_stack([np.cos(angle), np.sin(angle)])
    tangent = (1 if left else -1) * np.column_stack([-arm[:, 1], arm[:, 0]])
    path = through(radius * arm + [x, 0], tangent, True, "circle")
    sign = 1 if left else -1
    np.testing.assert_allclose(path.segments.curvature, sign / radius, rtol=1e-8)
    assert path.area == pytest.approx(sign * math.pi * radius**2, rel=1e-9)
    assert path.length == pytest.approx(2 * math.pi * radius, rel=1e-10)


def test_lines_are_exact_and_double_points_go():
    points = np.array([[0, 0], [1, 0], [1, 0], [3, 0]], float)
    path = through(points, np.tile([1.0, 0.0], (4, 1)), False, "line")
    assert len(path.bulges) == 4
    np.testing.assert_allclose(path.segments.curvature, 0.0, atol=1e-15)
    assert path.length == pytest.approx(3.0, rel=1e-14)
    np.testing.assert_allclose(np.asarray(path.points)[[0, -1]], [[0, 0], [3, 0]])


def test_an_s_between_parallel_tangents():
    """From (0, 0) to (4, 2), east at both ends: two arcs of R = (4^2 + 2^2) / (4 * 2)."""
    path = through(np.array([[0, 0], [4, 2]], float), np.tile([1.0, 0], (2, 1)), False, "s")
    np.testing.assert_allclose(path.segments.curvature, [1 / 2.5, -1 / 2.5], rtol=1e-12)
    np.testing.assert_allclose(np.asarray(path.points)[1], [2, 1], atol=1e-12)


@settings(max_examples=8)
@given(tolerance=st.sampled_from([1e-2, 1e-3, 1e-4, 1e-5]), count=st.integers(150, 600))
def test_simplified_stays_within_the_tolerance(tolerance, count):
    path = through(*ellipse(count), True, "ellipse")
    fewer = simplified(path, tolerance)
    before, after = (np.asarray(dense(c, 9)[0]) for c in (path, fewer))
    # Both ways, each against a polyline so fine that its chords are off by 1 % of the tolerance.
    for points, other in ((after, path), (before, fewer)):
        bend = np.abs(other.segments.on_host().curvature).max()
        spacing = math.sqrt(8e-2 * tolerance / bend)
        long = lengths(other.segments.on_host(), np).max()
        line, _ = dense(other, max(2, math.ceil(long / spacing) + 1))
        ring = LineString([*line, line[0]])
        shapely.prepare(ring)
        # It is checked on vertices and middles of the given pieces: between them, much less more.
        assert np.all(shapely.dwithin(ring, shapely.points(points), 1.06 * tolerance))
    # 150 pairs are hardly finer than what the finest tolerance itself needs.
    most = 0.75 if tolerance == 1e-5 and count < 170 else 0.7
    assert len(fewer.bulges) < most * len(path.bulges)
    np.testing.assert_allclose(corner_turns(fewer), 0.0, atol=1e-8)
    assert fewer.area == pytest.approx(path.area, abs=1.1 * tolerance * path.length)


def test_a_looser_tolerance_takes_fewer_pieces():
    """A pair of arcs errs by the third power of its length: ten times finer, 10^(1/3) as many."""
    path = through(*ellipse(4000), True, "ellipse")
    counts = np.array([len(simplified(path, t).bulges) for t in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)])
    assert np.all(np.diff(counts) > 0)
    np.testing.assert_allclose(counts[3:] / counts[2:-1], 10 ** (1 / 3), rtol=0.15)


def split(path, parts):
    """The same curve with every piece cut into equal parts."""
    pieces = path.segments.on_host()
    many = pieces[np.repeat(np.arange(len(pieces)), parts)]
    way = np.repeat(lengths(pieces, np), parts) * np.tile(np.arange(parts) / parts, len(pieces))
    points, _ = advance(many.start, many.direction, many.curvature, way, np)
    sweep = 4 * np.arctan(np.repeat(np.asarray(path.bulges), parts)) / parts
    if not path.closed:
        points = np.concatenate([points, pieces.end[-1:]])
    return contour(points, np.tan(sweep / 4), path.closed)


def test_many_parts_of_lines_and_arcs_become_few():
    plain = rounded_rectangle(20, 12, 3)
    fine = split(plain, 64)
    fewer = simplified(fine, 1e-6)
    # Eight pieces; a pair each at best, and a few more where one starts on the piece before.
    assert len(fine.bulges) == 512
    assert len(fewer.bulges) <= 64
    assert fewer.area == pytest.approx(plain.area, abs=2e-6 * plain.length)


def test_sharp_vertices_are_kept():
    for plain in (box(8, 5), contour([[-4, 0], [4, 0]], [0.0, 1.0])):
        fewer = simplified(split(plain, 50), 1e-4)
        turns = corner_turns(fewer)
        sharp = np.abs(turns) > 1e-3
        np.testing.assert_allclose(turns[sharp], math.pi / 2, atol=1e-6)
        kept = np.asarray(fewer.points)[sharp]
        expected = np.asarray(plain.points)[np.abs(corner_turns(plain)) > 1e-3]
        assert len(kept) == len(expected)
        for vertex in expected:
            assert np.hypot(*(kept - vertex).T).min() < 1e-12
        assert len(fewer.bulges) <= 20


def test_an_open_path_keeps_its_ends():
    path = through(*ellipse(200, turn=np.pi), False, "half an ellipse")
    fewer = simplified(path, 1e-3)
    assert not fewer.closed
    np.testing.assert_array_equal(
        np.asarray(fewer.points)[[0, -1]], np.asarray(path.points)[[0, -1]]
    )
    assert len(fewer.bulges) < 0.2 * len(path.bulges)
    curve = LineString(sampled(path))
    assert max(curve.distance(Point(p)) for p in dense(fewer)[0]) < 1.1e-3


def test_a_circle_stays_one():
    fewer = simplified(split(circle(5.0), 100), 1e-6)
    np.testing.assert_allclose(fewer.segments.curvature, 0.2, rtol=1e-6)
    assert len(fewer.bulges) <= 12
