"""The paper's first experiment: one cut at every speed, distances of both sensors."""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from calibration.plans.avoidance import (
    advance_together,
    air_baselines,
    sample_together,
    stacked,
)
from calibration.plans.avoidance_loop import Spindle
from experiments.nishikawa_chatter_avoidance.conditions import (
    LENGTH,
    RATE,
    SENSORS,
    SHORT_60,
    SWEEP,
    Mill,
    papers_settings,
)
from procmodel.chatter import AirCut, Baseline, power_spectra, prepare, scores, taper, windows_of
from procmodel.chatter.dynamics import Plant, start
from procmodel.chatter.lobes import stability
from procmodel.chatter.sampling import start_sampling

AIR_WINDOWS = 25
_RANGE = (95.0, 470.0)
_BLOCK = 4096
# Windows until chatter has grown up and the filters are full.
_GROWN = 3


@dataclass(frozen=True)
class Sweep:
    """Cuts at the speeds of the paper.

    Attributes
    ----------
    mill : Mill
        The tool.
    speeds : ndarray, shape (s,) [1/min]
        Spindle speeds.
    growth : ndarray, shape (s,) [1/s]
        Of a small vibration, by the stability lobes; positive where the cut chatters.
    distance : ndarray, shape (s, 2)
        Of displacement and acceleration: mean over the windows of the cut of the largest distance
        in a window; mean over the repetitions.
    spread : ndarray, shape (s, 2)
        Standard deviation of that over the repetitions.
    frequency : ndarray, shape (s, 2) [Hz]
        Of the largest distance, median over the windows; mean over the repetitions.
    vibration : ndarray, shape (s,) [m]
        Root mean square displacement of the tip in the feed direction, less its mean.
    power : ndarray, shape (s, 2) [um^2, (m/s^2)^2]
        At the chatter frequency of the displacement, mean over the windows.
    spectra : ndarray, shape (2, 2, bins) [um^2, (m/s^2)^2]
        At 18000 1/min: of both sensors, in air and in the cut, means.
    """

    mill: Mill
    speeds: np.ndarray
    growth: np.ndarray
    distance: np.ndarray
    spread: np.ndarray
    frequency: np.ndarray
    vibration: np.ndarray
    power: np.ndarray
    spectra: np.ndarray

    @property
    def chatters(self) -> np.ndarray:
        """Where the cut chatters, by the lobes."""
        return self.growth > 0.0

    @property
    def worst_good(self) -> np.ndarray:
        """Largest distance without chatter, of both sensors."""
        return self.distance[~self.chatters].max(axis=0)

    @property
    def least_bad(self) -> np.ndarray:
        """Smallest distance under chatter, of both sensors."""
        return self.distance[self.chatters].min(axis=0)

    @property
    def ratio(self) -> np.ndarray:
        """The second over the first."""
        return self.least_bad / self.worst_good


def swept(
    mill: Mill = SHORT_60,
    speeds: tuple[float, ...] = SWEEP,
    windows: int = 13,
    repetitions: int = 4,
) -> Sweep:
    """Air cutting and a cut at every speed, repeated with other noise.

    Parameters
    ----------
    mill : Mill
        The tool.
    speeds : tuple of float [1/min]
        Spindle speeds.
    windows : int
        Windows of every cut; the paper's cuts of 100 mm last 2.1 to 10 s, 13 to 62 windows.
    repetitions : int
        How often all of it is done, 2 at least; the paper's was done once.

    Returns
    -------
    Sweep
        Of these.
    """
    rotation = np.array(speeds) / 60.0
    plant = mill.plant(_RANGE, mill.sampling())
    each = [_once(mill, plant, rotation, windows, seed) for seed in range(1, repetitions + 1)]
    shown = int(np.argmin(np.abs(np.array(speeds) - 18000.0)))
    distance = np.array([e.distance for e in each])
    return Sweep(
        mill,
        np.array(speeds),
        np.array([stability(mill.modes(r), *mill.law, r, mill.width).growth for r in rotation]),
        distance.mean(axis=0),
        distance.std(axis=0, ddof=1),
        np.mean([e.frequency for e in each], axis=0),
        np.mean([e.tips.std(axis=1) for e in each], axis=0),
        np.mean([e.power for e in each], axis=0),
        each[0].spectra[shown],
    )


class _Once(NamedTuple):
    """One repetition, as in `Sweep`; `tips` displacements, `spectra` of all speeds."""

    distance: np.ndarray
    frequency: np.ndarray
    power: np.ndarray
    tips: np.ndarray
    spectra: np.ndarray


def _once(mill: Mill, plant: Plant, rotation: np.ndarray, windows: int, seed: int) -> _Once:
    sampling, settings = mill.sampling(), papers_settings()
    # An override of the fastest speed stands for each of the others.
    spindle = Spindle(float(rotation.max()), 100.0)
    overrides = [float(r / spindle.rotation) for r in rotation]
    air = air_baselines(plant, sampling, settings.windowing, spindle, overrides, AIR_WINDOWS, seed)
    records, tips = _cuts(mill, plant, rotation, windows, seed + 1000)
    weights = taper(settings.windowing.taper, LENGTH, np)
    units = np.array([1e12, 1.0])[:, None]
    distance, frequency, power, spectra = [], [], [], []
    for override, record in zip(overrides, records, strict=True):
        alone = [_channel(air[override], c) for c in range(len(SENSORS))]
        found = [scores(record[:, [c]], a, settings) for c, a in enumerate(alone)]
        distance.append([f.score.mean() for f in found])
        frequency.append([np.median(f.frequency) for f in found])
        cut = units * power_spectra(windows_of(record, LENGTH, LENGTH), weights, np).mean(axis=0)
        at = int(np.argmax(np.where(prepare(settings, alone[0]).free, cut[0], 0.0)))
        power.append(cut[:, at])
        quiet = units * np.asarray(air[override].baseline.mean)
        spectra.append(np.stack([quiet, cut], axis=1))
    return _Once(np.array(distance), np.array(frequency), np.array(power), tips, np.array(spectra))


def _cuts(
    mill: Mill, plant: Plant, rotation: np.ndarray, windows: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Samples (s, n, 2) of cuts at all speeds side by side, and displacements of the tip."""
    sampling = mill.sampling()
    plants = [eqx.tree_at(lambda p: p.modes, plant, mill.modes(float(speed))) for speed in rotation]
    keys = jax.random.split(jax.random.key(seed), (len(rotation), 2))
    states = [start(plant, float(r), k[0]) for r, k in zip(rotation, keys, strict=True)]
    rigs = [start_sampling(plant, sampling, k[1]) for k in keys]
    together, state, rig = (stacked(each) for each in (plants, states, rigs))
    steps = _BLOCK * sampling.oversampling
    speed = np.repeat(rotation[:, None], steps, axis=1)
    entry = mill.width * np.clip(np.arange(steps) / (0.02 * RATE * sampling.oversampling), 0.0, 1.0)
    samples, tips = [], []
    for i in range(_GROWN + windows):
        depth = np.broadcast_to(entry if i == 0 else mill.width, speed.shape)
        state, signals = advance_together(together, state, speed, depth)
        rig, some = sample_together(sampling, rig, signals)
        if i >= _GROWN:
            samples.append(np.asarray(some))
            tips.append(np.asarray(signals.tip[:, :: sampling.oversampling, 0]))
    return np.concatenate(samples, axis=1), np.concatenate(tips, axis=1)


def _channel(air: AirCut, channel: int) -> AirCut:
    """Air cutting of one sensor alone."""
    moments = air.baseline
    rows = slice(channel, channel + 1)
    one = Baseline(moments.count, moments.mean[rows], moments.squares[rows])
    return AirCut(air.windowing, air.rotation, air.channels[rows], one)
