"""Programs that move the tool along paths, read back and compared."""

import math
import re
from importlib import resources

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import PathSettings, path_program_text, read_gcode, write_path_program
from procmodel.io.polyline import full_circle
from tests.procmodel.io.contour_shapes import PLATE, area, polyline, star, stars, traced

SETTINGS = PathSettings(z=-3.0, feed=400.0, plunge_feed=100.0, spindle_speed=8000.0)


def refused(call, *arguments, **keywords):
    with pytest.raises(InputError) as raised:
        call(*arguments, **keywords)
    return str(raised.value)


def read_back(tmp_path, shapes, **keywords):
    path = tmp_path / "path.nc"
    write_path_program(path, shapes, SETTINGS, **keywords)
    return read_gcode(path)


def farthest(one, other):
    """Largest distance from a point of one contour to the nearest of the other."""
    # The chords between the traced points fall short of an arc by its sagitta / 256^2.
    line = shapely.LineString(traced(other, 256))
    return max(line.distance(shapely.Point(point)) for point in traced(one))


def test_known_program():
    gap = polyline([(1, 1), (1, 2)], closed=False, name="gap.dxf, layer Ö(1); %")
    assert path_program_text([PLATE, gap], SETTINGS) == (
        "(TOOL CENTRE ALONG 2 PATHS AT Z -3.0000)\n"
        "(GENERIC ISO G-CODE, NO MAKER'S DIALECT: CHECK BEFORE RUNNING)\n"
        "(IT HOLDS NO CODES FOR TOOL CHANGE, TOOL LENGTH OR COOLANT)\n"
        "G21 G90 G17 G40 G94\n"
        "S8000 M3\n"
        "G0 Z5.0000\n"
        "(PASS 1: PLATE)\n"
        "G0 X0.0000 Y0.0000\n"
        "G1 Z-3.0000 F100\n"
        "G1 X40.0000 Y0.0000 F400\n"
        "G1 X40.0000 Y15.0000 F400\n"
        "G3 X35.0000 Y20.0000 I-5.0000 J0.0000 F400\n"
        "G1 X0.0000 Y20.0000 F400\n"
        "G1 X0.0000 Y0.0000 F400\n"
        "G0 Z5.0000\n"
        "(PASS 2: GAP.DXF, LAYER __1__ _)\n"
        "G0 X1.0000 Y1.0000\n"
        "G1 Z-3.0000 F100\n"
        "G1 X1.0000 Y2.0000 F400\n"
        "G0 Z5.0000\n"
        "M5\n"
        "M30\n"
    )


def test_the_program_read_back(tmp_path):
    program = read_back(tmp_path, [PLATE, PLATE.reversed(), full_circle((9, 9), (7, 9), True, "h")])
    assert program.depths == (-3.0, -3.0, -3.0)
    assert [move.closed for move in program.moves] == [True] * 3
    assert [area(move) for move in program.moves] == pytest.approx(
        [area(PLATE), -area(PLATE), -4 * math.pi], rel=1e-12
    )
    assert set(np.concatenate(program.feeds)) == {400.0}
    assert program.ramps == 0 and program.notes == ()


@settings(deadline=None)
@given(
    shapes=st.lists(stars(largest_bulge=4.0), min_size=1, max_size=3),
    closed=st.booleans(),
    scale=st.sampled_from([1.0, 1e-3]),
)
@example(shapes=[star([1.0, 1.0, 1.00004], [1.0, -1.0, 0.7])], closed=True, scale=1e-3)
def test_round_trip(tmp_path_factory, shapes, closed, scale):
    """A thousandth of the size, 1 to 80 um, makes the rounding matter."""
    shapes = [
        polyline(each.points * scale, each.bulges if closed else each.bulges[:-1], closed=closed)
        for each in shapes
    ]
    if not closed:
        # Ends that meet would be read as closed.
        gaps = [np.hypot(*(each.points[0] - each.points[-1])) for each in shapes]
        shapes = [each for each, gap in zip(shapes, gaps, strict=True) if gap > 1.2e-3]
        if not shapes:
            return
    program = read_back(tmp_path_factory.getbasetemp(), shapes)
    assert len(program.moves) == len(shapes)
    for move, shape in zip(program.moves, shapes, strict=True):
        assert move.closed is closed
        # Each vertex of the halved path is a written point, off by half a step in x and in y.
        written = shape.with_arcs_halved().points
        for point in written:
            assert np.abs(move.points - point).max(axis=1).min() < 0.51e-4
        # Half a step more in the centre moves the middle of an arc by at most as much again;
        # what falls short of the arcs between traced points is far less.
        assert farthest(move, shape) < 1.5e-4
        assert farthest(shape, move) < 1.5e-4


def test_rounding_does_not_add_up(tmp_path):
    # Rounded increments would walk away by about half a step times the root of their number.
    count = 3000
    angles = 2 * np.pi * np.arange(count) / count
    ring = polyline(10 * np.column_stack([np.cos(angles), np.sin(angles)]))
    (move,) = read_back(tmp_path, [ring]).moves
    assert np.abs(move.points - ring.points).max() < 0.51e-4


def words(program):
    return [
        {letter: float(value) for letter, value in re.findall(r"([GXYIJ])(-?[0-9.]+)", line)}
        for line in program.splitlines()
        if re.match(r"G[0123] X", line)
    ]


@settings(deadline=None)
@given(stars(largest_bulge=4.0))
def test_ends_lie_on_the_circles_that_controls_compute(shape):
    x, y = 0.0, 0.0
    arcs = 0
    for block in words(path_program_text([shape], SETTINGS)):
        if block["G"] >= 2:
            centre = (x + block["I"], y + block["J"])
            first = math.dist(centre, (x, y))
            last = math.dist(centre, (block["X"], block["Y"]))
            # End and centre are off by half a step in x and in y each, whatever the radius.
            assert abs(first - last) < 2 * math.sqrt(2) * 0.5e-4 + 1e-9
            cross = (x - centre[0]) * (block["Y"] - centre[1]) - (y - centre[1]) * (
                block["X"] - centre[0]
            )
            # At most half a turn, to within rounding.
            assert (cross if block["G"] == 3 else -cross) > -1e-3 * first
            arcs += 1
        x, y = block["X"], block["Y"]
    assert arcs == np.count_nonzero(shape.bulges) + np.count_nonzero(np.abs(shape.bulges) > 1)


def test_moves_that_vanish_are_left_out():
    shape = polyline([(0, 0), (1, 0), (1.00002, 0), (1.00002, 1)])
    assert path_program_text([shape], SETTINGS).count("G1 X") == 3
    tiny = polyline([(0, 0), (1e-5, 0), (0, 1e-5)], name="dot")
    assert refused(path_program_text, [PLATE, tiny], SETTINGS) == (
        "dot: the path is shorter than the 0.0001 mm that the program writes: delete it"
    )


@pytest.mark.parametrize(
    ("chord", "bulge", "code"),
    [
        (1.0, 0.9e-4, "G1"),  # sagitta 0.45e-4
        (1.0, 1.1e-4, "G3"),
        (0.0004, 1.0, "G1"),  # radius 2e-4
        (0.001, 1.0, "G3"),
        (0.001, -1.0, "G2"),
    ],
)
def test_flat_and_tiny_arcs_become_lines(chord, bulge, code):
    shape = polyline([(0, 0), (chord, 0)], [bulge], closed=False)
    assert f"\n{code} X{chord:.4f}" in path_program_text([shape], SETTINGS)


def test_negative_zero_is_not_written():
    shape = polyline([(-1e-9, 0), (1, -1e-9), (1, 1)])
    assert "-0.0000" not in path_program_text([shape], SETTINGS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"feed": 0}, "feed is 0: give a number of at least 0.0001"),
        ({"plunge_feed": -1}, "plunge_feed is -1: give a number of at least 0.0001"),
        ({"spindle_speed": math.nan}, "spindle_speed is nan: give a number of at least 0.0001"),
        ({"feed": math.inf}, "feed is inf: give a number of at least 0.0001"),
        ({"z": math.nan}, "z is nan: give a number of mm"),
        ({"safe_height": math.inf}, "safe_height is inf: give a number of mm"),
        (
            {"z": 5.0},
            "z is 5 mm, not below the safe_height of 5 mm: give a smaller z or a larger "
            "safe_height",
        ),
    ],
)
def test_settings_out_of_range(changes, message):
    usual = {"z": -3.0, "feed": 400.0, "plunge_feed": 100.0, "spindle_speed": 8000.0}
    assert refused(PathSettings, **(usual | changes)) == message


def test_faulty_paths(tmp_path):
    assert refused(path_program_text, [], SETTINGS) == "the program has no path: give at least one"
    doubled = polyline([(0, 0), (1, 0), (1, 0)])
    assert "shape, vertex 2 and vertex 3: the points coincide" in refused(
        path_program_text, [doubled], SETTINGS
    )
    missing = tmp_path / "none" / "p.nc"
    assert "does not exist: create it first" in refused(
        write_path_program, missing, [PLATE], SETTINGS
    )


def test_own_template(tmp_path):
    template = tmp_path / "ours.toml"
    template.write_text(
        'header = "O1 {{}} S{spindle_speed:.1f} {pass_count:02d}"\n'
        'pass = "G0 X{start_x:.1f} Y{start_y} Z{z:.2f}\\n{moves}\\n({name} {number})"\n'
        'line = "G1 X{x:.3f} Y{y:+.3f}"\nfooter = "M2"\n'
    )
    line = polyline([(0, 0), (1, 2)], closed=False)
    assert path_program_text([line], SETTINGS, template) == (
        "O1 {} S8000.0 01\nG0 X0.0 Y0.0000 Z-3.00\nG1 X1.000 Y+2.000\n(SHAPE 1)\nM2\n"
    )


def test_the_shipped_template_names_every_field():
    text = (resources.files("procmodel.io") / "path_iso.toml").read_text()
    for field in ("pass_count", "number", "name", "start_x", "start_y", "moves", "i", "j"):
        assert re.search(rf"^#.*\b{field}\b", text, flags=re.MULTILINE)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('layer = "M30"', ["unknown entry 'layer'", "allowed are header, pass, line,"]),
        ('footer = "{safez}"', ["unknown field '{safez}'", "did you mean 'safe_z'?"]),
        ('footer = "{moves}"', ["unknown field '{moves}'", "allowed are pass_count, z, safe_z"]),
        ('pass = "{start_x}{start_y}{z}"', ["entry 'pass' lacks '{moves}'"]),
        ('clockwise_arc = "G2 I{i} J{j}"', ["entry 'clockwise_arc' lacks '{x}'"]),
        ('footer = "{z:d}"', ["entry 'footer' cannot be filled in"]),
        ("footer = ", ["this is not TOML", "or begin from path_iso.toml"]),
    ],
)
def test_faulty_templates(tmp_path, text, parts):
    template = tmp_path / "ours.toml"
    template.write_text(text)
    message = refused(path_program_text, [PLATE], SETTINGS, template)
    for part in ["ours.toml", *parts]:
        assert part in message
