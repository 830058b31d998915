"""Programs of G-code, read as contours."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import read_gcode
from tests.procmodel.io.contour_shapes import PLATE_AREA, arc, area, pieces, refused, stars, traced


@pytest.fixture
def read(tmp_path):
    def write(text, **arguments):
        path = tmp_path / "prog.nc"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_gcode(path, **arguments)

    return write


PLATE_PROGRAM = """%
O1234 (PLATE 40 X 20; ONE CORNER ROUNDED)
N10 G21 G90 G17 G40 G49 G80 G94 G54
N20 T1 M6
N30 G0 S8000 M3 G43 H1 Z50.
N40 G0 X0 Y0 ; to the start
N50 Z2.
N60 G1 Z-3 F100
N70 X40. F400
N80 Y15
N90 G3 X35. Y20. I-5. J0
N100 G01 X0
N110 Y0 F200
N120 G0 Z50
N130 M30
%
G1 X999
"""


def test_a_usual_program(read):
    program = read(PLATE_PROGRAM)
    (plate,) = program.moves
    assert plate.closed
    np.testing.assert_array_equal(plate.points, [(0, 0), (40, 0), (40, 15), (35, 20), (0, 20)])
    assert area(plate) == pytest.approx(PLATE_AREA, rel=1e-14)
    assert plate.name == "prog.nc, lines 9 to 13"
    assert program.depths == (-3.0,)
    assert program.feeds[0].tolist() == [400, 400, 400, 400, 200]
    assert program.lines[0].tolist() == [9, 10, 11, 12, 13]
    assert program.ramps == 0
    assert program.notes == (
        "prog.nc: line 3 chooses the zero point G54: X and Y are taken as written",
    )


def spelt(text):
    """The same program as other systems would write it."""
    yield text.lower()
    yield re.sub(r"(?<=[0-9.]) (?=[A-Z])", "", text)
    yield re.sub(r"(?<=[A-Z])(?=[-0-9])", " ", text)
    yield text.replace("\n", "\r\n")
    yield "\ufeff" + text
    yield re.sub(r"(?m)^N[0-9]+ ", "", text)
    yield re.sub(r"(?m)^(N[0-9]+ .*)$", r"\1 (NOTE (NESTED) G1 X7)", text)
    yield text.replace("G3", "G03").replace("G0 ", "G00 ")
    yield text.replace("(PLATE", "(GRÖSSE").encode("latin-1")


@pytest.mark.parametrize("number", range(9))
def test_spellings(read, number):
    text = PLATE_PROGRAM.replace("O1234 ", "O1234\n", 1)
    assert len(list(spelt(text))) == 9
    (plate,) = read(list(spelt(text))[number]).moves
    assert plate.closed and len(plate.points) == 5
    assert area(plate) == pytest.approx(PLATE_AREA, rel=1e-14)


def incremental(text):
    """The plate's contour in increments, begun in absolute coordinates."""
    return (
        "G21 G90 G0 X100 Y50\nG91\nG1 Z-3 F100\nX40\nY15\nG3 X-5 Y5 "
        f"{text}\nG1 X-35\nY-20\nG90 G0 Z50"
    )


@pytest.mark.parametrize("centre", ["I-5 J0", "I-5", "R5", "G90.1 I135 J65", "G91.1 I-5"])
def test_increments_and_centres(read, centre):
    (plate,) = read(incremental(centre)).moves
    assert plate.points[2:4].tolist() == [[140, 65], [135, 70]]
    assert area(plate) == pytest.approx(PLATE_AREA, rel=1e-14)


def test_sums_of_increments_close_and_make_no_tiny_moves(read):
    text = "G21 G90 G0 X0 Y0\nG91\n" + "G1 X0.1\n" * 3 + "G1 Y0.1\n" * 7 + "G90 X0.3 Y0.7\nX0 Y0"
    (found,) = read(text).moves
    assert found.closed and len(found.points) == 11
    assert area(found) == pytest.approx(0.3 * 0.7 / 2)


def test_a_full_circle_after_increments_stays_one(read):
    # 0.1 + 0.1 + 0.1 is not 0.3 in binary.
    text = "G21 G90 G0 X0 Y0\nG91\n" + "G0 X0.1\n" * 3 + "G90 G2 X0.3 Y0 I1 J0"
    (circle,) = read(text).moves
    assert area(circle) == pytest.approx(-math.pi, rel=1e-9)


@pytest.mark.parametrize(("code", "sign"), [("G2", -1), ("G3", 1)])
@pytest.mark.parametrize("end", ["", "X5 Y1"])
def test_full_circles(read, code, sign, end):
    (circle,) = read(f"G21 G0 X5 Y1 Z1\nG1 Z-1 F50\n{code} {end} I-3 J4\nG0 Z5").moves
    assert circle.closed and len(circle.points) == 2
    assert area(circle) == pytest.approx(sign * 25 * math.pi, rel=1e-14)
    assert circle.points.mean(axis=0).tolist() == [2, 5]
    assert circle.name == "prog.nc, line 3"


@pytest.mark.parametrize("code", ["G2", "G3"])
@pytest.mark.parametrize("radius", [10.0, -10.0])
def test_radius_words(read, code, radius):
    (found,) = read(f"G21 G0 X0 Y0\n{code} X12 Y0 R{radius}").moves
    minor = 2 * math.asin(0.6)
    sweep = minor if radius > 0 else 2 * math.pi - minor
    assert found.length == pytest.approx(10 * sweep, rel=1e-12)
    # Clockwise from left to right passes above the chord.
    middle = traced(found)[len(traced(found)) // 2]
    assert np.sign(middle[1]) == (1 if code == "G2" else -1)
    for piece in pieces(found):
        centre, arc_radius, _, arc_sweep = arc(*piece)
        assert arc_radius == pytest.approx(10, rel=1e-12)
        assert centre[0] == pytest.approx(6, abs=1e-9)
        assert abs(centre[1]) == pytest.approx(8, rel=1e-9)
        assert abs(arc_sweep) <= math.pi


@given(
    start=st.tuples(st.floats(-90, 90), st.floats(-90, 90)),
    radius=st.floats(1, 50),
    first=st.floats(-math.pi, math.pi),
    sweep=st.floats(0.05, 6.2),
    clockwise=st.booleans(),
    style=st.sampled_from(["centre", "absolute centre", "radius"]),
)
def test_arcs_of_all_styles(tmp_path_factory, start, radius, first, sweep, clockwise, style):
    centre = (start[0] - radius * math.cos(first), start[1] - radius * math.sin(first))
    last = first + (-sweep if clockwise else sweep)
    end = (centre[0] + radius * math.cos(last), centre[1] + radius * math.sin(last))
    where = {
        "centre": f"I{centre[0] - start[0]:.9f} J{centre[1] - start[1]:.9f}",
        "absolute centre": f"G90.1 I{centre[0]:.9f} J{centre[1]:.9f}",
        "radius": f"R{radius if sweep <= math.pi else -radius:.9f}",
    }[style]
    code = "G2" if clockwise else "G3"
    path = tmp_path_factory.getbasetemp() / "arc.nc"
    path.write_text(
        f"G21 G0 X{start[0]:.9f} Y{start[1]:.9f}\n{code} X{end[0]:.9f} Y{end[1]:.9f} {where}"
    )
    (found,) = read_gcode(path).moves
    # Near half a turn the centre moves by the root of the error of R: sqrt(2 * 50 * 2e-9).
    tolerance = 1e-3 if style == "radius" else 1e-6
    assert found.length == pytest.approx(radius * sweep, abs=tolerance)
    middle = (first + last) / 2
    expected = (centre[0] + radius * math.cos(middle), centre[1] + radius * math.sin(middle))
    gap = np.hypot(*(traced(found, 64) - expected).T).min()
    assert gap < radius * sweep / 128 + tolerance


@settings(deadline=None)
@given(stars(largest_bulge=0.99))
def test_random_contours_written_with_nine_decimals(tmp_path_factory, shape):
    lines = [f"G21 G90 G0 X{shape.points[0][0]:.9f} Y{shape.points[0][1]:.9f}"]
    for start, end, bulge in pieces(shape):
        words = f"X{end[0]:.9f} Y{end[1]:.9f}"
        if bulge:
            (x, y), *_ = arc(start, end, bulge)
            code = "G3" if bulge > 0 else "G2"
            lines.append(f"{code} {words} I{x - start[0]:.9f} J{y - start[1]:.9f}")
        else:
            lines.append(f"G1 {words}")
    path = tmp_path_factory.getbasetemp() / "star.nc"
    path.write_text("\n".join(lines))
    (found,) = read_gcode(path).moves
    assert found.closed
    np.testing.assert_allclose(found.points, shape.points, rtol=0, atol=1e-8)
    # An error of 1e-9 against chords of at least 1.
    np.testing.assert_allclose(found.bulges, shape.bulges, rtol=0, atol=1e-7)


def test_inches(read):
    (found,) = read("G20 G0 X1 Y0\nG1 X2 F10\nG3 X2 Y1 I0 J0.5\nG21 G1 X0 F100").moves
    np.testing.assert_allclose(found.points, [(25.4, 0), (50.8, 0), (50.8, 25.4), (0, 25.4)])
    assert found.bulges.tolist() == pytest.approx([0, 1, 0])
    program = read("G20 G0 X1 Y0\nG1 X2 F10\nG21 Y9 F10")
    assert program.feeds[0].tolist() == [254, 10]


def test_unit_that_is_not_stated(read):
    text = "G0 X1 Y0\nG1 X2\n"
    program = read(text)
    assert program.notes == ("prog.nc: neither G21 nor G20 stands before line 1: mm are assumed",)
    assert program.moves[0].points.tolist() == [[1, 0], [2, 0]]
    assert np.isnan(program.feeds[0]).all() and math.isnan(program.depths[0])
    program = read(text, units="inch")
    assert program.notes == ()
    assert program.moves[0].points.tolist() == [[25.4, 0], [50.8, 0]]
    assert read("G20\n" + text, units="inch").moves[0].points.tolist() == [[25.4, 0], [50.8, 0]]
    assert "line 1: G20 contradicts the unit that was given" in refused(
        read, "G20\n" + text, units="mm"
    )
    assert "units is 'um', but G-code is in mm or inch" in refused(read, text, units="um")


def test_runs_are_broken_by_rapids_and_by_moves_in_z(read):
    program = read(
        "G21 G0 X0 Y0 Z1\nG1 Z-1 F10\nX10\nZ-2\nX0 F20\nG0 X0 Y5\nG1 X10 Z-2\nG0 Z1\nX0 Y9"
    )
    assert [move.points.tolist() for move in program.moves] == [
        [[0, 0], [10, 0]],
        [[10, 0], [0, 0]],
        [[0, 5], [10, 5]],
    ]
    assert program.depths == (-1, -2, -2)
    assert [feeds.tolist() for feeds in program.feeds] == [[10], [20], [20]]
    assert not any(move.closed for move in program.moves)
    assert program.ramps == 0


def test_ramps_and_helices_end_a_run_and_are_counted(read):
    program = read(
        "G21 G0 X0 Y0 Z0\nG1 X10 Z-1 F10\nX20\nY10\nG3 X20 Y10 Z-2 I5 J0\nG1 X0\nG91 X5 Z-1\nX-5 Z0"
    )
    assert program.ramps == 3
    assert [move.points.tolist() for move in program.moves] == [
        [[10, 0], [20, 0], [20, 10]],
        [[20, 10], [0, 10]],
        [[5, 10], [0, 10]],
    ]
    assert program.depths == (-1, -2, -3)
    assert (
        "no cutting move G1, G2 or G3 in X and Y at constant Z (1 moves change Z while they cut)"
        in refused(read, "G21 G0 X0 Y0 Z0\nG1 X10 Z-1")
    )


def test_there_and_back_stays_open(read):
    (move,) = read("G21 G0 X0 Y0\nG1 X10\nX0").moves
    assert not move.closed and len(move.points) == 3


@pytest.mark.parametrize(("gap", "closed"), [(0.0009, True), (0.0011, False)])
def test_ends_close_within_a_thousandth(read, gap, closed):
    (move,) = read(f"G21 G0 X0 Y0\nG1 X10\nY10\nX0 Y{gap}").moves
    assert move.closed is closed
    assert len(move.points) == (3 if closed else 4)


def test_an_overrun_onto_the_start_is_dropped(read):
    (move,) = read("G21 G0 X0 Y0\nG1 X10\nY10\nX0 Y0\nX0.0005").moves
    assert move.closed
    assert move.points.tolist() == [[0, 0], [10, 0], [10, 10]]
    program = read("G21 G0 X0 Y0\nG1 X10\nY10\nX0 Y0\nX0.0005")
    assert len(program.feeds[0]) == len(program.lines[0]) == 3


def test_words_without_effect_and_moves_without_length(read):
    text = (
        "G21 G0 X0 Y0 S100 M3\nG4 X2.5\nG4 P100 F9\nG1 F50\nG1 X0 Y0\nX10 D1 T2 M8\n"
        "X10 Y0\n:0001\nN5\nG61.1 G64 P0.01\nG69 G50 G9\nY10"
    )
    (move,) = read(text).moves
    assert move.points.tolist() == [[0, 0], [10, 0], [10, 10]]
    assert read(text).feeds[0].tolist() == [50, 50]


def test_deletable_blocks_are_executed(read):
    program = read("G21 G0 X0 Y0\n/ G1 X10\n/2 G1 Y10\n/N40 G1 X0\n/(only a remark)\n/1")
    assert len(program.moves[0].points) == 4
    assert program.notes == (
        "prog.nc: line 2 begins with '/': it is executed, as with the switch for deletable "
        "blocks off",
    )


@pytest.mark.parametrize("end", ["M2", "M02", "M30", "%"])
def test_nothing_is_read_behind_the_end(read, end):
    (move,) = read(f"%\nG21 G0 X0 Y0\nG1 X10\n{end}\nG1 X20 G81").moves
    assert move.points.tolist() == [[0, 0], [10, 0]]


UNSUPPORTED = [
    ("G18", "G18 (plane ZX) is not supported: write the contour in the plane XY, G17"),
    ("G19", "G19 (plane YZ) is not supported: write the contour in the plane XY, G17"),
    ("G91 G28 Z0", "G28 (return to the reference point) is not supported: delete the block"),
    ("G41 D1", "G41 (cutter compensation left) is not supported: the path of the tool centre"),
    ("G42 D1", "G42 (cutter compensation right) is not supported: the path of the tool centre"),
    ("G53 Z0", "G53 (machine coordinates) is not supported: write all coordinates in one"),
    ("G55", "G55 (another zero point) is not supported: write all coordinates in one zero point"),
    ("G59.1", "G59.1 (another zero point) is not supported"),
    ("G54.1 P3", "G54.1 is not supported: write the contour with G0, G1, G2 and G3"),
    ("G81 X1 Y1 Z-3 R1", "G81 (drilling cycle) is not supported: write its moves as G0 and G1"),
    ("G83 Q1", "G83 (deep-hole drilling cycle) is not supported"),
    ("G92 X0", "G92 (shift of the zero point) is not supported"),
    ("G93", "G93 (inverse-time feed) is not supported: write the feed in mm/min, G94"),
    ("G95", "G95 (feed per revolution) is not supported"),
    ("G68 R30", "G68 (rotated coordinates) is not supported"),
    ("G33 Z-1", "G33 (thread cutting) is not supported"),
    ("G65 P9010", "G65 (macro call) is not supported: write the moves themselves"),
    ("G187 P1", "G187 is not supported: write the contour with G0, G1, G2 and G3"),
    ("M98 P100", "M98 (sub-program) is not supported: write its blocks in the program itself"),
    ("M99", "M99 (end of a sub-program) is not supported: end the program with M30"),
    ("#1=5", "'#1=5' (macro expression) is not supported: write the numbers themselves"),
    ("G1 X[1+2]", "'G1X[1+2]' (macro expression) is not supported"),
    ("N5 GOTO 10", "'N5GOTO10' (macro expression) is not supported"),
    ("O100 sub", "'O100SUB' (sub-program or loop) is not supported"),
    ("o<hole> call", "'O<HOLE>CALL' (sub-program or loop) is not supported"),
    ("G1 A90", "A90 (another axis) is not supported: contours have X, Y and Z only: delete it"),
    ("G2 X1 Y0 I1 K1", "K1 (centre in Z) is not supported: arcs lie in the plane XY: delete it"),
    ("G1 E5", "E5 is not supported: delete the word"),
    ("G1 X1,R2", "',' in 'G1X1,R2' is not supported: write decimal points, and roundings and"),
    ("G1 X", "'X' has no number: correct or delete it"),
    ("G1 X1.2.3", "'.3' is no G-code word: correct or delete it"),
    ("MSG(HELLO)", "'M' has no number: correct or delete it"),
    ("G1 X1 X2", "X stands twice in the block: delete one of the two"),
    ("G0 G1 X1", "G0 and G1 stand in one block: delete one of the two"),
    ("G90 G91", "G90 and G91 stand in one block: delete one of the two"),
    ("G20 G21", "G20 and G21 stand in one block: delete one of the two"),
    ("G1 X1 (NOTE", "a comment is not closed: write ')' at its end"),
    ("G1 X1 NOTE)", "')' closes a comment that '(' has not opened: delete it"),
    ("G1 X5 I2", "I stands without G2 or G3: write one of them, or delete it"),
    ("G80\nX5", "X stands before any of G0, G1, G2 and G3: begin the block with one of them"),
    ("G2 X10", "the arc has neither I and J nor R: add its centre or radius"),
    ("G2 X10 R5 I5", "the arc has both R and a centre: delete one of the two"),
    ("G2 X0 Y0 R5", "a full circle cannot be written with R: write I and J"),
    ("G2 X10 R0", "the radius of the arc is zero: correct R"),
    ("G2 X10 R4.9", "the radius 4.9 mm is too small for an arc whose ends are 10 mm apart"),
    ("G2 X10 I0 J0", "the centre of the arc is its start: correct I and J"),
    ("G90.1 G2 X10 I5", "an arc with an absolute centre (G90.1) needs both I and J: add both"),
    (
        "G2 X10 I5.002 J0",
        "the end of the arc is 4.998 mm from its centre but the start 5.002 mm, 0.004 mm apart: "
        "correct X, Y, I or J",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("block", "sentence"), UNSUPPORTED)
def test_what_is_refused(read, block, sentence):
    line = 3 + block.count("\n")
    message = refused(read, f"G21 G90\nG0 X0 Y0\n{block}\nG1 X50\n")
    assert f"prog.nc, line {line}: {sentence}" in message


@pytest.mark.parametrize(
    ("unit", "excess", "accepted"),
    [("G21", 0.0009, True), ("G21", 0.0011, False), ("G20", 9e-5, True), ("G20", 11e-5, False)],
)
def test_tolerance_of_the_end_of_an_arc(read, unit, excess, accepted):
    # Both radii change, one up and one down.
    text = f"{unit} G0 X0 Y0\nG3 X10 I{5 + excess:.6f} J0"
    if accepted:
        assert len(read(text).moves) == 1
    else:
        assert "prog.nc, line 2: the end of the arc is " in refused(read, text)


def test_absolute_centres_without_their_word_get_a_hint(read):
    message = refused(read, "G21 G0 X100 Y0\nG3 X110 Y0 I105 J0")
    assert message.endswith("correct X, Y, I or J, or write G90.1 if they are absolute")


@pytest.mark.parametrize(
    ("text", "axes"),
    [("G1 X5 Y5", "X and Y"), ("G0 X1\nG1 X5", "Y"), ("G91 G0 X1 Y1\nG1 X5", "X and Y")],
)
def test_cuts_from_unknown_places(read, text, axes):
    line = 2 + text.count("\n")
    assert (
        f"prog.nc, line {line}: the cut begins at an unknown {axes}: write a G0 with X and Y in "
        "G90 before it" in refused(read, "G21\n" + text)
    )


def test_a_plunge_before_the_first_position_is_no_cut(read):
    (move,) = read("G21 G1 Z5 F100\nG1 Z5\nG0 X0 Y0\nG1 X9").moves
    assert move.points.tolist() == [[0, 0], [9, 0]]


def test_motion_before_any_code(read):
    assert "line 1: X stands before any of G0, G1, G2 and G3" in refused(read, "G21 X5")


def test_files_that_are_no_programs(read, tmp_path):
    assert "no cutting move G1, G2 or G3 in X and Y at constant Z: give a program" in refused(
        read, "G21 G0 X5 Y5\n"
    )
    assert "no cutting move" in refused(read, "")
    assert "this is a binary file, not G-code" in refused(read, b"G1\0X5")
    assert "no such file" in refused(read_gcode, tmp_path / "none.nc")
    assert "I is not a finite number" in refused(read, "G21 G0 X0 Y0\nG2 I" + "9" * 400)


@settings(deadline=None, max_examples=300)
@given(
    st.lists(
        st.one_of(
            st.sampled_from(PLATE_PROGRAM.splitlines()),
            st.text("GXYZIJRFMN0123456789.-/%();#[]=, ", max_size=20),
        ),
        max_size=8,
    )
)
def test_any_text_is_read_or_refused(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "any.nc"
    path.write_text("\n".join(lines))
    try:
        program = read_gcode(path)
    except InputError as error:
        assert "any.nc" in str(error) and "\n" not in str(error)
    else:
        assert program.moves
        assert all(np.isfinite(move.points).all() for move in program.moves)
