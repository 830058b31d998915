"""The layer law: known answers, its inverse, conservation, and its limit."""

import functools
import math

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.wear import (
    CircleSection,
    LayeredCavity,
    SquareSection,
    cavity_depths,
    constant_step_half_widths,
    continuous_wall_depth,
    electrode_wear,
    layer_depth,
    layer_feed,
    relative_wear,
    wear_ratio_of_layer,
)

feeds = st.floats(0.01, 500.0)
areas = st.floats(1.0, 1e7)
ratios = st.floats(1e-6, 50.0)


@pytest.fixture(scope="module")
def ten_layers(wear_reference):
    case = wear_reference["ten_layers"]
    half_widths = constant_step_half_widths(case["half_width"], case["step"], 10)
    return case, SquareSection().area(half_widths)


def test_ten_layer_example(ten_layers):
    case, layer_areas = ten_layers
    depths = layer_depth(case["feed"], layer_areas, case["wear_ratio"], case["electrode_area"])
    np.testing.assert_allclose(depths, case["depths"], rtol=0, atol=1e-6)
    totals = cavity_depths(case["feed"], layer_areas, case["wear_ratio"], case["electrode_area"])
    np.testing.assert_allclose(totals, np.cumsum(case["depths"]), rtol=0, atol=1e-5)
    assert float(totals[-1]) == pytest.approx(case["total_depth"], abs=1e-6)


def test_ten_layer_example_compensated(ten_layers):
    case, layer_areas = ten_layers
    wear = case["wear_ratio"], case["electrode_area"]
    feed = np.asarray(layer_feed(case["wanted_depth"], layer_areas, *wear))
    np.testing.assert_allclose(feed, case["compensated_feeds"], rtol=0, atol=1e-6)
    assert feed.sum() == pytest.approx(case["compensated_total"], abs=1e-6)
    np.testing.assert_allclose(layer_depth(feed, layer_areas, *wear), 10.0, rtol=1e-14)


@given(feed=feeds, area=areas, ratio=ratios, electrode=areas)
def test_feed_and_depth_are_inverse(feed, area, ratio, electrode):
    depth = layer_depth(feed, area, ratio, electrode)
    assert float(layer_feed(depth, area, ratio, electrode)) == pytest.approx(feed, rel=1e-13)
    wanted = layer_feed(feed, area, ratio, electrode)
    assert float(layer_depth(wanted, area, ratio, electrode)) == pytest.approx(feed, rel=1e-13)


@given(feed=feeds, area=areas, ratio=ratios, electrode=areas)
def test_feed_is_shared_between_workpiece_and_electrode(feed, area, ratio, electrode):
    depth = float(layer_depth(feed, area, ratio, electrode))
    worn = float(electrode_wear(feed, area, ratio, electrode))
    assert depth + worn == pytest.approx(feed, rel=1e-14)
    # Eq. (2): electrode volume lost over workpiece volume removed.
    assert electrode * worn / (area * depth) == pytest.approx(ratio, rel=1e-12)
    assert worn / depth == pytest.approx(float(relative_wear(area, ratio, electrode)), rel=1e-12)


@given(feed=feeds, area=areas, ratio=st.floats(1e-3, 50.0), electrode=st.floats(1e3, 1e6))
def test_one_layer_gives_the_wear_ratio_back(feed, area, ratio, electrode):
    depth = layer_depth(feed, area, ratio, electrode)
    found = float(wear_ratio_of_layer(feed, depth, area, electrode))
    # The length worn is a difference, so digits are lost where it is a small part of the feed.
    lost = 1.0 + 1.0 / float(relative_wear(area, ratio, electrode))
    assert found == pytest.approx(ratio, rel=1e-14 * lost)


def test_no_wear_is_no_loss():
    assert float(layer_depth(7.0, 1e5, 0.0, 1e4)) == 7.0
    assert float(electrode_wear(7.0, 1e5, 0.0, 1e4)) == 0.0


@given(
    widths=st.lists(st.floats(5.0, 500.0), min_size=12, max_size=12),
    ratio=ratios,
    electrode=st.floats(100.0, 1e5),
    gap=st.floats(0.0, 20.0),
)
def test_electrode_length_is_wear_ratio_times_volume(widths, ratio, electrode, gap):
    half_widths = np.sort(widths)[::-1]
    cavity = LayeredCavity(half_widths, 3.0, SquareSection(), ratio, electrode, gap)
    areas = 4.0 * (half_widths + gap) ** 2
    volume = np.sum(areas * np.diff(np.asarray(cavity.depths), prepend=0.0))
    assert float(cavity.electrode_length) == pytest.approx(ratio * volume / electrode, rel=1e-9)
    spent = float(cavity.electrode_length) + float(cavity.depths[-1])
    assert spent == pytest.approx(3.0 * len(widths), rel=1e-13)


@functools.partial(jax.jit, static_argnums=0)
def total_depth(layers, section, half_width, ratio, electrode, slope=1.0):
    step = half_width / layers
    half_widths = constant_step_half_widths(half_width, step, layers)
    return LayeredCavity(half_widths, slope * step, section, ratio, electrode).depths


@pytest.fixture(scope="module")
def arctangent(wear_reference):
    case = wear_reference["arctangent"]
    area = math.pi * case["electrode_diameter"] ** 2 / 4.0
    return case, (case["half_width"], case["wear_ratio"], area)


def test_known_sums_of_layers(arctangent):
    case, cavity = arctangent
    sums = [float(total_depth(n, SquareSection(), *cavity)[-1]) for n in case["layers"]]
    np.testing.assert_allclose(sums, case["total_depth"], rtol=0, atol=1e-6)
    half_width, ratio, area = cavity
    limit = continuous_wall_depth(0.0, half_width, ratio / area)
    assert float(limit) == pytest.approx(case["limit"], abs=1e-6)


@pytest.mark.parametrize(
    ("section", "area_factor"),
    [(SquareSection(), 4.0), (CircleSection(), math.pi)],
    ids=["square", "circle"],
)
def test_sum_tends_to_the_arctangent_at_first_order(arctangent, section, area_factor):
    _, cavity = arctangent
    half_width, ratio, area = cavity
    limit = float(continuous_wall_depth(0.0, half_width, ratio / area, area_factor))
    counts = np.array([100, 200, 400, 800, 1600])
    errors = np.array([float(total_depth(n, section, *cavity)[-1]) - limit for n in counts])
    orders = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.01)
    assert np.all(np.diff(np.abs(orders - 1.0)) < 0)
    # The left rule's leading error: -(dX/2) (1 - 1 / (1 + k^2 X0^2)).
    k2 = area_factor * ratio / area
    leading = -0.5 * (half_width / counts) * (1.0 - 1.0 / (1.0 + k2 * half_width**2))
    assert errors[-1] == pytest.approx(leading[-1], rel=1e-3)


def test_whole_wall_tends_to_the_arctangent(arctangent):
    _, cavity = arctangent
    half_width, ratio, area = cavity
    layers, slope = 2000, 0.4
    depths = np.asarray(total_depth(layers, CircleSection(), *cavity, slope=slope))
    walls = half_width * (1.0 - np.arange(1, layers + 1) / layers)
    limit = continuous_wall_depth(walls, half_width, ratio / area, math.pi, slope)
    np.testing.assert_allclose(depths, limit, rtol=0, atol=slope * half_width / layers)
    # A wall of the other section is another curve.
    other = continuous_wall_depth(walls, half_width, ratio / area, 4.0, slope)
    assert np.max(np.abs(depths - np.asarray(other))) > 1.0


def test_little_wear_leaves_the_programmed_slope():
    depth = continuous_wall_depth(np.array([0.0, 40.0, 100.0]), 100.0, 1e-14, slope=2.0)
    np.testing.assert_allclose(depth, [200.0, 120.0, 0.0], atol=1e-6)


def test_without_wear_the_wall_is_straight_and_its_derivative_the_limit():
    def wall(rho):
        return continuous_wall_depth(30.0, 100.0, rho)

    assert float(wall(0.0)) == 70.0
    # d z / d rho at 0 is -(area factor) (X0^3 - X^3) / 3.
    assert float(jax.grad(wall)(0.0)) == pytest.approx(-4.0 * (100.0**3 - 30.0**3) / 3.0)
    assert float(jax.grad(wall)(1e-9)) == pytest.approx(float(jax.grad(wall)(0.0)), rel=1e-3)


def test_constant_step_half_widths():
    np.testing.assert_allclose(constant_step_half_widths(10.0, 2.5, 4), [10.0, 7.5, 5.0, 2.5])
