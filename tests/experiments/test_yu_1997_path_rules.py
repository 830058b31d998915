"""The path rules in simulation: key numbers on coarse cells, plain formulas, the command.

The known answers hold for coarse cells and few layers too; what depends on the cells is only
looked at for its order, and for what must not depend on them.
"""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from experiments.comparison import deviations
from experiments.yu_1997_path_rules import compensation, cutting, hemisphere, known, rules, run
from experiments.yu_1997_path_rules.conditions import CHOSEN
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.zmap_maps import WorkpieceMap

COARSE = replace(CHOSEN, cell=2.5, fine_cell=1.25)


@pytest.fixture(scope="module")
def expected():
    return run.expected_numbers()


@pytest.fixture(scope="module")
def all_rules():
    return {name: rules.cut_variant(COARSE, rules.ALL, name) for name in ("flat", "rotating")}


def off(name, value, expected):
    return deviations({name: value}, expected)[name]


def test_the_tilt_of_a_groove_approaches_its_law(expected):
    tilts = [known.tilt(COARSE, stretch) for stretch in (1.0, 2.0)]
    one_way = [tilt.one_way[-1] for tilt in tilts]
    assert off("known: tilt one way, of a long path", 2 * one_way[1] - one_way[0], expected) <= 1
    # The electrode's own length is a share of the path that halves with a path twice as long.
    assert (0.5 - one_way[0]) / (0.5 - one_way[1]) == pytest.approx(2.0, rel=0.1)
    for tilt in tilts:
        first, second = tilt.to_and_fro
        assert first == pytest.approx(-second, abs=1e-3)
        assert abs(second) < tilt.one_way[-1]
        assert tilt.one_way[0] == pytest.approx(tilt.one_way[1], abs=1e-4)


def test_expected_numbers_follow_from_the_equations(expected):
    # u / (1 + u) at u = 1, L_e over the feed.
    assert expected["known: tilt one way, of a long path"]["value"] == 1 / (1 + 1)
    u = 0.2 * 255**2 / 50**2
    assert u == pytest.approx(5.2, abs=0.01)
    assert u / 5 == pytest.approx(1.04, abs=0.001)
    # Four gaps between the ends of five lines, 50 um apart, that end 27.5 um from the wall.
    radius, half = 27.5, 25.0
    under = 0.5 * (half * math.sqrt(radius**2 - half**2) + radius**2 * math.asin(half / radius))
    share = 4 * 2 * (radius * half - under) / (255**2 - (4 - math.pi) * radius**2)
    entry = expected["no rule, rotating: share uncut"]
    assert share == pytest.approx(entry["value"], abs=entry["tolerance"])
    # Periphery, four lines inside and the ways between them; five lines alone.
    assert expected["path of a layer: all rules, no rule"]["value"] == [
        4 * 200 + 4 * 200 + 4 * 40,
        5 * 200 + 200,
    ]
    feeds = expected["levelling: feeds, u = 1"]["value"]
    assert feeds == [0.5, 0.2, 0.08, 0.03]


def test_wedge_and_cone_of_linear_compensation(expected):
    wedge = known.linear_tip(COARSE, False, 2.5)
    cones = [known.linear_tip(COARSE, True, cell) for cell in (2.5, 1.25)]
    assert wedge.wanted == pytest.approx(0.01 / 0.2)
    assert cones[0].wanted == pytest.approx(math.pi * 0.01 / 0.2)
    assert off("known: wedge slope over k / R", wedge.slope / wedge.wanted, expected) <= 1
    error = [1 - cone.slope / cone.wanted for cone in cones]
    assert error[0] / error[1] == pytest.approx(2.0, rel=0.1)
    assert abs(error[0] - 2 * error[1]) < 0.01
    for shape, area in ((wedge, 2500.0), (cones[1], math.pi * 625)):
        assert shape.wanted_area == pytest.approx(0.01 / 0.2 * area, rel=2e-3)
        assert shape.area == pytest.approx(shape.wanted_area, rel=0.01)


@pytest.mark.slow
def test_levelling_beats_the_tilt_of_the_law(expected):
    groove = known.levelled_groove(COARSE, 2.0)
    assert off("simulated: tilt after levelling, u = 1", groove.after, expected) <= 1
    assert off("law: tilt after levelling, u = 1", groove.by_law[1], expected) <= 1
    assert off("levelling: feeds, u = 1", list(groove.plan.feeds / 4.0), expected) <= 1
    # Without the passes' falling feeds the tilt stays.
    assert groove.before > 0.4


@pytest.mark.slow
def test_layers_of_the_pocket_obey_eq_3_and_conserve_volume(all_rules, expected):
    for row in all_rules.values():
        assert abs(row.volume) < 1e-12
        assert row.law == pytest.approx(0.0, abs=5e-4)
    gentle = replace(COARSE, wear_ratio=COARSE.gentle_wear_ratio)
    depth = compensation.start_up(gentle, "rotating")
    assert depth[-1] == pytest.approx(1.0, abs=1e-4)
    # Before the start-up is over it does not hold.
    assert abs(depth[0] - 1) > 0.1


@pytest.mark.slow
def test_flatness_and_tip_are_those_of_the_feed_at_any_feed(all_rules):
    flat = all_rules["flat"].floor
    assert flat.inside < 1 and flat.tip < 1e-9
    # Rule 1: what the rules do is in proportion to the feed, to rounding.
    rotating = all_rules["rotating"].floor
    tenfold = rules.cut_variant(replace(COARSE, feed=40.0), rules.ALL, "rotating").floor
    assert tenfold.inside == pytest.approx(rotating.inside, rel=1e-9)
    assert tenfold.tip == pytest.approx(rotating.tip, rel=1e-9)
    assert tenfold.foot == pytest.approx(math.sqrt(10) * rotating.foot, rel=1e-9)


@pytest.mark.slow
def test_overlap_and_turning_do_what_the_paper_says(all_rules):
    bare = rules.cut_variant(COARSE, "no overlap, one direction", "rotating")
    assert bare.floor.inside > 1.2 * all_rules["rotating"].floor.inside
    assert rules.cut_variant(COARSE, "no rule", "rotating").uncovered > 0.01
    assert all_rules["rotating"].uncovered < 1e-4
    turned, kept = (rules.slot(COARSE, turning) for turning in (True, False))
    assert turned.floor.tip < 0.6 * kept.floor.tip
    assert turned.made.job.steps.quarter_turns[:5].tolist() == [0, 1, 2, 3, 0]
    assert not np.any(kept.made.job.steps.quarter_turns)


def test_radii_are_those_of_fillets_that_are_drawn():
    box = shapely.box(-50, -50, 50, 50)
    path = LayerPath(np.array([[-25.0, -25.0], [25.0, 25.0]]), np.ones(1, bool))
    job = cutting.Job(box, [path], COARSE.square, "local", 0.2, 1.0)
    surface = WorkpieceMap.around(job.steps, job.electrode)
    x, y = np.meshgrid(surface.x, surface.y, indexing="ij")

    def drawn(depth):
        loss = np.zeros((50, 50))
        # The electrode's rim is rounded by 6 um.
        into = np.clip(np.abs(job.electrode.centres[0]) - 19.0, 0.0, 6.0)
        loss += 6.0 - np.sqrt(36.0 - into**2)
        state = SimpleNamespace(surface=surface, depth=depth, electrode_loss=loss)
        return cutting.Cut(job, np.zeros(0), (state,))

    wall = np.minimum(50 - np.abs(x), 50 - np.abs(y))
    # A floor of 20 um with a fillet of 9 um along its walls.
    into = np.clip(9.0 - wall, 0.0, 9.0)
    made = drawn(np.where(wall > 0, 20.0 - (9.0 - np.sqrt(81.0 - into**2)), 0.0))
    assert cutting.foot_radius(made) == pytest.approx(9.0, rel=0.03)
    # Two of its four sides.
    assert cutting.rim_radius(made) == pytest.approx(6.0 / math.sqrt(2), rel=0.03)
    # Vertical walls with corners of 15 um from above.
    round_box = shapely.box(-35, -35, 35, 35).buffer(15, quad_segs=64)
    made = drawn(np.where(shapely.contains_xy(round_box, x, y), 20.0, 0.0))
    assert cutting.corner_radius(made, 10.0) == pytest.approx(15.0, rel=0.06)


@pytest.mark.slow
def test_the_hemisphere_needs_its_own_feeds(expected):
    few = replace(COARSE, draws=2)
    bowl = hemisphere.bowl(few)
    plans = hemisphere.plans(bowl, few, searched=False)
    made = {name: hemisphere.cut_plan(bowl, name, f, few) for name, f in plans.items()}
    for name in ("constant feed", "eq. (3)"):
        assert off(f"hemisphere: rms, {name}", made[name].right[0], expected) <= 1
    assert made["eq. (3)"].right[0] < 0.1 * made["constant feed"].right[0]
    # The feeds of eq. (3) are summed again in plain Python: section at the bottom, eq. (6).
    area = bowl.electrode.section_area
    feeds = [2 * (1 + 0.2 / area * math.pi * (100**2 - (2 * n) ** 2)) for n in range(1, 49)]
    np.testing.assert_allclose(made["eq. (3)"].feeds, feeds, rtol=1e-3)
    wrong = hemisphere.cut_bowl(bowl, plans["eq. (3)"], 0.22)[0]
    assert hemisphere.error(bowl, wrong)[0] > 2 * made["eq. (3)"].right[0]


@pytest.fixture(scope="module")
def small():
    """All parts once, on a few layers: what the numbers are does not matter here."""
    few = replace(COARSE, layers=8, watched=2, draws=1, many_passes=4)
    return run.compute(few, names=run.DRAWN, searched=False)


@pytest.mark.slow
def test_the_command_writes_tables_numbers_and_pictures(small, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda **_: small)
    # Too few layers for the known answers: the command has to say so.
    assert run.main(["--out", str(tmp_path / "new"), "--no-search"]) == 1
    printed = capsys.readouterr().out
    assert "known: wedge slope" in printed and "OFF" in printed and "slot, turned" in printed
    written = json.loads((tmp_path / "new" / "results.json").read_text(encoding="utf-8"))
    assert written["key_numbers"]["known: wedge slope over k / R"]["as_expected"] is True
    assert written["rules"][0]["inside"] is None
    pictures = sorted((tmp_path / "new").glob("*.png"))
    assert len(pictures) == 2
    # All that is compared is expected, and all that is expected is compared.
    searched = {f"hemisphere: rms, {name}" for name in run.hemisphere.SEARCHED}
    assert set(run.key_numbers(small)) | searched == set(run.expected_numbers())
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)
