"""`electrode path`, with what is written read back by other means."""

import json
import math
import re

import numpy as np
import pytest

from procmodel.io import Column, read_table

CONE = ["--tip-diameter", 60, "--base-diameter", 120, "--height", 150]
SQUARE = ["--tip-width", 60, "--base-width", 100, "--height", 150]
CURVED = ["--tip-diameter", 100, "--base-diameter", 100, "--height", 120, "--arc-radius", 100]
WIRE = ["--wire-diameter", 200, "--gap", 14.7]


def positions(path):
    table = read_table(path, [Column("pass", "1"), Column("x", "um"), Column("z", "um")])
    return table.values["pass"], np.column_stack([table.values["x"], table.values["z"]])


def moves(text):
    """Words of every cutting move of a program, as (code, {letter: value})."""
    for line in text.splitlines():
        if re.match(r"G[123] ", line):
            code, *words = line.split()
            yield code, {word[0]: float(word[1:]) for word in words}


def test_positions_of_a_cone(tmp_path, run_json):
    out = tmp_path / "cone.csv"
    result = run_json("electrode", "path", "cone-frustum", *CONE, *WIRE, "--out", out)
    one = result["passes"][0]
    length = math.hypot(30.0, 150.0)
    assert one["steps"] == math.ceil(length / 0.3)
    assert one["length_um"] == pytest.approx(length)
    assert one["time_s"] == pytest.approx(length / (1000.0 / 60.0))
    _, points = positions(out)
    assert len(points) == one["steps"] + 1
    # 114.7 um from the flank, within a rounding of 0.05 um on each axis.
    along = np.array([30.0, 150.0]) / length
    off = points @ np.array([along[1], -along[0]]) - 30.0 * along[1]
    np.testing.assert_allclose(off, 114.7, atol=0.071)
    np.testing.assert_allclose(points * 10, np.round(points * 10), atol=1e-6)
    assert one["deviation_um"] == pytest.approx(np.abs(off - 114.7).max(), abs=1e-6)
    assert one["rounding_um"] <= 0.05 + 1e-9
    assert [d["diameter_um"] for d in result["dimensions"]] == [60.0, pytest.approx(120.0)]
    assert result["dimensions"][0]["area_um2"] == pytest.approx(math.pi * 900.0)
    assert result["notes"] == []


def test_acceleration_adds_to_the_time(run_json):
    arguments = ["electrode", "path", "cone-frustum", *CONE, *WIRE]
    slow = run_json(*arguments, "--acceleration", 0.01)["passes"][0]["time_s"]
    # L / f + f / a with f = 16.7 um/s and a = 10 um/s^2.
    feed = 1000.0 / 60.0
    assert slow == pytest.approx(math.hypot(30.0, 150.0) / feed + feed / 10.0, rel=1e-3)


def test_lead_in(run_json):
    arguments = ["electrode", "path", "cone-frustum", *CONE, *WIRE]
    plain, led = (run_json(*arguments, *lead)["passes"][0] for lead in ([], ["--lead-in", 40]))
    assert led["length_um"] == pytest.approx(plain["length_um"] + 40.0)
    assert led["end_um"] == plain["end_um"]
    assert led["start_um"][1] < plain["start_um"][1] - 39.0


def test_passes(tmp_path, run_json):
    out = tmp_path / "passes.csv"
    result = run_json("electrode", "path", "cone-frustum", *CONE, *WIRE, "--roughing", 20,
                      "--roughing", 5, "--out", out)  # fmt: skip
    assert [p["allowance_um"] for p in result["passes"]] == [20.0, 5.0, 0.0]
    number, points = positions(out)
    along = np.array([30.0, 150.0]) / math.hypot(30.0, 150.0)
    off = points @ np.array([along[1], -along[0]]) - 30.0 * along[1]
    for i, distance in enumerate((134.7, 119.7, 114.7), start=1):
        np.testing.assert_allclose(off[number == i], distance, atol=0.071)


@pytest.mark.parametrize(("flag", "code", "sense"), [([], "G3", -1), (["--convex"], "G2", 1)])
def test_program_of_a_curved_electrode(flag, code, sense, tmp_path, run_json):
    program = tmp_path / "curved.nc"
    result = run_json("electrode", "path", "curved", *CURVED, "--wire-diameter", 20, "--gap", 5,
                      *flag, "--gcode", program)  # fmt: skip
    approach, (found, words) = moves(program.read_text())
    assert found == code
    # The circle of radius 100 about (50 -+ 80, 60), and the wire 15 um off it.
    centre = np.array([0.05 - sense * 0.08, 0.06])
    start = np.array([approach[1]["X"], 0.06 - 0.6 * (0.1 + sense * 0.015)])
    assert start[0] == pytest.approx(0.05 + 0.8 * 0.015, abs=1e-4)
    offset = np.array([words["I"], words["K"]])
    np.testing.assert_allclose(start + offset, centre, atol=2e-4)
    end = [words["X"], words["Z"]]
    assert math.dist(end, centre) == pytest.approx(0.1 + sense * 0.015, abs=2e-4)
    assert end[1] == pytest.approx(0.06 + 0.6 * (0.1 + sense * 0.015), abs=1e-4)
    # From X to Z is counter-clockwise seen from +Y, and G18 counts from Z to X.
    assert "G18" in program.read_text()
    assert any("control" in note for note in result["notes"])


def test_program_of_a_square_frustum_turns_the_spindle(tmp_path, run_json):
    program = tmp_path / "square.nc"
    result = run_json("electrode", "path", "square-frustum", *SQUARE, *WIRE, "--gcode", program)
    assert result["sides"] == 4
    assert [d["width_um"] for d in result["dimensions"]] == [60.0, pytest.approx(100.0)]
    assert [d["area_um2"] for d in result["dimensions"]] == pytest.approx([3600.0, 10_000.0])
    text = program.read_text()
    angles = re.findall(r"SPINDLE TO ([\d.]+) DEGREES", text)
    assert [float(a) for a in angles] == [0.0, 90.0, 180.0, 270.0]
    assert text.count("M0\n") == 4
    # Each time from the retreat, in X, to the first position, and back.
    assert len(list(moves(text))) == 8
    retreat = float(re.search(r"G0 X([\d.]+)", text)[1])
    assert retreat > 0.5 * 0.1 + 0.1147
    assert any("4 times" in note and "90" in note for note in result["notes"])


def test_profile_from_a_table(tmp_path, run_json):
    table = tmp_path / "profile.csv"
    table.write_text("radius [um],z [mm],bulge [-]\n40,0,0\n60,0.1,0\n60,0.2,0\n")
    out, program = tmp_path / "out.csv", tmp_path / "out.nc"
    result = run_json("electrode", "path", table, *WIRE, "--out", out, "--gcode", program)
    kinds = [p["kind"] for p in result["passes"][0]["pieces"]]
    assert kinds == ["line", "arc", "line"]
    assert [d["z_um"] for d in result["dimensions"]] == pytest.approx([0.0, 100.0, 200.0])
    assert result["passes"][0]["pieces"][1]["radius_um"] == pytest.approx(114.7)
    codes = [code for code, _ in moves(program.read_text())]
    # The approach, then the three pieces; around a corner that bulges, from X to Z.
    assert codes == ["G1", "G1", "G2", "G1"]
    _, points = positions(out)
    np.testing.assert_allclose(points[-1], [174.7, 200.0], atol=0.051)


def test_report_and_picture(tmp_path, run):
    picture = tmp_path / "path.png"
    code, out, err = run("electrode", "path", "cone-frustum", *CONE, "--plot", picture)
    assert (code, err) == (0, "")
    for word in ("cone-frustum", "diameter 60.000", "finishing: 510 steps", "rounding", "note"):
        assert word in out, out
    assert ".." not in out
    assert picture.stat().st_size > 5000


def test_job_file_and_template(tmp_path, run):
    (tmp_path / "mine.toml").write_text('footer = "M2"\n')
    job = tmp_path / "job.toml"
    job.write_text(
        'command = "electrode path"\nshape = "cone-frustum"\ntip-diameter = 60\n'
        'base_diameter = 120\nheight = 150\nroughing = [20, 5]\ngcode = "job.nc"\n'
        'template = "mine.toml"\njson = true\n'
    )
    code, out, err = run("run", job)
    assert code == 0, err
    assert len(json.loads(out)["passes"]) == 3
    assert (tmp_path / "job.nc").read_text().endswith("M2\n")


FAULTS = {
    "unknown shape": (["cone"], ("'cone'", "cone-frustum")),
    "nothing given": (["cone-frustum"], ("is missing", "cone-frustum")),
    "no arc radius": (["curved", *CONE], ("--arc-radius", "missing")),
    "another shape's option": (["cone-frustum", *CONE, "--tip-width", 3], ("--tip-width",)),
    "sides of a cone": (["cone-frustum", *CONE, "--sides", 4], ("--sides",)),
    "step below resolution": (["cone-frustum", *CONE, "--step", 0.05], ("0.05", "resolution")),
    "negative gap": (["cone-frustum", *CONE, "--gap", -1], ("--gap", "-1")),
    "no feed": (["cone-frustum", *CONE, "--feed", 0], ("--feed", "above 0")),
    "NaN": (["cone-frustum", *CONE, "--wire-diameter", "nan"], ("--wire-diameter", "nan")),
    "height 0": (["cone-frustum", *CONE[:4], "--height", 0], ("height", "above 0")),
    "wire too thick": (["curved", *CURVED, "--wire-diameter", 200], ("wire", "hollow of radius")),
    "arc too tight": (["curved", *CONE, "--arc-radius", 50], ("radius 50", "at least")),
    "roughing order": (["cone-frustum", *CONE, "--roughing", 5, "--roughing", 9], ("--roughing",)),
    "no such table": (["missing.csv"], ("missing.csv",)),
    "program as table": (["cone-frustum", *CONE, "--out", "a.nc"], ("a.nc", "--gcode")),
    "template alone": (["cone-frustum", *CONE, "--template", "t.toml"], ("--template",)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_sentence(fault, tmp_path, run, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, words = FAULTS[fault]
    wire = [] if {"--wire-diameter", "--gap"} & set(arguments) else WIRE
    if fault == "wire too thick":
        wire = ["--gap", 5]
    outputs = ["--gcode", "o.nc"] if fault == "wire too thick" else []
    code, out, err = run("electrode", "path", *arguments, *wire, *outputs, "--json")
    assert (code, out) == (2, ""), err
    assert err.startswith("procmodel: ") and err.count("\n") == 1
    assert all(word in err for word in words), err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("radius [um],z [um]\n40,0\n", ("two corners",)),
        ("radius [um],z [um]\n40,0\n40,0\n", ("piece 1", "no length")),
        ("radius [um],z [um]\n40,0\n-4,10\n", ("axis",)),
        ("radius,z\n40,0\n50,10\n", ("row 1", "radius [um]")),
        ("radius [um],z [um]\n40,0\n50,x\n", ("row 3",)),
    ],
)
def test_faulty_profile(text, words, tmp_path, run):
    table = tmp_path / "profile.csv"
    table.write_text(text)
    code, out, err = run("electrode", "path", table)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and "profile.csv" in err
    assert all(word in err for word in words), err
