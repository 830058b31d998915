"""`wear plan` with solids, slots and maps, and its scanning paths."""

import csv
import itertools
import math
import re

import numpy as np
import pytest
import shapely
import trimesh

from procmodel.io import write_table

from .conftest import ELECTRODE

PLAN = ("wear", "plan", "--wear-ratio", 0.3)
PYRAMID = ["--shape", "pyramid", "--half-width", 250, "--wall-angle", 45, "--layer-depth", 5]
SLOT = ["--shape", "slot", "--length", 300, "--width", 50, "--depth", 20, "--layer-depth", 5]


def read(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def swept(paths, layer, radius):
    """Area that a round electrode clears on the path of a layer, from the file alone."""
    at = paths["layer [1]"] == layer
    points = np.column_stack([paths["x [um]"], paths["y [um]"]])[at]
    cutting = paths["cutting [1]"][at]
    moves = [
        shapely.LineString(points[i : i + 2]) for i in range(len(points) - 1) if cutting[i + 1]
    ]
    moves += [shapely.Point(p) for p, c in zip(points, cutting, strict=True) if not c]
    return shapely.union_all([m.buffer(radius, quad_segs=64) for m in moves])


@pytest.fixture
def frustum(tmp_path):
    """Pyramid of 45 degrees from 500 um down to 200 um of width, 150 um deep, as STL in mm."""
    top, bottom, depth = 0.25, 0.1, 0.15
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    points = np.vstack([np.column_stack([top * corners, np.zeros(4)]),
                        np.column_stack([bottom * corners, np.full(4, -depth)])])  # fmt: skip
    path = tmp_path / "frustum.stl"
    trimesh.convex.convex_hull(points).export(path)
    return path


def test_solid_and_shape_of_the_same_pyramid_agree(frustum, tmp_path, run_json):
    out, paths = tmp_path / "plan.csv", tmp_path / "paths.csv"
    result = run_json(*PLAN, "--solid", frustum, "--layer-depth", 5, *ELECTRODE, "--gap", 2,
                      "--level", "top", "--out", out, "--paths", paths)  # fmt: skip
    shape = run_json(*PLAN, *PYRAMID, "--depth", 150, *ELECTRODE, "--gap", 2)
    assert result["layers"] == shape["layers"] == 30
    plan = read(out)
    np.testing.assert_allclose(plan["half width [um]"], 250.0 - 5 * np.arange(30), rtol=1e-3)
    # The round electrode leaves the corners of the gap's 52 um radius.
    corners = (4 - math.pi) * 52.0**2
    wanted = 4 * (250.0 - 5 * np.arange(30)) ** 2 - corners
    np.testing.assert_allclose(plan["area [um^2]"], wanted, rtol=1e-4)
    saved = 0.3 / (math.pi * 50.0**2) * 30 * 5 * corners
    assert shape["total_feed"] - result["total_feed"] == pytest.approx(saved, rel=1e-3)
    assert shape["path_length_um"] is None
    assert result["uncovered_share"] < 1e-4
    lost = 30 * corners / np.sum(4 * (250.0 - 5 * np.arange(30)) ** 2)
    assert result["unreachable_share"] == pytest.approx(lost, rel=1e-2)
    assert result["islands"] == 0 and result["lifted_moves"] == 0
    found = read(paths)
    np.testing.assert_array_equal(np.unique(found["layer [1]"]), np.arange(1, 31))
    for layer in (1, 30):
        assert swept(found, layer, 52.0).area == pytest.approx(wanted[layer - 1], rel=1e-3)
    length = np.sum(
        np.hypot(*np.diff([found["x [um]"], found["y [um]"]]))[found["cutting [1]"][1:] > 0]
    )
    assert result["path_length_um"] == pytest.approx(length, rel=1e-5)
    assert result["path_time_s"] > length / (10_000 / 60)


def test_program_follows_the_paths(frustum, tmp_path, run_json):
    program, paths, out = tmp_path / "p.nc", tmp_path / "paths.csv", tmp_path / "plan.csv"
    run_json(*PLAN, "--solid", frustum, "--layer-depth", 15, *ELECTRODE, "--pattern", "raster",
             "--gcode", program, "--paths", paths, "--out", out)  # fmt: skip
    found = read(paths)
    text = program.read_text()
    feeds = -1000 * np.array([float(z) for z in re.findall(r"G1 Z(-[\d.]+)", text)])
    np.testing.assert_allclose(feeds, read(out)["cumulative feed [um]"], atol=1e-6)
    np.testing.assert_allclose(np.unique(found["cumulative feed [um]"]), feeds, atol=1e-6)
    written = 1000 * np.array(re.findall(r"G[01] X(-?[\d.]+) Y(-?[\d.]+)", text)[:-1], float)
    assert len(written) == len(found["x [um]"])
    np.testing.assert_allclose(written[:, 0], found["x [um]"], atol=0.051)
    np.testing.assert_allclose(written[:, 1], found["y [um]"], atol=0.051)


def test_slot_turns_the_square_electrode(tmp_path, run_json):
    program, paths, picture = tmp_path / "s.nc", tmp_path / "s.csv", tmp_path / "s.png"
    result = run_json(*PLAN, *SLOT, "--electrode-side", 50, "--gcode", program, "--paths", paths,
                      "--preview", picture)  # fmt: skip
    turns = read(paths)["quarter turns [1]"]
    np.testing.assert_array_equal(turns[::3], [0, 1, 2, 3])
    assert program.read_text().count("M0 (LAYER") == 3
    assert result["path_length_um"] == pytest.approx(4 * 2 * 250.0, rel=1e-3)
    assert picture.read_bytes().startswith(b"\x89PNG")
    # V = length x width x depth; the square electrode leaves nothing.
    worn = 0.3 * 300 * 50 * 20 / 50.0**2
    assert result["electrode_length"] == pytest.approx(worn, rel=2e-3)


def test_depth_map(tmp_path, run_json):
    table = tmp_path / "map.csv"
    x, y = np.meshgrid(np.linspace(-150, 150, 31), np.linspace(-100, 100, 21))
    z = np.minimum(40.0, 2.0 * (150.0 - np.abs(x)))
    write_table(table, {"x [um]": x.ravel(), "y [um]": y.ravel(), "z [um]": z.ravel()})
    out = tmp_path / "plan.csv"
    run_json(*PLAN, "--shape", "map", "--table", table, "--layer-depth", 10, "--electrode-side", 40,
             "--out", out)  # fmt: skip
    widths = 300.0 - np.array([5.0, 15.0, 25.0, 35.0])
    np.testing.assert_allclose(read(out)["area [um^2]"], 200.0 * widths, rtol=1e-6)


def test_scallop_makes_layers_by_the_slope(tmp_path, run_json):
    out = tmp_path / "plan.csv"
    common = ["--shape", "hemisphere", "--radius", 150, "--depth", 130, *ELECTRODE]
    result = run_json(*PLAN, *common, "--layer-depth", 10, "--scallop", 1, "--out", out)
    bottom = read(out)["target z [um]"]
    top = np.append(0.0, bottom[:-1])
    corner = np.hypot(np.sqrt(150.0**2 - bottom**2), top)
    assert np.all(150.0 - corner <= 1.0 + 1e-6)
    assert len(bottom) == result["layers"] < 130


def test_rules_switched_off_change_the_paths(run_json):
    common = [*PLAN, *PYRAMID, "--depth", 20, *ELECTRODE, "--pattern", "raster"]
    on = run_json(*common)
    off = run_json(*common, "--no-inside-and-periphery", "--overlap", 0, "--no-to-and-fro",
                   "--no-alternate")  # fmt: skip
    assert off["path_length_um"] < on["path_length_um"]
    assert on["uncovered_share"] < 1e-6


def test_two_stages_of_a_solid(frustum, tmp_path, run_json):
    common = [*PLAN, "--solid", frustum, "--layer-depth", 15, *ELECTRODE]
    paths = tmp_path / "paths.csv"
    one = run_json(*common)
    two = run_json(*common, "--finish-thickness", 30, "--finish-wear-ratio", 0.4,
                   "--finish-electrode-diameter", 50, "--paths", paths)  # fmt: skip
    rough, fine = two["stages"]
    area = math.pi * 50.0**2
    removed = rough["electrode_length"] * area / 0.3
    removed += fine["electrode_length"] * math.pi * 25.0**2 / 0.4
    # The thinner electrode clears more of the corners.
    corners = (4 - math.pi) * (50.0**2 - 25.0**2) * 150.0
    assert removed == pytest.approx(one["electrode_length"] * area / 0.3 + corners, rel=5e-3)
    assert set(read(paths)["stage [1]"]) == {1.0, 2.0}
    assert two["uncovered_share"] < 1e-3


def test_narrow_layers_refused_plunged_or_left(tmp_path, run, run_json):
    cone = trimesh.creation.cone(radius=100.0, height=100.0, sections=128)
    cone.vertices[:, 2] *= -1
    cone.invert()
    path = tmp_path / "cone.stl"
    cone.export(path)
    common = [*PLAN, "--solid", path, "--solid-unit", "um", "--layer-depth", 10, *ELECTRODE]
    code, _, err = run(*common)
    assert code == 2
    assert "electrode diameter 100 um" in err and "layer 6 at the depth 60 um" in err
    stopped = run_json(*common, "--narrow", "stop")
    assert stopped["layers"] == 5
    assert any("ends above layer 6" in w for w in stopped["warnings"])
    plunged = run_json(*common, "--narrow", "plunge")
    assert plunged["layers"] == 10
    assert any("5 layers from layer 6 on are narrower" in w for w in plunged["warnings"])


def test_job_file(frustum, tmp_path, run):
    job = tmp_path / "job.toml"
    job.write_text(
        'command = "wear plan"\nsolid = "frustum.stl"\nlayer-depth = 15\nwear-ratio = 0.3\n'
        'electrode-diameter = 100\npattern = "contour"\ntravel = [1000, 1000, 5000]\njson = true\n'
    )
    code, out, err = run("run", job)
    assert code == 0, err
    assert '"path_length_um"' in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--layer-depth", 5], ["either --shape or --solid"]),
        ([*PYRAMID, "--solid", "part.stl"], ["either --shape or --solid"]),
        (["--solid", "none.stl", "--layer-depth", 5], ["none.stl", "no such file"]),
        (["--shape", "slott", "--layer-depth", 5], ["did you mean 'slot'"]),
        (["--shape", "slot", "--layer-depth", 5, "--width", 50], ["--length is missing"]),
        ([*SLOT, "--layer-depth", 2], ["give one"]),
        ([*SLOT, "--electrode-side", 60], ["--electrode-side", "another size"]),
        ([*SLOT], ["electrode diameter 100 um", "layer 1", "thinner"]),
        ([*SLOT[:-4], "--layer-depth", 5], ["depth is missing"]),
        ([*PYRAMID, "--pattern", "rastr"], ["did you mean 'raster'"]),
        ([*PYRAMID, "--pattern", "raster", "--overlap", 1], ["overlap 1"]),
        ([*PYRAMID, "--narrow", "skip", "--pattern", "raster"], ["--narrow is 'skip'"]),
        ([*PYRAMID, "--scallop", 0], ["--scallop is 0"]),
        ([*PYRAMID, "--level", "foo"], ["--level is", "middle"]),
        ([*PYRAMID, "--undercut", "foo"], ["--undercut is"]),
        ([*PYRAMID, "--depth", 100, "--travel", 400, 1000, 9000], ["cavity is 500 um along X"]),
        ([*PYRAMID, "--depth", 100, "--travel", 1000, 1000, 300], ["sum of the feeds", "along Z"]),
        ([*PYRAMID, "--preview", "p.gif"], ["p.gif", ".png"]),
        (["--shape", "table", "--table", "areas.csv", "--layer-depth", 5, "--pattern", "raster"],
         ["no outline to scan"]),
    ],
)  # fmt: skip
def test_faulty(arguments, words, tmp_path, run, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "areas.csv").write_text("z [um],area [um^2]\n0,90000\n50,90000\n")
    code, printed, err = run(*PLAN, *ELECTRODE, *arguments, "--json")
    assert code == 2, (printed, err)
    assert printed == "" and err.count("\n") == 1
    assert all(word in err for word in words), err


def test_faulty_solids_are_named(frustum, tmp_path, run):
    mesh = trimesh.load_mesh(frustum)
    common = [*PLAN, *ELECTRODE, "--layer-depth", 5]
    holed, turned = tmp_path / "holed.stl", tmp_path / "turned.stl"
    mesh.submesh([np.arange(1, len(mesh.faces))], append=True).export(holed)
    mesh.invert()
    mesh.export(turned)
    for path, words in ((holed, "is open"), (turned, "inside out")):
        code, _, err = run(*common, "--solid", path)
        assert code == 2
        assert path.name in err and words in err
    code, _, err = run(*common, "--solid", frustum, "--travel", 400, 600, 9000)
    assert code == 2
    assert "frustum.stl" in err and "travel" in err
    code, _, err = run(*common, "--solid", frustum, "--depth", 200)
    assert code == 2
    assert "at most 150 um" in err


def test_levelling_passes_go_to_and_fro_over_the_last_layer(tmp_path, run_json, run):
    box = ["--shape", "pyramid", "--half-width", 100, "--wall-angle", 90, "--depth", 30]
    out, paths = tmp_path / "plan.csv", tmp_path / "paths.csv"
    options = (*PLAN, *box, "--layer-depth", 3, *ELECTRODE)
    found = run_json(*options, "--levelling", 3, "--out", out, "--paths", paths)
    passes = found["levelling"]
    assert passes["tilt"] < 0.2 * passes["tilt_before"]
    assert np.all(np.diff(passes["feeds"]) < 0)
    plan, ways = read(out), read(paths)
    assert found["layers"] == 13 and len(plan["feed [um]"]) == 13
    np.testing.assert_allclose(plan["feed [um]"][-3:], passes["feeds"])
    assert plan["target z [um]"][-1] == pytest.approx(30.0, abs=0.05)
    np.testing.assert_allclose(np.diff(plan["cumulative feed [um]"][-4:]), passes["feeds"])
    corners = [
        np.column_stack([ways["x [um]"], ways["y [um]"]])[ways["layer [1]"] == n]
        for n in (10, 11, 12, 13)
    ]
    for one, next_one in itertools.pairwise(corners):
        np.testing.assert_array_equal(one, next_one[::-1])
    code, _, err = run(*options, "--levelling", 2, "--layer-depth", 5)
    assert code == 2 and "one --layer-depth" in err


def test_depths_in_single_precision_are_what_they_were_meant_to_be(tmp_path, run, run_json):
    # 0.06 mm in single precision is 59.99999866 um.
    corners = 0.2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    points = np.vstack([np.column_stack([corners, np.full(4, z)]) for z in (0.0, -0.06)])
    part, plan = tmp_path / "part.stl", tmp_path / "plan.csv"
    trimesh.convex.convex_hull(points).export(part)
    options = ("--solid", part, *ELECTRODE)
    run_json(*PLAN, *options, "--layer-depth", 20, "--depth", 60)
    run_json(*PLAN, *options, "--layer-depth", 20, "--out", plan)
    cut = run_json("wear", "simulate", "--plan", plan, *options, "--wear-ratio", 0.3, "--cell", 10)
    assert cut["layers"] == 3
    code, _, err = run(*PLAN, *options, "--layer-depth", 2, "--solid-unit", "m")
    assert code == 2 and "makes 30000 layers of 2 um" in err
    code, _, err = run(*PLAN, *options, "--layer-depth", 200, "--solid-unit", "m",
                       "--paths", tmp_path / "p.csv")  # fmt: skip
    assert code == 2 and "check the unit of the part" in err


def test_a_floor_between_layers_and_a_closed_passage_are_noted(tmp_path, run_json):
    step = np.array([[0, 0], [400, 0], [400, -20], [200, -20], [200, -60], [0, -60.0]]) / 1000.0
    front = [trimesh.creation.extrude_triangulation(
        step, [[0, 4, 5], [0, 3, 4], [0, 1, 3], [1, 2, 3]], 0.3)]  # fmt: skip
    mesh = front[0]
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    part = tmp_path / "step.stl"
    mesh.export(part)
    uneven = run_json(*PLAN, "--solid", part, *ELECTRODE, "--layer-depth", 12)
    assert any("level floor at 20 um" in note for note in uneven["warnings"])
    even = run_json(*PLAN, "--solid", part, *ELECTRODE, "--layer-depth", 10)
    assert not any("level floor" in note for note in even["warnings"])
    x, y = np.meshgrid(np.arange(0.0, 501.0, 10.0), np.arange(0.0, 301.0, 10.0), indexing="ij")
    neck = ((x < 200) | (x > 300) | (np.abs(y - 150) < 35)) & (x > 0) & (x < 500)
    depth = np.where(neck & (y > 0) & (y < 300), 20.0, 0.0)
    table = tmp_path / "map.csv"
    write_table(table, {"x [um]": x.ravel(), "y [um]": y.ravel(), "z [um]": depth.ravel()})
    shape = ("--shape", "map", "--table", table, "--layer-depth", 10)
    found = run_json(*PLAN, *shape, *ELECTRODE)
    assert any("does not fit through" in note for note in found["warnings"])
    thin = run_json(*PLAN, *shape, "--electrode-diameter", 40)
    assert not any("does not fit through" in note for note in thin["warnings"])
