"""Scores and vibration whose truth is known, for the tests of thresholds."""

from typing import NamedTuple

import numpy as np
from scipy.io import wavfile

from calibration.chatter_cuts import CutScores
from calibration.chatter_detection import air_cut_of_record, stored
from procmodel.chatter import Windowing
from procmodel.io.baselines import save_baselines
from procmodel.io.records import read_record

STEP = 0.16


class Truth(NamedTuple):
    """What scores are drawn from; y = log(1 + D)."""

    stable: float = 2.5
    gap: float = 1.6
    cut_spread: float = 0.3
    spread: float = 0.3
    freedom: float = 5.0
    correlation: float = 0.3

    def level(self, label):
        return self.stable + {"stable": 0.0, "marginal": 0.5, "chatter": 1.0}[label] * self.gap


def windows(rng, level, truth, count):
    """Successive y of one cut about its level, by the recursion itself."""
    noise = truth.spread * rng.standard_t(truth.freedom, count)
    y = np.empty(count)
    y[0] = level + noise[0]
    share = np.sqrt(1.0 - truth.correlation**2)
    for i in range(1, count):
        y[i] = level + truth.correlation * (y[i - 1] - level) + share * noise[i]
    return y


def cut(rng, label, truth=None, count=40, tool="A", speed=12000.0, shift=0.0, name=""):
    truth = truth or Truth()
    level = truth.level(label) + shift + truth.cut_spread * rng.normal()
    scores = np.expm1(windows(rng, level, truth, count))
    return CutScores(label, tool, speed, scores, STEP, STEP, name)


def cuts(rng, stable=6, chatter=6, marginal=0, **options):
    labels = ["stable"] * stable + ["marginal"] * marginal + ["chatter"] * chatter
    return [cut(rng, label, name=f"cut {i + 1}", **options) for i, label in enumerate(labels)]


RATE, WINDOW, SPEED = 8000.0, 512, 6000.0


def vibration(rng, kind, seconds=2.0, strength=1.0):
    """Noise and forced lines of 100 Hz; a cut is louder, and chatter adds a line at 1234 Hz."""
    time = np.arange(round(seconds * RATE)) / RATE
    cutting = kind != "air"
    samples = rng.normal(size=len(time)) * (
        0.1 if not cutting else 0.12 * np.exp(0.1 * rng.normal())
    )
    for order in range(1, 8):
        height = 0.4 if cutting else 0.02
        samples += height / order * np.sin(2.0 * np.pi * 100.0 * order * time + order)
    if kind in ("marginal", "chatter"):
        height = strength * (0.08 if kind == "chatter" else 0.03) * np.exp(0.3 * rng.normal())
        sway = 1.0 + 0.3 * np.sin(2.0 * np.pi * 1.3 * time + rng.uniform(0.0, 6.0))
        samples += height * sway * np.sin(2.0 * np.pi * 1234.0 * time)
    return samples


def record(path, samples):
    wavfile.write(path, int(RATE), samples.astype(np.float32))


def shop(folder, seed=0, labels=("stable",) * 6 + ("marginal",) * 2 + ("chatter",) * 6, tools=1):
    """Recordings, their table and a baseline in a folder: the paths of table and baseline."""
    rng = np.random.default_rng(seed)
    record(folder / "air.wav", vibration(rng, "air", 8.0))
    rows = ["file,label,spindle speed [1/min],tool,start [s],stop [s]"]
    for i, label in enumerate(labels):
        record(folder / f"cut {i}.wav", vibration(rng, label))
        rows.append(f"cut {i}.wav,{label},{SPEED:g},T{i % tools + 1},{0.1 if i == 0 else ''},")
    (folder / "labels.csv").write_text("\n".join(rows) + "\n")
    air = read_record(folder / "air.wav")
    baseline, _ = air_cut_of_record(air, Windowing(RATE, WINDOW), SPEED / 60.0)
    save_baselines(folder / "air.h5", stored(baseline, air.units))
    return folder / "labels.csv", folder / "air.h5"
