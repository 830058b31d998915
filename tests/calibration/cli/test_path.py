"""`path correct` and `path check`, with what is written read back by other means."""

import json
import math

import numpy as np
import pytest
import shapely

from calibration.cli import main
from procmodel.engagement.contour import contour
from procmodel.io import BulgePolyline, read_contours, write_contours_csv, write_dxf
from tests.procmodel.engagement.shapes import dilated, region, rounded_rectangle

CUT = ["--tool-diameter", 10, "--radial-depth", 0.1, "--spacing", 0.02]
FORCES = ["--flutes", 2, "--axial-depth", 10, "--feed-per-tooth", 0.05]
COEFFICIENTS = (
    "tangential_shear = 2000.0\nradial_shear = 800.0\naxial_shear = 300.0\n"
    "tangential_edge = 20.0\nradial_edge = 15.0\naxial_edge = 0.0\n"
)
LINE = math.degrees(math.acos(0.98))
FIGURES = {"min_deg", "max_deg", "p99_deg", "mean_deg", "overshoot_percent", "points", "statuses"}


def polyline(path):
    return BulgePolyline(np.asarray(path.points), np.asarray(path.bulges), path.closed, path.name)


@pytest.fixture(scope="module")
def wall():
    return rounded_rectangle(60, 40, 8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, wall):
    """Wall as table and drawing, and everything that one run of the command writes from it."""
    folder = tmp_path_factory.mktemp("path")
    write_contours_csv(folder / "wall.csv", [polyline(wall)])
    write_dxf(folder / "wall.dxf", [polyline(wall)], ["WALL"])
    for suffix in (".csv", ".dxf", ".nc"):
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in (
                "path", "correct", folder / "wall.dxf", *CUT, "--out", folder / f"out{suffix}",
                "--z", -3, "--feed", 400, "--spindle-speed", 8000,
            )])  # fmt: skip
        assert stop.value.code == 0
    return folder


@pytest.mark.parametrize("name", ["wall.csv", "wall.dxf"])
def test_json_of_the_pocket(name, folder, run_json):
    result = run_json("path", "correct", folder / name, *CUT, "--method", "backward")
    assert set(result) >= {
        "target_deg", "before", "after", "floor_percent", "points", "statuses", "notes", "passes",
    }  # fmt: skip
    assert "force" not in result
    assert set(result["before"]) == set(result["after"]) == FIGURES
    assert result["target_deg"] == pytest.approx(LINE, abs=1e-9)
    assert result["before"]["overshoot_percent"] == pytest.approx(63.24, abs=0.005)
    assert result["floor_percent"] == pytest.approx(12.41, abs=0.005)
    assert result["after"]["overshoot_percent"] == pytest.approx(12.41, abs=0.2)
    for part in (result["before"], result["after"]):
        assert part["min_deg"] <= part["mean_deg"] <= part["p99_deg"] <= part["max_deg"]
    assert result["points"] == sum(result["statuses"].values())
    assert result["notes"] == []


def test_report_is_for_people(folder, run):
    code, out, err = run("path", "correct", folder / "wall.csv", *CUT, "--method", "forward",
                         "--passes", 1)  # fmt: skip
    assert (code, err) == (0, "")
    for word in ("target", "before", "after", "unavoidable", "left on the wall", "note"):
        assert word in out
    assert ".." not in out


def test_target_angle(folder, run_json):
    result = run_json("path", "correct", folder / "wall.csv", *CUT, "--target-angle", 15)
    assert result["target_deg"] == pytest.approx(15.0, abs=1e-12)
    assert result["after"]["min_deg"] == pytest.approx(15.0, abs=1e-5)


def _right_side(path):
    """Where a path crosses the x axis on the right."""
    ring = shapely.LinearRing(contour(path.points, path.bulges).flattened())
    return ring.intersection(shapely.LineString([(0.0, 0.1), (100.0, 0.1)])).bounds[2]


def test_passes_and_previous_diameter(folder, tmp_path, run_json):
    out = tmp_path / "three.csv"
    result = run_json("path", "correct", folder / "wall.csv", *CUT, "--passes", 3,
                      "--previous-diameter", 12, "--out", out)  # fmt: skip
    assert len(result["passes"]) == 3
    read = read_contours(out)
    assert len(read) == 4
    # Each pass before the last is 6 (1 - cos target) closer to the wall than the one before it.
    right = [_right_side(c) for c in read]
    assert np.diff(right[:3]) == pytest.approx([0.12, 0.12], abs=1e-4)
    assert right[2:] == pytest.approx([30 - 6 - 0.1, 25.0], abs=1e-4)


@pytest.mark.parametrize("suffix", [".nc", ".csv", ".dxf"])
def test_what_is_written_stays_inside_the_wall(suffix, folder, wall):
    read = read_contours(folder / f"out{suffix}")
    passes = [contour(c.points, c.bulges, c.closed, c.name) for c in read]
    assert len(passes) == 2
    assert all(c.closed for c in passes)
    inside, rest = region([wall]), region([wall])
    for one in passes:
        cleared = dilated([one], 5.0)
        assert cleared.difference(inside.buffer(1e-3)).is_empty
        rest = rest.difference(cleared)
    # The last pass is parallel to the wall: no more than a film stays.
    assert rest.buffer(-1e-3).is_empty


def test_program_and_table_hold_the_same(folder):
    program, table = read_contours(folder / "out.nc"), read_contours(folder / "out.csv")
    for one, other in zip(program, table, strict=True):
        assert one.points == pytest.approx(other.points, abs=1e-9)
    text = (folder / "out.nc").read_text()
    assert "S8000 M3" in text and "Z-3.0000" in text and "F400" in text


def test_check_agrees_with_what_was_said_to_be_written(folder, tmp_path, run_json):
    out = tmp_path / "again.nc"
    spacing = [*CUT[:4], "--spacing", 0.01]  # that of the figures of what is written
    said = run_json("path", "correct", folder / "wall.csv", *spacing, "--out", out)["written"]
    found = run_json("path", "check", folder / "wall.csv", *spacing, "--program", out)
    assert found["milling"] == "down"
    assert len(found["passes"]) == 2
    assert found["engagement"] == found["passes"][-1]
    for key in ("min_deg", "max_deg", "p99_deg", "mean_deg"):
        # Bulges from I and J, of four decimals, are not those that were rounded.
        assert found["engagement"][key] == pytest.approx(said[key], abs=1e-3)
    assert found["floor_percent"] == pytest.approx(12.41, abs=0.02)


def test_reversed_program_is_up_milling(folder, tmp_path, run_json):
    """In a mirror, the path corrected for down milling is the one corrected for up milling."""
    read = read_contours(folder / "out.csv")
    mirrored = [BulgePolyline(c.points * [-1.0, 1.0], -c.bulges, c.closed, c.name) for c in read]
    backwards = tmp_path / "up.csv"
    write_contours_csv(backwards, mirrored)
    down, up = (
        run_json("path", "check", folder / "wall.csv", *CUT, "--program", program)
        for program in (folder / "out.csv", backwards)
    )
    assert (down["milling"], up["milling"]) == ("down", "up")
    for key in ("min_deg", "max_deg", "mean_deg", "points"):
        assert up["engagement"][key] == pytest.approx(down["engagement"][key], abs=1e-6)


def test_check_without_a_program_is_the_parallel_path(folder, run_json):
    result = run_json("path", "check", folder / "wall.dxf", *CUT)
    assert result["engagement"]["overshoot_percent"] == pytest.approx(63.24, abs=0.005)


def test_forces(folder, tmp_path, run_json):
    file = tmp_path / "coefficients.toml"
    file.write_text(COEFFICIENTS)
    options = [*CUT, *FORCES, "--coefficients", file, "--stiffness", 20000]
    force = run_json("path", "correct", folder / "wall.csv", *options)["force"]
    assert set(force) == {"before", "after"}
    for part in force.values():
        assert set(part) == {"peak_n", "mean_n", "form_error_um"}
        assert 0 < part["mean_n"]["max"] <= part["peak_n"]["max"]
    # Same angle along the lines; less of it in the corners.
    before, after = force["before"], force["after"]
    assert before["peak_n"]["min"] == pytest.approx(after["peak_n"]["min"], rel=1e-6)
    assert after["peak_n"]["max"] < before["peak_n"]["max"]
    checked = run_json("path", "check", folder / "wall.csv", *options)["force"]
    for key, values in before.items():
        assert checked[key] == pytest.approx(values)


def test_pictures(folder, tmp_path, run):
    file = tmp_path / "coefficients.toml"
    file.write_text(COEFFICIENTS)
    options = [*CUT, *FORCES, "--coefficients", file, "--stiffness", 20000]
    for command, picture in (("correct", "correct.png"), ("check", "check.svg")):
        code, _, err = run("path", command, folder / "wall.csv", *options, "--plot",
                           tmp_path / picture)  # fmt: skip
        assert code == 0, err
        assert (tmp_path / picture).stat().st_size > 5000


def test_drawing_has_a_layer_for_wall_and_passes(folder, tmp_path, run_json):
    drawing = tmp_path / "all.dxf"
    run_json("path", "correct", folder / "wall.dxf", *CUT, "--dxf", drawing, "--layer", "wall")
    for layer in ("WALL", "PASS 1", "PASS 2"):
        assert len(read_contours(drawing, layer=layer)) == 1


def test_placeholders_of_the_program_are_said(folder, tmp_path, run_json):
    result = run_json("path", "correct", folder / "wall.csv", *CUT, "--out", tmp_path / "a.nc")
    assert any("--feed" in note for note in result["notes"])


def test_job_file(folder, run, run_json):
    job = folder / "job.toml"
    job.write_text(
        'command = "path correct"\ncontour = "wall.csv"\ntool-diameter = 10\nradial_depth = 0.1\n'
        'spacing = 0.02\nmethod = "backward"\njson = true\nout = "from_job.nc"\n'
    )
    code, out, err = run("run", job)
    assert code == 0, err
    result = json.loads(out)
    direct = run_json("path", "correct", folder / "wall.csv", *CUT)
    assert result["after"] == direct["after"]
    assert len(read_contours(folder / "from_job.nc")) == 2
