"""The cavities of Yu and Masuzawa (1997): key numbers, their independent sums, the loop.

Every number in expected.json that is not a simulation is summed here again in plain Python from
eqs (3) and (4), without the library.
"""

import json
from dataclasses import replace
from itertools import accumulate
from math import atan, pi, sqrt

import numpy as np
import pytest

from experiments.comparison import deviations
from experiments.yu_1997_cavities import loop, run
from experiments.yu_1997_cavities.cavities import (
    compensated,
    finished,
    paper_wall,
    ring_is_thick_enough,
    startup_decay,
)
from experiments.yu_1997_cavities.conditions import ASSUMED, cone_frustum, pyramid_frustum

RHO = 0.17 / 50**2


@pytest.fixture(scope="module")
def results():
    return run.compute()


@pytest.fixture(scope="module")
def expected():
    return run.expected_numbers()


def test_every_key_number_is_as_expected(results, expected):
    off = deviations(run.key_numbers(results), expected)
    assert {name: value for name, value in off.items() if value > 1} == {}


def test_the_known_answers_are_those_of_the_notes(expected):
    # Typed from section 1 of the physics notes on wear, to its digits.
    assert expected["known: depth"]["value"] == 79.322654
    assert expected["known: compensated total"]["value"] == 130.8
    assert expected["known: their limit"]["value"] == 101.759586
    assert expected["known: total of 125 feeds"]["value"] == 1055.349477
    assert sum(e["kind"] == "known answer" for e in expected.values()) == 9


def test_wear_ratios_off_by_ten_percent_are_rejected(expected):
    numbers = run.key_numbers(run.compute(ASSUMED.with_wear_scaled(1.1)))
    off = deviations(numbers, expected)
    sensitive = [
        name
        for name, entry in expected.items()
        if entry["kind"] == "known answer"
        or "plain" in name
        or "electrode" in name
        or name in ("constant feed: depth", "constant feed: depth, limit", "loop: R")
    ]
    assert len(sensitive) == 9 + 3 + 5 + 3
    assert {name: off[name] for name in sensitive if off[name] <= 1} == {}


def test_expected_walls_and_lengths_agree_with_plain_sums(expected):
    areas = {
        "pyramid frustum": [4 * (150 - n) ** 2 for n in range(110)],
        "cone frustum": [pi * (150 - n / sqrt(3)) ** 2 for n in range(150)],
        "hemisphere": [pi * (150**2 - n**2) for n in range(1, 148)],
    }
    for name, area in areas.items():
        mean_feed = sum(1 + RHO * a for a in area) / len(area)
        for way, feed in (("plain", 1.0), ("even", mean_feed)):
            worst = worst_error([feed] * len(area), area, RHO)
            assert expected[f"{name}: error, {way}"]["value"] == pytest.approx(worst, abs=1e-6)
        length = RHO * sum(area)
        assert expected[f"{name}: electrode"]["value"] == pytest.approx(length, abs=1e-5)


def test_expected_finishing_agrees_with_plain_sums(expected):
    shapes = {
        "cone frustum": [150 - n / sqrt(3) for n in range(150)],
        "hemisphere": [sqrt(150**2 - n**2) for n in range(1, 149)],
    }
    for name, half_widths in shapes.items():
        # Roughing reaches as far as the circle of its electrode's area fits into the core.
        core = [max(x - 25, 0) if x - 25 >= 50 / sqrt(pi) else 0 for x in half_widths]
        ring = [pi * (x**2 - c**2) for x, c in zip(half_widths, core, strict=True)]
        lengths = [RHO * pi * sum(c**2 for c in core), 0.26 / (400 * pi) * sum(ring)]
        assert expected[f"{name}, finished: electrodes"]["value"] == pytest.approx(
            lengths, abs=1e-5
        )
        feeds = [1 + 0.17 / (400 * pi) * a for a in ring]
        short = worst_error(feeds, ring, 0.26 / (400 * pi))
        assert expected[f"{name}, finished: error, roughing R"]["value"] == pytest.approx(
            short, abs=1e-3
        )


def worst_error(feeds, areas, wear_per_area):
    """Greatest wall error of layers 1 um deep."""
    depths = accumulate(f / (1 + wear_per_area * a) for f, a in zip(feeds, areas, strict=True))
    return max(abs(z - n) for n, z in enumerate(depths, start=1))


def test_the_uncompensated_depth_agrees_with_sum_and_arctangent(expected):
    depth = sum(2 / (1 + RHO * 4 * (150 - 2 * n) ** 2) for n in range(55))
    k = 2 * sqrt(RHO)
    limit = (atan(k * 150) - atan(k * 40)) / k
    assert expected["constant feed: depth"]["value"] == pytest.approx(depth, abs=1e-6)
    assert expected["constant feed: depth, limit"]["value"] == pytest.approx(limit, abs=1e-6)


def test_without_wear_the_walls_are_as_intended():
    dry = ASSUMED.with_wear_scaled(1e-9)
    cavity = compensated(pyramid_frustum(dry), dry)
    assert cavity.max_error(cavity.plain) < 1e-5
    assert paper_wall(dry).depths[-1] == pytest.approx(110.0, abs=1e-5)


def test_a_ring_thinner_than_half_the_electrode_is_refused():
    assert ring_is_thick_enough(ASSUMED.ring, ASSUMED.finishing.size)
    assert not ring_is_thick_enough(20.0, 40.0)
    with pytest.raises(ValueError, match="ring of 20 um"):
        finished(cone_frustum(ASSUMED), replace(ASSUMED, ring=20.0))


def test_wall_error_of_the_loop_follows_from_the_error_of_the_fit(results):
    fitted = results.fit.result.parameters["wear_ratio"].value
    for cut in results.loop:
        area = np.asarray(cut.schedule.layers.area)
        ratio = (1 + fitted / 2500 * area) / (1 + 0.17 / 2500 * area)
        predicted = np.cumsum(ratio - 1)
        # Half the resolution of the cumulative feed.
        np.testing.assert_allclose(cut.wall_error, predicted, rtol=0, atol=0.05)


def test_a_wear_ratio_off_by_ten_percent_leaves_the_band(results):
    wrong = replace(ASSUMED.roughing, wear_ratio=1.1 * ASSUMED.roughing.wear_ratio)
    for cut in results.loop:
        assert cut.inside_band
        assert not loop.planned_cut(cut.wanted, results.fit, wrong, ASSUMED).inside_band


@pytest.mark.slow
def test_the_bias_by_sharp_steps_is_of_first_order_in_the_step(results):
    halved = replace(ASSUMED, test_step=1.0, test_feed=1.0, test_layers=110)
    assert loop.staircase_bias(halved) == pytest.approx(results.staircase_bias / 2, rel=0.1)


@pytest.mark.slow
def test_the_band_holds_as_often_as_it_says(expected):
    entry = expected["loop: share inside band"]
    share = loop.coverage(pyramid_frustum(ASSUMED), ASSUMED, run.REPEATS)
    assert share == pytest.approx(entry["value"], abs=entry["tolerance"])


@pytest.mark.parametrize(("u", "decay"), [(0.25, 0.05), (1, 0.22), (2, 0.40), (8, 0.83)])
def test_startup_decay(u, decay):
    # Physics notes on wear, section 3, to their two digits.
    assert startup_decay(u) == pytest.approx(decay, abs=0.005)


@pytest.mark.slow
def test_the_command_writes_table_numbers_and_pictures(results, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda repeats: results)
    assert run.main(["--out", str(tmp_path / "new")]) == 0
    printed = capsys.readouterr().out
    assert "known: depth" in printed and "OFF" not in printed
    written = json.loads((tmp_path / "new" / "results.json").read_text(encoding="utf-8"))
    assert written["key_numbers"]["known: depth"]["as_expected"] is True
    pictures = sorted((tmp_path / "new").glob("*.png"))
    assert len(pictures) == 5
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)


def test_the_command_fails_when_a_number_is_off(results, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda repeats: results)
    monkeypatch.setattr("experiments.yu_1997_cavities.figures.draw_all", lambda *_: [])
    entries = run.expected_numbers()
    entries["known: depth"]["value"] += 1.0
    monkeypatch.setattr(run, "expected_numbers", lambda: entries)
    assert run.main(["--out", str(tmp_path)]) == 1
    assert "OFF" in capsys.readouterr().out
