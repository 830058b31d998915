"""Target depth of cells, against volumes and closed forms."""

import math

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io.solid_map import DepthMap
from procmodel.io.solids import SolidMesh
from procmodel.wear import Hemisphere, SquareSection, TabulatedSolid, TaperedSolid, cone, pyramid
from procmodel.wear.slicing import slices_of_slot, slices_of_solid
from procmodel.wear.target_map import target_map
from procmodel.wear.zmap_maps import WorkpieceMap

CELL = 2.0


@pytest.fixture(scope="module")
def grid():
    """60 x 60 cells about the origin."""
    return WorkpieceMap(np.zeros((60, 60)), CELL, (-60.0, -60.0))


def volume(map_):
    return float(np.sum(map_)) * CELL**2


@pytest.mark.parametrize(
    ("solid", "expected"),
    [
        (Hemisphere(50.0), 2.0 / 3.0 * math.pi * 50.0**3),
        (cone(50.0, math.pi / 4), math.pi / 3.0 * 50.0**3),
        (pyramid(50.0, math.pi / 4), 4.0 / 3.0 * 50.0**3),
    ],
)
def test_volume_is_the_solids(grid, solid, expected):
    assert volume(target_map(solid, grid)) == pytest.approx(expected, rel=1e-3)


def test_depth_at_a_cell_in_the_middle_of_a_slope(grid):
    # A plane is its own mean over a cell: at (21, 1) the cone is 29 deep, but for its curvature.
    depth = target_map(pyramid(50.0, math.pi / 4), grid)
    assert depth[40, 30] == pytest.approx(50.0 - 21.0, abs=1e-12)
    assert depth[0, 0] == 0.0


def test_frustum_ends_at_its_depth(grid):
    depth = target_map(cone(50.0, math.pi / 4), grid, 20.0)
    assert np.max(depth) == 20.0
    expected = math.pi / 3.0 * (50.0**3 - 30.0**3)
    assert volume(depth) == pytest.approx(expected, rel=1e-3)


def test_vertical_wall_covers_part_of_a_cell(grid):
    solid = pyramid(49.5, math.pi / 2)
    depth = target_map(solid, grid, 10.0, samples=4)
    # The wall at 49.5 leaves three quarters of the cell from 48 to 50.
    assert depth[54, 30] == pytest.approx(7.5)
    assert volume(depth) == pytest.approx(99.0**2 * 10.0, rel=1e-12)


def test_slot_and_staircase_have_the_volume_of_their_slices(grid):
    slot = slices_of_slot(80.0, 20.0, np.array([3.0, 6.0, 9.0]))
    depth = target_map(slot, grid)
    assert volume(depth) == pytest.approx(slot.volume, rel=1e-12)
    assert set(np.unique(depth)) == {0.0, 9.0}
    stairs = slices_of_solid(Hemisphere(50.0), np.arange(5.0, 46.0, 5.0))
    assert volume(target_map(stairs, grid)) == pytest.approx(stairs.volume, rel=2e-3)


def test_stairs_of_thin_layers_near_the_solid(grid):
    fine = slices_of_solid(Hemisphere(50.0), np.arange(0.5, 50.0, 0.5), "middle")
    difference = target_map(fine, grid) - target_map(Hemisphere(50.0), grid)
    inside = np.hypot(grid.x[:, None], grid.y[None, :]) < 45.0
    assert np.max(np.abs(difference[inside])) < 0.5


def test_mesh_has_the_depth_of_its_solid(grid):
    # A pyramid frustum, apex cut off: corners at the surface and at the bottom.
    top, low = 50.0, 20.0
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    heights = np.repeat([0.0, 30.0], 4)
    vertices = np.column_stack([np.vstack([top * square, low * square]), heights])
    faces = [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, i + 4, j), (j, i + 4, j + 4)]
    mesh = SolidMesh(vertices, np.array(faces))
    known = target_map(pyramid(50.0, math.pi / 4), grid, 30.0)
    np.testing.assert_allclose(target_map(mesh, grid), known, atol=1e-9)


def test_depth_map_is_linear_between_places_and_nothing_beyond(grid):
    places = np.linspace(-40.0, 40.0, 9)
    plane = 20.0 + 0.1 * places[:, None] + 0.2 * places[None, :]
    depth = target_map(DepthMap(places, places, plane), grid)
    assert depth[35, 25] == pytest.approx(20.0 + 0.1 * 11.0 - 0.2 * 9.0, abs=1e-12)
    assert depth[0, 30] == 0.0


@pytest.mark.parametrize(
    ("target", "more", "words"),
    [
        (TabulatedSolid([0.0, 10.0], [100.0, 50.0]), {}, "TabulatedSolid has no depth"),
        (pyramid(40.0, math.pi / 2), {}, "vertical walls"),
        (Hemisphere(40.0), {"depth": 0.0}, "depth 0 um"),
        (Hemisphere(40.0), {"samples": 0}, "samples 0"),
        (TaperedSolid(40.0, math.pi / 4, SquareSection(10.0)), {}, "give its slices"),
    ],
)
def test_bad_targets_are_named(grid, target, more, words):
    with pytest.raises(InputError, match=words):
        target_map(target, grid, **more)
