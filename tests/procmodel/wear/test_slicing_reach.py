"""Erosion and dilation by the electrode against closed forms and sampled places."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from procmodel.wear import SquareSection
from procmodel.wear.layer_path import ElectrodeSection
from procmodel.wear.slicing_reach import FIT, dilate, erode, inscribed_radius

BLOCK = shapely.box(-100, -100, 100, 100)
RING = shapely.Point(0, 0).buffer(150).difference(shapely.box(-40, -30, 50, 20))
ROUND, SQUARE = ElectrodeSection("round", 50.0), ElectrodeSection("square", 50.0)


def test_round_electrode_rounds_the_corners_of_a_square():
    cleared = dilate(erode(BLOCK, ROUND, 3.0), ROUND, 3.0)
    wanted = float(SquareSection(corner_radius=25.0).area(97.0, 3.0))
    assert cleared.area == pytest.approx(wanted, rel=1e-4)


def test_square_electrode_rounds_corners_with_the_gap_alone():
    assert dilate(erode(BLOCK, SQUARE), SQUARE).area == pytest.approx(200.0**2, rel=5e-5)
    cleared = dilate(erode(BLOCK, SQUARE, 3.0), SQUARE, 3.0)
    wanted = float(SquareSection(corner_radius=0.0).area(97.0, 3.0)) - (4 - math.pi) * 3.0**2
    assert cleared.area == pytest.approx(wanted, rel=1e-4)


def test_electrode_that_just_fits_leaves_a_thin_way():
    hole = shapely.Point(7, 8).buffer(28.0, quad_segs=64)
    places = erode(hole, ROUND, 3.0)
    assert 0 < places.area < math.pi * (2 * FIT) ** 2
    assert erode(shapely.Point(7, 8).buffer(27.9), ROUND, 3.0).is_empty
    slot = erode(shapely.box(0, 0, 300, 50), SQUARE)
    left, low, right, high = slot.bounds
    assert right - left == pytest.approx(250.0, abs=3 * FIT)
    assert high - low == pytest.approx(2 * FIT, rel=1e-6)


@pytest.mark.parametrize("electrode", [ROUND, SQUARE], ids=["round", "square"])
@pytest.mark.parametrize(
    "region", [BLOCK, RING, shapely.box(0, 0, 60, 300)], ids=["block", "ring", "strip"]
)
@given(seed=st.integers(0, 2**32 - 1))
def test_reachable_places_are_those_where_the_electrode_fits(electrode, region, seed):
    gap = 4.0
    reachable = erode(region, electrode, gap)
    generator = np.random.default_rng(seed)
    left, low, right, high = region.bounds
    for x, y in generator.uniform((left, low), (right, high), (20, 2)):
        centre = shapely.Point(x, y)
        if electrode.shape == "round":
            body = centre.buffer(25.0 + gap, quad_segs=64)
        else:
            body = shapely.box(x - 25, y - 25, x + 25, y + 25).buffer(gap, quad_segs=64)
        if reachable.boundary.distance(centre) > 0.05:
            assert reachable.contains(centre) == region.contains(body)


@pytest.mark.parametrize("electrode", [ROUND, SQUARE], ids=["round", "square"])
def test_dilated_line_has_the_area_of_its_closed_form(electrode):
    line = shapely.LineString([(0, 0), (100, 0)])
    ends = math.pi * 25.0**2 if electrode.shape == "round" else 50.0**2
    assert dilate(line, electrode).area == pytest.approx(100 * 50 + ends, rel=1e-3)
    corner = shapely.LineString([(0, 0), (100, 0), (100, 80)])
    if electrode.shape == "square":
        assert dilate(corner, electrode).area == pytest.approx(150 * 50 + 80 * 50)
    slanted = shapely.LineString([(0, 0), (30, 40)])
    width = 50.0 if electrode.shape == "round" else 50 * 0.6 + 50 * 0.8
    assert dilate(slanted, electrode).area == pytest.approx(50 * width + ends, rel=1e-3)


def test_inscribed_radius():
    assert inscribed_radius(BLOCK) == pytest.approx(100.0, rel=1e-3)
    both = shapely.union_all([BLOCK, shapely.box(200, 0, 210, 10)])
    assert inscribed_radius(both) == pytest.approx(100.0, rel=1e-3)
    assert inscribed_radius(shapely.Polygon()) == 0.0
