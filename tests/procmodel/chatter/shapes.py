"""Signals for the tests of chatter whose truth is known, and detectors made of them."""

import numpy as np

from procmodel.chatter import AirCut, DetectorSettings, Windowing, air_cut, prepare

RATE = 25600.0
LENGTH = 4096
ROTATION = 12500.0 / 60.0
NOISE = 1.0


def noise(seconds, seed, channels=1, rate=RATE):
    rng = np.random.default_rng(seed)
    return NOISE * rng.normal(size=(round(seconds * rate), channels))


def line(samples, frequency, amplitude, rate=RATE):
    """A line of an amplitude that may be a function of time [s]."""
    time = np.arange(len(samples)) / rate
    height = amplitude(time) if callable(amplitude) else amplitude
    return (height * np.sin(2.0 * np.pi * frequency * time))[:, None]


def forced(samples, rotation, amplitude, orders=range(1, 60), rate=RATE):
    """Lines at multiples of the rotation, those of odd orders, as runout makes them, at a third."""
    return sum(
        line(samples, k * rotation, amplitude * (1.0 if k % 2 == 0 else 1.0 / 3.0), rate)
        for k in orders
        if k * rotation < 0.45 * rate
    )


def stable_cut(seconds, seed, amplitude=1.0, rotation=ROTATION):
    """Noise and forced lines."""
    samples = noise(seconds, seed)
    return samples + forced(samples, rotation, amplitude)


def windowing(**changes):
    return Windowing(**{"rate": RATE, "length": LENGTH, **changes})


def air(seconds=6.0, seed=1, channels=1, amplitude=0.1, rotation=ROTATION, **changes) -> AirCut:
    samples = noise(seconds, seed, channels)
    samples = samples + forced(samples, rotation, amplitude)
    return air_cut(samples, windowing(**changes), rotation)


def detector(baseline=None, stable=None, **settings):
    baseline = baseline or air()
    chosen = DetectorSettings(baseline.windowing, **{"band": (100.0, 10000.0), **settings})
    return prepare(chosen, baseline, stable=stable)
