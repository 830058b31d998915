"""Solids from mesh files, and what is wrong with some of them."""

import numpy as np
import pytest
import trimesh

from procmodel.errors import InputError
from procmodel.io import read_solid
from procmodel.io.solids import FORMATS


@pytest.fixture
def written(tmp_path):
    """Write a mesh; its file."""

    def write(mesh, name="part.stl"):
        path = tmp_path / name
        mesh.export(path)
        return path

    return write


def block(size=(0.2, 0.1, 0.05), at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(size)
    return mesh.apply_translation(at)


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_same_solid(written, kind):
    solid = read_solid(written(block(at=(1.0, 2.0, 3.0)), f"part.{kind}"), unit="mm")
    assert solid.volume == pytest.approx(200.0 * 100.0 * 50.0, rel=1e-5)
    np.testing.assert_allclose(solid.extents, [200.0, 100.0, 50.0], rtol=1e-5)
    # The highest point is the surface; x and y stay where the drawing has them.
    assert solid.vertices[:, 2].min() == 0.0
    assert solid.depth == pytest.approx(50.0, rel=1e-5)
    np.testing.assert_allclose(solid.vertices[:, :2].mean(axis=0), [1000.0, 2000.0], rtol=1e-6)
    assert solid.vertices.shape == (8, 3)


def test_ascii_stl_and_capital_ending(tmp_path):
    path = tmp_path / "PART.STL"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(block()))
    assert read_solid(path, unit="um").volume == pytest.approx(0.2 * 0.1 * 0.05, rel=1e-5)


def test_depth_counts_downwards(written):
    cone = trimesh.creation.cone(radius=10.0, height=30.0, sections=64)
    cone.apply_transform(np.diag([1, 1, -1, 1]))  # tip down, as a cavity
    if cone.volume < 0:
        cone.invert()
    solid = read_solid(written(cone))
    tip = solid.vertices[np.argmax(solid.vertices[:, 2])]
    np.testing.assert_allclose(tip, [0.0, 0.0, 30.0], atol=1e-5)
    assert solid.volume == pytest.approx(cone.volume, rel=1e-5)


def test_surface_at_the_height_0_of_the_file(written):
    path = written(block((10, 10, 4), at=(0, 0, -7)))
    assert read_solid(path, top="file").vertices[:, 2].min() == pytest.approx(5.0)
    assert read_solid(path).vertices[:, 2].min() == 0.0
    with pytest.raises(InputError, match="stands 2 um above height 0"):
        read_solid(written(block((10, 10, 4))), top="file")


def test_collapsed_and_unmerged_triangles_are_put_right(written):
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    loose = trimesh.Trimesh(sphere.triangles.reshape(-1, 3), process=False,
                            faces=np.arange(3 * len(sphere.faces)).reshape(-1, 3))  # fmt: skip
    loose.faces = np.vstack([loose.faces, [[0, 0, 1]]])
    solid = read_solid(written(loose, "part.off"))
    assert solid.vertices.shape == sphere.vertices.shape
    assert solid.volume == pytest.approx(sphere.volume, rel=1e-5)


def test_void_inside_a_body_is_kept(written):
    inner = block((4, 4, 4))
    inner.invert()
    solid = read_solid(written(trimesh.util.concatenate([block((10, 10, 10)), inner])))
    assert solid.volume == pytest.approx(1000 - 64, rel=1e-5)


def faulty(name):
    mesh = trimesh.creation.box((10, 10, 10))
    if name == "open":
        mesh.update_faces(np.arange(12) > 0)
    if name == "inside out":
        mesh.invert()
    if name == "inconsistently":
        mesh.faces = np.vstack([mesh.faces[:1, ::-1], mesh.faces[1:]])
    if name == "body":
        other = trimesh.creation.box((2, 2, 2)).apply_translation((20, 0, 0))
        other.invert()
        mesh = trimesh.util.concatenate([mesh, other])
    if name == "finite":
        mesh = trimesh.Trimesh(np.where(mesh.vertices > 4, np.inf, mesh.vertices), mesh.faces,
                               process=False)  # fmt: skip
    return mesh


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("open", ["open", "3 edges", "close"]),
        ("inside out", ["inside out", "normals"]),
        ("inconsistently", ["wound inconsistently along 3 edges", "unify"]),
        ("body", ["body 2 of 2 is inside out"]),
        ("finite", ["corners are not finite"]),
    ],
)
def test_faulty_meshes(written, name, words):
    with pytest.raises(InputError) as raised:
        read_solid(written(faulty(name), "part.off"))
    text = str(raised.value)
    assert "part.off" in text and "\n" not in text
    assert all(word in text for word in words), text


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("part.stl", b"solid nothing", ["empty", "export"]),
        ("part.stl", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 50, ["no mesh in the format STL"]),
        ("part.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n", ["OFF"]),
        ("part.off", b"OFF\n3 1 0\n0 0 0\n0 0 0\n0 0 0\n3 0 1 2\n", ["empty"]),
        ("part.obj", b"", ["empty"]),
        ("part.step", b"ISO-10303", [".stl, .obj"]),
    ],
)
def test_files_that_hold_no_mesh(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as raised:
        read_solid(path)
    text = str(raised.value)
    assert name in text and "\n" not in text
    assert all(word in text for word in words), text


def test_missing_file_folder_unit_and_top(tmp_path, written):
    with pytest.raises(InputError, match="no such file"):
        read_solid(tmp_path / "none.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(InputError, match="folder"):
        read_solid(tmp_path / "folder.stl")
    path = written(block())
    with pytest.raises(InputError, match="unit"):
        read_solid(path, unit="s")
    with pytest.raises(InputError, match="did you mean 'file'"):
        read_solid(path, top="fil")


def test_larger_than_the_travel(written):
    path = written(block())
    assert read_solid(path, "mm", travel=(200.1, 100.1, 50.1)).path == path
    with pytest.raises(InputError, match=r"100 um long along y, more than the travel of 90 um"):
        read_solid(path, "mm", travel=(300, 90, 60))
    with pytest.raises(InputError, match="three lengths"):
        read_solid(path, "mm", travel=(300, 90, 0))
