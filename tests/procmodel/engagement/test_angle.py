"""Engagement angles against closed forms worked by hand, polygons of shapely, and differences."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point
from shapely.geometry import box

from procmodel.engagement import (
    AIR,
    CORNER_TOO_SMALL,
    ENGAGED,
    SLOT,
    STATUS,
    area_rate,
    engagement_angle_constant_curvature,
    engagement_angle_entering_arc,
    engagement_status,
    radial_depth_for_angle,
    sharp_corner_angle,
    surface_kink,
)

# The paper's cut: tool of 10 mm, 0.1 mm radial depth, concave wall of 8 mm radius.
RADIUS, DEPTH, WALL = 5.0, 0.1, 8.0
LINE = 11.478340954533579  # acos(1 - 0.02) in degrees


def degrees(angle):
    return float(jnp.degrees(angle))


def test_the_line_of_the_paper():
    found = degrees(engagement_angle_constant_curvature(DEPTH, RADIUS, 0.0))
    assert found == pytest.approx(LINE, abs=1e-9)
    assert math.degrees(math.acos(0.98)) == pytest.approx(LINE, abs=1e-9)


def test_the_concave_arc_of_the_paper():
    found = degrees(engagement_angle_constant_curvature(DEPTH, RADIUS, 1.0 / WALL))
    assert found == pytest.approx(18.738, abs=5e-4)
    # The triangle of wall centre, tool centre and crossing with the stock, by the law of cosines.
    path, stock = WALL - RADIUS, WALL - DEPTH
    corner = math.acos((path**2 + RADIUS**2 - stock**2) / (2 * path * RADIUS))
    assert found == pytest.approx(180.0 - math.degrees(corner), abs=1e-9)


def test_holding_the_angle_of_the_line_on_the_arc():
    depth = float(radial_depth_for_angle(math.radians(LINE), RADIUS, 1.0 / WALL))
    # The stock's crossing stands at 0.98 of the radius: R_w^2 = 3^2 + 5^2 + 2 * 3 * 5 * 0.98.
    assert depth == pytest.approx(WALL - math.sqrt(63.4), abs=1e-12)
    found = degrees(engagement_angle_constant_curvature(depth, RADIUS, 1.0 / WALL))
    assert found == pytest.approx(LINE, abs=1e-9)


def test_the_way_into_the_arc():
    distances = np.array([0.8, 0.5, 0.25, 0.0])
    found = np.degrees(engagement_angle_entering_arc(distances, DEPTH, RADIUS, WALL))
    np.testing.assert_allclose(found, [11.6356, 12.7340, 14.9054, 18.7375], atol=5e-5)


def test_the_spike_begins_before_the_arc():
    begin = RADIUS * math.sin(math.radians(LINE))
    assert begin == pytest.approx(0.995, abs=5e-4)
    for distance in (begin, 2.0 * begin):
        found = degrees(engagement_angle_entering_arc(distance, DEPTH, RADIUS, WALL))
        assert found == pytest.approx(LINE, abs=1e-9)
    just_inside = degrees(engagement_angle_entering_arc(begin - 1e-6, DEPTH, RADIUS, WALL))
    assert just_inside == pytest.approx(LINE, abs=1e-3)
    at_arc = degrees(engagement_angle_entering_arc(0.0, DEPTH, RADIUS, WALL))
    on_arc = degrees(engagement_angle_constant_curvature(DEPTH, RADIUS, 1.0 / WALL))
    assert at_arc == pytest.approx(on_arc, abs=1e-9)


def test_sharp_corners():
    for interior in (30.0, 90.0, 150.0):
        found = degrees(sharp_corner_angle(math.radians(interior), DEPTH, RADIUS))
        assert found == pytest.approx(min(180.0, 180.0 - interior + LINE), abs=1e-9)
    assert degrees(sharp_corner_angle(0.0, DEPTH, RADIUS)) == 180.0


def test_the_kink_of_the_paper():
    kink = surface_kink(math.radians(LINE), RADIUS, 1.0 / (WALL - RADIUS))
    assert degrees(kink) == pytest.approx(7.18, abs=5e-3)


def test_sensitivity_on_a_line():
    slope = jax.grad(engagement_angle_constant_curvature)(DEPTH, RADIUS, 0.0)
    alpha = math.radians(LINE)
    assert float(slope) == pytest.approx(1.0 / (RADIUS * math.sin(alpha)), rel=1e-12)
    assert math.degrees(float(slope)) == pytest.approx(57.6, abs=0.05)


def test_statuses_name_every_case():
    curvature = np.array([0.0, 0.0, 0.0, 0.2, 0.5])
    depth = np.array([0.1, 0.0, 10.5, 0.1, 0.1])
    found = engagement_status(depth, RADIUS, curvature)
    assert found.tolist() == [ENGAGED, AIR, SLOT, CORNER_TOO_SMALL, CORNER_TOO_SMALL]
    assert all(int(code) in STATUS for code in found)
    angles = np.asarray(engagement_angle_constant_curvature(depth, RADIUS, curvature))
    assert angles[1:].tolist() == [0.0, math.pi, math.pi, math.pi]


@pytest.mark.parametrize("depth", [-1.0, 0.0, 0.1, 10.0, 11.0])
@pytest.mark.parametrize("curvature", [-0.3, 0.0, 0.125, 0.2, 0.4])
def test_values_and_gradients_are_finite_everywhere(depth, curvature):
    for order in (0, 1, 2):
        value, slope = jax.value_and_grad(engagement_angle_constant_curvature, order)(
            depth, RADIUS, curvature
        )
        assert np.isfinite(value) and np.isfinite(slope)


@given(
    radius=st.floats(0.5, 20.0),
    share=st.floats(1e-4, 0.95),
    bend=st.floats(-2.0, 0.9),
)
def test_depth_and_angle_are_inverse(radius, share, bend):
    curvature = bend / radius
    # Beyond the middle of a concave pocket a deeper stock means less of it.
    deepest = 2.0 * radius if curvature <= 0 else min(2.0 * radius, 0.99 / curvature)
    depth = share * deepest
    angle = engagement_angle_constant_curvature(depth, radius, curvature)
    if engagement_status(depth, radius, curvature) == ENGAGED:
        assert float(radial_depth_for_angle(angle, radius, curvature)) == pytest.approx(
            depth, rel=1e-7
        )


@given(radius=st.floats(1.0, 10.0), share=st.floats(0.02, 0.9), bend=st.floats(-1.0, 0.8))
def test_against_polygons_of_shapely(radius, share, bend):
    """Share of the tool's rim on its leading half that lies in the stock, counted on points."""
    curvature = bend / radius if abs(bend) > 0.05 else 0.0
    depth = share * min(2.0 * radius, 0.5 / abs(curvature) if curvature else math.inf)
    if curvature == 0.0:
        stock, centre = box(-1e3, -depth, 1e3, 0.0), (0.0, -radius)
    else:
        wall = 1.0 / abs(curvature)
        rings = (wall, wall - depth) if curvature > 0 else (wall + depth, wall)
        outer, inner = (Point(0, 0).buffer(r, quad_segs=2048) for r in rings)
        stock = outer.difference(inner)
        centre = (0.0, wall - radius) if curvature > 0 else (0.0, -wall - radius)
        if curvature < 0:
            stock, centre = stock, (0.0, wall + radius)
    towards = 1.0 if curvature >= 0 else -1.0
    # From the flank that touches the wall round to the other side, on the leading half.
    phi = (np.arange(4000) + 0.5) * math.pi / 4000
    rim = [
        Point(centre[0] + radius * math.sin(p), centre[1] + towards * radius * math.cos(p))
        for p in phi
    ]
    inside = np.array([stock.contains(point) for point in rim])
    expected = math.pi * np.mean(inside)
    found = float(engagement_angle_constant_curvature(depth, radius, curvature))
    assert found == pytest.approx(expected, abs=5e-3)


def test_area_rate():
    alpha = math.radians(LINE)
    assert float(area_rate(math.pi - alpha, math.pi, RADIUS)) == pytest.approx(DEPTH, rel=1e-12)
    assert float(area_rate(0.0, math.pi, RADIUS)) == 2.0 * RADIUS
    whole = area_rate(0.3, 0.9, RADIUS) + area_rate(0.9, 1.7, RADIUS)
    assert float(whole) == pytest.approx(float(area_rate(0.3, 1.7, RADIUS)), rel=1e-12)
