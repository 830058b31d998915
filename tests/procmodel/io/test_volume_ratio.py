"""Wear ratio from outlines: known areas, exact gradients, honest uncertainty."""

import numpy as np
import pytest
import shapely

from procmodel.errors import InputError
from procmodel.io import read_outline
from procmodel.wear.volume_ratio import area_below, volume_ratio
from tests.measured import OUTLINES, needs

WEDGE = np.array([(0, 10000), (0, 8465), (4887.5, 0), (9775, 8465), (9775, 10000)])

# An electrode 100 wide that lost 10 of its length, and a pocket 110 wide and 50 deep.
TOOL = np.array([(0.0, 80.0), (0.0, 10.0), (60.0, 10.0), (100.0, 10.0), (100.0, 80.0)])
WORK = np.array([(0.0, 20.0), (0.0, -50.0), (110.0, -50.0), (110.0, -2.0)])
# The same with a rounded tip and a bowl, no two coordinates alike.
WORN = np.array(
    [(0, 80), (3, 40), (9, 21), (30, 12), (62, 11), (88, 17), (97, 35), (100, 78.5)], dtype=float
)
BOWL = np.array(
    [(-9, 7), (-5, -9), (4, -38), (31, -49), (70, -51), (96, -36), (104, -4)], dtype=float
)


def test_known_answer():
    result = volume_ratio(TOOL, WORK, digitising_error=0.0)
    assert result.eroded_area == pytest.approx(1000.0, rel=1e-14)
    assert result.removed_area == pytest.approx(5500.0, rel=1e-14)
    assert result.ratio == pytest.approx(2 / 11, rel=1e-14)
    assert result.std == 0.0


def test_direction_of_the_outlines_does_not_matter():
    forward = volume_ratio(WORN, BOWL, digitising_error=1.0)
    backward = volume_ratio(WORN[::-1], BOWL[::-1], digitising_error=1.0)
    assert backward.ratio == pytest.approx(forward.ratio, rel=1e-14)
    assert backward.std == pytest.approx(forward.std, rel=1e-14)


def test_rectangle_given_or_found_is_the_same():
    rectangle = [(0, 0), (100, 0), (100, 80), (0, 80)]
    found = volume_ratio(WORN, BOWL, digitising_error=1.0)
    given = volume_ratio(WORN, BOWL, rectangle, digitising_error=1.0)
    assert given.eroded_area == pytest.approx(found.eroded_area, rel=1e-14)


@pytest.mark.parametrize("level", [0.0, -20.0, 30.0])
def test_area_agrees_with_clipped_polygons(level):
    below = shapely.box(-1e3, -1e3, 1e3, level)
    ends = [(BOWL[-1, 0], 1e3), (BOWL[0, 0], 1e3)]
    polygon = shapely.Polygon([*BOWL, *ends])
    assert area_below(BOWL, level)[0] == pytest.approx(polygon.intersection(below).area, rel=1e-12)


def finite_differences(function, points, step=1e-5):
    gradient = np.empty_like(points)
    for index in np.ndindex(points.shape):
        change = np.zeros_like(points)
        change[index] = step
        gradient[index] = (function(points + change) - function(points - change)) / (2 * step)
    return gradient


@pytest.mark.parametrize("level", [0.0, -20.0, 30.0])
def test_gradient_of_the_area(level):
    _, gradient = area_below(BOWL, level)
    expected = finite_differences(lambda points: area_below(points, level)[0], BOWL)
    np.testing.assert_allclose(gradient, expected, atol=1e-6)


@pytest.mark.parametrize("unworn", [None, [(0, 0), (100, 0), (100, 80), (0, 80)]])
def test_std_is_the_length_of_the_gradient(unworn):
    def ratio(tool, work):
        # The error is large so that the trial steps are not taken for growth.
        return volume_ratio(tool, work, unworn, digitising_error=1.0).ratio

    gradients = [
        finite_differences(lambda points: ratio(points, BOWL), WORN),
        finite_differences(lambda points: ratio(WORN, points), BOWL),
    ]
    expected = np.sqrt(sum(np.sum(gradient**2) for gradient in gradients))
    result = volume_ratio(WORN, BOWL, unworn, digitising_error=1.0)
    assert result.std == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("unworn", [None, [(0, -5), (103, -5), (103, 79), (-3, 79)]])
def test_std_agrees_with_monte_carlo(unworn):
    error = 0.3
    random = np.random.default_rng(20240917)
    draws = [
        volume_ratio(
            WORN + random.normal(0, error, WORN.shape),
            BOWL + random.normal(0, error, BOWL.shape),
            unworn,
            # Wider than what is drawn, so that no draw is refused for growth.
            digitising_error=10 * error,
        )
        for _ in range(2500)
    ]
    result = volume_ratio(WORN, BOWL, unworn, digitising_error=error)
    for name in ("ratio", "eroded_area", "removed_area"):
        spread = np.std([getattr(draw, name) for draw in draws], ddof=1)
        std = result.std if name == "ratio" else getattr(result, f"{name}_std")
        assert std == pytest.approx(spread, rel=0.05)


@pytest.mark.parametrize(
    ("tool", "work", "unworn", "sentence"),
    [
        (
            TOOL[[0, 1, 3, 2, 4]],
            WORK,
            None,
            "tool outline: the edge after point 2 (0, 10) crosses the edge after point 4 (60, 10)",
        ),
        (
            [(0, 80), (80, 10), (20, 10), (100, 80)],
            WORK,
            None,
            "tool outline: the edge after point 1 (0, 80) crosses the edge after point 3 (20, 10)",
        ),
        (TOOL, WORK[[0, 2, 1, 3]], None, "work outline: the edge after point 1"),
        (TOOL, WORK, [(0, 0), (100, 80), (100, 0), (0, 80)], "unworn outline: the edge after"),
        (
            TOOL,
            -WORK * [-1, 1],
            None,
            "it reaches 50 um above the workpiece top at y = 0 but 20 um",
        ),
        (TOOL, [(0, 0), (0, -50), (0, -20), (0, 0)], None, "the removed area is 0 um^2: give the"),
        (TOOL, [(0, 0), (0, -5), (0, -9)], None, "work outline: point 3 (0, -9) ends it 9 um"),
        (TOOL, [(0, 0), (1, 0), (2, 0)], None, "work outline: it reaches 0 um above"),
        (TOOL, WORK[1:3], None, "work outline: it has 2 points: give"),
        (TOOL, WORK[[1, 1, 1]], None, "work outline: all its points are one"),
        (TOOL - [0, 10], WORK, None, "the eroded area is 0 um^2, so nothing was worn: check"),
        (TOOL - [0, 14], WORK, None, "point 2 (0, -4) lies 4 um outside the unworn electrode"),
        (TOOL * [1, -1], WORK, None, "no part lies above the unworn tip at y = 0"),
        (
            TOOL,
            WORK,
            [(10, 0), (100, 0), (100, 80), (10, 80)],
            "lies 10 um outside the unworn electrode, more than 3 digitising errors (3 um), "
            "but an electrode cannot grow: check",
        ),
        (TOOL[1:], WORK, None, "tool outline: point 1 (0, 10) ends it 70 um short of its top"),
        (
            TOOL,
            WORK,
            [(0, 0), (100, 0), (100, 200), (0, 200)],
            "point 1 (0, 80) ends it 120 um short of the top of the unworn electrode at y = 200",
        ),
        (TOOL, WORK[:3], None, "work outline: point 3 (110, -50) ends it 50 um short of the work"),
    ],
)
def test_faulty_outlines(tool, work, unworn, sentence):
    with pytest.raises(InputError) as raised:
        volume_ratio(tool, work, unworn, digitising_error=1.0)
    assert sentence in str(raised.value)


def test_faulty_digitising_error():
    with pytest.raises(InputError, match="digitising_error is -1 um: give zero or a positive"):
        volume_ratio(TOOL, WORK, digitising_error=-1.0)


def test_arrays_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="shape"):
        volume_ratio(TOOL.T, WORK, digitising_error=1.0)


def test_growth_within_the_digitising_error_is_accepted():
    shifted = TOOL.copy()
    shifted[2, 1] = -1.5
    assert volume_ratio(shifted, WORK, digitising_error=1.0).ratio > 0


def test_points_digitised_twice_and_closed_outlines_are_accepted():
    doubled = np.repeat(TOOL, 2, axis=0)
    closed = np.vstack([TOOL, TOOL[:1]])
    for tool in (doubled, closed):
        result = volume_ratio(tool, WORK, digitising_error=1.0)
        assert result.eroded_area == pytest.approx(1000.0, rel=1e-14)


measured = needs(OUTLINES)


@measured
def test_measured_flat_pair():
    tool, work = (
        read_outline(OUTLINES / f"flat1_{part}_um.csv").points for part in ("tool", "work")
    )
    result = volume_ratio(tool, work, digitising_error=10.0)
    assert result.eroded_area == 6609498.5
    assert result.removed_area == 39255613.0
    assert result.ratio == pytest.approx(0.16837, abs=5e-6)
    assert 0.001 < result.std < 0.003


@measured
def test_measured_wedge_pair():
    tool, work = (
        read_outline(OUTLINES / f"tip1_{part}_um.csv").points for part in ("tool", "work")
    )
    result = volume_ratio(tool, work, WEDGE, digitising_error=10.0)
    eroded = shapely.Polygon(WEDGE).difference(shapely.Polygon(tool)).area
    removed = shapely.Polygon([*work, (work[-1, 0], 0), (work[0, 0], 0)]).area
    assert result.eroded_area == pytest.approx(eroded, rel=1e-12)
    assert result.removed_area == pytest.approx(removed, rel=1e-12)
    assert result.ratio == pytest.approx(0.140, abs=1e-3)
