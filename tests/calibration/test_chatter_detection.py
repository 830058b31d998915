"""Baselines to their files and back, detection of recordings in blocks, what is flagged."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.chatter_detection import (
    Source,
    after_gap,
    air_cut_at,
    air_cut_of_record,
    detect_record,
    detector_for,
    stored,
    with_override,
)
from calibration.chatter_tally import Tally
from calibration.chatter_trace import Trace
from procmodel.chatter import (
    CHATTER,
    Observation,
    Windowing,
    detect,
    null_threshold,
    observed,
    power_spectra,
    start,
    taper,
    windows_of,
)
from procmodel.errors import InputError
from procmodel.io.baselines import load_baselines, save_baselines
from procmodel.io.records import Record, open_record
from tests.calibration.chatter_recordings import (
    BAND,
    CHATTER_HZ,
    CHATTERS,
    LENGTH,
    OUT,
    RATE,
    ROTATION,
    SPEED,
    air,
    detector,
    noise,
    recording,
    table,
)

WINDOWING = Windowing(RATE, LENGTH)
SOURCE = Source(RATE, ("y",), ("m/s^2",))


def record(samples, names=("y",)):
    return Record(Path("air.csv"), RATE, names, ("m/s^2",) * len(names), samples)


class Blocks:
    """A recording of blocks that are made when they are asked for."""

    path, start, length, fault, status = Path("made"), 0.0, None, None, "read to the end"

    def __init__(self, blocks):
        self._blocks = blocks

    def __iter__(self):
        return iter(self._blocks)


def test_a_baseline_comes_back_from_its_file_to_the_bit(tmp_path):
    made = air(names=("y",))
    save_baselines(tmp_path / "b.h5", stored(made, ("m/s^2",), 80.0))
    back = air_cut_at(load_baselines(tmp_path / "b.h5"), SPEED)
    assert (back.windowing, back.rotation, back.channels) == (
        replace(made.windowing, hop=made.windowing.step), made.rotation, made.channels,
    )  # fmt: skip
    assert back.baseline.count == made.baseline.count
    np.testing.assert_array_equal(back.baseline.mean, made.baseline.mean)
    np.testing.assert_array_equal(back.baseline.squares, made.baseline.squares)


def test_overrides_are_found_by_speed_or_by_name():
    full, slow = air(seed=3, names=("y",)), air(seed=4, names=("y",))._replace(rotation=50.0)
    both = with_override(stored(full, ("m/s^2",)), stored(slow, ("m/s^2",), 50.0))
    assert [each.override for each in both.overrides] == [100.0, 50.0]
    for speed, expected in ((5900.0, full), (4600.0, full), (4400.0, slow)):
        np.testing.assert_array_equal(air_cut_at(both, speed).baseline.mean, expected.baseline.mean)
    assert air_cut_at(both, 6000.0, override=50.0).rotation == 50.0
    with pytest.raises(InputError, match="no baseline at override 90 %, only at 100, 50"):
        air_cut_at(both, 6000.0, override=90.0)
    with pytest.raises(InputError, match="already holds a baseline at override 50 %"):
        with_override(both, stored(slow, ("m/s^2",), 50.0))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rate": 6401.0}, "the rate 6400.0, the new one has 6401.0"),
        ({"hop": 100}, "the hop 256"),
        ({"taper": "rectangular"}, "the taper hann"),
        ({"channels": ("z",)}, "the channels y, the new one has z"),
        ({"units": ("m",)}, "the units m/s"),
    ],
)
def test_one_file_holds_one_set_up(changes, said):
    first, more = stored(air(names=("y",)), ("m/s^2",)), stored(air(names=("y",)), ("m/s^2",), 50.0)
    with pytest.raises(InputError, match=said):
        with_override(first, replace(more, **changes))


def test_channels_of_a_baseline_by_name():
    made = air(channels=3, names=("x", "y", "z"))
    baselines = stored(made, ("m/s^2",) * 3)
    some = air_cut_at(baselines, SPEED, channels=("z", "x"))
    assert some.channels == ("z", "x")
    np.testing.assert_array_equal(some.baseline.mean, made.baseline.mean[[2, 0]])
    with pytest.raises(InputError, match="no channel 'w'"):
        air_cut_at(baselines, SPEED, channels=("w",))


@pytest.mark.parametrize("block", [37, 512, 100_000])
def test_a_file_in_blocks_is_the_record_as_a_whole_to_the_bit(tmp_path, block):
    samples = recording()
    path = table(tmp_path / "cut.csv", samples)
    whole = detect(detector(), samples)
    found = detect_record(open_record(path, RATE, block_length=block), detector())
    assert [e[:-1] for e in found.events] == [e[:-1] for e in whole.events]
    assert len(found.events) > 0
    assert found.tally.windows == len(whole.observations)
    assert found.tally.score_max == whole.score_max
    assert found.bad == whole.state.bad
    assert found.warnings == ()


def test_chatter_is_found_where_it_is():
    found = detect_record(Blocks([recording()]), detector())
    first = found.events[0]
    # Two windows of five, each of 0.08 s, the hop half of it.
    assert CHATTERS < first.time_s < CHATTERS + 3 * LENGTH / RATE
    assert found.tally.first == first
    assert found.tally.chatter_frequency == pytest.approx(CHATTER_HZ, abs=0.1 * RATE / LENGTH)
    assert found.tally.status.startswith(f"chatter from {first.time_s:.3f} s on, ")
    result = found.as_dict()
    assert result["windows"] == WINDOWING.count(len(recording()))
    assert sum(result["states"].values()) == result["windows"]
    assert result["score_max_air"] < 20.0 < 100.0 < result["score_max"]
    # Half the time of the cut chatters; two windows or so on either side.
    assert abs(result["states"]["chatter"] - RATE / WINDOWING.step) < 6
    assert result["rotation_hz"] == pytest.approx(ROTATION, abs=0.05)


def test_without_chatter_nothing_is_said():
    found = detect_record(Blocks([recording(amplitude=0.0)]), detector())
    assert found.events == ()
    assert found.as_dict()["chatter_frequency_hz"] is None
    assert found.tally.status.startswith("stable")
    quiet = detect_record(Blocks([noise(3.0, 8)]), detector())
    assert quiet.tally.status.startswith("not judged")
    assert quiet.as_dict()["score_max"] is None


def seen(frequency, score, outcome=CHATTER):
    return Observation(0.0, score, frequency, 9.0, 0, "cutting", outcome, None, None, "")


def test_the_frequency_of_chatter_follows_the_scores():
    tally = Tally(2.0)
    # Both lines drift; a weak one elsewhere and a window that is stable do not count.
    tally.add([seen(700.0, 100.0), seen(690.0, 300.0), seen(1500.0, 150.0)], [])
    tally.add([seen(500.0, 1e9, "stable")], [])
    assert tally.chatter_frequency == pytest.approx((70000.0 + 207000.0) / 400.0)
    assert tally.frequency == 500.0
    assert Tally(2.0).chatter_frequency is None


def test_memory_does_not_grow_with_the_recording():
    rng = np.random.default_rng(2)
    one = rng.normal(size=(4096, 1))

    def peak(blocks):
        made = detector()
        trace = Trace(made, 0.0, rows=64)
        detect_record(Blocks([one]), made)
        tracemalloc.start()
        detect_record(Blocks(one + 0.0 for _ in range(blocks)), made, trace)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    short, long = peak(40), peak(240)
    # Six times as many samples; the rest would be 6.6 MB of them.
    assert long < 1.05 * short + 20_000


def test_windows_begin_anew_behind_a_gap():
    made = detector()
    samples = recording()
    missing, before = 1000, 12_345
    state, _, _ = observed(made, start(), samples[:before])
    state = after_gap(made, state, missing)
    behind = samples[before + missing :]
    state, events, seen = observed(made, state, behind)
    alone = detect(made, behind, (before + missing) / RATE)
    assert [e.time_s for e in events] == pytest.approx([e.time_s for e in alone.events], abs=1e-9)
    assert [o.score for o in seen] == [o.score for o in alone.observations]
    assert state.received == len(samples)


@pytest.mark.parametrize(("missing", "kept"), [(1280, True), (1281, False), (None, False)])
def test_votes_survive_a_gap_no_longer_than_their_windows(missing, kept):
    made = detector()
    samples = recording()[: round(3.3 * RATE)]
    state, _, _ = observed(made, start(), samples)
    assert len(state.cut.peaks) == 5
    after = after_gap(made, state, missing)
    assert after.engagement == state.engagement
    assert bool(after.cut.peaks) is kept
    assert after.received == len(samples) + (missing or 0)


def test_what_is_wrong_with_air_is_named():
    good = noise(4.0, 5)
    assert air_cut_of_record(record(good), WINDOWING, ROTATION)[1] == []
    cases = {}
    spoilt = good.copy()
    spoilt[0] = 1e3
    cases["outlier at the start"] = spoilt
    spoilt = good.copy()
    spoilt[9000:9400] = 0.5
    cases["stuck"] = spoilt
    cases["clipped"] = np.clip(good, -1.0, 1.0)
    cases["values repeated"] = np.repeat(good[: len(good) // 2], 2, axis=0)
    cases["not steady"] = recording(seed=6)
    cases["few windows"] = good[: 3 * LENGTH]
    for name, samples in cases.items():
        _, warnings = air_cut_of_record(record(samples), WINDOWING, ROTATION)
        assert any(each.startswith(f"{name}: ") for each in warnings), name
        # A loud sample makes its window loud, and so on; but nothing else is claimed of clean ones.
        assert len(warnings) <= 2, (name, warnings)


def test_air_that_is_no_signal_is_refused():
    good = noise(4.0, 5, channels=2)
    dead = good.copy()
    dead[:, 1] = 0.25
    with pytest.raises(InputError, match="channel 'z' is stuck"):
        air_cut_of_record(record(dead, ("y", "z")), WINDOWING, ROTATION)
    good[77, 0] = np.nan
    with pytest.raises(InputError, match="sample 78 of the air cutting is not a finite number"):
        air_cut_of_record(record(good, ("y", "z")), WINDOWING, ROTATION)


@pytest.mark.parametrize(
    ("source", "speed", "window", "said"),
    [
        (Source(6500.0, ("y",), ("m/s^2",)), SPEED, None, "at the rate 6400 Hz, the record has 65"),
        (SOURCE, 6500.0, None, "at the spindle speed 6000 1/min, the record has 6500"),
        (SOURCE, SPEED, 1024, "with the window length 512, not 1024"),
        (Source(RATE, ("z",), ("m/s^2",)), SPEED, None, "the baseline has no channel 'z'"),
        (Source(RATE, ("y",), ("m",)), SPEED, None, "'y' is in m/s.2, the record in m;"),
    ],
)
def test_a_baseline_of_other_conditions_is_refused(source, speed, window, said):
    baselines = stored(air(names=("y",)), ("m/s^2",))
    with pytest.raises(InputError, match=said):
        detector_for(baselines, source, speed, window=window, band=BAND)


def test_what_speaks_against_a_baseline_is_said():
    made = air(names=("y",))
    baselines = stored(made, ("1",))
    settings = {"band": BAND, "averaged_threshold": None}
    ready, warnings = detector_for(baselines, SOURCE, SPEED, threshold=100.0, **settings)
    assert [each.split(":")[0] for each in warnings] == ["unit"]
    noise_alone = null_threshold(made.baseline.count, int(ready.free.sum()), 1e-3) - 1.0
    for threshold, expected in ((1.01 * noise_alone, 1), (0.99 * noise_alone, 2)):
        _, warnings = detector_for(baselines, SOURCE, SPEED, threshold=threshold, **settings)
        assert len(warnings) == expected
    assert f"{noise_alone:.4g} in about one of 1000 windows" in warnings[1]


@pytest.mark.parametrize(("mains", "hidden"), [(50.0, True), (60.0, False), (None, False)])
def test_mains_that_hide_the_cut_are_named(mains, hidden):
    # At 6000 1/min every line of the cut is one of 50 Hz as well.
    baselines = stored(air(names=("y",)), ("m/s^2",))
    made, warnings = detector_for(baselines, SOURCE, SPEED, band=BAND, mains=mains)
    assert [each.split(":")[0] for each in warnings] == ["hidden lines"] * hidden
    found = detect_record(Blocks([recording(amplitude=0.0)]), made)
    assert found.tally.status.startswith("not judged" if hidden else "stable")


def test_faults_within_a_recording_are_counted_by_name():
    samples = recording()
    samples[3000] = np.nan
    samples[10_000:10_200] = 0.1
    found = detect_record(Blocks([samples]), detector())
    assert found.bad.not_finite == 2
    assert found.bad.stuck >= 1
    named = " ".join(found.warnings)
    for words in ("not finite: y", "stuck", "2 windows were not scored"):
        assert words in named.replace("channel 1", "y")
    assert found.events[0].state == CHATTER


def test_images_above_the_true_bandwidth_are_named():
    samples = np.repeat(recording()[: round(2.5 * RATE)], 2, axis=0)
    wide, narrow = detector(), detector(band=(50.0, 1500.0))
    said = [each.split(":")[0] for each in detect_record(Blocks([samples]), wide).warnings]
    assert said == ["values repeated", "images"]
    said = [each.split(":")[0] for each in detect_record(Blocks([samples]), narrow).warnings]
    assert said == ["values repeated"]


def test_a_recording_without_a_window_is_refused():
    with pytest.raises(InputError, match="511 samples are there, fewer than one window of 512"):
        detect_record(Blocks([noise(1.0, 1)[:511]]), detector())
    with pytest.raises(InputError, match="and none is left; check sensor"):
        detect_record(Blocks([np.full((3000, 1), np.nan)]), detector())


@pytest.mark.parametrize("rows", [16, 64, 4096])
def test_a_trace_in_few_rows_keeps_maxima_and_means(rows):
    made, samples = detector(), recording()
    trace = Trace(made, 0.5, rows=rows)
    observations = detect(made, samples).observations
    size = 777
    state = start(0.5)
    for i in range(0, len(samples), size):
        state, _, some = observed(made, state, samples[i : i + size])
        trace.add(samples[i : i + size], some)
    count = len(observations)
    assert trace.rows == -(-count // trace.stride) <= rows
    scores = np.array([o.score for o in observations])
    groups = np.split(scores, np.arange(trace.stride, count, trace.stride))
    np.testing.assert_array_equal(trace.score, [max(each) for each in groups])
    assert trace.ends[0] == pytest.approx(0.5 + LENGTH / RATE)
    assert trace.ends[-1] == pytest.approx(0.5 + LENGTH / RATE + count * WINDOWING.step / RATE)
    power = power_spectra(
        windows_of(samples, LENGTH, WINDOWING.step), taper("hann", LENGTH, np), np
    )
    low = made.scorer.low
    mean = (
        power[:, 0, low : low + made.scorer.bins] / air().baseline.mean[0][low:][: made.scorer.bins]
    )
    groups = np.split(mean, np.arange(trace.stride, count, trace.stride))
    np.testing.assert_allclose(trace.over_air, [each.mean(axis=0) for each in groups], rtol=1e-9)
    assert "chatter" in trace.state
    assert CHATTERS < trace.ends[trace.state.index("chatter")] + trace.stride * 0.04 < OUT + 1.0


def test_loudness_is_that_of_a_known_line():
    made = detector()
    time = np.arange(round(2.0 * RATE)) / RATE
    # Whole periods in a window, and readings at the peaks.
    samples = 7.0 + 3.0 * np.cos(2.0 * np.pi * 400.0 * time)[:, None]
    trace = Trace(made, 0.0)
    found = detect_record(Blocks([samples + 1e-9 * noise(2.0, 1)]), made, trace)
    count = sum(n for n, _, _ in trace.loudness().values())
    assert count == found.tally.windows
    for _, square, height in trace.loudness().values():
        assert square[0] == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-6)
        assert height[0] == pytest.approx(6.0, rel=1e-6)
