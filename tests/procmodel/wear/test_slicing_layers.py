"""Depths of layers, uniform and by the height of the stairs."""

import math

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.wear import Hemisphere, cone
from procmodel.wear.layer_bottoms import uniform_bottoms
from procmodel.wear.slicing_layers import (
    layer_bottoms_by_tolerance,
    mesh_slopes,
    solid_slopes,
)

from .solid_meshes import box, hemisphere, lathe


def test_stairs_on_a_straight_wall_are_t_cos_a():
    angle = math.radians(60.0)
    bottoms = layer_bottoms_by_tolerance(solid_slopes(cone(200.0, angle), 100.0), 1.0, 50.0)
    thickness = np.diff(bottoms, prepend=0.0)
    assert np.max(thickness) == pytest.approx(1.0 / math.cos(angle), rel=1e-3)
    assert bottoms[-1] == 100.0


def test_stairs_of_a_hemisphere_keep_the_tolerance_and_use_it():
    # Distance of a stair's inner corner from the sphere, independent of the slopes.
    bottoms = layer_bottoms_by_tolerance(solid_slopes(Hemisphere(100.0), 95.0), 1.0, 20.0)
    tops = np.append(0.0, bottoms[:-1])
    corner = np.hypot(np.sqrt(100.0**2 - bottoms**2), tops)
    assert np.all(100.0 - corner <= 1.0 + 1e-9)
    assert np.mean(100.0 - corner) > 0.7
    uniform = np.min(np.diff(bottoms, prepend=0.0))
    assert len(bottoms) < 0.75 * 95.0 / uniform


def test_mesh_and_parametric_solid_give_the_same_layers():
    of_solid = layer_bottoms_by_tolerance(solid_slopes(Hemisphere(100.0), 95.0), 1.0, 20.0)
    mesh = hemisphere(100.0, corners=256, rings=256)
    of_mesh = layer_bottoms_by_tolerance(mesh_slopes(mesh, 95.0), 1.0, 20.0)
    assert abs(len(of_mesh) - len(of_solid)) <= 2


def test_vertical_walls_take_the_greatest_depth_and_floors_end_a_layer():
    deep = box((0, 0, 0), (100, 100, 50))
    np.testing.assert_allclose(
        layer_bottoms_by_tolerance(mesh_slopes(deep), 0.1, 10.0), [10, 20, 30, 40, 50]
    )
    stepped = lathe([100, 100, 60, 60], [0, 23, 23, 50])
    slopes = mesh_slopes(stepped)
    np.testing.assert_allclose(slopes.floors, [23.0])
    bottoms = layer_bottoms_by_tolerance(slopes, 0.1, 10.0)
    assert np.min(np.abs(bottoms - 23.0)) < 1e-12
    assert np.max(np.diff(bottoms, prepend=0.0)) <= 10.0 + 1e-12


def test_least_depth_goes_before_the_tolerance():
    slopes = solid_slopes(Hemisphere(100.0), 99.0)
    bottoms = layer_bottoms_by_tolerance(slopes, 0.1, 10.0, least=0.5)
    # The last ones may share what is left.
    assert np.min(np.diff(bottoms, prepend=0.0)[:-2]) >= 0.5 - 1e-9
    assert len(bottoms) < len(layer_bottoms_by_tolerance(slopes, 0.1, 10.0))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: uniform_bottoms(0.0, 1.0), "depth 0 um gives no layer"),
        (lambda: uniform_bottoms(10.0, 0.0), "layer depth 0 um gives no layer"),
        (lambda: uniform_bottoms(10.0, 11.0), "at most the depth 10 um"),
        (lambda: uniform_bottoms(math.inf, 1.0), "depth is missing"),
        (lambda: solid_slopes(Hemisphere(10.0), 11.0), "at most 10 um"),
        (lambda: layer_bottoms_by_tolerance(solid_slopes(Hemisphere(10.0)), 0, 1), "tolerance 0"),
        (
            lambda: layer_bottoms_by_tolerance(solid_slopes(Hemisphere(10.0)), 1, 1, 2),
            "least layer depth 2 um",
        ),
    ],
)
def test_no_layers(call, words):
    with pytest.raises(InputError, match=words):
        call()
