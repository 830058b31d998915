"""Layers of meshes, maps, outlines and parametric solids."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import shapely

from procmodel.errors import InputError
from procmodel.wear import Hemisphere, TabulatedSolid, cone, pyramid, slice_solid
from procmodel.wear.layer_bottoms import uniform_bottoms
from procmodel.wear.layer_path import ElectrodeSection
from procmodel.wear.slicing import (
    slice_mesh,
    slices_of_depth_map,
    slices_of_outline,
    slices_of_slot,
    slices_of_solid,
)

from .solid_meshes import box, hemisphere, lathe, together

ELECTRODE = ElectrodeSection("round", 50.0)


@dataclass
class Map:
    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray


@pytest.mark.parametrize("level", ["paper", "top", "middle", "bottom"])
@pytest.mark.parametrize("solid", [pyramid(250.0, math.pi / 4), cone(200.0, 1.0), Hemisphere(150)])
def test_parametric_solids_have_the_areas_of_the_schedules(solid, level):
    bottoms = uniform_bottoms(140.0, 7.0)
    slices, layers = slices_of_solid(solid, bottoms, level), slice_solid(solid, 7.0, 140.0, level)
    np.testing.assert_allclose(slices.areas, layers.area, rtol=1e-9)
    target = slices.target_layers()
    np.testing.assert_allclose(target.half_width, layers.half_width, rtol=1e-3)
    np.testing.assert_array_equal(target.thickness, layers.thickness)


def test_mesh_of_a_hemisphere_and_the_hemisphere_agree():
    bottoms = uniform_bottoms(96.0, 4.0)
    mesh = slice_mesh(hemisphere(100.0, 256, 256), bottoms, "middle")
    solid = slices_of_solid(Hemisphere(100.0), bottoms, "middle")
    np.testing.assert_allclose(mesh.areas, solid.areas, rtol=3e-4)
    overlap = [a.symmetric_difference(b).area for a, b in zip(mesh.regions, solid.regions)]  # noqa: B905
    assert np.all(overlap < 1e-3 * solid.areas + 1.0)


def test_volume_error_of_the_levels():
    # The mid-point rule beats both one-sided rules by an order of the layer depth.
    mesh, bottoms = hemisphere(100.0), uniform_bottoms(99.0, 3.0)
    exact = slice_mesh(mesh, uniform_bottoms(99.0, 0.05)).volume
    error = {lv: slice_mesh(mesh, bottoms, lv).volume - exact for lv in ("top", "middle", "bottom")}
    assert error["top"] > 0 > error["bottom"]
    assert abs(error["middle"]) < 0.05 * min(error["top"], -error["bottom"])


def test_levels_stay_inside_their_layer_at_a_step():
    stepped = lathe([100, 100, 60, 60], [0, 20, 20, 40], corners=4)
    wide, narrow = 2 * 100.0**2, 2 * 60.0**2
    for level in ("top", "middle", "bottom"):
        slices = slice_mesh(stepped, np.array([10.0, 20.0, 30.0, 40.0]), level)
        np.testing.assert_allclose(slices.areas, [wide, wide, narrow, narrow], rtol=1e-12)
        assert slices.volume == pytest.approx(stepped.volume, rel=1e-12)


def test_islands_are_counted_and_kept():
    ring = together(box((-100, -100, 0), (100, 100, 30)), (box((-20, -20, -1), (20, 20, 31)), -1))
    slices = slice_mesh(ring, uniform_bottoms(30.0, 10.0))
    np.testing.assert_array_equal(slices.islands, [1, 1, 1])
    np.testing.assert_allclose(slices.areas, 200.0**2 - 40.0**2)
    reach = slices.reach(ELECTRODE, 2.0)
    assert not reach.cleared[0].intersects(shapely.box(-19.9, -19.9, 19.9, 19.9))


def test_target_layers_have_the_cleared_area():
    slices = slices_of_outline(shapely.box(-100, -100, 100, 100), uniform_bottoms(20.0, 10.0))
    target = slices.target_layers(ELECTRODE, 3.0)
    np.testing.assert_allclose(target.area, 200.0**2 - (4 - math.pi) * 28.0**2, rtol=1e-4)
    np.testing.assert_allclose(target.half_width, 100.0, rtol=1e-3)


def test_depth_map_of_a_plane_and_a_box():
    x, y = np.linspace(0.0, 200.0, 21), np.linspace(0.0, 100.0, 11)
    wedge = Map(x, y, np.repeat((x / 4.0)[:, None], len(y), axis=1))
    slices = slices_of_depth_map(wedge, uniform_bottoms(48.0, 4.0), "bottom")
    np.testing.assert_allclose(slices.areas, (200.0 - 4.0 * slices.bottom) * 100.0, rtol=1e-12)
    flat = slices_of_depth_map(Map(x, y, np.full((21, 11), 30.0)), uniform_bottoms(30.0, 10.0))
    np.testing.assert_allclose(flat.areas, 200.0 * 100.0, rtol=1e-12)
    assert flat.bounds == (0.0, 0.0, 200.0, 100.0)


def test_depth_map_with_a_peak_has_an_island():
    x = np.linspace(-100.0, 100.0, 41)
    distance = np.hypot(*np.meshgrid(x, x, indexing="ij"))
    depth = np.where(distance < 90, 20.0, 0.0) - np.clip(40.0 - distance, 0.0, 20.0)
    slices = slices_of_depth_map(Map(x, x, depth), uniform_bottoms(18.0, 6.0))
    np.testing.assert_array_equal(slices.islands, [1, 1, 1])


def test_sloped_pocket_and_slot():
    outline = shapely.box(-100, -100, 100, 100)
    slices = slices_of_outline(outline, uniform_bottoms(40.0, 10.0), math.pi / 4)
    np.testing.assert_allclose(slices.areas, (200.0 - 2 * np.array([0, 10, 20, 30.0])) ** 2)
    assert slices_of_slot(300.0, 50.0, np.array([5.0])).areas[0] == pytest.approx(15000.0)


def test_undercuts_are_refused_or_clipped():
    vase = lathe([60, 60, 100, 100], [0, 20, 40, 60], corners=32)
    bottoms = uniform_bottoms(60.0, 10.0)
    with pytest.raises(InputError, match=r"layer 3 at the depth 25 um is undercut: .* um\^2"):
        slice_mesh(vase, bottoms)
    clipped = slice_mesh(vase, bottoms, undercut="clip")
    assert clipped.clipped == (3, 4, 5, 6)
    np.testing.assert_allclose(clipped.areas, clipped.areas[0], rtol=1e-12)


def test_narrow_layers_are_named_or_plunged():
    slices = slices_of_solid(Hemisphere(100.0), uniform_bottoms(100.0, 10.0), "middle")
    wide = ElectrodeSection("round", 100.0)
    with pytest.raises(InputError, match=r"diameter 100 um .* layer 10 at the depth 100 um"):
        slices.reach(wide)
    reach = slices.reach(wide, narrow="plunge")
    assert reach.narrow == (10,)
    assert reach.cleared[-1].area == pytest.approx(math.pi * 50.0**2, rel=1e-3)
    assert len(slices.above(10)) == 9
    assert slices.above(10).reach(wide).narrow == ()


def test_ring_left_for_finishing():
    slices = slices_of_outline(shapely.box(-100, -100, 100, 100), uniform_bottoms(80.0, 20.0), 1.0)
    rough = slices.inset(30.0)
    np.testing.assert_allclose(np.sqrt(rough.areas), np.sqrt(slices.areas) - 60.0, rtol=1e-9)
    # Layers that are all ring, and those below them, are left to finishing.
    assert len(slices.inset(65.0)) == np.sum(np.sqrt(slices.areas) > 130.0) < 4
    with pytest.raises(InputError, match=r"leaves nothing to rough .* half width 100 um"):
        slices.inset(100.0)
    with pytest.raises(InputError, match="finishing thickness 0"):
        slices.inset(0.0)


def test_parts_that_the_electrode_cannot_enter_are_named():
    parts = shapely.union_all([shapely.box(0, 0, 100, 100), shapely.box(200, 0, 300, 20)])
    prism = together(box((0, 0, 0), (100, 100, 10)), box((200, 0, 0), (300, 20, 10)))
    slices = slice_mesh(prism, np.array([10.0]))
    assert slices.areas[0] == pytest.approx(parts.area)
    assert slices.reach(ELECTRODE).lost == (1,)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: slice_mesh(hemisphere(50), np.array([])), "zero layers"),
        (lambda: slice_mesh(hemisphere(50), np.array([5.0, 5.0])), "layer 2 ends at 5 um"),
        (lambda: slice_mesh(hemisphere(50), np.array([40.0, 70.0])), "layer 2 .* nothing to cut"),
        (lambda: slice_mesh(hemisphere(50), np.array([5.0]), "botom"), "did you mean 'bottom'"),
        (lambda: slice_mesh(hemisphere(50), np.array([5.0]), undercut="cut"), "undercut 'cut'"),
        (lambda: slices_of_slot(20.0, 50.0, np.array([5.0])), "slot of length 20"),
        (lambda: slices_of_solid(TabulatedSolid([0, 9], [9, 9]), np.array([5.0])), "no outline"),
        (lambda: slices_of_outline(shapely.box(0, 0, 9, 9), np.array([5.0]), 2), "wall angle"),
        (lambda: slices_of_slot(90.0, 60.0, np.array([5.0])).reach(ELECTRODE, -1), "side gap -1"),
    ],
)
def test_faulty_layers(call, words):
    with pytest.raises(InputError, match=words) as raised:
        call()
    assert "\n" not in str(raised.value)
