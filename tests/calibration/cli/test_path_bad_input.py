"""Each fault: one sentence on stderr naming file, place and remedy; exit 2; nothing written."""

import ezdxf
import numpy as np
import pytest

from procmodel.io import BulgePolyline, write_contours_csv
from tests.procmodel.engagement.shapes import open_path, rounded_rectangle

from .test_path import COEFFICIENTS

CUT = ["--tool-diameter", 10, "--radial-depth", 0.1, "--spacing", 0.02]
SQUARE = "0,0\n30,0\n30,30\n0,30\n0,0\n"


@pytest.fixture
def folder(tmp_path):
    shapes = {"wall": rounded_rectangle(60, 40, 8), "open": open_path((20, 0), (10, 0.1))}
    for name, c in shapes.items():
        line = BulgePolyline(np.asarray(c.points), np.asarray(c.bulges), c.closed, name)
        write_contours_csv(tmp_path / f"{name}.csv", [line])
    return tmp_path


def drawing(path, units):
    document = ezdxf.new(units=units)
    document.modelspace().add_lwpolyline([(0, 0), (30, 0), (30, 30), (0, 30)], close=True)
    document.saveas(path)


def expect_refusal(run, folder, words, *arguments):
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    code, out, err = run("path", *arguments)
    assert (code, out) == (2, ""), (code, out, err)
    assert err.startswith("procmodel: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert not any(wrong in err for wrong in ("?.", "..", ":.", ",.", "::"))
    missing = [word for word in words if word not in err]
    assert not missing, (missing, err)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


def correct(run, folder, wall, words, *change):
    outputs = ["--out", folder / "out.nc", "--dxf", folder / "out.dxf", "--plot", folder / "o.png"]
    options = [*CUT, *outputs, *change, "--json"]
    expect_refusal(run, folder, words, "correct", folder / wall, *options)


TABLES = {
    "zero-length edge": ("x [mm],y [mm]\n0,0\n30,0\n30,0\n30,30\n0,30\n0,0\n", ("row 3", "row 4")),
    "no units": ("x,y\n" + SQUARE, ("row 1", "'x'", "x [mm]")),
    "unknown unit": ("x [smoot],y [mm]\n" + SQUARE, ("row 1", "smoot")),
    "no length at all": ("x [s],y [mm]\n" + SQUARE, ("row 1", "'x'")),
    "NaN": ("x [mm],y [mm]\n" + SQUARE.replace("30,30", "30,nan"), ("row 4",)),
    "no y": ("x [mm]\n1\n2\n3\n", ("y",)),
    "one point": ("x [mm],y [mm]\n1,1\n", ("one point",)),
    "empty": ("", ("empty",)),
    "crossing walls": (
        "x [mm],y [mm],contour [-],closed [-]\n0,0,1,1\n30,0,1,1\n30,30,1,1\n0,30,1,1\n"
        "15,15,2,1\n45,15,2,1\n45,45,2,1\n15,45,2,1\n",
        (),
    ),
}


@pytest.mark.parametrize("fault", TABLES)
def test_faulty_table(fault, folder, run):
    text, words = TABLES[fault]
    (folder / "faulty.csv").write_text(text)
    names = ("walls cross",) if fault == "crossing walls" else ("faulty.csv",)
    correct(run, folder, "faulty.csv", (*names, *words))


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_open_contour_where_a_closed_one_is_needed(side, folder, run):
    words = ("open.csv", "open", "(0, 0)", "mm apart", "closed", "left or right")
    correct(run, folder, "open.csv", words, "--side", side)


def test_drawing_without_units(folder, run):
    drawing(folder / "faulty.dxf", 0)
    correct(run, folder, "faulty.dxf", ("faulty.dxf", "unit", "INSUNITS"))


def test_drawing_in_unknown_units(folder, run):
    drawing(folder / "faulty.dxf", 7)
    correct(run, folder, "faulty.dxf", ("faulty.dxf", "INSUNITS 7", "4 (mm)"))


def test_units_that_contradict_the_drawing(folder, run):
    drawing(folder / "faulty.dxf", 4)
    correct(run, folder, "faulty.dxf", ("mm", "inch", "faulty.dxf"), "--units", "inch")


def test_unknown_layer(folder, run):
    drawing(folder / "plain.dxf", 4)
    correct(run, folder, "plain.dxf", ("plain.dxf", "WALL", "choose"), "--layer", "WALL")


def test_missing_file(folder, run):
    correct(run, folder, "wal.csv", ("wal.csv", "no such file"))


def test_no_kind_of_contour(folder, run):
    (folder / "wall.step").write_text("ISO-10303-21;\n")
    correct(run, folder, "wall.step", ("wall.step", ".dxf", ".csv"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--tool-diameter", 41], ("41 mm", "no room", "smaller tool")),
        (["--tool-diameter", 39.95], ("too narrow", "smaller tool")),
        (["--tool-diameter", -3], ("tool diameter", "-3", "above 0")),
        (["--tool-diameter", "nan"], ("tool diameter", "nan")),
        (["--radial-depth", 11], ("radial depth", "11 mm", "10 mm")),
        (["--radial-depth", -0.1], ("radial depth", "-0.1", "above 0")),
        (["--radial-depth", 0], ("radial depth", "above 0")),
        (["--target-angle", 200], ("target angle", "200", "180")),
        (["--target-angle", 0], ("target angle", "between 0 and 180")),
        (["--passes", 0], ("passes", "1 to 1000")),
        (["--passes", "two"], ("--passes", "integer")),
        (["--method", "backwards"], ("'backwards'", "'backward'")),
        (["--method", "x"], ("'x'", "backward", "forward")),
        (["--method", "forward", "--previous-diameter", 8], ("forward", "previous diameter")),
        (["--previous-diameter", -8], ("previous tool", "-8", "above 0")),
        (["--side", "within"], ("'within'", "inside", "outside")),
        (["--side", "left"], ("wall.csv", "closed", "inside or outside")),
        (["--layer", "WALL"], ("wall.csv", "layer", ".dxf")),
        (["--units", "mm"], ("wall.csv", "units", "header")),
        (["--spacing", 1e-6], ("1e-06", "places", "larger spacing")),
        (["--spacing", 0], ("spacing", "above 0")),
        (["--spacing", "inf"], ("spacing", "inf")),
        (["--tolerance", 0], ("--tolerance", "above 0")),
        (["--feed", -5, "--spindle-speed", 8000], ("feed", "-5")),
        (["--feed", 0], ("feed", "0")),
        (["--z", "inf"], ("z", "inf")),
        (["--coefficients", "c.toml"], ("--flutes", "missing", "--feed-per-tooth")),
        (["--flutes", 2], ("--coefficients", "missing")),
        (["--stiffness", 2e4], ("--coefficients",)),
        (["--out", "out.txt"], ("out.txt", ".nc", ".csv", ".dxf")),
        (["--out", "nowhere/out.nc"], ("nowhere",)),
        (["--dxf", "out.nc"], (".dxf",)),
        (["--plot", "out.docx"], ("out.docx", ".png")),
        (["--no-such"], ("--no-such",)),
    ],
    ids=lambda value: "".join(map(str, value)) if isinstance(value, list) else "",
)
def test_faulty_option(change, words, folder, run):
    correct(run, folder, "wall.csv", words, *change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--milling", "upwards"], ("'upwards'", "up")),
        (["--helix", 90], ("--helix", "between 0 and 90")),
        (["--flutes", 0], ("--flutes", "above 0")),
        (["--stiffness", 2e4, "--overhang", 40], ("--stiffness", "--overhang", "one")),
        (["--coefficients", "missing.toml"], ("missing.toml", "no such file")),
    ],
    ids=lambda value: "".join(map(str, value)) if isinstance(value, list) else "",
)
def test_faulty_force_option(change, words, folder, run):
    file = folder / "coefficients.toml"
    file.write_text(COEFFICIENTS)
    forces = ["--coefficients", file, "--flutes", 2, "--axial-depth", 5, "--feed-per-tooth", 0.05]
    correct(run, folder, "wall.csv", words, *forces, *change)


LOOP = "G1 X{0} Y-15\nG1 X{0} Y15\nG1 X-{0} Y15\nG1 X-{0} Y-15\n"
HEAD = "G21 G90 G17\nG0 X-25 Y-15 Z5\nG1 Z-1 F100\n"
PROGRAMS = {
    "unsupported word": (HEAD + "G81 X1 Y1 R2\n", ("line 4", "G81", "write its moves")),
    "tool compensation": (HEAD + "G41 D1\n" + LOOP.format(25), ("line 4", "G41")),
    "open cuts": (HEAD + "G1 X25 Y-15\nG1 X25 Y15\nG0 Z5\nM30\n", ("cut 1", "open", "lead-in")),
    "no cut": ("G21 G90\nG0 X1 Y1\nM30\n", ("no cutting move",)),
    "bad arc": (HEAD + "G3 X25 Y15 I1 J1\n", ("line 4", "centre", "correct")),
    "not finished": (HEAD + "G1 X\n", ("line 4",)),
}


@pytest.mark.parametrize("fault", PROGRAMS)
def test_faulty_program(fault, folder, run):
    text, words = PROGRAMS[fault]
    (folder / "bad.nc").write_text(text)
    options = [*CUT, "--program", folder / "bad.nc", "--plot", folder / "check.png"]
    expect_refusal(run, folder, ("bad.nc", *words), "check", folder / "wall.csv", *options)


def test_half_a_pass(folder, run):
    """Two walls need two cuts for each pass."""
    wall, island = rounded_rectangle(60, 40, 8), rounded_rectangle(12, 12, 4)
    lines = [
        BulgePolyline(np.asarray(c.points), np.asarray(c.bulges), c.closed, "w")
        for c in (wall, island)
    ]
    write_contours_csv(folder / "two.csv", lines)
    (folder / "one.nc").write_text(HEAD + LOOP.format(25) + "G0 Z5\nM30\n")
    words = ("1 cuts", "takes 2", "whole passes")
    expect_refusal(run, folder, words, "check", folder / "two.csv", *CUT, "--program",
                   folder / "one.nc")  # fmt: skip


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--spacing", "inf"], ("spacing", "above 0")),
        (["--spacing", 1e-6], ("places", "larger spacing")),
        (["--previous-diameter", "inf"], ("previous tool",)),
        (["--program", "missing.nc"], ("missing.nc", "no such file")),
        (["--target-angle", 180], ("target angle", "180")),
        (["--coefficients", "c.toml"], ("--flutes",)),
    ],
    ids=lambda value: "".join(map(str, value)) if isinstance(value, list) else "",
)
def test_faulty_option_of_check(change, words, folder, run):
    options = [*CUT, "--plot", folder / "check.png", *change, "--json"]
    expect_refusal(run, folder, words, "check", folder / "wall.csv", *options)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('command = "path corect"\n', ("job.toml", "'correct'")),
        ('command = "path correct"\ntool-diametre = 10\n', ("job.toml", "'tool-diameter'")),
    ],
)
def test_faulty_job(text, words, folder, run):
    (folder / "job.toml").write_text(text)
    code, out, err = run("run", folder / "job.toml")
    assert (code, out) == (2, "")
    assert "?." not in err and err.count("\n") == 1
    assert all(word in err for word in words), err
