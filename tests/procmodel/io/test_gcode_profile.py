"""Programs along profiles: the moves, the planes' senses, templates and what is refused."""

import math

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io.gcode_profile import ProfileSettings, profile_program_text, write_profile_program
from procmodel.io.polyline import BulgePolyline

SETTINGS = ProfileSettings(feed=1.5, safe_x=0.5)


def polyline(points, bulges, name="finishing"):
    return BulgePolyline(np.array(points), np.array(bulges), False, name)


def test_lines_and_arcs():
    quarter = math.tan(math.pi / 8)
    path = polyline([[0.1, 0], [0.2, 0.05], [0.15, 0.1], [0.2, 0.15]], [0, quarter, -quarter])
    text = profile_program_text([path], SETTINGS)
    # A quarter from (.2, .05) to (.15, .1), from X to Z: its centre is (.15, .05). The next one
    # turns the other way, about (.2, .1).
    assert text.splitlines()[5:] == [
        "G0 X0.5000", "(PASS 1: FINISHING)", "G0 Z0.0000", "G1 X0.1000 F1.5",
        "G1 X0.2000 Z0.0500 F1.5",
        "G2 X0.1500 Z0.1000 I-0.0500 K0.0000 F1.5",
        "G3 X0.2000 Z0.1500 I0.0500 K0.0000 F1.5",
        "G0 X0.5000", "M30",
    ]  # fmt: skip
    assert "G18" in text and "SPINDLE TURNING" in text


def test_wide_arcs_become_two_and_flat_ones_lines():
    wide = polyline([[0.2, 0.0], [0.2, 0.1]], [math.tan(math.radians(270) / 4)])
    text = profile_program_text([wide], SETTINGS)
    assert text.count("G2 ") == 2
    flat = polyline([[0.2, 0.0], [0.2, 0.01], [0.2, 0.01001], [0.3, 0.02]], [1e-4, 0, 0])
    text = profile_program_text([flat], SETTINGS)
    assert (text.count("G2 "), text.count("G1 ")) == (0, 3)


def test_every_flat_repeats_every_pass():
    path = polyline([[0.1, 0], [0.2, 0.1]], [0])
    text = profile_program_text([path, path], ProfileSettings(1.0, 0.5, (0.0, 120.0, 240.0)))
    assert text.count("M0\n") == 6 and text.count("(PASS 2") == 3
    assert "3 FLATS" in text and "TO 240.0000 DEGREES" in text


def test_template(tmp_path):
    template = tmp_path / "mine.toml"
    template.write_text('line = "L X{x:.3f} Z{z:.3f}"\n')
    out = tmp_path / "out.nc"
    write_profile_program(out, [polyline([[0.1, 0], [0.2, 0.1]], [0])], SETTINGS, template)
    assert "\nL X0.200 Z0.100\n" in out.read_text()
    for text, words in (('line = "X{x}"', "{z}"), ('line = "X{x} Z{z} {y}"', "{y}"),
                        ('lines = "X"', "line")):  # fmt: skip
        template.write_text(text)
        with pytest.raises(InputError, match=r"mine\.toml") as caught:
            profile_program_text([polyline([[0.1, 0], [0.2, 0.1]], [0])], SETTINGS, template)
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: profile_program_text([], SETTINGS), ("no path",)),
        (lambda: profile_program_text([polyline([[0.1, 0], [0.6, 0.1]], [0])], SETTINGS),
         ("x = 0.6", "safe_x of 0.5")),
        (lambda: profile_program_text([polyline([[0.45, 0], [0.45, 0.2]], [1.0])], SETTINGS),
         ("x = 0.55", "safe_x")),
        (lambda: profile_program_text([polyline([[0.1, 0], [0.1, 1e-5]], [0])], SETTINGS),
         ("shorter",)),
        (lambda: ProfileSettings(0.0, 0.5), ("feed",)),
        (lambda: ProfileSettings(1.0, math.nan), ("safe_x",)),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(InputError) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert all(word in str(caught.value) for word in words), caught.value
