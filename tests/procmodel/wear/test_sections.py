"""Layer areas: closed forms and an independent opening with shapely."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from procmodel.wear import (
    AnnulusSection,
    CircleSection,
    PolygonSection,
    SquareSection,
)

widths = st.floats(1.0, 500.0)
gaps = st.floats(0.0, 20.0)


def opening(polygon, radius, gap):
    """What a disc of `radius` reaches inside a polygon, and the gap around it."""
    return polygon.buffer(-radius, quad_segs=512).buffer(radius + gap, quad_segs=512).area


@given(half_width=widths, gap=gaps)
def test_sharp_square_and_circle(half_width, gap):
    cleared = half_width + gap
    square = float(SquareSection().area(half_width, gap))
    assert square == pytest.approx((2 * cleared) ** 2, rel=1e-14)
    circle = float(CircleSection().area(half_width, gap))
    assert circle == pytest.approx(math.pi * cleared**2, rel=1e-14)


@given(half_width=st.floats(20.0, 500.0), radius=st.floats(0.5, 19.0), gap=gaps)
def test_rounded_square_is_what_the_electrode_reaches(half_width, radius, gap):
    box = shapely.box(-half_width, -half_width, half_width, half_width)
    expected = opening(box, radius, gap)
    found = float(SquareSection(radius).area(half_width, gap))
    assert found == pytest.approx(expected, rel=2e-6)


def test_square_narrower_than_the_electrode_is_the_electrodes_own_circle():
    # Continuous where the half width passes the radius, and constant below.
    section = SquareSection(corner_radius=25.0)
    above, below = section.area(25.0 + 1e-9, 3.0), section.area(25.0 - 1e-9, 3.0)
    assert float(above) == pytest.approx(float(below), rel=1e-9)
    for half_width in (25.0, 10.0, 1.0):
        circle = math.pi * (25.0 + 3.0) ** 2
        assert float(section.area(half_width, 3.0)) == pytest.approx(circle, rel=1e-14)


def test_areas_take_arrays():
    half_widths = np.array([[50.0, 40.0], [30.0, 20.0]])
    for section in (SquareSection(5.0), CircleSection(), AnnulusSection(SquareSection(), 8.0)):
        found = np.asarray(section.area(half_widths, 1.5))
        assert found.shape == (2, 2)
        one_by_one = [[float(section.area(x, 1.5)) for x in row] for row in half_widths]
        np.testing.assert_allclose(found, one_by_one, rtol=1e-14)


@given(half_width=st.floats(30.0, 500.0), thickness=st.floats(1.0, 29.0), gap=gaps)
def test_ring_closed_forms(half_width, thickness, gap):
    outer, inner = half_width + gap, half_width + gap - thickness
    circle = AnnulusSection(CircleSection(), thickness).area(half_width, gap)
    assert float(circle) == pytest.approx(math.pi * (outer**2 - inner**2), rel=1e-11)
    square = AnnulusSection(SquareSection(), thickness).area(half_width, gap)
    assert float(square) == pytest.approx(4.0 * (outer**2 - inner**2), rel=1e-11)


def test_ring_thicker_than_the_section_is_the_whole_section():
    for outer in (CircleSection(), SquareSection(), SquareSection(4.0)):
        ring = AnnulusSection(outer, thickness=30.0)
        assert float(ring.area(20.0, 2.0)) == pytest.approx(float(outer.area(20.0, 2.0)))
    # Rings that follow each other inwards fill the section.
    rings = sum(float(AnnulusSection(CircleSection(), 10.0).area(x)) for x in (50, 40, 30, 20, 10))
    assert rings == pytest.approx(math.pi * 50.0**2, rel=1e-14)


@given(half_width=st.floats(1.0, 99.0), radius=st.floats(1.0, 60.0), gap=gaps)
def test_square_polygon_agrees_with_the_square(half_width, radius, gap):
    polygon = PolygonSection([(0, 0), (200, 0), (200, 200), (0, 200)], radius)
    assert polygon.half_width == pytest.approx(100.0, abs=1e-4)
    found = float(polygon.area(half_width, gap))
    expected = float(SquareSection(radius).area(half_width, gap))
    # Above the electrode's radius and below it, where it plunges.
    assert found == pytest.approx(expected, rel=1e-4)
