"""Programs that follow given polylines, read back by the reader of programs."""

import re
from itertools import pairwise

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io import (
    PolylineLayer,
    PolylineScanning,
    polyline_program_text,
    read_template,
    write_polyline_program,
)

SETTINGS = PolylineScanning("solid", 25.0, 12.5, 1.0, side_gap=2.0)
SQUARE = np.array([[0, 0], [100, 0], [100, 100.04], [100, 100.0], [0, 100]], float)
SPOT = np.array([[300.0, -50.0]])


def moves(text):
    """Every move in order, as (lifted or cutting, x, y, z) in um, by a reading of its own."""
    at, found = {"X": 0.0, "Y": 0.0, "Z": 0.0}, []
    for line in text.splitlines():
        if not line.startswith(("G0", "G1")):
            continue
        for axis, value in re.findall(r"([XYZ])(-?[\d.]+)", line):
            at[axis] = 1000 * float(value)
        found.append((line[:2], *(round(at[a], 6) for a in "XYZ")))
    return found


def test_polylines_are_followed_and_the_electrode_is_lifted_between_them():
    layers = [PolylineLayer(1, 5.5, 50.0, [SQUARE, SPOT]), PolylineLayer(2, 9.0, 50.0, [SQUARE])]
    program = moves(polyline_program_text(read_template(), layers, SETTINGS))
    at_depth = [m for m in program if m[3] == -5.5]
    assert at_depth == [
        ("G1", 0.0, 0.0, -5.5),
        ("G1", 100.0, 0.0, -5.5),
        # The move of 0.04 um is below a written step.
        ("G1", 100.0, 100.0, -5.5),
        ("G1", 0.0, 100.0, -5.5),
        ("G1", 300.0, -50.0, -5.5),
    ]
    # Between places that are apart it is lifted.
    for before, after in pairwise(program):
        if before[1:3] != after[1:3] and after[0] == "G0":
            assert before[3] == after[3] == 1000.0
    assert sum(m[3] == -9.0 for m in program) == 4


def test_turns_of_the_electrode_stop_the_program_once_each():
    layers = [PolylineLayer(n, 2.0 * n, 25.0, [SQUARE], t) for n, t in enumerate([0, 1, 1, 2], 1)]
    text = polyline_program_text(read_template(), layers, SETTINGS)
    turns = re.findall(r"M0 \(LAYER (\d): ELECTRODE TURNED BY (\d)", text)
    assert turns == [("2", "1"), ("4", "2")]


def test_template_and_header(tmp_path):
    template = tmp_path / "ours.toml"
    template.write_text('turn = "G10 C{quarter_turns}"\nheader = "{shape} {electrode_radius}"\n')
    path = tmp_path / "part.nc"
    layers = [PolylineLayer(1, 2.0, 25.0, [SQUARE], 3)]
    write_polyline_program(path, read_template(template), layers, SETTINGS)
    assert path.read_text().splitlines()[:2] == ["SOLID 0.0250", "G10 C3"]
    template.write_text('turn = "M0"')
    with pytest.raises(InputError, match=r"'turn' lacks '\{quarter_turns\}'"):
        read_template(template)


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        ([], "no layer"),
        ([PolylineLayer(3, 5.0, 9.0, [])], "layer 3: it has no way to follow"),
        ([PolylineLayer(1, 5.0, 9.0, [SPOT]), PolylineLayer(2, 5.0, 9.0, [SPOT])], "layer 2"),
        ([PolylineLayer(1, 5.05, 9.0, [SPOT])], "no multiple"),
    ],
)
def test_faulty_layers(layers, words):
    with pytest.raises(InputError, match=words):
        polyline_program_text(read_template(), layers, SETTINGS)


@pytest.mark.parametrize("name", ["electrode_radius", "scan_feed", "plunge_feed", "safe_height"])
def test_settings_are_above_0(name):
    values = {"electrode_radius": 1.0, "scan_feed": 1.0, "plunge_feed": 1.0, name: 0.0}
    with pytest.raises(InputError, match=f"{name} is 0"):
        PolylineScanning("solid", **values)
