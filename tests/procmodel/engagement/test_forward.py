"""Algorithm I: the tractrix in closed form, orders, laps."""

import math

import numpy as np
import pytest

from procmodel.engagement.biarcs import simplified
from procmodel.engagement.forward import forward_pass, march, passes
from procmodel.engagement.segments import advance, lengths
from procmodel.engagement.surface import Surface, previous_surface
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import box, circle, open_path, rounded_rectangle

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


def test_errors():
    _, surface = pocket()
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
