"""Algorithm II: the surface that holds the angle, what no tool can leave, and no gouge anywhere."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize_scalar
from shapely import LineString, MultiLineString, Point

from procmodel.engagement.angle import (
    STATUS,
    radial_depth_for_angle,
    surface_kink,
)
from procmodel.engagement.backward import previous_pass, wanted_surface
from procmodel.engagement.contour import corner_turns, stations
from procmodel.engagement.offset import offset
from procmodel.engagement.segments import advance, lengths
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import (
    along,
    box,
    circle,
    dumbbell,
    open_path,
    region,
    rounded_rectangle,
    sagitta,
    sampled,
    stars,
    stroke,
    total_length,
)

RADIUS, DEPTH, WALL = 5.0, 0.1, 8.0
ALPHA = math.acos(1 - DEPTH / RADIUS)


def paper_path(lead=40.0):
    """Path of the paper's cut: a line, a quarter of Rp - r = 3 to the left, a line."""
    bend = WALL - RADIUS
    return open_path((lead, 0.0), (0.5 * math.pi * bend, 1 / bend), (lead, 0.0))


def test_the_wanted_surface_on_lines_and_circles():
    # Beside a line it is a line 0.1 mm inside the wall.
    flat = wanted_surface(open_path((10, 0.0)), ALPHA, RADIUS)
    np.testing.assert_allclose(np.asarray(flat.points)[:, 1], DEPTH - RADIUS, atol=1e-12)
    np.testing.assert_allclose(np.asarray(flat.points)[0, 0], RADIUS * math.sin(ALPHA), rtol=1e-12)
    # Beside a circle of 3 it is a circle of 8 - a_e, a_e (2 - a_e / 8) / 3.75 = 1 - 0.98.
    depth = float(radial_depth_for_angle(ALPHA, RADIUS, 1 / WALL))
    assert depth == pytest.approx(0.0375 + depth**2 / 16, rel=1e-12)
    ring = wanted_surface(circle(WALL - RADIUS), ALPHA, RADIUS)
    np.testing.assert_allclose(np.hypot(*np.asarray(ring.points).T), WALL - depth, rtol=1e-12)
    boss = wanted_surface(circle(WALL + RADIUS, turn=-1.0), ALPHA, RADIUS)
    depth = float(radial_depth_for_angle(ALPHA, RADIUS, -1 / WALL))
    np.testing.assert_allclose(np.hypot(*np.asarray(boss.points).T), WALL + depth, rtol=1e-12)


@given(alpha=st.floats(0.05, 3.0), radius=st.floats(0.5, 8.0), bend=st.floats(-0.3, 0.3))
def test_every_point_of_the_wanted_surface_is_on_the_rim(alpha, radius, bend):
    bend = bend if abs(bend) > 0.01 else 0.0
    path = open_path((4.0, 0.0), (3.0, bend))
    wanted = wanted_surface(path, alpha, radius).segments.on_host()
    pieces = path.segments.on_host()
    share = np.linspace(0, 1, 5)[:, None]
    for one, other in zip((pieces[:1], pieces[1:]), (wanted[:1], wanted[-1:]), strict=True):
        points, heading = advance(
            one.start, one.direction, one.curvature, share * lengths(one, np), np
        )
        points, heading = points.reshape(-1, 2), heading.reshape(-1, 2)
        # The flank at the wall turned forwards by alpha.
        c, s = math.cos(alpha - math.pi / 2), math.sin(alpha - math.pi / 2)
        expected = points + radius * heading @ np.array([[c, s], [-s, c]])
        if lengths(other, np)[0] * abs(other.curvature[0]) > math.pi:
            continue
        got, _ = advance(
            other.start, other.direction, other.curvature, share * lengths(other, np), np
        )
        np.testing.assert_allclose(got.reshape(-1, 2), expected, atol=1e-9)


def test_the_kink_of_the_paper():
    wanted = wanted_surface(paper_path(), ALPHA, RADIUS)
    turns = corner_turns(wanted)
    # Concave where the arc begins, convex by as much where it ends.
    kink = math.atan2(5 / 3 * math.sin(ALPHA), 1 + 5 / 3 * math.cos(ALPHA))
    np.testing.assert_allclose(turns, [kink, -kink], atol=1e-9)
    assert math.degrees(kink) == pytest.approx(7.18, abs=5e-3)
    assert float(surface_kink(ALPHA, RADIUS, 1 / 3)) == pytest.approx(kink, rel=1e-12)


def floor(previous):
    """Greatest engagement that a disc in the kink leaves, from triangles alone.

    The line y = -(r cos alpha) and the circle around (0, 3) that is wanted meet in a corner; a disc
    of the previous radius inside, touching both, cannot come nearer. Tool centres come along the
    line y = 0 and then round the circle of 3; the rim ends where it meets line, disc or circle.
    """
    bend = WALL - RADIUS
    level = -RADIUS * math.cos(ALPHA)
    big = math.hypot(RADIUS * math.sin(ALPHA), bend + RADIUS * math.cos(ALPHA))
    # Disc inside: above the line by its radius, and inside the circle by its radius.
    y = level + previous
    x = math.sqrt((big - previous) ** 2 - (y - bend) ** 2)
    disc = np.array([x, y])
    on_line = x
    out = (disc - [0, bend]) / (big - previous)
    on_circle = math.atan2(out[1], out[0])

    def angle(way):
        if way <= 0:
            centre, heading = np.array([way, 0.0]), 0.0
        else:
            heading = way / bend
            centre = np.array([bend * math.sin(heading), bend - bend * math.cos(heading)])

        def outside(alpha):
            # Signed distance of the rim's point beyond the surface left.
            phi = heading - math.pi / 2 + alpha
            p = centre + RADIUS * np.array([math.cos(phi), math.sin(phi)])
            if p[0] <= on_line and p[1] < disc[1]:
                return level - p[1]
            seen = math.atan2(p[1] - bend, p[0])
            if seen >= on_circle:
                return math.hypot(p[0], p[1] - bend) - big
            return math.hypot(*(p - disc)) - previous

        return brentq(outside, 1e-3, 1.0, xtol=1e-14)

    # The disc touches within r2 tan(kink / 2) of the kink, 0.063 of its radius.
    ways = 0.08 * previous * np.linspace(-1, 1, 801)
    best = max(range(1, len(ways) - 1), key=lambda i: angle(ways[i]))
    found = minimize_scalar(
        lambda w: -angle(w), bounds=(ways[best - 1], ways[best + 1]), method="bounded",
        options={"xatol": 1e-10},
    )  # fmt: skip
    return max(-found.fun, angle(ways[best]), angle(0.0))


def test_the_floor_of_the_overshoot():
    assert math.degrees(floor(RADIUS)) == pytest.approx(12.902, abs=5e-4)
    assert floor(RADIUS) / ALPHA - 1 == pytest.approx(0.1241, abs=5e-5)


@pytest.mark.parametrize("previous", [5.0, 4.0, 2.5, 1.0])
def test_overshoot_where_the_kink_makes_it_unavoidable(previous):
    path = paper_path()
    found = previous_pass([path], ALPHA, RADIUS, previous)
    way = np.concatenate([np.linspace(38, 42, 4001), np.linspace(39.95, 40.05, 4001)])
    angle = found.surface.engagement(*along(path, way), RADIUS).angle
    # The maximum is a cusp or smooth; between places of 25 um the angle moves by less than this.
    assert angle.max() == pytest.approx(floor(previous), abs=2e-5)
    peak = way[np.argmax(angle)]
    near = np.linspace(peak - 1e-3, peak + 1e-3, 4001)
    fine = found.surface.engagement(*along(path, near), RADIUS).angle
    assert fine.max() == pytest.approx(floor(previous), abs=1e-6)
    assert angle.min() > ALPHA - 1e-9


def test_a_smaller_tool_leaves_less():
    floors = [floor(previous) for previous in (5.0, 4.0, 2.5, 1.0, 0.1)]
    assert np.all(np.diff(floors) < 0)
    assert floors[-1] == pytest.approx(ALPHA, rel=1e-2)


def test_everywhere_else_the_angle_is_held():
    path = paper_path()
    found = previous_pass([path], ALPHA, RADIUS)
    angle = found.surface.engagement(
        *along(path, np.concatenate([np.linspace(20, 38.9, 200), np.linspace(41.2, 60, 200)])),
        RADIUS,
    ).angle
    np.testing.assert_allclose(angle, ALPHA, atol=1e-6)


@pytest.mark.parametrize("previous", [None, 3.0])
def test_a_closed_pocket(previous):
    paths = offset([rounded_rectangle(60, 40, WALL)], RADIUS)
    found = previous_pass(paths, ALPHA, RADIUS, previous)
    at = stations(paths[0], 0.02)
    angle = found.surface.engagement(at.point, at.direction, RADIUS).angle
    assert angle.max() == pytest.approx(floor(previous or RADIUS), abs=2e-3)
    assert angle.min() >= ALPHA - 1e-9
    held = np.abs(angle - ALPHA) < 1e-6
    assert 0.8 < np.mean(held) < 1.0


@pytest.mark.parametrize("angle", [0.0, -0.1, math.pi, 4.0])
def test_angles_that_are_none(angle):
    with pytest.raises(InputError, match="must be between 0 and 180"):
        previous_pass([paper_path()], angle, RADIUS)


def test_no_room_is_an_error():
    with pytest.raises(InputError, match="finds no room inside the pass"):
        previous_pass(offset([box(20, 11)], 5.0), 0.4, 5.0, 6.0)


def no_gouge(walls, paths, found, radius):
    """What the previous pass sweeps lies inside the walls, and inside what is wanted."""
    left = region(found.surface.contours)
    swept = stroke(found.path, found.radius)
    inside = region(walls)
    everything = [*walls, *found.path, *found.wanted, *found.surface.contours]
    off = max(sagitta(c, found.radius) for c in everything)
    # Polygons are off by that all along both boundaries; sets of thin slivers beyond are none.
    allowed = 2 * off * (total_length(walls) + total_length(found.surface.contours)) + 1e-5
    assert swept.difference(inside).area <= allowed
    assert left.difference(inside).area <= allowed
    assert swept.difference(left).area <= allowed
    if not in_good_order(found.wanted):
        return  # nothing fits both sides of a crossing, and less engagement beside it is told of
    # The rim of this pass at the wanted angle and its whole wall side stay in the stock: nowhere
    # along the path is it engaged less than wanted, as seen by points of the wanted curve.
    wanted = [p for c in found.wanted for p in (stations(c, 0.05 * radius).point)]
    deep = left.buffer(-3 * off - 1e-5)
    shapely.prepare(deep)
    points = np.asarray(wanted)
    assert not np.any(shapely.contains_xy(deep, points[:, 0], points[:, 1]))


def in_good_order(wanted):
    """Whether wanted surfaces cross neither themselves nor one another."""
    rings = [LineString([*p, p[0]]) for p in map(sampled, wanted)]
    return MultiLineString(rings).is_simple


def checked(walls, angle, radius, previous):
    paths = offset(walls, radius)
    try:
        found = previous_pass(paths, angle, radius, previous)
    except InputError as error:
        if "itself near" in str(error) or "no room" not in str(error):
            # What is wanted at one place may be in the way of what is wanted at another. Then it is
            # said that nothing fits both; for a wanted surface in good order that is no answer.
            assert "no room" in str(error) or "does not close" in str(error)
            assert not in_good_order([wanted_surface(path, angle, radius) for path in paths])
        return None
    no_gouge(walls, paths, found, radius)
    for path in paths:
        at = stations(path, 0.2 * radius)
        seen = found.surface.engagement(at.point, at.direction, radius)
        for field in (seen.angle, seen.total, seen.area_rate, seen.arcs):
            assert np.all(np.isfinite(field))
        assert set(seen.status.tolist()) <= set(STATUS)
        assert np.all((seen.angle >= 0) & (seen.angle <= math.pi))
    return found


@settings(max_examples=6)
@given(
    walls=stars(),
    alpha=st.floats(0.15, 1.4),
    radius=st.floats(0.4, 1.2),
    share=st.floats(0.3, 1.0),
)
def test_never_deeper_than_wanted(walls, alpha, radius, share):
    assume(offset(walls, radius))
    checked(walls, alpha, radius, share * radius)


@pytest.mark.parametrize(
    "walls",
    [
        [box(30, 20)],
        [rounded_rectangle(30, 20, 1.0)],
        [box(40, 30), circle(4.0, (3, 2), -1.0)],
        [box(40, 30), box(5, 4).reversed()],
        [dumbbell(1.9, 3.8, 6.0, 14.0)],
        [dumbbell(2.5, 5.0, 6.0, 14.0)],
    ],
    ids=["sharp", "small arcs", "round island", "square island", "closed", "neck"],
)  # fmt: skip
def test_named_cases(walls):
    assert checked(walls, 0.4, 2.0, 2.0) is not None


def test_a_neck_as_wide_as_the_tool():
    # Paths on both sides of it touch: either a pass without a gouge, or told that it has no room.
    checked([dumbbell(2.0, 4.0, 6.0, 14.0)], 0.4, 2.0, 2.0)


def test_sharp_corners_reach_the_wall_no_deeper():
    """Round the corner of a boss the arc of turning is the tool's own, around the corner."""
    (around,) = offset([box(10, 10).reversed()], RADIUS)
    wanted = wanted_surface(around, ALPHA, RADIUS)
    assert Point(0, 0).within(region([wanted.reversed()]))
    # Parallel to the sides at the radial depth of the line.
    assert np.abs(np.asarray(wanted.points)).max() >= 5 + DEPTH - 1e-9
