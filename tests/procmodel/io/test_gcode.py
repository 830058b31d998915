"""Programs of G-code, read back and followed move by move."""

import math
import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import ProgramLayer, Scanning, program_text, read_template, write_program
from procmodel.io.gcode import LEAST_OVERLAP_OF_SQUARES, contour_offsets

LAYERS = [
    ProgramLayer(1, 18.0, 250.0),
    ProgramLayer(2, 34.5, 240.0),
    ProgramLayer(3, 49.6, 50.0),
    ProgramLayer(4, 60.0, 31.25),
]


def scanning(shape="square", **changes):
    return Scanning(**{"shape": shape, "electrode_radius": 50.0, "scan_feed": 12.5,
                       "plunge_feed": 2.0} | changes)  # fmt: skip


@dataclass
class Pass:
    """One layer as the machine would cut it: mm."""

    z: float
    path: list[tuple[float, float]]
    feeds: set[float]
    turns: list[str]


def follow(program):
    """Positions of the electrode while it is below the workpiece top, layer by layer."""
    position = {"X": 0.0, "Y": 0.0, "Z": 0.0}
    layers = []
    assert "G21 G90 G17" in program
    for line in program.splitlines():
        words = dict(re.findall(r"([GXYZIJFM])(-?[\d.]+)", re.sub(r"\(.*?\)", "", line)))
        if line.startswith("G21") or "G" not in words:
            continue
        before = dict(position)
        position.update({axis: float(words[axis]) for axis in "XYZ" if axis in words})
        where = (position["X"], position["Y"])
        if words["G"] == "0":
            assert position["Z"] > 0 or before["X"] == where[0], "rapid move in the cavity"
        elif "Z" in words:
            assert before["Z"] > 0, "plunge from above"
            assert where == (before["X"], before["Y"])
            layers.append(Pass(position["Z"], [where], set(), []))
        elif words["G"] == "1":
            layers[-1].path.append(where)
            layers[-1].feeds.add(float(words["F"]))
        else:
            centre = (before["X"] + float(words["I"]), before["Y"] + float(words["J"]))
            radius = math.hypot(float(words["I"]), float(words["J"]))
            assert where == (before["X"], before["Y"]), "a full circle"
            angles = np.linspace(0, 2 * np.pi, 257)[1:]
            layers[-1].path += [
                (centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a)) for a in angles
            ]
            layers[-1].turns.append(words["G"])
            layers[-1].feeds.add(float(words["F"]))
    assert position["Z"] > 0
    return layers


def swept(layer, electrode_radius_mm):
    path = np.array(layer.path)
    line = shapely.Point(path[0]) if len(path) == 1 else shapely.LineString(path)
    return line.buffer(electrode_radius_mm, quad_segs=64)


@pytest.mark.parametrize("shape", ["square", "circle"])
def test_depths_and_extents_are_those_planned(shape):
    passes = follow(program_text(read_template(), LAYERS, scanning(shape)))
    assert [layer.z for layer in passes] == [-0.018, -0.0345, -0.0496, -0.06]
    for planned, layer in zip(LAYERS, passes, strict=True):
        x, y = np.array(layer.path).T
        reach = max(planned.half_width, 50.0) / 1000
        for extent in (x.max(), -x.min(), y.max(), -y.min()):
            assert extent + 0.05 == pytest.approx(reach, abs=1e-12)
        assert layer.feeds <= {12.5}


@pytest.mark.parametrize("shape", ["square", "circle"])
def test_direction_alternates_from_layer_to_layer(shape):
    layers = [ProgramLayer(n, 10.0 * n, 250.0) for n in (1, 2, 3)]
    passes = follow(program_text(read_template(), layers, scanning(shape)))
    if shape == "circle":
        assert [set(layer.turns) for layer in passes] == [{"3"}, {"2"}, {"3"}]
    else:
        contours = [shapely.LinearRing(layer.path[:5]) for layer in passes]
        assert [ring.is_ccw for ring in contours] == [True, False, True]


@pytest.mark.parametrize("shape", ["square", "circle"])
@settings(deadline=None)
@given(
    half_width=st.floats(20, 1000),
    radius=st.floats(10, 200),
    overlap=st.floats(0, 0.9),
)
def test_no_island_stays(shape, half_width, radius, overlap):
    if shape == "square":
        overlap = max(overlap, LEAST_OVERLAP_OF_SQUARES + 0.001)
    plan = scanning(shape, electrode_radius=radius, overlap=overlap)
    (layer,) = follow(program_text(read_template(), [ProgramLayer(1, 1.0, half_width)], plan))
    # The chords of the circles drawn here fall short of the arcs by less than a thousandth.
    region = swept(layer, radius / 1000 * 1.001)
    assert region.geom_type == "Polygon"
    assert all(shapely.Polygon(hole).area < 1e-6 for hole in region.interiors)


def test_squares_with_too_little_overlap_would_leave_islands():
    path = []
    for offset in contour_offsets(1000.0, 100.0, LEAST_OVERLAP_OF_SQUARES - 0.02):
        path += [(offset, offset), (-offset, offset), (-offset, -offset), (offset, -offset),
                 (offset, offset)]  # fmt: skip
    assert len(shapely.LineString(path).buffer(100.0, quad_segs=64).interiors) > 0


@pytest.mark.parametrize(
    ("half_width", "offsets"),
    [
        (250.0, [200.0, 120.0, 40.0]),
        (240.0, [190.0, 110.0, 30.0]),
        (170.0, [120.0, 40.0]),
        (130.0, [80.0, 0.0]),
        (90.0, [40.0]),
        (50.0, [0.0]),
        (30.0, [0.0]),
    ],
)
def test_contours(half_width, offsets):
    assert contour_offsets(half_width, 50.0, 0.2) == offsets


@settings(deadline=None)
@given(st.floats(0.2, 5000), st.floats(0.01, 500), st.floats(0, 0.99))
def test_contours_go_inwards_to_a_covered_centre(half_width, radius, overlap):
    if half_width / (radius * (1 - overlap)) > 1e4:
        return
    offsets = contour_offsets(half_width, radius, overlap)
    assert all(inner < outer for outer, inner in pairwise(offsets))
    assert 0 <= offsets[-1] <= max(radius * (1 - overlap), 0.05) + 1e-9
    assert offsets[0] == pytest.approx(max(half_width - radius, 0.0), abs=0.05 + 1e-9)


def test_single_plunge_says_so():
    program = program_text(read_template(), [ProgramLayer(7, 5.0, 20.0)], scanning())
    assert "(LAYER 7: SUM OF FEEDS 0.0050, HALF WIDTH 0.0200)" in program
    assert "G0 X0.0000 Y0.0000\nG1 Z-0.0050 F2\n(SINGLE PLUNGE AT THE CENTRE)\nG0 Z1" in program


def test_program_warns_in_its_header(tmp_path):
    path = tmp_path / "cavity.nc"
    write_program(path, read_template(), LAYERS, scanning(side_gap=3.0))
    text = path.read_text()
    assert "GENERIC ISO G-CODE, NO MAKER'S DIALECT: CHECK BEFORE RUNNING" in text
    assert "ELECTRODE RADIUS 0.0500, EXPECTED SIDE GAP 0.0030" in text
    assert "-0.0000" not in text
    assert text.isascii()
    assert text.endswith("M30\n")


@pytest.mark.parametrize(
    ("layers", "sentence"),
    [
        ([], "the program has no layer: give at least one"),
        ([ProgramLayer(1, 0.0, 9.0)], "layer 1: its cumulative feed of 0 um does not exceed"),
        (
            [ProgramLayer(1, 9.0, 9.0), ProgramLayer(2, 8.0, 9.0)],
            "layer 2: its cumulative feed of 8 um does not exceed the 9 um above it: give the sum",
        ),
        ([ProgramLayer(1, math.nan, 9.0)], "layer 1: its cumulative feed of nan um"),
        ([ProgramLayer(1, 9.06, 9.0)], "layer 1: its cumulative feed of 9.06 um is no multiple of"),
        ([ProgramLayer(3, 9.0, 0.0)], "layer 3: its half width is 0 um: give a number greater"),
    ],
)
def test_faulty_layers(layers, sentence):
    with pytest.raises(InputError) as raised:
        program_text(read_template(), layers, scanning())
    assert sentence in str(raised.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"shape": "triangle"}, "shape 'triangle' is unknown: choose 'square' or 'circle'"),
        ({"electrode_radius": 0}, "electrode_radius is 0: give a number greater than zero"),
        ({"scan_feed": -1}, "scan_feed is -1: give"),
        ({"plunge_feed": math.inf}, "plunge_feed is inf: give"),
        ({"safe_height": math.nan}, "safe_height is nan: give"),
        ({"side_gap": -1}, "side_gap is -1: give zero or a positive number"),
        ({"overlap": 0.1}, "overlap is 0.1: give a share of the electrode's width from 0.146"),
        ({"shape": "circle", "overlap": 1}, "overlap is 1: give a share"),
    ],
)
def test_faulty_scanning(changes, sentence):
    with pytest.raises(InputError) as raised:
        scanning(**changes)
    assert sentence in str(raised.value)
