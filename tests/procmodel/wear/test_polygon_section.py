"""Polygons that a round electrode clears: closed forms, a pixel image, and refusals."""

import math
from itertools import pairwise

import jax
import numpy as np
import pytest
import scipy.ndimage
import shapely
from hypothesis import given
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.wear import PolygonSection

CORNER = 1.0 - math.pi / 4.0
RECTANGLE = [(0, 0), (300, 0), (300, 120), (0, 120)]
L_SHAPE = [(0, 0), (260, 0), (260, 100), (100, 100), (100, 240), (0, 240)]
# Two squares of 200 um joined by a neck 30 um wide and 50 um long.
DUMBBELL = [
    (0, 0), (200, 0), (200, 85), (250, 85), (250, 0), (450, 0),
    (450, 200), (250, 200), (250, 115), (200, 115), (200, 200), (0, 200),
]  # fmt: skip


@given(inset=st.floats(0.0, 30.0), gap=st.floats(0.0, 15.0), radius=st.floats(2.0, 29.0))
def test_rectangle(inset, gap, radius):
    section = PolygonSection(RECTANGLE, radius)
    width, height = 300 - 2 * (inset - gap), 120 - 2 * (inset - gap)
    expected = width * height - 4 * CORNER * (radius + gap) ** 2
    assert float(section.area(60.0 - inset, gap)) == pytest.approx(expected, rel=2e-5)


@given(inset=st.floats(0.0, 20.0), gap=st.floats(0.0, 15.0), radius=st.floats(2.0, 25.0))
def test_l_shape_with_a_reflex_corner(inset, gap, radius):
    section = PolygonSection(L_SHAPE, radius)
    # Inscribed circle at the inner corner: x = y = r touches (100, 100) or fits the 100 um arms.
    assert section.half_width == pytest.approx((100.0 * math.sqrt(2)) / (1 + math.sqrt(2)), 1e-5)
    area, perimeter = 260 * 100 + 100 * 140, 2 * (260 + 240)
    inward = inset - gap
    # Five convex corners and a reflex one, whose parallel curve inwards is an arc.
    expected = area - perimeter * inward + 4 * inward**2 - 5 * CORNER * (radius + gap) ** 2
    if inward > 0:
        expected += CORNER * inward**2
    found = float(section.area(section.half_width - inset, gap))
    assert found == pytest.approx(expected, rel=5e-5)


def test_neck_that_the_electrode_cannot_pass():
    section = PolygonSection(DUMBBELL, electrode_radius=40.0)
    # Each square with round corners, and the cap by which the electrode bulges into the neck.
    radius, half_neck = 40.0, 15.0
    cap = radius**2 * math.asin(half_neck / radius)
    cap -= half_neck * math.sqrt(radius**2 - half_neck**2)
    squares = 2 * (200**2 - 4 * CORNER * radius**2)
    found = float(section.area(section.half_width))
    assert found == pytest.approx(squares + 2 * cap, rel=2e-5)
    # A thinner electrode clears the neck too.
    thin = float(PolygonSection(DUMBBELL, electrode_radius=10.0).area(100.0))
    passed = 2 * 200**2 + 50 * 30 - 8 * CORNER * 100.0
    assert thin == pytest.approx(passed, rel=2e-5)


@pytest.mark.parametrize(("inset", "gap"), [(0.0, 0.0), (9.0, 0.0), (6.0, 4.0)])
def test_any_polygon_against_a_pixel_image(inset, gap):
    corners = [(0, 0), (170, 25), (240, -10), (215, 150), (130, 90), (95, 175), (-20, 120)]
    radius = 14.0
    section = PolygonSection(corners, radius)
    pixel = 0.25
    x = np.arange(-60, 280, pixel)
    y = np.arange(-60, 220, pixel)
    inside = shapely.contains_xy(shapely.Polygon(corners), *np.meshgrid(x, y))
    wall = scipy.ndimage.distance_transform_edt(inside) * pixel
    centres = wall > inset + radius
    reach = scipy.ndimage.distance_transform_edt(~centres) * pixel
    expected = np.count_nonzero(reach <= radius + gap) * pixel**2
    found = float(section.area(section.half_width - inset, gap))
    assert found == pytest.approx(expected, rel=3e-3)


def test_orientation_does_not_matter():
    one, other = PolygonSection(L_SHAPE, 12.0), PolygonSection(L_SHAPE[::-1], 12.0)
    assert float(one.area(40.0, 2.0)) == pytest.approx(float(other.area(40.0, 2.0)), rel=1e-12)


def test_area_grows_with_width_and_gap_from_the_electrodes_own_circle():
    section = PolygonSection(DUMBBELL, electrode_radius=20.0)
    areas = np.asarray(section.area(np.linspace(0.0, section.half_width, 24)))
    assert areas[0] == pytest.approx(math.pi * 20.0**2)
    assert all(a <= b for a, b in pairwise(areas))
    assert float(section.area(80.0, 3.0)) > float(section.area(80.0, 0.0))


def test_gradients_by_the_closed_form_of_the_rectangle():
    section = PolygonSection(RECTANGLE, electrode_radius=18.0)

    def area(half_width, gap):
        return section.area(half_width, gap)

    by_width, by_gap = jax.jit(jax.grad(area, argnums=(0, 1)))(50.0, 4.0)
    width, height = 300 - 2 * (10 - 4), 120 - 2 * (10 - 4)
    assert float(by_width) == pytest.approx(2 * (width + height), rel=1e-7)
    # The gap moves the walls and rounds the corners: 128 chords for each quarter circle.
    assert float(by_gap) == pytest.approx(2 * (width + height) - 8 * CORNER * 22.0, rel=2e-5)
    batch = jax.vmap(jax.grad(area))(np.array([50.0, 40.0]), np.array([4.0, 4.0]))
    np.testing.assert_allclose(batch, [2 * (width + height), 2 * (width + height) - 80.0], 1e-7)


@pytest.mark.parametrize(
    ("vertices", "radius", "sentence"),
    [
        ([(0, 0), (1, 1)], 0.1, "at least three"),
        ([(0, 0, 0), (1, 0, 0), (1, 1, 0)], 0.1, r"\(x, y\) pairs"),
        ([(0, 0), (10, 10), (10, 0), (0, 10)], 0.1, "cross or repeat.*in order"),
        (RECTANGLE, 60.1, "electrode_radius 60.1 um does not fit.* 60 um: go thinner"),
        (RECTANGLE, 0.0, "electrode_radius 0 um"),
        (RECTANGLE, -1.0, "electrode_radius -1 um"),
        (RECTANGLE, math.nan, "electrode_radius nan um"),
    ],
)
def test_refusals(vertices, radius, sentence):
    with pytest.raises(InputError, match=sentence):
        PolygonSection(vertices, radius)


def test_vertices_that_are_not_numbers_are_refused():
    with pytest.raises(InputError):
        PolygonSection([(0, 0), (math.nan, 0), (10, 10), (0, 10)], 1.0)
