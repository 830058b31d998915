"""Recordings of air, a stable cut and chatter whose truth is known, small enough for many tests."""

import numpy as np

from procmodel.chatter import DetectorSettings, Windowing, air_cut, prepare
from tests.procmodel.chatter.shapes import forced, line

RATE, LENGTH, SPEED = 6400.0, 512, 6000.0
ROTATION, CHATTER_HZ = SPEED / 60.0, 1137.0
# Air, the cut, chatter in it, air again [s].
CUT, CHATTERS, OUT, END = 2.0, 3.0, 4.0, 5.0
BAND = (50.0, 3000.0)


def noise(seconds, seed, channels=1):
    """White, and the lines of a spindle that turns."""
    rng = np.random.default_rng(seed)
    samples = rng.normal(size=(round(seconds * RATE), channels))
    return samples + forced(samples, ROTATION, 0.2, rate=RATE)


def recording(seed=1, channels=1, amplitude=2.0, seconds=END):
    """Air, cut, chatter of an amplitude from the middle of the cut on, air."""
    samples = noise(seconds, seed, channels)
    time = np.arange(len(samples)) / RATE
    cutting = ((time >= CUT) & (time < OUT))[:, None]
    chatters = ((time >= CHATTERS) & (time < OUT))[:, None]
    samples = samples + cutting * forced(samples, ROTATION, 1.0, rate=RATE)
    return samples + chatters * line(samples, CHATTER_HZ, amplitude, RATE)


def air(seed=11, seconds=4.0, channels=1, names=None):
    return air_cut(noise(seconds, seed, channels), Windowing(RATE, LENGTH), ROTATION, names)


def detector(baseline=None, **settings):
    baseline = baseline or air()
    chosen = DetectorSettings(baseline.windowing, **{"band": BAND, **settings})
    return prepare(chosen, baseline)


def table(path, samples, names=("y",), unit="m/s^2", rows=None, clock="sample [1]"):
    """CSV with a count of the samples; `rows` picks and repeats them."""
    rows = range(len(samples)) if rows is None else rows
    heading = ",".join([clock, *(f"{name} [{unit}]" for name in names)])
    lines = [",".join([str(i), *map(repr, samples[i].tolist())]) for i in rows]
    path.write_text("\n".join([heading, *lines]) + "\n")
    return path
