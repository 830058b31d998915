"""Places moved by Newton's method: the paper's arc in closed form, other ways to the same angle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.engagement.angle import engagement_angle_constant_curvature
from procmodel.engagement.contour import contour
from procmodel.engagement.moving import METHODS, move_places
from procmodel.engagement.offset import offset
from procmodel.engagement.surface import Surface, previous_surface
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import along, open_path, stars

RADIUS, DEPTH, WALL = 5.0, 0.1, 8.0
ALPHA = math.acos(1 - DEPTH / RADIUS)


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
    _, surface = paper()
    with pytest.raises(InputError, match="method is 'newton': choose one of ratio, angle"):
        move_places(surface, np.zeros((1, 2)), np.ones((1, 2)), ALPHA, RADIUS, "newton")


def wavy(pieces):
    """A round wall of many arcs with kinks between them."""
    phi = 2 * math.pi * np.arange(pieces) / pieces
    radius = 60.0 + 0.3 * np.cos(12 * phi)
    points = np.column_stack([radius * np.cos(phi), radius * np.sin(phi)])
    return contour(points, np.full(pieces, math.tan(math.pi / (2 * pieces))))


@pytest.mark.parametrize("pieces", [60, 600, 4000])
def test_short_pieces_are_looked_up_anew(pieces):
    """Moved much farther than a piece is long, and met by the surface itself afterwards."""
    surface = previous_surface([wavy(pieces)], DEPTH, RADIUS)
    path = offset([wavy(pieces)], RADIUS)[0]
    point, direction = along(path, np.linspace(1.0, path.length - 1.0, 70))
    # Away from the wall and towards it, by more than the pieces at hand.
    normal = np.column_stack([direction[:, 1], -direction[:, 0]])
    centres = point + np.where(np.arange(70) % 2, 0.06, -0.06)[:, None] * normal
    found = move_places(surface, centres, direction, ALPHA, RADIUS)
    assert np.all(found.converged)
    assert np.abs(found.moved).max() > surface.index.spacing or pieces == 60
    seen = surface.engagement(centres + found.moved[:, None] * normal, direction, RADIUS)
    np.testing.assert_allclose(seen.angle, ALPHA, atol=1e-9)


@settings(max_examples=3)
@given(walls=stars(), radius=st.floats(0.5, 3.0), seed=st.integers(0, 9))
def test_moved_places_have_the_angle_or_say_that_they_do_not(walls, radius, seed):
    surface = Surface(walls)
    random = np.random.default_rng(seed)
    centres = random.uniform(-9, 9, (250, 2))
    heading = random.uniform(0, 2 * math.pi, 250)
    directions = np.column_stack([np.cos(heading), np.sin(heading)])
    found = move_places(surface, centres, directions, 1.0, radius)
    normal = np.column_stack([directions[:, 1], -directions[:, 0]])
    seen = surface.engagement(centres + found.moved[:, None] * normal, directions, radius)
    # A rim through a vertex has two angles.
    off = np.abs(seen.angle - 1.0)
    assert np.all(np.isfinite(found.moved))
    assert np.sum(off[found.converged] > 1e-6) <= 2
