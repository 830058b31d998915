"""Corrected paths against closed forms, and against discs and polygons of shapely."""

import math

import numpy as np
import pytest
import shapely

from calibration.plans.path import correct_path, survey
from calibration.plans.path_check import check_path
from procmodel.engagement.contour import contour, oriented
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import (
    box,
    circle,
    dilated,
    open_path,
    rounded_rectangle,
    sampled,
)

# Angles are known to the root of rounding, some 1e-7 rad, where curves are nearly parallel.
RADIUS, DEPTH, SPACING = 5.0, 0.1, 0.02
LINE = math.degrees(math.acos(0.98))


def in_arc(wall, radius=RADIUS, depth=DEPTH, side=1.0):
    """Engagement [deg] inside (1) or outside (-1) an arc, of the triangle of the two centres."""
    path, surface = wall - side * radius, wall - side * depth
    cosine = side * (surface**2 - path**2 - radius**2) / (2.0 * path * radius)
    return math.degrees(math.acos(cosine))


def corrected(walls, side="inside", **options):
    options = {"spacing": SPACING} | options
    return correct_path(oriented(walls, side), RADIUS, DEPTH, **options)


@pytest.fixture(scope="module")
def pocket():
    return corrected([rounded_rectangle(60, 40, 8)])


def test_pocket_before_is_the_closed_form(pocket):
    before = pocket.as_dict()["before"]
    assert math.degrees(pocket.target) == pytest.approx(LINE, abs=1e-12)
    assert before["min_deg"] == pytest.approx(LINE, abs=1e-9)
    assert before["max_deg"] == pytest.approx(in_arc(8.0), abs=1e-6)
    assert before["overshoot_percent"] == pytest.approx(63.24, abs=0.005)
    # The material cut is the ring of the depth, whatever the angle does.
    path = sum(c.length for c in pocket.before.path)
    assert path == pytest.approx(2 * (44 + 24) + 2 * math.pi * 3, rel=1e-12)
    ring = DEPTH * (2 * (44 + 24)) + math.pi * (8.0**2 - 7.9**2)
    cut = np.sum(pocket.before.area_rate * pocket.before.weight)
    assert cut == pytest.approx(ring, rel=1e-4)  # trapezia of 0.02 mm


def test_pocket_after_reaches_the_floor_and_no_less(pocket):
    figures = pocket.as_dict()
    floor, after = figures["floor_percent"], figures["after"]["overshoot_percent"]
    assert floor == pytest.approx(12.41, abs=0.005)
    assert floor - 0.2 <= after <= floor + 1e-6
    assert figures["after"]["min_deg"] == pytest.approx(LINE, abs=1e-5)
    assert figures["left_on_wall_mm"] == {"min": pytest.approx(0), "max": pytest.approx(0)}


def rim_in_stock(path, cleared, places):
    """Engagement [deg] by points on the rim, from the wall forwards, that are not cleared yet."""
    shapely.prepare(cleared)
    angles = np.linspace(0.0, 0.5 * math.pi, 9001)
    found = []
    ring = sampled(path)
    ring = ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]
    line = shapely.LinearRing(ring)
    for way in places * line.length:
        o, ahead = (np.array(line.interpolate(way + d).coords[0]) for d in (0.0, 1e-4))
        forward = (ahead - o) / np.hypot(*(ahead - o))
        wall = np.array([forward[1], -forward[0]])
        rim = o + RADIUS * (np.cos(angles)[:, None] * wall + np.sin(angles)[:, None] * forward)
        free = np.flatnonzero(shapely.contains_xy(cleared, rim))
        found.append(math.degrees(angles[free[0]]))
    return np.array(found)


def test_engagement_of_the_corrected_pass_counted_on_the_rim(pocket):
    inner, last = pocket.passes
    # Off the vertices, where the direction of the sampled ring is that of its chords.
    places = (np.arange(300) + 0.37) / 300
    found = rim_in_stock(last[0], dilated(inner, RADIUS), places)
    # Chords of the sampled arcs are up to half of 90/256 degrees off the tangent.
    assert np.max(found) <= LINE * (1 + pocket.as_dict()["floor_percent"] / 100) + 0.19
    assert np.min(found) >= LINE - 0.19
    assert np.median(found) == pytest.approx(LINE, abs=0.02)
    # The plain pass before the last one fails the same test.
    plain = [rounded_rectangle(60 - 10.2, 40 - 10.2, 2.9)]
    worst = np.max(rim_in_stock(last[0], dilated(plain, RADIUS), places))
    assert worst == pytest.approx(in_arc(8.0), abs=0.19)


def test_boss_is_engaged_too_little_at_its_corners():
    figures = corrected([rounded_rectangle(60, 40, 8)], "outside").as_dict()
    assert figures["before"]["min_deg"] == pytest.approx(in_arc(8.0, side=-1.0), abs=1e-5)
    assert figures["before"]["max_deg"] == pytest.approx(LINE, abs=1e-6)
    assert figures["after"]["min_deg"] == pytest.approx(LINE, abs=1e-5)
    assert figures["after"]["overshoot_percent"] <= figures["floor_percent"] + 1e-6


def test_island_in_a_pocket():
    walls = [rounded_rectangle(60, 40, 8), circle(6)]
    figures = corrected(walls).as_dict()
    assert figures["before"]["min_deg"] == pytest.approx(in_arc(6.0, side=-1.0), abs=1e-5)
    assert figures["before"]["max_deg"] == pytest.approx(in_arc(8.0), abs=1e-6)
    assert figures["after"]["min_deg"] == pytest.approx(LINE, abs=1e-5)
    assert figures["after"]["overshoot_percent"] <= figures["floor_percent"] + 1e-6


def test_sharp_corners_are_counted_and_left():
    plan = corrected([box(40, 40)])
    figures = plan.as_dict()
    # Arriving in and leaving each of the four corners.
    assert figures["statuses"]["corner_too_small"] == 8
    assert figures["before"]["statuses"]["corner_too_small"] == 8
    assert any("4 corner(s)" in note for note in plan.notes)
    # In the corner, up to a right angle more than on the line.
    assert figures["before"]["max_deg"] == pytest.approx(90.0 + LINE, abs=1e-6)
    # Between the circle of the tool and the end of the sides: r (sqrt(2) - 1) in the corner, but
    # from the boundary cleared the nearest wall is r (1 - cos 45).
    left = RADIUS * (1.0 - math.sqrt(0.5))
    assert figures["left_on_wall_mm"]["max"] == pytest.approx(left, abs=1e-3)


@pytest.mark.parametrize(
    ("side", "extreme"), [("left", "max_deg"), ("right", "min_deg")], ids=["concave", "convex"]
)
def test_open_wall(side, extreme):
    plan = corrected([open_path((20.0, 0.0), (10.0, 0.1), (20.0, 0.0))], side)
    figures = plan.as_dict()
    arc = in_arc(10.0, side=1.0 if side == "left" else -1.0)
    assert figures["before"][extreme] == pytest.approx(arc, abs=1e-5)
    # Also at the ends, where the rim reaches past the wall.
    assert figures["before"]["statuses"] == {"engaged": figures["before"]["points"]}
    assert figures["after"]["min_deg"] == pytest.approx(LINE, abs=1e-5)
    assert figures["after"]["overshoot_percent"] <= figures["floor_percent"] + 1e-6
    assert all(not c.closed for one in plan.passes for c in one)


def test_circle_needs_one_other_radius():
    """Concentric circles: the surface of the angle is that of the law of cosines."""
    plan = corrected([circle(20.0)])
    ((inner,), _) = plan.passes
    surface = math.sqrt(15.0**2 + 25.0 + 2 * 15.0 * 5.0 * 0.98)
    radii = np.hypot(*np.asarray(inner.points).T)
    assert radii == pytest.approx(surface - RADIUS, abs=1e-9)
    after = plan.as_dict()["after"]
    assert after["max_deg"] == pytest.approx(LINE, abs=1e-6)
    assert plan.as_dict()["floor_percent"] == pytest.approx(0.0, abs=1e-6)


def _right_side(paths):
    """Where the paths cross the x axis on the right."""
    rings = shapely.MultiLineString([shapely.LinearRing(c.flattened()) for c in paths])
    axis = shapely.LineString([(0.0, 0.1), (100.0, 0.1)])
    return float(rings.intersection(axis).bounds[2])


def test_several_passes_with_another_tool():
    plan = corrected([rounded_rectangle(60, 40, 8)], passes=3, previous_radius=6.0)
    figures = plan.as_dict()
    assert len(plan.passes) == 4
    assert len(figures["passes"]) == 3
    # Each pass along the straight sides is one depth of its own tool further in.
    right = [_right_side(one) for one in plan.passes]
    other = 6.0 * (1.0 - 0.98)
    deep = [30 - DEPTH - 2 * other - 6, 30 - DEPTH - other - 6, 30 - DEPTH - 6, 30 - RADIUS]
    assert right == pytest.approx(deep, abs=1e-9)
    for part in figures["passes"]:
        assert part["min_deg"] == pytest.approx(LINE, abs=1e-5)
    # The passes in between turn on the spot in corners of the wanted surface; the last does not.
    assert figures["after"]["statuses"] == {"engaged": figures["after"]["points"]}


def test_passes_that_find_no_room_are_left_out():
    # The path is 14 mm wide, and each pass takes 5 (1 - cos 60) off either side.
    plan = corrected([rounded_rectangle(24, 40, 8)], passes=5, target=math.radians(60.0))
    assert len(plan.passes) == 3
    assert any("passes find room" in note for note in plan.notes)


def test_forward_holds_the_target_and_misses_the_wall():
    wall = rounded_rectangle(22, 20, 8)
    plan = corrected([wall], method="forward", passes=2)
    assert len(plan.passes) == len(plan.surveys) == 2
    for one in plan.surveys:
        off = np.abs(one.angle - one.target)
        assert np.quantile(off, 0.99) <= 1e-6
        assert np.max(off) <= 3e-4
    left = plan.as_dict()["left_on_wall_mm"]
    # Along a side of 4 mm or more what a corner did is forgotten by exp(-1) each r sin(target).
    assert 0.0 <= left["min"] <= left["max"] * math.exp(-3.0)
    assert 0.05 < left["max"] < 0.2
    assert any(f"{left['max']:.4f} mm on the walls" in note for note in plan.notes)
    # By polygons: what both passes clear stays inside the wall, and that much short of it.
    cleared = dilated(plan.passes[-1], RADIUS)
    rest = shapely.Polygon(sampled(wall)).difference(cleared.buffer(1e-4))
    corner = shapely.Polygon(sampled(rounded_rectangle(22, 20, 8))).exterior
    away = max(corner.distance(shapely.Point(p)) for p in cleared.exterior.coords)
    assert rest.area > 0.1
    assert away == pytest.approx(left["max"], abs=1e-3)


def test_forward_in_a_circle_misses_by_the_closed_form():
    wall, first = 8.0, 7.8
    plan = corrected([circle(wall)], method="forward", passes=2)
    surface = first
    for _ in range(2):
        # Path p with surface^2 = p^2 + r^2 + 2 p r cos(target).
        p = -RADIUS * 0.98 + math.sqrt((RADIUS * 0.98) ** 2 + surface**2 - RADIUS**2)
        surface = p + RADIUS
    left = plan.as_dict()["left_on_wall_mm"]
    assert left["max"] == pytest.approx(wall - surface, abs=1e-6)


def test_target_is_taken():
    wanted = math.radians(20.0)
    plan = corrected([rounded_rectangle(60, 40, 8)], target=wanted)
    figures = plan.as_dict()
    assert figures["target_deg"] == pytest.approx(20.0)
    assert figures["after"]["min_deg"] == pytest.approx(20.0, abs=1e-5)
    # Deeper on the straight sides than the pass that is only parallel.
    right = _right_side(plan.passes[0])
    assert right == pytest.approx(25.0 - RADIUS * (1 - math.cos(wanted)), abs=1e-9)


def test_up_milling_is_the_same_in_a_mirror():
    walls = oriented([rounded_rectangle(60, 40, 8)], "inside")
    plan = corrected([rounded_rectangle(60, 40, 8)])
    program = [c for one in plan.passes for c in one]
    down = check_path(walls, RADIUS, DEPTH, program, spacing=SPACING)
    up = check_path(walls, RADIUS, DEPTH, [c.reversed() for c in program], spacing=SPACING)
    assert (down.milling, up.milling) == ("down", "up")
    # The shape is its own mirror image, but the correction is not: a path that was corrected for
    # down milling is reversed as a whole, so only what does not depend on direction agrees.
    assert up.surveys[-1].weight.sum() == pytest.approx(down.surveys[-1].weight.sum())
    plain = check_path(walls, RADIUS, DEPTH, plan.before.path, spacing=SPACING)
    back = check_path(
        walls, RADIUS, DEPTH, [c.reversed() for c in plan.before.path], spacing=SPACING
    )
    for key in ("min_deg", "max_deg", "mean_deg", "points"):
        mirrored, seen = back.as_dict()["engagement"][key], plain.as_dict()["engagement"][key]
        assert mirrored == pytest.approx(seen, abs=1e-6)


def test_program_against_itself_is_refused():
    walls = oriented([rounded_rectangle(60, 40, 8)], "inside")
    inner, last = contour(*_two(24.9)), contour(*_two(25.0))
    with pytest.raises(InputError, match="pass 1 of the program goes round against the others"):
        check_path(walls, RADIUS, DEPTH, [inner.reversed(), last], spacing=SPACING)


def _two(half):
    shape = rounded_rectangle(2 * half, 2 * half - 20, half - 22)
    return np.asarray(shape.points), np.asarray(shape.bulges)


def test_figures_weigh_places_by_their_way(pocket):
    """Twice the spacing on the same path: the mean stays, the number of places halves."""
    coarse = survey(pocket.before.path, pocket.before.surface, RADIUS, pocket.target, 0.04)
    fine, wide = pocket.before.as_dict(), coarse.as_dict()
    assert wide["points"] == pytest.approx(fine["points"] / 2, rel=0.01)
    assert wide["mean_deg"] == pytest.approx(fine["mean_deg"], abs=2e-3)


@pytest.mark.parametrize("bad", [math.inf, math.nan, 0.0, -1.0])
def test_impossible_spacing_and_tool(bad):
    walls = oriented([rounded_rectangle(60, 40, 8)], "inside")
    for call in (correct_path, check_path):
        with pytest.raises(InputError, match="spacing"):
            call(walls, RADIUS, DEPTH, spacing=bad)
        with pytest.raises(InputError, match="previous tool"):
            call(walls, RADIUS, DEPTH, previous_radius=bad)
