"""Algorithm I: the tractrix in closed form, orders, laps, and places moved by Newton's method."""

import math

import numpy as np
import pytest

from procmodel.engagement.angle import engagement_angle_constant_curvature
from procmodel.engagement.biarcs import simplified
from procmodel.engagement.forward import METHODS, forward_pass, march, move_places, passes
from procmodel.engagement.offset import offset
from procmodel.engagement.segments import advance, lengths
from procmodel.engagement.surface import Surface, previous_surface
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import along, box, circle, open_path, rounded_rectangle

RADIUS, DEPTH, WALL = 5.0, 0.1, 8.0
ALPHA = math.acos(1 - DEPTH / RADIUS)


def straight_march(to, count, alpha, beta):
    """Along the x axis, the stock below it; the angle beta of the rim's end at the end."""
    begin = to * np.arange(count) / count
    at = begin[:, None] + to / count * np.array([0.0, 0.5, 1.0])
    points = np.stack([at, np.zeros_like(at)], axis=-1)
    tangents = np.broadcast_to([1.0, 0.0], points.shape)
    start = -RADIUS * np.array([math.sin(beta), -math.cos(beta)])
    centre, direction, speed = march(
        points, tangents, np.full(count, to / count), alpha, RADIUS, start
    )
    q = points[:, 2] - np.asarray(centre)
    return np.arctan2(q[:, 0], -q[:, 1]), np.asarray(direction), np.asarray(speed), q


def tractrix(u, alpha, beta):
    shrink = math.exp(-u / (RADIUS * math.sin(alpha)))
    return alpha + 2 * math.atan(math.tan(0.5 * (beta - alpha)) * shrink)


@pytest.mark.parametrize(
    ("way", "degrees"), [(2, 34.1667), (5, 46.9129), (10, 55.8593), (20, 59.5886)]
)
def test_the_tractrix(way, degrees):
    alpha, beta = math.radians(60), math.radians(20)
    assert math.degrees(tractrix(way, alpha, beta)) == pytest.approx(degrees, abs=5e-5)
    found, direction, speed, q = straight_march(way, 400, alpha, beta)
    assert math.degrees(found[-1]) == pytest.approx(degrees, abs=5e-5)
    assert found[-1] == pytest.approx(tractrix(way, alpha, beta), abs=1e-9)
    # The tool heads for where the rim is alpha behind, at the speed that keeps the radius.
    heading = np.arctan2(direction[:, 1], direction[:, 0])
    np.testing.assert_allclose(heading, found - alpha, atol=1e-12)
    np.testing.assert_allclose(speed, np.sin(found) / math.sin(alpha), rtol=1e-12)
    np.testing.assert_allclose(np.hypot(*q.T), RADIUS, rtol=1e-12)


def test_fourth_order():
    alpha, beta = math.radians(60), math.radians(20)
    exact = tractrix(5.0, alpha, beta)
    off = [abs(straight_march(5.0, n, alpha, beta)[0][-1] - exact) for n in (5, 10, 20, 40)]
    np.testing.assert_allclose(np.log2(np.divide(off[:-1], off[1:])), 4, atol=0.5)
    assert off[-1] < 1e-7


def test_a_start_at_the_angle_stays_there():
    found, direction, speed, _ = straight_march(20.0, 100, ALPHA, ALPHA)
    np.testing.assert_allclose(found, ALPHA, atol=1e-12)
    np.testing.assert_allclose(direction, np.tile([1.0, 0.0], (100, 1)), atol=1e-12)
    np.testing.assert_allclose(speed, 1.0, rtol=1e-12)


def test_wrong_starts_are_forgotten():
    """By exp(-1) in a way of r sin(alpha): also where the start was far too deep."""
    for beta in (0.01, 1.2):
        found = straight_march(5 * RADIUS * math.sin(ALPHA), 500, ALPHA, beta)[0][-1]
        off = 2 * math.tan(0.5 * (beta - ALPHA)) * math.exp(-5)
        assert found - ALPHA == pytest.approx(off, rel=1e-3)


def nodes(path):
    """Where the two arcs of each pair begin: places that the march has computed."""
    pieces = path.segments.on_host()
    return pieces.start[::2], pieces.direction[::2]


def test_a_straight_wall_in_closed_form():
    surface = Surface([open_path((40, 0.0))])
    found = forward_pass(surface, ALPHA, RADIUS)
    (path,) = found.path
    # One pair of flank and rim: the tool runs r cos(alpha) above the edge.
    np.testing.assert_allclose(np.asarray(path.points)[:, 1], RADIUS * math.cos(ALPHA), atol=1e-12)
    assert found.closing_gap == 0.0
    assert found.least_speed == pytest.approx(1.0, rel=1e-12)


def test_round_pockets_and_bosses_in_closed_form():
    """In a cleared circle the path is one of the radius r cos(alpha) + sqrt(R^2 - r^2 sin^2)."""
    for stock, sign in ((7.9, 1.0), (20.0, -1.0)):
        found = forward_pass(Surface([circle(stock, turn=sign)]), ALPHA, RADIUS)
        (path,) = found.path
        leg = math.sqrt(stock**2 - (RADIUS * math.sin(ALPHA)) ** 2)
        expected = leg - sign * RADIUS * math.cos(ALPHA)
        at, _ = nodes(path)
        np.testing.assert_allclose(np.hypot(*at.T), expected, atol=1e-8)
        assert np.sign(path.area) == sign
        assert found.closing_gap < 1e-9


def pocket(corner=WALL):
    walls = [rounded_rectangle(60, 40, corner)]
    return walls, previous_surface(walls, DEPTH, RADIUS)


@pytest.mark.parametrize("alpha", [ALPHA, 0.6])
def test_every_node_is_at_the_target(alpha):
    _, surface = pocket()
    found = forward_pass(surface, alpha, RADIUS)
    (path,) = found.path
    seen = surface.engagement(*nodes(path), RADIUS)
    np.testing.assert_allclose(seen.angle, alpha, atol=1e-6)
    # Between them as well, to what the pairs of arcs leave.
    half = 0.5 * lengths(path.segments.on_host(), np)
    p = path.segments.on_host()
    middle = advance(p.start, p.direction, p.curvature, half, np)
    between = surface.engagement(*middle, RADIUS).angle
    np.testing.assert_allclose(between, alpha, rtol=2e-2)
    assert found.least_speed > 0.0


def test_the_second_lap_closes():
    _, surface = pocket()
    found = forward_pass(surface, ALPHA, RADIUS)
    # A lap of 180 mm forgets by exp(-180 / 0.995).
    assert found.closing_gap < 1e-9
    # At 3 rad the way to forget is short again, and at 90 degrees exp(-180 / 5) is left at most.
    assert forward_pass(surface, 1.5, RADIUS).closing_gap < 1e-8


def test_steps_refine_to_one_path():
    _, surface = pocket()
    areas = [forward_pass(surface, ALPHA, RADIUS, h).path[0].area for h in (0.02, 0.01, 0.005)]
    # Nodes are of the fourth order and pairs of arcs of the third: the area settles fast.
    assert abs(areas[1] - areas[2]) < 0.5 * abs(areas[0] - areas[1]) + 1e-7
    assert areas[2] == pytest.approx(areas[1], rel=1e-7)


def test_several_passes_meet_the_surfaces_of_each_other():
    _, surface = pocket(12.0)
    found = passes(surface, ALPHA, RADIUS, 2, 0.02)
    assert len(found) == 2 and found[0][1] is surface
    for this, met in found:
        (path,) = this.path
        seen = met.engagement(*nodes(path), RADIUS)
        # The second surface is made of the pairs of arcs of the first path: it is as good as they.
        assert np.percentile(np.abs(seen.angle / ALPHA - 1), 95) < 0.01
    # Each pass is farther out by the radial depth of the line on the straight sides.
    high = [np.asarray(this.path[0].points)[:, 1].max() for this, _ in found]
    assert high[1] - high[0] == pytest.approx(DEPTH, rel=1e-3)


def paper():
    walls = [open_path((40, 0.0), (0.5 * math.pi * WALL, 1 / WALL), (40, 0.0))]
    (path,) = offset(walls, RADIUS)
    return path, previous_surface(walls, DEPTH, RADIUS)


def on_arc(moved):
    """Angle on the paper's arc with the path's radius 3 + moved: a triangle of 3 + x, 5, 7.9."""
    path = WALL - RADIUS + moved
    cosine = (path**2 + RADIUS**2 - (WALL - DEPTH) ** 2) / (2 * path * RADIUS)
    return math.pi - math.acos(cosine)


def test_newton_in_c_converges_in_six_steps():
    path, surface = paper()
    at = along(path, np.linspace(30, path.length - 30, 801))
    found = move_places(surface, *at, ALPHA, RADIUS)
    assert np.all(found.converged)
    assert found.steps <= 6
    np.testing.assert_allclose(found.angle, ALPHA, atol=1e-9)
    # Moved, the places have that angle: evaluated anew, in the direction of the given path.
    normal = np.column_stack([at[1][:, 1], -at[1][:, 0]])
    again = surface.engagement(at[0] + found.moved[:, None] * normal, at[1], RADIUS)
    np.testing.assert_allclose(again.angle, ALPHA, atol=1e-9)
    # On the line nothing moves; on the arc as far as the triangle says.
    assert found.moved[0] == pytest.approx(0.0, abs=1e-12)
    on = np.abs(found.moved - found.moved[400]) < 1e-9
    exact = math.sqrt((WALL - DEPTH) ** 2 - (RADIUS * math.sin(ALPHA)) ** 2)
    exact -= RADIUS * math.cos(ALPHA) + WALL - RADIUS
    assert np.sum(on) > 10
    np.testing.assert_allclose(found.moved[on], exact, atol=1e-10)


def test_newton_in_the_angle_agrees():
    path, surface = paper()
    at = along(path, np.linspace(41.0, 43.0, 11))
    one, other = (move_places(surface, *at, ALPHA, RADIUS, m) for m in ("ratio", "angle"))
    assert np.all(other.converged)
    np.testing.assert_allclose(other.moved, one.moved, atol=1e-10)
    assert one.steps <= other.steps


def test_one_step_of_the_paper_s_mode():
    """A finite difference in alpha on the arc, by the triangle; and the same step in c."""
    path, surface = paper()
    at = along(path, np.array([42.0]))
    h = 1e-5 * RADIUS
    start, slope = on_arc(0.0), (on_arc(h) - on_arc(0.0)) / h
    expected = (ALPHA - start) / slope
    found = move_places(surface, *at, ALPHA, RADIUS, "difference")
    assert found.steps == 1
    assert found.moved[0] == pytest.approx(expected, rel=1e-7)
    assert found.angle[0] == pytest.approx(on_arc(expected), abs=1e-8)
    # 24.5 % below, by the triangle alone.
    assert on_arc(expected) / ALPHA - 1 == pytest.approx(-0.2453, abs=5e-5)

    # In c = 1 + (p^2 - 37.41) / (10 p), p = 3 + x, the step falls short by 1.5 % of the angle.
    path_radius, rest = WALL - RADIUS, (WALL - DEPTH) ** 2 - RADIUS**2
    ratio = 1 + (path_radius**2 - rest) / (10 * path_radius)
    step = (1 - math.cos(ALPHA) - ratio) / ((1 + rest / path_radius**2) / 10)
    one = move_places(surface, *at, ALPHA, RADIUS, "ratio", steps=1)
    assert one.moved[0] == pytest.approx(step, rel=1e-9)
    assert on_arc(step) / ALPHA - 1 == pytest.approx(-0.0146, abs=5e-5)
    assert one.angle[0] == pytest.approx(on_arc(step), abs=1e-9)


def test_one_step_in_the_radial_depth():
    """What the step misses when not the tool but the stock before it is moved: 22 and 0.33 %."""

    def angle(depth):
        return float(engagement_angle_constant_curvature(depth, RADIUS, 1 / WALL))

    # c = a (2 - a / 8) / 3.75.
    slope = (2 - DEPTH / 4) / 3.75
    in_angle = DEPTH + (ALPHA - angle(DEPTH)) * math.sin(angle(DEPTH)) / slope
    in_ratio = DEPTH + (math.cos(angle(DEPTH)) - math.cos(ALPHA)) / slope
    assert angle(in_angle) / ALPHA - 1 == pytest.approx(-0.22, abs=5e-3)
    assert angle(in_ratio) / ALPHA - 1 == pytest.approx(-0.0033, abs=5e-5)


@pytest.mark.parametrize("method", METHODS)
def test_places_without_a_solution_are_not_converged(method):
    surface = Surface([open_path((60, 0.0), start=(-30.0, 0.0))])
    # In reach from air; out of reach; far from everything; deep in the stock; at the wall's end.
    heights = np.array([RADIUS + 0.5, RADIUS + 4.0, 500.0, -3 * RADIUS, RADIUS])
    centres = np.column_stack([[0.0, 0.0, 0.0, 0.0, -60.0], heights])
    found = move_places(surface, centres, np.tile([1.0, 0.0], (5, 1)), ALPHA, RADIUS, method)
    for field in (found.moved, found.angle):
        assert np.all(np.isfinite(field))
    assert np.all(np.abs(found.moved) <= 0.5 * RADIUS + 1e-12)
    assert not np.any(found.converged[1:])
    if method == "ratio":
        # c is linear in the distance on a line, on and off the stock: one step, and one to see it.
        assert found.converged[0]
        assert found.moved[0] == pytest.approx(0.5 + DEPTH, abs=1e-12)


def test_lift_off_and_slot_are_left_in_c():
    surface = Surface([open_path((60, 0.0), start=(-30.0, 0.0))])
    heights = np.array([RADIUS + 1e-9, RADIUS, -RADIUS, -RADIUS + 1e-9, 0.0])
    centres = np.column_stack([np.zeros(5), heights])
    found = move_places(
        surface, centres, np.tile([1.0, 0.0], (5, 1)), ALPHA, RADIUS, reach=3 * RADIUS
    )
    assert np.all(found.converged) and found.steps <= 3
    np.testing.assert_allclose(found.moved, heights - RADIUS * math.cos(ALPHA), atol=1e-9)


def test_errors():
    _, surface = pocket()
    with pytest.raises(InputError, match="method is 'newton': choose one of ratio, angle"):
        move_places(surface, np.zeros((1, 2)), np.ones((1, 2)), ALPHA, RADIUS, "newton")
    for angle in (0.0, math.pi, -1.0):
        with pytest.raises(InputError, match="must be between 0 and 180"):
            forward_pass(surface, angle, RADIUS)


def test_a_pass_in_a_square_pocket_stays_finite():
    """Corners of the stock as round as the previous tool: followed, or said that it cannot be."""
    surface = previous_surface([box(60, 40)], DEPTH, RADIUS)
    found = forward_pass(surface, ALPHA, RADIUS)
    (path,) = found.path
    assert np.all(np.isfinite(path.points)) and np.all(np.isfinite(path.bulges))
    assert np.isfinite(found.least_speed)
    assert len(simplified(path, 1e-4).bulges) < len(path.bulges)
