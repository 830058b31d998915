"""Target solids and their layers."""

import math

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.wear import (
    Hemisphere,
    PolygonSection,
    SquareSection,
    TabulatedSolid,
    TaperedSolid,
    cone,
    layer_feed,
    pyramid,
    slice_solid,
)


def test_schedule_of_the_45_degree_pyramid(wear_reference):
    case = wear_reference["schedule_45_deg"]
    electrode = math.pi * case["electrode_diameter"] ** 2 / 4.0
    layers = slice_solid(pyramid(case["half_width"], math.pi / 4), case["layer_depth"])
    assert layers.bottom.shape == (case["layers"],)
    feeds = np.asarray(layer_feed(layers.thickness, layers.area, case["wear_ratio"], electrode))
    assert feeds[0] == pytest.approx(case["first_feed"], abs=1e-6)
    assert feeds[-1] == pytest.approx(case["last_feed"], abs=1e-6)
    assert feeds.sum() == pytest.approx(case["total_feed"], abs=1e-6)
    # Total feed = N L + rho V.
    used = case["wear_ratio"] / electrode * float(layers.volume)
    assert feeds.sum() == pytest.approx(125 * 2.0 + used, rel=1e-12)


def test_pyramid_layers_follow_eq_5():
    layers = slice_solid(pyramid(100.0, math.pi / 4), 10.0)
    n = np.arange(1, 11)
    np.testing.assert_allclose(layers.area, 4.0 * (100.0 - (n - 1) * 10.0) ** 2, rtol=1e-12)
    np.testing.assert_allclose(layers.bottom, 10.0 * n, rtol=1e-12)


def test_hemisphere_layers_follow_eq_6():
    layers = slice_solid(Hemisphere(60.0), 7.0)
    half_width, bottom = np.asarray(layers.half_width), np.asarray(layers.bottom)
    np.testing.assert_allclose(half_width**2 + bottom**2, 60.0**2, rtol=1e-12)
    np.testing.assert_allclose(layers.area, np.pi * half_width**2, rtol=1e-12)
    assert bottom[-1] == 60.0 and half_width[-1] == 0.0
    # Below the pole there is nothing, and the pole's derivative is finite.
    solid = Hemisphere(60.0)
    assert float(solid.half_width(61.0)) == 0.0
    assert np.isfinite(float(jax.grad(solid.half_width)(60.0)))


@pytest.mark.parametrize(
    ("solid", "volume"),
    [
        (pyramid(90.0, math.atan(2.0)), 4 * 90.0**2 * 180.0 / 3),
        (cone(90.0, math.atan(0.5)), math.pi * 90.0**2 * 45.0 / 3),
        (Hemisphere(90.0), 2 * math.pi * 90.0**3 / 3),
    ],
    ids=["pyramid", "cone", "hemisphere"],
)
def test_levels_and_volume(solid, volume):
    depth = solid.full_depth
    volumes = {
        (level, count): float(slice_solid(solid, depth / count, level=level).volume)
        for level in ("top", "middle", "bottom")
        for count in (50, 100)
    }
    error = {key: value - volume for key, value in volumes.items()}
    assert error["top", 100] > 0 > error["bottom", 100]
    # One-sided levels are of first order, the middle of second.
    assert error["top", 50] / error["top", 100] == pytest.approx(2.0, rel=0.05)
    assert error["bottom", 50] / error["bottom", 100] == pytest.approx(2.0, rel=0.05)
    assert error["middle", 50] / error["middle", 100] == pytest.approx(4.0, rel=0.05)
    assert abs(error["middle", 100]) < 1e-4 * volume
    paper = float(slice_solid(solid, depth / 100).volume)
    assert paper == volumes["bottom" if isinstance(solid, Hemisphere) else "top", 100]


@given(depth=st.floats(20.0, 90.0), remainder=st.floats(0.101, 1.1))
def test_layers_fill_the_depth(depth, remainder):
    layer = depth / (7.0 + remainder)
    # More than a tenth of a layer is a layer, less makes the last one deeper.
    layers = slice_solid(TaperedSolid(100.0, 1.2, SquareSection()), layer, depth)
    thickness, bottom = np.asarray(layers.thickness), np.asarray(layers.bottom)
    assert bottom[-1] == depth
    assert np.all(thickness > 0)
    np.testing.assert_allclose(thickness[:-1], layer, rtol=1e-9)
    assert thickness[-1] == pytest.approx(remainder * layer, rel=1e-9)
    np.testing.assert_allclose(np.cumsum(thickness), bottom, rtol=1e-12)
    assert len(bottom) == 8


def test_a_layer_that_divides_but_for_rounding_leaves_no_remainder():
    # 0.3 / 0.1 is 2.9999999999999996 and 0.7 / 0.1 is 6.999999999999999.
    for depth in (0.3, 0.7, 2.3):
        layers = slice_solid(cone(10.0, 1.0), 0.1, depth)
        assert layers.bottom.shape == (round(depth / 0.1),)


def test_a_thin_remainder_deepens_the_last_layer():
    layers = slice_solid(TaperedSolid(100.0, 1.2, SquareSection()), 10.0, 30.9)
    np.testing.assert_allclose(layers.thickness, [10.0, 10.0, 10.9])
    layers = slice_solid(TaperedSolid(100.0, 1.2, SquareSection()), 10.0, 31.1)
    np.testing.assert_allclose(layers.thickness, [10.0, 10.0, 10.0, 1.1])


def test_tabulated_solid():
    solid = TabulatedSolid([0.0, 10.0, 30.0], [900.0, 400.0, 100.0])
    assert solid.full_depth == 30.0
    np.testing.assert_allclose(
        solid.area(np.array([0, 5, 10, 20, 30.0])), [900, 650, 400, 250, 100]
    )
    np.testing.assert_allclose(solid.half_width(np.array([0.0, 10.0])), [15.0, 10.0])
    layers = slice_solid(solid, 5.0)
    np.testing.assert_allclose(layers.area, [900, 650, 400, 325, 250, 175])
    middle = slice_solid(solid, 5.0, level="middle")
    # The midpoint rule is exact for straight pieces.
    assert float(middle.volume) == pytest.approx(650.0 * 10 + 250.0 * 20)


def test_vertical_walls_and_other_sections():
    box = TaperedSolid(50.0, math.pi / 2, SquareSection())
    layers = slice_solid(box, 4.0, depth=10.0)
    np.testing.assert_allclose(layers.thickness, [4.0, 4.0, 2.0])
    np.testing.assert_allclose(layers.half_width, 50.0)
    assert float(layers.volume) == pytest.approx(100.0**2 * 10.0)
    polygon = PolygonSection([(0, 0), (100, 0), (100, 100), (0, 100)], 5.0)
    tapered = slice_solid(TaperedSolid(polygon.half_width, math.pi / 4, polygon), 10.0, 30.0)
    expected = [4 * x**2 - (4 - math.pi) * 25.0 for x in (50.0, 40.0, 30.0)]
    np.testing.assert_allclose(tapered.area, expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: pyramid(0.0, 1.0), "half width 0 um must be above 0"),
        (lambda: cone(math.inf, 1.0), "half width inf um"),
        (lambda: pyramid(10.0, 0.0), "wall angle 0 deg"),
        (lambda: pyramid(10.0, math.radians(91.0)), "wall angle 91 deg must be .* at most 90"),
        (lambda: pyramid(10.0, 45.0), "wall angle 2578"),
        (lambda: Hemisphere(-1.0), "radius -1 um must be above 0"),
        (lambda: TabulatedSolid([0.0], [1.0]), "2 or more"),
        (lambda: TabulatedSolid([0.0, 1.0], [1.0, 2.0, 3.0]), "same length"),
        (lambda: TabulatedSolid([0.0, 2.0, 1.0], [1.0, 1.0, 1.0]), "increase from entry"),
        (lambda: TabulatedSolid([-1.0, 2.0], [1.0, 1.0]), "must be >= 0"),
        (lambda: TabulatedSolid([0.0, 1.0, 2.0], [3.0, -1.0, 0.0]), "entry 2 is below 0"),
        (lambda: slice_solid(TaperedSolid(5, math.pi / 2, SquareSection()), 1.0), "depth is miss"),
        (lambda: slice_solid(cone(10.0, 1.0), 1.0, depth=16.0), "at most 15.5741 um, the solid's"),
        (lambda: slice_solid(cone(10.0, 1.0), 1.0, depth=0.0), "depth 0 um must be above 0"),
        (lambda: slice_solid(cone(10.0, 1.0), 0.0), "layer depth 0 um gives no layer"),
        (lambda: slice_solid(cone(10.0, 1.0), 6.0, depth=5.0), "at most the depth 5 um"),
        (lambda: slice_solid(cone(10.0, 1.0), math.nan), "layer depth nan um"),
    ],
)
def test_refusals(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


def test_an_unknown_level_is_refused():
    with pytest.raises((InputError, KeyError)):
        slice_solid(cone(10.0, 1.0), 1.0, level="centre")
