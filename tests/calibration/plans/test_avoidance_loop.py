"""The loop by itself, on signals made for it; its log; policies compared."""

import csv
import math

import numpy as np
import pytest

from calibration.plans import avoidance_loop
from calibration.plans.avoidance_comparison import paired
from calibration.plans.avoidance_log import HEADINGS, LogRow, format_log, write_log
from calibration.plans.avoidance_loop import Loop, Spindle, baselines_of
from calibration.plans.avoidance_policies import Decision, FixedSteps
from procmodel.chatter import CHATTER, DetectorSettings, Windowing, air_cut
from procmodel.errors import InputError
from procmodel.io.baselines import OverrideBaseline, StoredBaseline, load_baselines, save_baselines
from tests.procmodel.chatter.shapes import forced, line

RATE, LENGTH, ROTATION = 6400.0, 512, 100.0
OVERRIDES = (1.0, 0.9, 0.8, 0.7)
SPINDLE = Spindle(ROTATION, 40.0, 0.05)
SETTINGS = DetectorSettings(
    Windowing(RATE, LENGTH, LENGTH), (50.0, 3000.0), averaged_threshold=None
)


def noise(count, rotation, seed, height=0.2):
    samples = np.random.default_rng(seed).normal(size=(count, 1))
    return samples + forced(samples, rotation, height, rate=RATE)


def air(override, windows=40):
    turning = override * ROTATION
    return air_cut(noise(windows * LENGTH, turning, 3), SETTINGS.windowing, turning)


def made(policy=None, overrides=OVERRIDES, spindle=SPINDLE):
    return Loop(SETTINGS, {o: air(o) for o in overrides}, spindle, policy or FixedSteps(overrides))


def driven(loop, blocks=60, stable_below=0.75):
    """A machine that follows at once; air at first, then a cut that chatters at high overrides."""
    state, log, asked = avoidance_loop.start(loop), [], []
    for i in range(blocks):
        turning = state.override * ROTATION
        block = noise(LENGTH, turning, 100 + i, 0.2 if i < 6 else 1.5)
        if i >= 6 and state.override > stable_below:
            block = block + line(block, 1137.0, 4.0, RATE)
        before = state.override
        state, rows, _ = avoidance_loop.step(loop, state, block)
        log += rows
        if state.override != before:
            asked.append(((i + 1) * LENGTH / RATE, before, state.override))
    return state, log, asked


@pytest.fixture(scope="module")
def run():
    loop = made()
    return loop, *driven(loop)


def test_it_goes_down_until_the_chatter_is_gone(run):
    _, state, log, asked = run
    assert [(a, b) for _, a, b in asked] == [(1.0, 0.9), (0.9, 0.8), (0.8, 0.7)]
    assert state.override == 0.7 and state.changes == 3
    settled = [r for r in log if r.override == 0.7]
    assert len(settled) > 10 and {r.outcome for r in settled} <= {"stable", "marginal", ""}
    assert all(r.rotation == pytest.approx(70.0) for r in settled)


def test_two_of_five_windows_at_every_override(run):
    _, _, log, _ = run
    for override in (0.9, 0.8):
        here = [r for r in log if r.override == override]
        assert len(here) == 2 and here[-1].outcome == CHATTER
        assert min(r.score for r in here) > SETTINGS.threshold
        # The line lies between two bins of 12.5 Hz.
        assert here[-1].frequency == pytest.approx(1137.0, abs=4.0)
        assert here[-1].decision.startswith("chatter at 113") and not here[0].decision


def test_nothing_is_judged_while_the_spindle_changes_its_speed(run):
    loop, _, log, asked = run
    for when, before, after in asked:
        ready = when + loop.spindle.change(before, after)
        assert loop.spindle.change(before, after) == pytest.approx(0.1 * 100 / 40 + 0.05)
        first = next(r for r in log if r.time > when)
        assert first.time - LENGTH / RATE >= ready - 1e-9
        assert first.time - LENGTH / RATE < ready + 1.0 / RATE


def test_without_chatter_nothing_is_done():
    loop = made()
    state, log, asked = driven(loop, 40, stable_below=2.0)
    assert asked == [] and state.override == 1.0
    assert {r.decision for r in log} == {""}
    assert any(r.engagement == "cutting" for r in log)


def test_steps_are_pure():
    loop = made()
    first = avoidance_loop.start(loop)
    block = noise(2 * LENGTH, ROTATION, 1)
    state, rows, _ = avoidance_loop.step(loop, first, block)
    again, same, _ = avoidance_loop.step(loop, first, block)
    assert rows == same and len(rows) == 2
    assert state.seen.next == again.seen.next and first.seen.windows == 0


def test_an_override_near_a_baseline_has_its_own_lines_left_out():
    loop = made()
    detector = loop.detector_at(0.705)
    assert detector.rotation.frequency == pytest.approx(70.5)
    away = np.abs(SETTINGS.windowing.frequencies / 70.5 - 20.0) * 70.5
    assert not detector.free[np.argmin(away)]


class Wild:
    """Wants what nobody recorded."""

    def start(self):
        return None

    def decide(self, state, seen):
        return state, Decision(0.6, "down.")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: driven(made(Wild())), "no baseline is within 2 % of the override 60 %"),
        (lambda: made(overrides=(0.9, 0.8)), "no baseline is within 2 % of the override 100 %"),
        (lambda: Loop(SETTINGS, {}, SPINDLE, FixedSteps()), "the loop has no baseline"),
        (
            lambda: Loop(SETTINGS, {1.0: air(0.9)}, SPINDLE, FixedSteps()),
            "the baseline of the override 100 % was made at 5400 1/min, .* turns at 6000",
        ),
        (lambda: Spindle(0.0, 1.0), "rotation of the spindle is 0 rev/s"),
        (lambda: Spindle(1.0, math.inf), "acceleration of the spindle is inf rev/s"),
        (lambda: Spindle(1.0, 1.0, -0.1), "settling is -0.1 s"),
    ],
)
def test_what_cannot_work_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_baselines_from_a_file(tmp_path):
    parts = [
        OverrideBaseline(
            100.0 * o, 60.0 * o * ROTATION, a.baseline.count, a.baseline.mean, a.baseline.squares
        )
        for o, a in ((o, air(o)) for o in OVERRIDES)
    ]
    stored = StoredBaseline(RATE, LENGTH, LENGTH, "hann", ("channel 1",), ("m",), tuple(parts))
    save_baselines(tmp_path / "air.h5", stored)
    found = baselines_of(load_baselines(tmp_path / "air.h5"))
    loop = Loop(SETTINGS, found, SPINDLE, FixedSteps(OVERRIDES))
    for o in OVERRIDES:
        ours, theirs = loop.detector_at(o), made().detector_at(o)
        np.testing.assert_allclose(ours.scorer.gain, theirs.scorer.gain, rtol=1e-12)
        assert ours.rotation.frequency == pytest.approx(theirs.rotation.frequency, rel=1e-12)


def test_the_log_can_be_read_back(run, tmp_path):
    _, _, log, _ = run
    write_log(tmp_path / "log.csv", log)
    with open(tmp_path / "log.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0]) == HEADINGS and len(rows) == len(log) + 1
    for read, row in zip(rows[1:], log, strict=True):
        assert float(read[0]) == pytest.approx(row.time, abs=1e-4)
        assert float(read[1]) == pytest.approx(100 * row.override)
        assert float(read[2]) == pytest.approx(60 * row.rotation, abs=0.05)
        assert read[7] == row.decision


def test_the_log_leaves_out_what_is_not_known():
    row = LogRow(0.5, 1.0, 100.0, math.nan, math.nan, "air", "", 'said "so", then.')
    assert list(csv.reader(format_log([row]).splitlines()))[1] == [
        "0.5000", "100.00", "6000.0", "", "", "air", "", 'said "so", then.',
    ]  # fmt: skip


def test_paired_differences_have_the_interval_of_their_mean():
    rng = np.random.default_rng(4)
    base = rng.normal(0.0, 10.0, 400)
    off = rng.normal(0.0, 1.0, 400)
    found = paired(base + off, base, seed=1)
    assert found.mean == pytest.approx(off.mean()) and found.pairs == 400
    half = 1.6449 * off.std() / math.sqrt(400)
    # 4000 bootstrap samples tell a quantile to about 2 % of the deviation.
    np.testing.assert_allclose(
        found.interval90, off.mean() + np.array([-half, half]), atol=0.1 * half
    )
    assert found.interval90[0] < 0.0 < found.interval90[1]
    # Four deviations of the mean are told apart, though cuts differ by ten times more.
    shifted = paired(base + off + 0.2, base, seed=1)
    assert shifted.interval90[0] > 0.0
    with pytest.raises(InputError, match="as many as each other"):
        paired([1.0, 2.0], [1.0])
