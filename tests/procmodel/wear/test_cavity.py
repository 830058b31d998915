"""Layered and staged cavities: wall curve and electrode lengths."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.wear import (
    AnnulusSection,
    CircleSection,
    LayeredCavity,
    SquareSection,
    StagedCavity,
    constant_step_half_widths,
    wall_depth,
)

AREA = math.pi * 50.0**2
WALLS = np.array([30.0, 20.0, 20.0, 8.0])
DEPTHS = np.array([2.0, 5.0, 9.0, 10.0])


def test_gap_widens_areas_and_moves_the_wall():
    cavity = LayeredCavity(np.array([30.0, 20.0]), 4.0, SquareSection(), 0.2, 1e3, gap=3.0)
    np.testing.assert_allclose(cavity.layer_areas, [4 * 33.0**2, 4 * 23.0**2])
    np.testing.assert_allclose(cavity.wall_positions, [33.0, 23.0])
    by_hand = np.cumsum([4.0 / (1 + 0.2 * 4356 / 1e3), 4.0 / (1 + 0.2 * 2116 / 1e3)])
    np.testing.assert_allclose(cavity.depths, by_hand, rtol=1e-14)


@pytest.mark.parametrize(
    ("position", "depth"),
    [
        (0.0, 10.0),  # the floor
        (8.0, 10.0),  # corners of the layers
        (14.0, 9.5),
        (20.0, 9.0),  # where a vertical step is, its bottom or its top
        (25.0, 3.5),
        (30.0, 2.0),
        (30.001, 0.0),  # the untouched surface
        (1e6, 0.0),
    ],
)
@pytest.mark.parametrize("side", [1, -1])
def test_wall_by_hand(position, depth, side):
    found = float(wall_depth(side * position, WALLS, DEPTHS))
    allowed = [5.0, 9.0] if position == 20.0 else [depth]
    assert min(abs(found - d) for d in allowed) < 1e-9


def test_edge_width_makes_the_edge_a_ramp():
    found = wall_depth(np.array([29.0, 30.0, 31.0, 32.0, 34.0, 35.0]), WALLS, DEPTHS, 4.0)
    np.testing.assert_allclose(found, [2.3, 2.0, 1.5, 1.0, 0.0, 0.0], atol=1e-12)


@given(
    steps=st.lists(st.floats(0.1, 20.0), min_size=9, max_size=9),
    thickness=st.floats(0.1, 5.0),
    position=st.floats(-200.0, 200.0),
)
def test_wall_against_a_plain_search(steps, thickness, position):
    walls = np.cumsum(steps)[::-1]
    depths = thickness * np.arange(1, len(walls) + 1)
    distance = abs(position)
    if distance > walls[0]:
        expected = 0.0
    elif distance <= walls[-1]:
        expected = depths[-1]
    else:
        n = max(i for i, wall in enumerate(walls) if wall >= distance)
        share = (walls[n] - distance) / (walls[n] - walls[n + 1])
        expected = depths[n] + share * (depths[n + 1] - depths[n])
    assert float(wall_depth(position, walls, depths)) == pytest.approx(expected, abs=1e-9)


@pytest.fixture(scope="module")
def staged():
    half_widths = constant_step_half_widths(200.0, 5.0, 20)
    inner = half_widths - 8.0
    roughing = LayeredCavity(inner, 4.0, CircleSection(), 0.17, AREA, gap=4.0)
    ring = AnnulusSection(CircleSection(), thickness=8.0)
    finishing = LayeredCavity(half_widths, 1.5, ring, 0.26, 0.5 * AREA, gap=1.5)
    return StagedCavity(roughing, finishing)


def test_staged_electrode_lengths_follow_each_stages_wear_ratio(staged):
    for stage, length in zip(
        (staged.roughing, staged.finishing), staged.electrode_lengths, strict=True
    ):
        thickness = np.diff(np.asarray(stage.depths), prepend=0.0)
        removed = np.sum(np.asarray(stage.layer_areas) * thickness)
        expected = stage.wear_ratio * removed / stage.electrode_area
        assert float(length) == pytest.approx(expected, rel=1e-12)
    ring = np.pi * ((np.asarray(staged.finishing.half_widths) + 1.5) ** 2)
    ring -= np.pi * ((np.asarray(staged.finishing.half_widths) - 8.0 + 1.5) ** 2)
    np.testing.assert_allclose(staged.finishing.layer_areas, ring, rtol=1e-12)


def test_staged_wall_is_the_finished_one_outside_and_the_roughed_floor_inside(staged):
    # Beyond the roughed opening only finishing has cut.
    outside = np.linspace(196.5, 201.0, 7)
    np.testing.assert_array_equal(staged.wall_depth(outside), staged.finishing.wall_depth(outside))
    everywhere = np.linspace(-220.0, 220.0, 401)
    both = [np.asarray(s.wall_depth(everywhere)) for s in (staged.roughing, staged.finishing)]
    np.testing.assert_array_equal(staged.wall_depth(everywhere), np.maximum(*both))
    # Both stages matter somewhere, or the test could not tell them apart.
    assert np.any(both[0] > both[1] + 0.1) and np.any(both[1] > both[0] + 0.1)


def test_finishing_deeper_than_roughing_cuts_its_ring_and_not_the_floor(staged):
    finishing = staged.finishing
    deeper = LayeredCavity(finishing.half_widths, 6.0, finishing.section, 0.26, 0.5 * AREA, 1.5)
    both = StagedCavity(staged.roughing, deeper)
    # The last layer's ring reaches from 98.5 to 106.5 um; nothing is finished inside it.
    assert float(deeper.depths[-1]) > float(staged.roughing.depths[-1]) + 1.0
    inside = np.array([0.0, 50.0, 97.9])
    np.testing.assert_allclose(both.wall_depth(inside), staged.roughing.depths[-1], rtol=1e-12)
    ring = np.array([99.1, 106.0])
    np.testing.assert_allclose(both.wall_depth(ring), deeper.depths[-1], rtol=1e-12)


def test_more_finishing_wear_costs_only_finishing_electrode(staged):
    worse = StagedCavity(
        staged.roughing,
        LayeredCavity(
            staged.finishing.half_widths, 1.5, staged.finishing.section, 0.5, 0.5 * AREA, 1.5
        ),
    )
    rough, fine = np.asarray(worse.electrode_lengths) - np.asarray(staged.electrode_lengths)
    assert rough == 0.0 and fine > 1.0
