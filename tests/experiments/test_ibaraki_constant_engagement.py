"""The cut of Ibaraki et al.: key numbers, and all of them again in plain Python.

`plain_numbers` knows nothing of the library: circles are intersected by triangles, forces summed by
Simpson's rule, Newton steps taken with derivatives by hand.
"""

import json
from dataclasses import replace
from math import acos, asin, atan, atan2, cos, degrees, hypot, pi, sin, sqrt, tan

import numpy as np
import pytest

from experiments.comparison import deviations
from experiments.ibaraki_constant_engagement import passes, run
from experiments.ibaraki_constant_engagement.conditions import PAPERS_CUT, open_wall

R, AE, RP = 5.0, 0.1, 8.0
RC, RW = RP - R, RP - AE
TARGET = acos(1 - AE / R)
# Al7075-T6: Chin. J. Mech. Eng. 34, 2021, doi 10.1186/s10033-021-00536-9, table 5.
KTC, KRC, KTE, KRE = 767.01, 168.8, 27.7, 26.6
FLUTES, DEPTH, FEED, HELIX = 4, 5.0, 0.04, pi / 6


def angle_in(surface, path):
    """On concentric arcs of the surface and of the tool's centre."""
    return acos((surface**2 - R**2 - path**2) / (2 * R * path))


def before_arc(s):
    """The tool's centre on the line, a distance s before the arc."""
    to = hypot(s, RC)
    return pi / 2 + atan2(RC, s) - acos((to**2 + R**2 - RW**2) / (2 * to * R))


def overshoot_after():
    """Greatest angle behind a previous tool of radius R in the corner of its path."""
    wanted = sqrt((RC + R * cos(TARGET)) ** 2 + (R * sin(TARGET)) ** 2)
    # Centre of the previous tool in its corner, from the arc's centre: parallel to line and arc.
    y = AE + R - RP
    x = sqrt((wanted - R) ** 2 - y**2)
    # Of two circles of radius R the rim leaves the stock at their common point beyond the chord.
    greatest = 0.0
    for i in range(-4000, 4001):
        s = 1e-4 * i
        if s <= 0:
            ox, oy, heading = s, -RC, 0.0
        else:
            heading = s / RC
            ox, oy = RC * sin(heading), -RC * cos(heading)
        gap = hypot(x - ox, y - oy)
        half = sqrt(R**2 - gap**2 / 4)
        middle = (ox + x) / 2, (oy + y) / 2
        for sign in (1, -1):
            px = middle[0] + sign * half * (y - oy) / gap
            py = middle[1] - sign * half * (x - ox) / gap
            # On the arc around the corner, between its ends on the line and on the wanted arc.
            turn = atan2(px - x, y - py)
            if 0.0 <= turn <= atan2(x, -y):
                greatest = max(greatest, atan2(py - oy, px - ox) + pi / 2 - heading)
    return greatest


def flute_integrals(alpha, count=400):
    """Of the force along and across, over the engaged angle; Simpson's rule."""
    along = across = 0.0
    h = alpha / count
    for i in range(count + 1):
        phi = pi - alpha + i * h
        weight = h / 3 * (1 if i in (0, count) else 4 if i % 2 else 2)
        ft, fr = KTC * FEED * sin(phi) + KTE, KRC * FEED * sin(phi) + KRE
        along += weight * (-ft * cos(phi) - fr * sin(phi))
        across += weight * (ft * sin(phi) - fr * cos(phi))
    return along, across


def plain_numbers():
    arc = angle_in(RW, RC)
    floor = overshoot_after()
    kink = degrees(atan(R / RC * sin(TARGET) / (1 + R / RC * cos(TARGET))))
    numbers = {
        "angle on the line": degrees(TARGET),
        "angle in the arc": degrees(arc),
        "angle per radial depth on the line": degrees(1 / (R * sin(TARGET))),
        "radial depth that holds the angle in the arc": RP
        - sqrt(RC**2 + R**2 + 2 * RC * R * cos(TARGET)),
        "transition: .8, .5, .25, 0 mm before the arc": [
            degrees(before_arc(s)) for s in (0.8, 0.5, 0.25, 0.0)
        ],
        "transition: begins before the arc": R * sin(TARGET),
        "transition: ends before the arc's end": RC * asin(R * sin(arc) / RW),
        "transition: greatest distance from the closed form": 0.0,
        "algorithm II: kinks of the wanted surface": [kink, -kink],
        "algorithm II: overshoot before": 100 * (arc / TARGET - 1),
        "algorithm II: overshoot after": 100 * (floor / TARGET - 1),
        "algorithm II: floor of the overshoot": 100 * (floor / TARGET - 1),
        "algorithm II: greatest angle after": degrees(floor),
        "algorithm II: least angle after": degrees(TARGET),
        "pocket: overshoot before": 100 * (arc / TARGET - 1),
        "pocket: overshoot after": 100 * (floor / TARGET - 1),
        "pocket: left on the wall after": 0.0,
    }
    return {**numbers, **newton_numbers(arc), **forward_numbers(), **force_numbers(arc, floor)}


def newton_numbers(arc):
    def off(angle):
        return 100 * (angle / TARGET - 1)

    # Slope of the cosine by the radius of the path, and by that of the surface.
    by_path = -(RW**2 - R**2) / (2 * R * RC**2) - 1 / (2 * R)
    by_surface = RW / (R * RC)
    dc = cos(TARGET) - cos(arc)
    da = -(TARGET - arc) * sin(arc)
    # The paper's mode takes its slope over a hundred thousandth of the radius.
    h = 1e-5 * R
    difference = (angle_in(RW, RC + h) - arc) / h
    return {
        "newton: path, one step in the angle, off": off(
            angle_in(RW, RC + (TARGET - arc) / difference)
        ),
        "newton: path, one step in the cosine, off": off(angle_in(RW, RC + dc / by_path)),
        "newton: surface, one step in the angle, off": off(angle_in(RW + da / by_surface, RC)),
        "newton: surface, one step in the cosine, off": off(angle_in(RW + dc / by_surface, RC)),
        "newton: path, steps from place to place, off": 0.0,
        "newton: converged, moved in the arc": steady_path(RW) - RC,
    }


def steady_path(surface):
    """Radius of the path of constant engagement in an endless arc."""
    return sqrt(surface**2 - (R * sin(TARGET)) ** 2) - R * cos(TARGET)


def forward_numbers():
    surface, left = RP - 3 * AE, []
    for number in (1, 2, 3):
        surface = steady_path(surface) + R
        left.append(RP - (3 - number) * AE - surface)
    return {"algorithm I: angle off": 0.0, "algorithm I: left after each pass": left}


def force_numbers(arc, floor):
    lag = tan(HELIX) / R
    # One flute is in the cut at a time, and at some instant with all of the engaged angle.
    assert floor < arc < lag * DEPTH < 2 * pi / FLUTES - arc
    flute = {a: flute_integrals(a) for a in (TARGET, arc, floor)}
    peak = {a: hypot(*f) / lag for a, f in flute.items()}
    mean = {a: FLUTES * DEPTH / (2 * pi) * hypot(*f) for a, f in flute.items()}
    line, most, junction = (flute[a][1] / lag for a in (TARGET, arc, floor))
    numbers = {
        "force: wall, arc over line": most / line,
        "force: mean, line and arc": [mean[TARGET], mean[arc]],
        "force: peak, line and arc": [peak[TARGET], peak[arc]],
        "force: greatest mean and peak after": [mean[floor], peak[floor]],
        "force: variation of the peak, before": peak[arc] - peak[TARGET],
        "force: variation of the peak, after": peak[floor] - peak[TARGET],
    }
    for name, datum in (("absolute", 0.0), ("arc less line", line)):
        stiffness = (most - datum) / 0.014
        numbers |= {
            f"14 um {name}: fitted stiffness": stiffness,
            f"14 um {name}: left in the arc, before": 14.0,
            f"14 um {name}: on the lines": 1e3 * (line - datum) / stiffness,
            f"14 um {name}: junction more than line, after": 1e3 * (junction - line) / stiffness,
        }
    return numbers


@pytest.fixture(scope="module")
def results():
    return run.compute()


@pytest.fixture(scope="module")
def expected():
    return run.expected_numbers()


def test_every_key_number_is_as_expected(results, expected):
    numbers = run.key_numbers(results)
    assert numbers.keys() == expected.keys()
    off = deviations(numbers, expected)
    assert {name: value for name, value in off.items() if value > 1} == {}


def test_expected_numbers_are_those_of_plain_python(expected):
    plain = plain_numbers()
    assert plain.keys() == expected.keys()
    for name, value in plain.items():
        # expected.json is written to twelve digits.
        np.testing.assert_allclose(
            expected[name]["value"], value, rtol=1e-10, atol=1e-11, err_msg=name
        )


def test_plain_numbers_are_those_of_the_notes():
    # Typed from the physics notes on engagement, to their digits.
    plain = plain_numbers()
    notes = {
        "angle on the line": (11.478, 5e-4),
        "angle in the arc": (18.738, 5e-4),
        "angle per radial depth on the line": (57.6, 0.05),
        "transition: .8, .5, .25, 0 mm before the arc": (
            [11.6356, 12.7340, 14.9054, 18.7375],
            6e-5,
        ),
        "transition: begins before the arc": (0.995, 5e-4),
        "transition: ends before the arc's end": (0.614, 5e-4),
        "algorithm II: kinks of the wanted surface": ([7.18, -7.18], 5e-3),
        "algorithm II: overshoot before": (63.2, 0.05),
        "algorithm II: floor of the overshoot": (12.41, 5e-3),
        "algorithm II: greatest angle after": (12.902, 5e-4),
        "newton: surface, one step in the angle, off": (-22.0, 0.5),
        "newton: surface, one step in the cosine, off": (-0.33, 5e-3),
    }
    for name, (value, digits) in notes.items():
        np.testing.assert_allclose(plain[name], value, rtol=0, atol=digits, err_msg=name)


@pytest.mark.parametrize("wrong", [{"radius": 4.9}, {"corner": 7.9}])
def test_a_wrong_radius_is_rejected(wrong, expected):
    conditions = replace(PAPERS_CUT, **wrong)
    numbers = run.geometry_numbers(passes.on_open_wall(conditions), conditions)
    off = deviations(numbers, expected)
    of_the_line = {
        "angle on the line",
        "angle per radial depth on the line",
        "transition: begins before the arc",
        "algorithm II: least angle after",
    }
    # The line knows nothing of its corner; and formula and survey agree for any radius.
    blind = of_the_line if "corner" in wrong else set()
    agreement = "transition: greatest distance from the closed form"
    assert {name for name, value in off.items() if value <= 1} - {agreement} == blind


def test_the_corrected_wall_is_nowhere_cut_deeper_than_asked(results):
    assert results.wall.after.angle.min() == pytest.approx(TARGET, abs=1e-10)
    assert results.pocket.miss == pytest.approx((0.0, 0.0), abs=1e-9)


def test_wall_and_arc_meet_without_a_corner():
    pieces = open_wall(PAPERS_CUT).segments.on_host()
    np.testing.assert_allclose(pieces.curvature, [0.0, 1 / RP, 0.0], atol=1e-12)
    np.testing.assert_allclose(pieces.direction, [[1, 0], [1, 0], [0, 1]], atol=1e-12)


def test_stiffness_and_coefficients_are_said_to_be_confounded(results):
    for reading in (results.loads.absolute, results.loads.relative):
        assert any("cannot be told apart" in note for note in reading.fit.notes)


def test_the_command_writes_table_numbers_and_pictures(results, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda: results)
    assert run.main(["--out", str(tmp_path / "new")]) == 0
    printed = capsys.readouterr().out
    assert "angle in the arc" in printed and "OFF" not in printed
    written = json.loads((tmp_path / "new" / "results.json").read_text(encoding="utf-8"))
    assert written["key_numbers"]["angle in the arc"]["as_expected"] is True
    pictures = sorted((tmp_path / "new").glob("*.png"))
    assert len(pictures) == 6
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)


def test_the_command_fails_when_a_number_is_off(results, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda: results)
    monkeypatch.setattr("experiments.ibaraki_constant_engagement.figures.draw_all", lambda *_: [])
    entries = run.expected_numbers()
    entries["angle in the arc"]["value"] += 0.1
    monkeypatch.setattr(run, "expected_numbers", lambda: entries)
    assert run.main(["--out", str(tmp_path)]) == 1
    assert "OFF" in capsys.readouterr().out
