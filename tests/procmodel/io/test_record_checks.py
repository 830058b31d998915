"""Faults of sensors: each is found where it is, and sound signals are left alone."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io.record_checks import flags, held_samples

COUNT = 20000


def noise(seed=0, count=COUNT):
    return np.random.default_rng(seed).standard_normal(count)


def sine(cycles=137.3, count=COUNT):
    return np.sin(2 * np.pi * cycles * np.arange(count) / count)


def found(samples, **arguments):
    return [(each.name, each.first_sample, each.count) for each in flags(samples, **arguments)]


def quantised(samples, step):
    return np.round(samples / step) * step


SOUND = {
    "noise": noise(),
    "noise of 16 bits": quantised(noise(), 2**-12),
    "noise of few levels": quantised(noise(), 0.5),
    "noise below the last digit": quantised(0.3 * noise(), 1.0),
    "sine": sine(),
    "sine of 8 bits": quantised(sine(), 2**-7),
    "sine of 12 bits": quantised(sine(), 2**-11),
    "sine of whole periods": np.tile(sine(2.0, 40), COUNT // 40),
    "heavy tails": np.random.default_rng(1).standard_t(2.0, COUNT),
    "chatter that grows": np.exp(np.linspace(-3, 3, COUNT)) * sine(900.0) + 0.1 * noise(),
    "drift": np.linspace(0, 50, COUNT) + noise(),
    "once per revolution": (np.arange(COUNT) % 100 < 10).astype(float),
    "spikes, one of them first": noise() + 30.0 * (np.arange(COUNT) % 500 == 0),
    "slow ramp of few levels": np.floor(np.arange(COUNT) / 7.0) + 0.0 * noise(),
}


@pytest.mark.parametrize("name", [name for name in SOUND if name != "slow ramp of few levels"])
def test_sound_signals_have_no_fault(name):
    assert found(SOUND[name]) == []


def test_no_false_alarm_in_many_recordings():
    """Of 400 recordings of sound noise of several kinds, hardly any is called faulty."""
    alarms = 0
    for seed in range(100):
        for samples in (
            noise(seed, 4000),
            quantised(noise(seed, 4000), 0.05),
            quantised(noise(seed, 4000), 1.0),
            sine(40 + seed / 7, 4000) + 0.01 * noise(seed, 4000),
        ):
            alarms += bool(flags(samples))
    assert alarms <= 4


def test_not_finite():
    samples = noise()
    samples[[100, 101, 500]] = np.nan, np.inf, -np.inf
    (finding,) = flags(samples, ["spindle y"])
    assert finding[:3] == ("not finite", 100, 3)
    assert finding.sentence.startswith("spindle y: 3 samples are not finite")
    assert found(np.full(100, np.nan)) == [("not finite", 0, 100)]


@pytest.mark.parametrize("factor", [2, 3, 4, 5, 16])
def test_held_samples(factor):
    samples = np.repeat(noise(), factor)[1:]
    assert held_samples(samples) == factor
    assert held_samples(noise()) == held_samples(SOUND["noise of few levels"]) == 1
    # A few changes out of the rhythm do not hide it.
    samples[[1000, 7001]] += 0.1
    assert held_samples(samples) == factor
    (finding,) = flags(np.repeat(noise(), factor))
    assert finding[:3] == ("values repeated", 1, COUNT * (factor - 1))
    assert f"stands {factor} times" in finding.sentence


def test_slow_steps_are_held_values():
    assert held_samples(SOUND["slow ramp of few levels"]) == 7


def test_stuck_sensor():
    samples = noise()
    samples[5000:5040] = samples[5000]
    assert found(samples) == [("stuck", 5000, 40)]
    assert found(samples, stuck_length=50) == []
    assert found(np.full(1000, 2.5)) == [("stuck", 0, 1000)]
    samples[-20:] = 0.0
    assert found(samples) == [("stuck", 5000, 60)]


def test_held_values_are_stuck_only_when_they_stand_longer():
    samples = np.repeat(noise(), 8)
    assert [name for name, *_ in found(samples)] == ["values repeated"]
    samples[8000:8240] = samples[8000]
    assert ("stuck", 8000, 240) in found(samples)
    # Long runs are nothing odd in a signal of few digits, but this one is.
    quiet = quantised(0.2 * noise(), 1.0)
    assert found(quiet) == []
    quiet[3000:6000] = 0.0
    assert [name for name, *_ in found(quiet)] == ["stuck"]


@pytest.mark.parametrize("kind", ["noise", "sine", "noise of 16 bits", "sine of 12 bits"])
def test_clipped_sensor(kind):
    samples = np.clip(SOUND[kind], -10.0, 0.9)
    at = np.flatnonzero(samples == samples.max())
    assert ("clipped", at[0], len(at)) in found(samples)
    both = [f for f in flags(np.clip(SOUND[kind], -0.9, 0.9)) if f.name == "clipped"]
    assert {"minimum" in f.sentence for f in both} == {True, False}
    # Standing at the end of the range is not a second fault.
    assert {name for name, *_ in found(samples)} == {"clipped"}


def test_outlier_at_the_start():
    samples = noise()
    samples[:2] = 80.0, -90.0
    assert found(samples) == [("outlier at the start", 0, 2)]
    elsewhere = noise()
    elsewhere[9000] = 80.0
    assert found(elsewhere) == []
    held = np.repeat(samples, 2)
    assert ("outlier at the start", 0, 4) in found(held)


def test_channels_are_checked_on_their_own():
    samples = np.stack([noise(0), noise(1), noise(2)], axis=1)
    samples[100:200, 1] = 0.0
    samples[7, 2] = np.nan
    assert [(f.name, f.sentence.split(":")[0]) for f in flags(samples, ["x", "y", "z"])] == [
        ("stuck", "y"),
        ("not finite", "z"),
    ]
    assert [f.sentence.split(":")[0] for f in flags(samples)] == ["channel 2", "channel 3"]


def test_short_recordings_and_wrong_arguments():
    assert found([]) == found([1.0]) == found([1.0, 2.0]) == []
    with pytest.raises(InputError, match="one column per channel"):
        flags(np.zeros((2, 2, 2)))
    with pytest.raises(InputError, match="2 names for 1"):
        flags(noise(), ["x", "y"])
    with pytest.raises(InputError, match="stuck_length"):
        flags(noise(), stuck_length=1)
