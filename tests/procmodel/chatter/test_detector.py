"""The detector: streaming equals the whole to the bit, rules, masks, faults, refusals."""

import itertools
import math

import numpy as np
import pytest

from procmodel.chatter import (
    CHATTER,
    MARGINAL,
    STABLE,
    BadWindows,
    DetectorSettings,
    EngagementRule,
    air_cut,
    detect,
    distance,
    growth_rate,
    observed,
    power_spectra,
    prepare,
    require_matching,
    restarted,
    scores,
    start,
    step,
    taper,
    windows_of,
)
from procmodel.chatter.detector_rules import fault_of, longest_run, outcome_after, passed
from procmodel.chatter.rotation import Rotation
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes import (
    LENGTH,
    RATE,
    ROTATION,
    air,
    detector,
    line,
    noise,
    stable_cut,
    windowing,
)

CHATTER_LINE = 5.37 * ROTATION


@pytest.fixture(scope="module")
def baseline():
    return air()


@pytest.fixture(scope="module")
def cut():
    """Air for 2 s, a stable cut for 4 s with chatter growing in its second half, air for 2 s."""
    samples = stable_cut(8.0, 3)
    quiet = noise(8.0, 3)
    seconds = np.arange(len(samples)) / RATE
    cutting = (seconds > 2.0) & (seconds < 6.0)
    samples = np.where(cutting[:, None], samples, quiet)
    height = np.where(cutting & (seconds > 4.0), 0.01 * np.exp(5.0 * (seconds - 4.0)), 0.0)
    return samples + line(samples, CHATTER_LINE, lambda _: np.minimum(height, 2.0))


def in_blocks(what, samples, sizes):
    state, events, observations, at = start(), [], [], 0
    for size in sizes:
        state, found, seen = observed(what, state, samples[at : at + size])
        events += found
        observations += seen
        at += size
    assert at >= len(samples)
    return state, events, observations


# repr of a float is exact, and that of NaN equals itself.
@pytest.mark.parametrize("changes", [{}, {"hop": 64}, {"hop": 17}, {"hop": 100}, {"length": 75}])
@pytest.mark.parametrize("channels", [1, 3])
def test_streaming_equals_the_whole_to_the_bit(changes, channels):
    rate, rng = 1000.0, np.random.default_rng(4)
    chosen = windowing(**{"rate": rate, "length": 64, "hop": None, **changes})
    samples = rng.normal(size=(3000, channels))
    samples[500:2500] *= 3.0
    samples[1200:2200] += line(samples[1200:2200], 213.0, lambda t: 0.2 * np.exp(4.0 * t), rate)
    samples[1500, 0], samples[700:760] = np.nan, 1.0
    quiet = air_cut(rng.normal(size=(4000, channels)), chosen, 70.0)
    what = prepare(
        DetectorSettings(chosen, (20.0, 450.0), 20.0, teeth=2, averaged_threshold=15.0), quiet
    )
    whole = detect(what, samples)
    assert whole.events and whole.state.bad.not_finite and whole.state.bad.stuck
    for sizes in (
        [1] * 3000,
        [5000],
        [63, 64, 65, 0, 1, 3000],
        *(np.random.default_rng(i).integers(0, 400, size=100) for i in range(3)),
    ):
        state, events, observations = in_blocks(what, samples, sizes)
        assert repr(tuple(events)) == repr(whole.events)
        assert repr(tuple(observations)) == repr(whole.observations)
        assert (state.windows, state.bad, state.engagement, state.received) == (
            whole.state.windows,
            whole.state.bad,
            whole.state.engagement,
            3000,
        )
    assert state.windows == chosen.count(3000)


def test_a_step_changes_nothing_that_was_there(baseline, cut):
    what, block = detector(baseline), cut[: 3 * LENGTH // 2].copy()
    state, _ = step(what, start(), block)
    before = repr(state)
    kept = [x.copy() for x in state.pending]
    # The caller's buffer is used again for the next block.
    block[:] = 7.0
    once = step(what, state, cut[3 * LENGTH // 2 : 9 * LENGTH])
    assert repr(state) == before
    np.testing.assert_array_equal(state.pending, kept)
    again = step(what, state, cut[3 * LENGTH // 2 : 9 * LENGTH])
    assert repr(once) == repr(again)


@pytest.mark.parametrize("kind", ["hann", "rectangular"])
@pytest.mark.parametrize("channels", [1, 3])
def test_scores_follow_the_laws(kind, channels):
    quiet = air(channels=channels, taper=kind)
    samples = noise(3.0, 6, channels)
    samples[:, -1:] += line(samples, 1111.0, 0.5)
    settings = DetectorSettings(quiet.windowing, (500.0, 9000.0))
    found = scores(samples, quiet, settings)
    free = prepare(settings, quiet).free
    spectra = power_spectra(windows_of(samples, LENGTH, LENGTH // 2), taper(kind, LENGTH, np), np)
    distances = np.where(free, distance(spectra, quiet.baseline, np), -np.inf)
    np.testing.assert_allclose(found.score, distances.max(axis=(1, 2)), rtol=1e-9)
    where = distances.max(axis=1).argmax(axis=1) * RATE / LENGTH
    assert (np.abs(found.frequency - where) <= 0.5 * RATE / LENGTH + 1e-9).all()
    np.testing.assert_array_equal(found.channel, distances.max(axis=2).argmax(axis=1))
    # The bias of the parabola, see the test of the vertex: 0.17 bins without a taper.
    assert np.median(found.frequency) == pytest.approx(1111.0, abs=0.17 * RATE / LENGTH)
    band = (quiet.windowing.frequencies >= 500.0) & (quiet.windowing.frequencies <= 9000.0)
    level = (spectra / quiet.baseline.mean)[..., band].mean(axis=(1, 2))
    np.testing.assert_allclose(found.level, level, rtol=1e-9)
    np.testing.assert_allclose(found.time, (np.arange(len(level)) + 2) * LENGTH / 2 / RATE)


def test_scores_are_those_of_the_detector_to_the_bit(baseline, cut):
    what = detector(baseline)
    found = detect(what, cut)
    batch = scores(cut, baseline, what.settings)
    assert [o.score for o in found.observations] == batch.score.tolist()
    assert [o.level for o in found.observations] == batch.level.tolist()
    assert [o.time for o in found.observations] == batch.time.tolist()


def test_a_window_that_is_not_finite_is_not_scored(baseline, cut):
    spoiled = cut.copy()
    spoiled[10 * LENGTH] = np.inf
    batch = scores(spoiled, baseline, DetectorSettings(baseline.windowing, (100.0, 10000.0)))
    assert (~batch.sound).sum() == 2
    assert np.isnan(batch.score[~batch.sound]).all() and np.isfinite(batch.score[batch.sound]).all()


def test_the_whole_story_of_a_cut(baseline, cut):
    found = detect(detector(baseline), cut)
    first = found.events[0]
    assert first.state == CHATTER and first.channel == "channel 1"
    assert 4.0 < first.time_s < 5.0
    assert first.frequency_hz == pytest.approx(CHATTER_LINE, abs=1.0)
    # It grows at 5 1/s until it is full at 5.06 s; noise keeps the first windows back.
    assert first.growth_rate == pytest.approx(5.0, rel=0.25)
    assert "chatter at" in first.sentence and "growing" in first.sentence
    states = [(o.time, o.engagement) for o in found.observations]
    assert all(s == "air" for t, s in states if t < 2.0 or t > 6.6)
    assert all(s == "cutting" for t, s in states if 2.5 < t < 5.9)
    outcomes = [(o.time, o.outcome) for o in found.observations]
    assert {o for t, o in outcomes if t < 2.0 or t > 6.6} == {""}
    assert {o for t, o in outcomes if 2.5 < t < 4.0} == {STABLE}
    assert {o for t, o in outcomes if 5.0 < t < 5.9} == {CHATTER}
    assert found.score_max == max(o.score for o in found.observations if o.outcome)


def test_without_the_mask_forced_lines_give_alarms():
    quiet = air()
    stable = stable_cut(4.0, 31)
    assert detect(detector(quiet), stable).events == ()
    blind = detect(detector(quiet, mask=False), stable)
    assert blind.events and blind.events[0].time_s < 1.0
    order = blind.events[0].frequency_hz / ROTATION
    assert order == pytest.approx(round(order), abs=0.01)


def test_without_refining_a_slipping_spindle_gives_alarms():
    true = ROTATION * 1.004
    quiet = air(rotation=true)._replace(rotation=ROTATION)
    stable = stable_cut(4.0, 32, rotation=true)
    assert detect(detector(quiet), stable).events == ()
    settings = DetectorSettings(quiet.windowing, (100.0, 10000.0))
    nominal = prepare(settings, quiet, Rotation(ROTATION, 0.0))
    assert detect(nominal, stable).events


def test_ignored_lines_and_mains_are_not_chatter():
    quiet = air(seed=2)
    samples = stable_cut(3.0, 33)
    samples = samples + line(samples, 1730.0, 1.0) + line(samples, 350.0, 1.0)
    assert detect(detector(quiet), samples).events
    assert detect(detector(quiet, ignored=(1730.0,), mains=50.0), samples).events == ()


def test_averaging_finds_a_line_that_votes_do_not():
    quiet = air(seconds=10.0)
    samples = stable_cut(6.0, 34)
    samples = samples + line(samples, CHATTER_LINE, 0.25)
    votes = {"threshold": 100.0, "averaged_threshold": None}
    assert detect(detector(quiet, **votes), samples).events == ()
    found = detect(detector(quiet, threshold=100.0, averaged_threshold=20.0), samples).events
    assert found[0].statistic == "averaged distance"
    assert found[0].frequency_hz == pytest.approx(CHATTER_LINE, abs=1.0)
    clean = stable_cut(6.0, 35)
    assert detect(detector(quiet, averaged_threshold=20.0), clean).events == ()


def test_a_marginal_cut_is_told_only_when_asked():
    quiet = air(seconds=10.0)
    samples = stable_cut(4.0, 36)
    # Distance of this line: (A^2 / 2) (2/3) / (2 / n) = 68, its share of the middle Hann bin.
    samples = samples + line(samples, 875.0 * RATE / LENGTH, math.sqrt(0.1))
    plain = detect(detector(quiet, averaged_threshold=None), samples)
    assert plain.events == ()
    assert {o.outcome for o in plain.observations[8:]} == {MARGINAL}
    told = detect(detector(quiet, averaged_threshold=None, report_marginal=True), samples)
    assert [e.state for e in told.events] == [MARGINAL]


def test_it_speaks_again_when_chatter_has_grown():
    quiet = air()
    samples = stable_cut(6.0, 37)
    samples = samples + line(samples, CHATTER_LINE, lambda t: 0.2 * np.exp(0.5 * t))
    # From 100 to 5 e^6 times as much power: by factors of 10, two more times.
    again = detect(detector(quiet), samples).events
    assert len(again) >= 2
    assert all(b.score > 8.0 * a.score for a, b in itertools.pairwise(again))
    assert len(detect(detector(quiet, again=1e9), samples).events) == 1


def test_entry_may_be_left_out_of_the_votes():
    quiet = air()
    samples = noise(6.0, 38)
    samples[: 2 * LENGTH] = 0.3 * samples[: 2 * LENGTH]
    cutting = slice(2 * LENGTH, None)
    samples[cutting] += (stable_cut(6.0, 38) - noise(6.0, 38))[cutting]
    samples[cutting] += line(samples, CHATTER_LINE, 2.0)[cutting]
    rule = EngagementRule(entry_windows=3)
    early = detect(detector(quiet, engagement=rule), samples).events[0]
    late = detect(detector(quiet, engagement=rule, entry_votes=False), samples).events[0]
    assert late.time_s == pytest.approx(early.time_s + 0.5 * LENGTH / RATE)


def test_after_a_change_of_speed_the_old_one_is_forgotten(baseline, cut):
    what = detector(baseline)
    until = round(5.5 * RATE)
    state, events = step(what, start(), cut[:until])
    assert events and state.cut.outcome == CHATTER
    fresh = restarted(state, skip=1000)
    assert fresh.engagement == state.engagement and fresh.windows == state.windows
    assert fresh.cut.outcome == "" and fresh.cut.peaks == ()
    _, _, seen = observed(what, fresh, cut[until : until + 1000 + LENGTH])
    assert [o.time for o in seen] == [(until + 1000 + LENGTH) / RATE]


def test_growth_rate_of_an_exponential():
    time = np.arange(6) * 0.08
    assert growth_rate(time, 3.0 * np.exp(2 * -1.7 * time)) == pytest.approx(-1.7, rel=1e-12)
    assert growth_rate(time[:2], np.ones(2)) is None


def test_votes_and_outcomes():
    assert passed([1.0, 120.0, 3.0, 101.0, 2.0], 100.0, 2)
    assert not passed([1.0, 120.0, 3.0, 100.0, 2.0], 100.0, 2)
    assert outcome_after(STABLE, True, True) == CHATTER
    assert outcome_after(CHATTER, False, True) == CHATTER
    assert outcome_after(STABLE, False, True) == MARGINAL
    assert outcome_after(CHATTER, False, False) == STABLE


def faulty(kind):
    window = np.random.default_rng(0).normal(size=(LENGTH, 2))
    if kind == "not finite":
        window[5, 1] = np.nan
    elif kind == "stuck":
        window[1000:1600, 0] = window[1000, 0]
    elif kind == "clipped":
        window[:, 1] = np.clip(3.0 * np.sin(0.05 * np.arange(LENGTH)), -2.0, 2.0)
    elif kind == "held twice":
        window = np.repeat(window[::2], 2, axis=0)
    elif kind == "coarse":
        window = np.round(window)
    elif kind == "stuck for a moment":
        window[1000:1400, 0] = window[1000, 0]
    return window


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        ("not finite", "not finite"),
        ("stuck", "stuck"),
        ("clipped", "clipped"),
        ("sound", ""),
        ("held twice", ""),
        ("coarse", ""),
        ("stuck for a moment", ""),
    ],
)
def test_faults_of_windows(kind, fault):
    window = faulty(kind)
    assert fault_of(window, float(window.sum()), 512, None) == fault
    if not fault:
        assert fault_of(window, 1.0, 512, 0.9 * window.max()) == "clipped"


def test_runs_are_counted_to_the_last_sample():
    assert longest_run(np.array([[1.0], [2.0], [2.0], [3.0], [3.0], [3.0]])) == 3
    assert longest_run(np.array([[1.0, 5.0], [2.0, 5.0]])) == 2


@pytest.mark.parametrize("kind", ["not finite", "stuck", "clipped"])
def test_bad_windows_are_counted_and_never_scored(kind):
    quiet = air(channels=2, hop=LENGTH)
    samples = np.concatenate([noise(0.48, 40, 2), faulty(kind), noise(0.48, 41, 2)])
    samples = samples[: 7 * LENGTH]
    samples = np.concatenate([noise(3 * LENGTH / RATE, 40, 2), faulty(kind), samples])
    found = detect(detector(quiet), samples)
    assert found.observations[3].fault == kind and math.isnan(found.observations[3].score)
    expected = BadWindows()
    for o in found.observations:
        expected = expected.and_one(o.fault) if o.fault else expected
    assert found.state.bad == expected and sum(expected) >= 1
    assert len(found.state.bad.sentences) == 1
    assert found.events == () and found.state.windows == len(found.observations)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"rate": 51200.0}, "rate 25600 Hz, the record has 51200"),
        ({"length": 2048}, "window length 4096, not 2048"),
        ({"taper": "rectangular"}, "taper 'hann', not 'rectangular'"),
    ],
)
def test_a_baseline_of_other_windows_is_refused(baseline, changes, named):
    with pytest.raises(InputError, match=named):
        prepare(DetectorSettings(windowing(**changes)), baseline)


def test_a_baseline_of_another_speed_or_other_channels_is_refused(baseline):
    cut = baseline.windowing
    require_matching(baseline, windowing(hop=100), rotation=ROTATION * 1.01)
    with pytest.raises(InputError, match="12500 1/min, the record has 15000"):
        require_matching(baseline, cut, rotation=250.0)
    with pytest.raises(InputError, match=r"has 1 channels .*, the record has 2"):
        require_matching(baseline, cut, channels=["x", "y"])
    with pytest.raises(InputError, match="of the channels channel 1, the record of x"):
        require_matching(baseline, cut, channels=["x"])
    with pytest.raises(InputError, match="spindle speed"):
        prepare(DetectorSettings(cut), baseline, Rotation(250.0, 0.0))
    with pytest.raises(InputError, match="1 channels"):
        step(detector(baseline), start(), np.ones((10, 2)))


def test_a_dead_sensor_gives_no_detector():
    quiet = air_cut(np.zeros((10 * LENGTH, 1)), windowing(), ROTATION)
    with pytest.raises(InputError, match="sensor"):
        prepare(DetectorSettings(windowing()), quiet)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"band": (500.0, 100.0)}, "band"),
        ({"threshold": 0.0}, "threshold"),
        ({"votes": 6}, "6 of 5"),
        ({"averaged": 0}, "averaged spectra"),
        ({"averaged_threshold": -1.0}, "averaged"),
        ({"margin": 0.0}, "margin"),
        ({"teeth": 0}, "teeth"),
        ({"reference_windows": 3}, "reference windows"),
        ({"slip": 0.5}, "slip"),
        ({"again": 1.0}, "repeated"),
        ({"growth_windows": 2}, "growth"),
        ({"engagement": EngagementRule(1.0, 2.0)}, "level"),
    ],
)
def test_settings_without_sense_are_refused(changes, named):
    with pytest.raises(InputError, match=named):
        DetectorSettings(windowing(), **changes)
