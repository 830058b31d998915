"""The experiment after Nishikawa et al., shortened: the paper's numbers, and the fit once more.

`growth` knows nothing of the library: it steps through the cut of one pitch in plain NumPy, goes
through the air in one step, and takes the largest eigenvalue of the map.
"""

import json
from dataclasses import replace
from math import acos, cos, exp, log, pi, sin, sqrt

import numpy as np
import pytest

from calibration.plans.avoidance import Run
from calibration.plans.avoidance_log import LogRow
from experiments.comparison import deviations
from experiments.nishikawa_chatter_avoidance import recording, run, slopes, study, sweep
from experiments.nishikawa_chatter_avoidance.conditions import (
    LONG_60,
    LONG_85,
    SHORT_60,
    Paper,
)
from procmodel.errors import InputError

# Typed from the paper.
PAPERS = {
    "chatter from": 18000.0,
    "no chatter up to": 16000.0,
    "chatter frequency at 18000": 3850.0,
    "displacement: power at 18000": 0.00192,
    "displacement: largest distance, good": 23.27,
    "displacement: least distance, chatter": 71.07,
    "displacement: their ratio": 3.05,
    "acceleration: power at 18000": 0.0154,
    "acceleration: largest distance, good": 13.64,
    "acceleration: least distance, chatter": 30.58,
    "acceleration: their ratio": 2.24,
    "85 deg: speed reached": 7500.0,
    "60 deg: speed reached": 13500.0,
}


def propagator(w, zeta, t):
    """Free motion of position and velocity over a time."""
    wd, decay = w * sqrt(1.0 - zeta**2), exp(-zeta * w * t)
    s, c = decay * sin(wd * t) / wd, decay * cos(wd * t)
    return np.array([[c + zeta * w * s, s], [-(w**2) * s, c - zeta * w * s]])


def growth(mill, speed):
    """ln |mu| per second of two modes that regenerate, cutting up."""
    w, rotation = 2.0 * pi * mill.frequency, speed / 60.0
    mass = mill.stiffness / w**2
    leave = acos(1.0 - 2.0 * mill.immersion)
    # Teeth in the cut, each with the mean 1/2 of the square of a sine.
    brake = mill.process * mill.width / (2.0 * pi * 0.001 * rotation) * 2.0 * leave / (2.0 * pi) / 2
    zeta = mill.damping + brake / (2.0 * mass * w)
    pitch, cut = 1.0 / (2.0 * rotation), leave / (2.0 * pi * rotation)
    n = max(16, round(24.0 * cut * mill.frequency))
    h = cut / n
    # Columns: two positions, two velocities, two displacements at every step of the cut before.
    size = 4 + 2 * n
    state, before = np.eye(size)[:4], np.eye(size)[4:].reshape(n, 2, size)
    half, whole, through = (propagator(w, zeta, t) for t in (0.5 * h, h, pitch - cut))

    def free(motion, step):
        return np.concatenate(
            [
                step[0, 0] * motion[:2] + step[0, 1] * motion[2:],
                step[1, 0] * motion[:2] + step[1, 1] * motion[2:],
            ]
        )

    after = []
    for i in range(n):
        phi = leave * (i + 0.5) / n
        out, ahead = np.array([sin(phi), cos(phi)]), np.array([cos(phi), -sin(phi)])
        per_chip = -mill.width * mill.tangential * (ahead + mill.normal * out)
        tip = free(state, half)[:2]
        # A force constant in the step acts on the displacement in its middle as well.
        own = (1.0 - half[0, 0]) / w**2 / mass
        matrix = np.eye(2) - own * np.outer(per_chip, out)
        tip = tip + own * np.linalg.solve(matrix, np.outer(per_chip, out @ (tip - before[i])))
        force = np.outer(per_chip, out @ (tip - before[i])) / mass
        state = free(state, whole)
        state[:2] += (1.0 - whole[0, 0]) / w**2 * force
        state[2:] += whole[0, 1] * force
        after.append(tip)
    step = np.concatenate([free(state, through), *after])
    return log(np.abs(np.linalg.eigvals(step)).max()) / pitch


@pytest.fixture(scope="module")
def expected():
    return run.expected_numbers()


@pytest.fixture(scope="module")
def swept():
    return sweep.swept(speeds=(16000.0, 18000.0, 28000.0), windows=13, repetitions=6)


@pytest.fixture(scope="module")
def both():
    return slopes.both_slopes(2.2, 25, (1.0, 0.9, 0.5))


def test_expected_numbers_are_the_papers(expected):
    theirs = {name: entry["value"] for name, entry in expected.items() if "paper" in entry["kind"]}
    assert theirs == PAPERS
    paper = Paper()
    for i, sensor in enumerate(("displacement", "acceleration")):
        assert PAPERS[f"{sensor}: largest distance, good"] == paper.worst_good[i]
        assert PAPERS[f"{sensor}: least distance, chatter"] == paper.least_bad[i]
        assert paper.least_bad[i] / paper.worst_good[i] == pytest.approx(paper.ratio[i], abs=5e-3)


@pytest.mark.parametrize(
    ("mill", "stable", "chatters"),
    [
        (SHORT_60, (10000, 14000, 16000), range(18000, 28001, 2000)),
        (LONG_60, (13500,), (15000,)),
        (LONG_85, (7500,), (9000, 10500, 12000, 13500, 15000)),
    ],
    ids=["short, 60 deg", "long, 60 deg", "long, 85 deg"],
)
def test_the_fit_by_another_law(mill, stable, chatters):
    assert max(growth(mill, s) for s in stable) < 0.0
    assert min(growth(mill, s) for s in chatters) > 0.0


def test_without_damping_by_the_process_the_fit_fails():
    free = replace(SHORT_60, process=0.0)
    assert max(growth(free, s) for s in (10000, 14000, 16000)) > 0.0


def test_growth_of_library_and_plain_numpy(swept):
    plain = [growth(SHORT_60, s) for s in swept.speeds]
    # 24 steps in a cycle are off by some 1/s.
    np.testing.assert_allclose(swept.growth, plain, rtol=0.02, atol=5.0)


def test_the_sweep_is_as_expected(swept, expected):
    numbers = run.sweep_numbers(swept)
    off = deviations(numbers, expected)
    assert {name: value for name, value in off.items() if value > 1} == {}


def test_a_quieter_sensor_would_not_fit(swept, expected):
    # Half the noise is four times the distance.
    louder = replace(swept, distance=4.0 * swept.distance)
    off = deviations(run.sweep_numbers(louder), expected)
    assert off["displacement: least distance, chatter"] > 1
    assert off["acceleration: least distance, chatter"] > 1


def test_the_loop_ends_where_the_papers_did(both, expected):
    off = deviations(run.slope_numbers(both), expected)
    assert max(off.values()) <= 1
    for slope in (85, 60):
        assert both.off[slope].changes == 0
        assert both.vibration(slope, True) < 0.5 * both.vibration(slope, False)
        assert 0.0 < both.first_alarm(slope) < 0.8


def test_the_measured_cut(expected):
    found = recording.detected()
    if found is None:
        pytest.skip(f"no measured data: {recording.FILE} is absent; set PROCMODEL_DATA")
    off = deviations(run.recording_numbers(found), expected)
    assert max(off.values()) <= 1


def test_without_the_data_the_measured_cut_is_left_out(monkeypatch, tmp_path):
    monkeypatch.setattr(recording, "FILE", tmp_path / "data.mat")
    assert recording.detected() is None
    assert run.recording_numbers(None) == {}
    assert "set PROCMODEL_DATA" in run.about_recording(None)


def made_up(energy, lost, chatters):
    size = 2e-5 if chatters else 1e-7
    blocks = np.array([0.1, 0.2])
    return Run(
        (), (), blocks, np.ones(2), np.ones(2), np.full(2, size), energy, 2.0 + lost, lost, 1
    )


def made_up_study():
    rng = np.random.default_rng(2)
    bad = np.arange(12) < 7
    return study.Study(
        {
            name: tuple(
                made_up(1e-9 * rng.lognormal(shift, 0.3), lost, b and name == study.HOLD)
                for b in bad
            )
            for name, shift, lost in (
                (study.HOLD, 1.0, 0.0),
                (study.FIXED, 0.0, 0.6),
                (study.FREQUENCY, 0.0, 0.1),
                (study.COST, -0.5, 0.0),
            )
        },
        np.array([100.0]),
    )


def test_differences_of_policies_are_paired():
    found = made_up_study()
    assert found.chattering.sum() == 7
    energy, lost = found.against(study.COST, study.FIXED, chattering=True)
    ratio = found.energy(study.COST)[:7] / found.energy(study.FIXED)[:7]
    assert energy.mean == pytest.approx(np.mean(np.log10(ratio)))
    assert energy.interval90[1] < 0.0 and energy.pairs == 7
    assert lost.mean == pytest.approx(-0.6)


def test_thresholds_lie_between_the_labels():
    quiet, loud = made_up(1e-9, 0.0, False), made_up(1e-9, 0.0, True)

    def scored(base, score):
        rows = tuple(
            LogRow(0.1 * i, 1.0, 100.0, score * 1.1**i, 500.0, "cutting", "stable", "")
            for i in range(6)
        )
        return replace(base, log=rows)

    runs = tuple(scored(b, s) for b, s in ((quiet, 5.0), (quiet, 8.0), (loud, 60.0), (loud, 90.0)))
    found = study._thresholds(runs, 1, 50)
    assert found.min() > 5.0 * 1.1**5 and found.max() < 90.0
    with pytest.raises(InputError, match="all alike"):
        study._thresholds(runs[:2], 1, 50)


def test_the_command_writes_table_numbers_and_pictures(
    swept, both, expected, tmp_path, monkeypatch, capsys
):
    results = run.Results(swept, both, made_up_study(), None)
    monkeypatch.setattr(run, "compute", lambda: results)
    assert run.main(["--out", str(tmp_path / "new")]) == 0
    printed = capsys.readouterr().out
    assert "OFF" not in printed and "12 simulated cuts, 7 of which chatter" in printed
    written = json.loads((tmp_path / "new" / "results.json").read_text(encoding="utf-8"))
    assert written["key_numbers"]["85 deg: speed reached"]["as_expected"] is True
    pictures = sorted((tmp_path / "new").glob("*.png"))
    assert len(pictures) == 5
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)
    assert (tmp_path / "new" / "slope_85.csv").read_text().startswith("time [s],override [%]")


def test_the_command_fails_when_a_number_is_off(swept, both, tmp_path, monkeypatch, capsys):
    results = run.Results(swept, both, made_up_study(), None)
    monkeypatch.setattr(run, "compute", lambda: results)
    monkeypatch.setattr("experiments.nishikawa_chatter_avoidance.figures.draw_all", lambda *_: [])
    entries = run.expected_numbers()
    entries["60 deg: speed reached"]["value"] += 1500.0
    monkeypatch.setattr(run, "expected_numbers", lambda: entries)
    assert run.main(["--out", str(tmp_path)]) == 1
    assert "OFF" in capsys.readouterr().out


def test_a_machine_of_the_study(monkeypatch):
    monkeypatch.setattr(study, "WIDE", (1.0, 0.5))
    machine = study._machine(np.random.default_rng([1, 0]), 2, 0)
    assert len(machine.plants) == len(machine.depths) == 2
    assert {o: a.rotation for o, a in machine.air.items()} == {
        o: pytest.approx(o * machine.spindle.rotation) for o in (1.0, 0.5)
    }
    # Half the speed, twice the damping by the process.
    full, half = (machine.damping_at(o * machine.spindle.rotation) for o in (1.0, 0.5))
    np.testing.assert_allclose(half - machine.damping, 2.0 * (full - machine.damping))
