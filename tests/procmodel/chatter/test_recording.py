"""Recordings of the plant: the filter, blocks, noise, and labels against the law of stability."""

import math

import jax
import numpy as np
import pytest

from procmodel.chatter.cutting import Tool
from procmodel.chatter.dynamics import Plant, PlantState, ProcessNoise, Signals, advance, start
from procmodel.chatter.recording import (
    Schedule,
    air_cut_air,
    label_of_excess,
    label_of_multiplier,
    labelled_recording,
    rotation_ramp,
)
from procmodel.chatter.sampling import Sampling, antialias_taps, sample, start_sampling
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes_plant import (
    COEFFICIENTS,
    FLIP_SPEED,
    MODE,
    SLOT,
    SPEED,
    strongest,
)

SAMPLING = Sampling(10240.0, 6, 2e-8, 0.5)
SHORT = {"before": 0.2, "entry": 0.05, "cutting": 0.7, "exit": 0.05, "after": 0.1}


def rig(sampling=SAMPLING, tool=None, **rest):
    return Plant(
        MODE,
        tool or Tool(2),
        SLOT,
        COEFFICIENTS,
        step=sampling.step,
        slowest=60.0,
        fastest=220.0,
        **({"noise": ProcessNoise(1e-4, 1e-3)} | rest),
    )


@pytest.mark.parametrize("oversampling", [2, 5])
def test_the_filter_passes_what_is_sampled_and_nothing_above(oversampling):
    taps = antialias_taps(oversampling)
    np.testing.assert_allclose(taps, taps[::-1], rtol=1e-12)
    # In units of the sampling rate.
    frequency = np.linspace(0.0, 0.5 * oversampling, 2001)
    turning = np.exp(-2j * np.pi * frequency[:, None] * np.arange(len(taps)) / oversampling)
    gain = np.abs(turning @ taps)
    assert gain[0] == pytest.approx(1.0, rel=1e-12)
    assert np.max(np.abs(gain[frequency <= 0.34] - 1.0)) < 1e-3
    assert np.max(gain[frequency >= 0.5]) < 10.0 ** (-75.0 / 20.0)


def test_samples_are_of_their_instants():
    # A slow sine and one beyond half the rate, in the middle of the steps, in blocks.
    quiet = Sampling(1000.0, 4)
    plant = rig(quiet, noise=None)
    middles = (np.arange(2400) + 0.5) * quiet.step
    slow = np.sin(2.0 * np.pi * 130.0 * middles)
    wave = slow + np.sin(2.0 * np.pi * 730.0 * middles)
    state, parts = start_sampling(plant, quiet), []
    for rows in np.split(np.arange(2400), [400, 1604]):
        two = np.stack([wave[rows]] * 2, axis=1)
        state, some = sample(quiet, state, Signals(two, two, two, two, wave[rows]))
        parts.append(np.asarray(some))
    samples = np.concatenate(parts)
    assert samples.shape == (600, 4)
    instants = (np.arange(600) - quiet.delay) / 1000.0
    expected = np.sin(2.0 * np.pi * 130.0 * instants)
    np.testing.assert_allclose(samples[40:, 0], expected[40:], atol=1e-3)


@pytest.mark.slow
def test_blocks_and_keys():
    schedule = air_cut_air(SPEED, 0.5e-3, **SHORT)
    first = labelled_recording(rig(), schedule, SAMPLING, 3, block=4096)
    again = labelled_recording(rig(), schedule, SAMPLING, 3, block=1024)
    assert first.samples.shape == (11264, 4)
    size = np.std(first.samples, axis=0)
    for channel in (0, 2):
        error = first.samples[:, channel] - again.samples[:, channel]
        assert np.max(np.abs(error)) < 1e-6 * size[channel]
    other = labelled_recording(rig(), schedule, SAMPLING, 4, block=4096)
    assert np.max(np.abs(other.samples[:, 0] - first.samples[:, 0])) > 1e-3 * size[0]
    assert first.channels == (
        "displacement 1",
        "displacement 2",
        "acceleration 1",
        "acceleration 2",
    )
    assert first.units == ("m", "m", "m/s^2", "m/s^2")
    assert first.rate == 10240.0 and first.rotation.tolist() == [SPEED] * 11264


def test_noise_of_the_sensors_has_its_spread():
    # Across the feed nothing moves: noise alone.
    found = labelled_recording(rig(), air_cut_air(SPEED, 0.5e-3, **SHORT), SAMPLING, 1)
    spread = np.std(found.samples[:, [1, 3]], axis=0)
    # 11,264 samples: a standard deviation is known to 0.7 %, five times that.
    np.testing.assert_allclose(spread, [2e-8, 0.5], rtol=0.035)
    neighbours = np.corrcoef(found.samples[1:, 1], found.samples[:-1, 1])[0, 1]
    assert abs(neighbours) < 5.0 / math.sqrt(11264)


@pytest.mark.parametrize(
    ("speed", "depth", "label", "frequency"),
    [
        (SPEED, 0.2e-3, "stable", None),
        (SPEED, 0.5e-3, "chatter", 945.35),
        (FLIP_SPEED, 3.0e-3, "chatter", 5.0 * FLIP_SPEED),
    ],
)
def test_labels_by_lobes_and_by_motion_agree(speed, depth, label, frequency):
    found = labelled_recording(
        rig(), air_cut_air(speed, depth, **SHORT), SAMPLING, 2, labelled_by="motion"
    )
    truth = found.truth
    assert truth.label == label
    assert label_of_multiplier(truth.stability.multiplier) == label
    assert truth.entry == pytest.approx((0.2, 0.25)) and truth.exit == pytest.approx((0.95, 1.0))
    air = found.samples[100:1900, 2]
    cutting = found.samples[6000:9600, 2]
    if frequency is None:
        assert truth.chatter_frequency is None and truth.excess < 0.05
    else:
        assert truth.chatter_frequency == pytest.approx(frequency, rel=1e-5)
        assert truth.excess > 0.3
        # The recording shows it where the truth says, the drift of large motion aside.
        seen = strongest(cutting, found.rate, forced=2.0 * speed)
        assert seen == pytest.approx(frequency, rel=0.01)
    assert np.std(cutting) > 1.2 * np.std(air)


def test_labels_of_numbers():
    sizes = [0.9, 0.97, -1.03, 1.031, 0.8 + 0.8j]
    labels = [label_of_multiplier(size) for size in sizes]
    assert labels == ["stable", "marginal", "marginal", "chatter", "chatter"]
    assert [label_of_excess(e) for e in (0.01, 0.05, 0.3, 0.4)] == [
        "stable",
        "marginal",
        "marginal",
        "chatter",
    ]


def test_a_schedule_of_air_alone_is_stable():
    schedule = Schedule(np.array([0.0, 0.2]), np.array([80.0, 120.0]), np.zeros(2))
    found = labelled_recording(rig(), schedule, SAMPLING, 1, block=1024, labelled_by="motion")
    assert found.truth.label == "stable" and found.truth.excess == 0.0
    assert found.truth.entry is None and found.truth.exit is None and found.truth.stability is None
    np.testing.assert_allclose(found.rotation, np.linspace(80.0, 120.0, 2048, endpoint=False))


def test_a_change_of_speed_in_the_cut_ends_chatter():
    # As an avoidance does it: 10000 1/min chatters at 0.5 mm, 12500 does not. By blocks.
    plant = rig(noise=None)
    wanted, state, rms = [166.7] * 6 + [208.333] * 8, start(plant, 166.7), []
    speed = 166.7
    for target in wanted:
        ramp = rotation_ramp(speed, target, 400.0, 6144, plant.step)
        speed = float(ramp[-1])
        state, signals = advance(plant, state, ramp, 0.5e-3)
        tip = np.asarray(signals.tip[:, 0])
        turned = np.asarray(signals.rotation)
        # What does not come back a tooth later.
        back = np.interp(turned - 0.5, turned, tip)
        rms.append(float(np.std((tip - back)[turned > turned[0] + 0.5])))
    assert speed == 208.333
    assert rms[5] > 0.3e-4
    assert rms[-1] < 0.02 * rms[5]


def test_ramps_keep_to_the_acceleration():
    up = rotation_ramp(100.0, 110.0, 50.0, 100, 1e-2)
    np.testing.assert_allclose(np.diff(up[:20]), 0.5, rtol=1e-9)
    assert up[0] == pytest.approx(100.5) and np.all(up[20:] == 110.0)
    down = rotation_ramp(100.0, 90.0, 50.0, 10, 1e-2)
    np.testing.assert_allclose(down, 100.0 - 0.5 * np.arange(1, 11))
    assert rotation_ramp(100.0, 100.0, 50.0, 3, 1e-2).tolist() == [100.0] * 3


def test_a_key_or_its_seed():
    plant = rig()
    states: list[PlantState] = [start(plant, 80.0, 7), start(plant, 80.0, jax.random.key(7))]
    tips = [advance(plant, s, np.full(256, 80.0), 0.0)[1].tip for s in states]
    np.testing.assert_array_equal(tips[0], tips[1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sampling(0.0), r"^rate is 0 Hz, but must be above 0\.$"),
        (lambda: Sampling(1e4, 0), r"^oversampling is 0, but must be 1 or more\.$"),
        (lambda: Sampling(1e4, 2.5), r"^oversampling is 2\.5, but must be a whole number\.$"),
        (lambda: Sampling(1e4, 4, -1.0), r"^displacement noise is -1, but must be 0 or more\.$"),
        (lambda: start_sampling(rig(), Sampling(1e4)), r"^the plant's step is 1\.6276e-05 s, but"),
        (lambda: air_cut_air(80.0, 1e-3, entry=0.0), r"^entry lasts 0 s, but must last longer"),
        (lambda: _recorded([0.0, 1.0], [80.0], [0.0, 0.0]), r"as long as each other, 2 or more\.$"),
        (lambda: _recorded([0.0, 0.0], [80.0, 80.0], [0.0, 0.0]), r"must start at 0 and rise\.$"),
        (lambda: _recorded([0.0, 1.0], [80.0, 80.0], [0.0, -1.0]), r"^depth is -1 m in a schedule"),
        (lambda: _recorded([0.0, 1.0], [80.0, math.nan], [0.0, 0.0]), r"of finite numbers\.$"),
        (
            lambda: labelled_recording(
                rig(), air_cut_air(80.0, 1e-3), SAMPLING, labelled_by="lobe"
            ),
            r"^labelled_by 'lobe' is unknown; did you mean 'lobes'\?\.$",
        ),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(InputError, match=message):
        make()


def _recorded(*columns):
    schedule = Schedule(*(np.array(c) for c in columns))
    return labelled_recording(rig(), schedule, SAMPLING)


def test_a_block_ends_with_a_sample():
    two = np.zeros((10, 2))
    with pytest.raises(InputError, match=r"^a block of 10 steps .* a multiple of 6\.$"):
        sample(SAMPLING, start_sampling(rig(), SAMPLING), Signals(two, two, two, two, two[:, 0]))
