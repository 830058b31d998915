"""Sections of meshes, also through corners and along triangles."""

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.wear.slicing_planes import cut_mesh

from .solid_meshes import Mesh, box, hemisphere, lathe, together

CUBE = box((-50, -50, 0), (50, 50, 80))


def test_section_of_a_box_is_its_rectangle():
    (section,) = cut_mesh(CUBE.vertices, CUBE.faces, np.array([33.3]))
    assert section.equals(shapely.box(-50, -50, 50, 50))


@pytest.mark.parametrize(("side", "top", "bottom"), [("above", 0.0, 1e4), ("below", 1e4, 0.0)])
def test_planes_along_the_end_faces_lie_on_the_side_asked_for(side, top, bottom):
    sections = cut_mesh(CUBE.vertices, CUBE.faces, np.array([-1.0, 0.0, 80.0, 81.0]), side)
    assert [s.area for s in sections] == pytest.approx([0.0, top, bottom, 0.0])


def test_step_shows_its_upper_or_lower_section():
    stepped = lathe([100, 100, 60, 60], [0, 20, 20, 50], corners=4)  # squares standing on a corner
    wide, narrow = 2 * 100.0**2, 2 * 60.0**2
    above = cut_mesh(stepped.vertices, stepped.faces, np.array([10.0, 20.0, 30.0]), "above")
    below = cut_mesh(stepped.vertices, stepped.faces, np.array([10.0, 20.0, 30.0]), "below")
    assert [s.area for s in above] == pytest.approx([wide, wide, narrow])
    assert [s.area for s in below] == pytest.approx([wide, narrow, narrow])


@given(st.integers(0, 2**32 - 1))
def test_random_planes_agree_with_trimesh(seed):
    generator = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=100.0)
    stretched = mesh.vertices * generator.uniform(0.5, 2.0, 3)
    heights = np.sort(generator.uniform(-60.0, 60.0, 4)) * np.ptp(stretched[:, 2]) / 200
    ours = cut_mesh(stretched, np.asarray(mesh.faces), heights)
    theirs = trimesh.Trimesh(stretched, mesh.faces, process=False)
    for section, height in zip(ours, heights, strict=True):
        lines = trimesh.intersections.mesh_plane(theirs, [0, 0, 1], [0, 0, height])
        polygons = shapely.polygonize(shapely.linestrings(np.round(lines[:, :, :2], 8)))
        assert section.area == pytest.approx(polygons.area, rel=1e-6)


def test_volume_is_the_integral_of_the_sections():
    mesh = hemisphere(100.0)
    depths, step = np.linspace(0.0, 100.0, 2001), 100.0 / 2000
    sections = cut_mesh(mesh.vertices, mesh.faces, depths[:-1] + step / 2)
    assert sum(s.area for s in sections) * step == pytest.approx(mesh.volume, rel=1e-5)


def test_planes_through_every_ring_of_corners():
    mesh = hemisphere(100.0, corners=32, rings=16)
    depths = np.unique(mesh.vertices[:, 2])[1:-1]
    for side in ("above", "below"):
        sections = cut_mesh(mesh.vertices, mesh.faces, depths, side)
        wanted = 16 * np.sin(2 * np.pi / 32) * (100.0**2 - depths**2)
        np.testing.assert_allclose([s.area for s in sections], wanted, rtol=1e-9)
        assert all(s.is_valid for s in sections)


def test_islands_within_holes_within_bodies():
    solid = together(
        box((-90, -90, 0), (90, 90, 50)), (box((-60, -60, -1), (60, 60, 51)), -1),
        box((-30, -30, 0), (30, 30, 50)),
    )  # fmt: skip
    (section,) = cut_mesh(solid.vertices, solid.faces, np.array([25.0]))
    assert section.area == pytest.approx(180**2 - 120**2 + 60**2)
    assert sorted(len(p.interiors) for p in shapely.get_parts(section)) == [0, 1]


def test_bodies_may_touch_but_not_overlap():
    touching = together(box((0, 0, 0), (50, 50, 50)), box((50, 0, 0), (100, 50, 50)))
    (section,) = cut_mesh(touching.vertices, touching.faces, np.array([20.0]))
    assert section.area == pytest.approx(5000.0)
    corner = together(box((0, 0, 0), (50, 50, 50)), box((50, 50, 0), (100, 100, 50)))
    (section,) = cut_mesh(corner.vertices, corner.faces, np.array([20.0]))
    assert section.area == pytest.approx(5000.0)
    overlapping = together(box((0, 0, 0), (50, 50, 50)), box((40, 0, 0), (90, 50, 50)))
    with pytest.raises(InputError, match=r"overlap at the depth 20 um: unite"):
        cut_mesh(overlapping.vertices, overlapping.faces, np.array([20.0]))


def test_open_mesh_is_named_with_its_depth():
    broken = Mesh(CUBE.vertices, np.delete(CUBE.faces, 5, axis=0))
    with pytest.raises(InputError, match=r"open at the depth 40 um"):
        cut_mesh(broken.vertices, broken.faces, np.array([40.0]))


def voxels(filled):
    """Outer faces of the filled unit cells of a grid, corners shared: edges of four faces occur."""
    corners, numbers, faces = [], {}, []

    def number(corner):
        if corner not in numbers:
            numbers[corner] = len(corners)
            corners.append(corner)
        return numbers[corner]

    padded = np.pad(filled, 1)
    for cell in np.argwhere(padded):
        for axis in range(3):
            for side in (0, 1):
                neighbour = cell.copy()
                neighbour[axis] += 2 * side - 1
                if padded[tuple(neighbour)]:
                    continue
                u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
                start = cell + side * np.eye(3, dtype=int)[axis]
                quad = [number(tuple(int(c) for c in start + a)) for a in (0 * u, u, u + v, v)]
                a, b, c, d = quad if side else quad[::-1]
                faces += [(a, b, c), (a, c, d)]
    return Mesh(np.array(corners, float), np.array(faces))


@given(st.integers(0, 2**32 - 1))
def test_random_voxels_through_their_faces_and_edges(seed):
    filled = np.random.default_rng(seed).random((4, 4, 3)) < 0.5
    if not filled.any():
        return
    mesh = voxels(filled)
    # Cells have been moved by one by the rim of empty cells.
    heights = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])
    counts = np.concatenate([[0], filled.sum(axis=(0, 1)), [0]])
    below = [s.area for s in cut_mesh(mesh.vertices, mesh.faces, heights, "below")]
    above = [s.area for s in cut_mesh(mesh.vertices, mesh.faces, heights, "above")]
    np.testing.assert_allclose(below, counts[np.floor(heights).astype(int)], atol=1e-9)
    np.testing.assert_allclose(above, counts[np.ceil(heights).astype(int) - 1], atol=1e-9)
