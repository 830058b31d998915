"""Recordings of the plant with known truth: what a rig would record, and whether the cut chatters.

SI units; spindle speed as rotation frequency [rev/s].
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from procmodel.chatter.dynamics import Plant, PlantState, advance, start
from procmodel.chatter.lobes import Stability, stability
from procmodel.chatter.sampling import Sampling, sample, sensor_counts, start_sampling
from procmodel.errors import InputError, nearest

LABELS = ("stable", "marginal", "chatter")
LABELLED_BY = ("lobes", "motion")
# Vibration beyond the forced one over feed per tooth: below is stable, above is chatter.
_EXCESS = (0.05, 0.3)


class Schedule(NamedTuple):
    """Spindle speed and depth over time, linear between instants.

    Attributes
    ----------
    times : numpy.ndarray, shape (k,) [s]
        Instants, rising, the first at 0; the last one is the end.
    rotation : numpy.ndarray, shape (k,) [rev/s]
        Spindle speed at these.
    depth : numpy.ndarray, shape (k,) [m]
        Axial depth at these, 0 in air.
    """

    times: np.ndarray
    rotation: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class Truth:
    """What is known of a recording.

    Attributes
    ----------
    label : {"stable", "marginal", "chatter"}
        Of the cut.
    stability : Stability or None
        Of the worst speed and depth of the schedule; none if all of it is in air.
    excess : float or None
        Root mean square, over the cut at its full depth, of the vibration beyond the forced one
        over feed per tooth; none unless labelled by motion.
    entry, exit : tuple of float or None [s]
        When the depth starts to rise from 0 and is at its greatest; when it starts to fall from
        there and is 0 again. None if all is in air, or if the recording ends in the cut.
    """

    label: str
    stability: Stability | None
    excess: float | None
    entry: tuple[float, float] | None
    exit: tuple[float, float] | None

    @property
    def chatter_frequency(self) -> float | None:
        """Frequency of the vibration that grows [Hz]; none without chatter."""
        found = self.stability
        return found.frequency if found and self.label == "chatter" else None


@dataclass(frozen=True)
class LabelledRecording:
    """A recording of the plant.

    Attributes
    ----------
    samples : numpy.ndarray, shape (n, c)
        Displacements, then accelerations, in the order of the plant's sensors.
    rate : float [Hz]
        Sampling rate; the sample i is of the instant i / rate.
    channels, units : tuple of str
        Of every column: "displacement 1", ..., "acceleration 1", ...; "m" and "m/s^2".
    rotation : numpy.ndarray, shape (n,) [rev/s]
        Spindle speed.
    truth : Truth
        What is known of it.
    """

    samples: np.ndarray
    rate: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    rotation: np.ndarray
    truth: Truth


def air_cut_air(
    rotation: float,
    depth: float,
    *,
    before: float = 0.5,
    entry: float = 0.05,
    cutting: float = 1.0,
    exit: float = 0.05,
    after: float = 0.2,
) -> Schedule:
    """Air, entry, cut, exit, air, at one spindle speed.

    Parameters
    ----------
    rotation : float [rev/s]
        Spindle speed.
    depth : float [m]
        Axial depth of the cut.
    before, entry, cutting, exit, after : float [s]
        How long each of them lasts.

    Returns
    -------
    Schedule
        For `labelled_recording`.

    Raises
    ------
    InputError
        If one of them lasts no time.
    """
    spans = {"before": before, "entry": entry, "cutting": cutting, "exit": exit, "after": after}
    for name, span in spans.items():
        if not (math.isfinite(span) and span > 0.0):
            raise InputError(f"{name} lasts {span:g} s, but must last longer than 0.")
    times = np.concatenate([[0.0], np.cumsum(list(spans.values()))])
    return Schedule(times, np.full(6, float(rotation)), np.array([0.0, 0, 1, 1, 0, 0]) * depth)


def rotation_ramp(
    rotation: float, wanted: float, acceleration: float, count: int, step: float
) -> np.ndarray:
    """Spindle speed on its way to a wanted one, its acceleration limited.

    Parameters
    ----------
    rotation : float [rev/s]
        Speed now.
    wanted : float [rev/s]
        Speed to reach.
    acceleration : float [rev/s^2]
        The limit, > 0.
    count : int
        Steps.
    step : float [s]
        Step of time.

    Returns
    -------
    numpy.ndarray, shape (n,) [rev/s]
        Speed at the end of every step; the last one is where the next block starts.
    """
    way = wanted - rotation
    passed = np.minimum(acceleration * step * np.arange(1, count + 1), abs(way))
    return np.where(passed == abs(way), wanted, rotation + math.copysign(1.0, way) * passed)


def labelled_recording(
    plant: Plant,
    schedule: Schedule,
    sampling: Sampling,
    key: Array | int = 0,
    *,
    labelled_by: str = "lobes",
    margin: float = 0.03,
    block: int = 4096,
) -> LabelledRecording:
    """Record the plant while it follows a schedule.

    Parameters
    ----------
    plant : Plant
        The plant.
    schedule : Schedule
        Spindle speed and depth.
    sampling : Sampling
        How it is recorded.
    key : Array or int
        Key of all noise, or its seed.
    labelled_by : {"lobes", "motion"}
        Label by the multiplier of the worst speed and depth among the schedule's instants; or by
        the vibration that the plant has beyond the forced one, of a second run under the same noise
        without waves on the surface. Lobes know of no noise and no time; motion does.
    margin : float
        By lobes, |mu| from 1 - margin to 1 + margin is marginal.
    block : int
        Samples simulated at once.

    Returns
    -------
    LabelledRecording
        Samples and truth.

    Raises
    ------
    InputError
        If the schedule is not one, or the way of labelling is unknown.
    """
    if labelled_by not in LABELLED_BY:
        hint = nearest(str(labelled_by), LABELLED_BY)
        raise InputError(f"labelled_by {labelled_by!r} is unknown{hint}.")
    _require_schedule(schedule)
    count = round(float(schedule.times[-1]) * sampling.rate)
    # The filter lags: the last samples need steps beyond the end.
    blocks = -(-(count + sampling.delay) // block)
    middles = (np.arange(blocks * block * sampling.oversampling) + 0.5) * sampling.step
    rotation = np.interp(middles, schedule.times, schedule.rotation)
    depth = np.interp(middles, schedule.times, schedule.depth)
    key = jax.random.key(key) if isinstance(key, int) else key
    process, sensors = jax.random.split(key)

    at = start(plant, float(rotation[0]), process)
    recorder = start_sampling(plant, sampling, sensors)
    forced = replace_regeneration(plant, "none") if labelled_by == "motion" else None
    beside: PlantState | None = start(forced, float(rotation[0]), process) if forced else None
    samples, beyond = [], []
    for rows in np.split(np.arange(len(middles)), blocks):
        at, signals = advance(plant, at, rotation[rows], depth[rows])
        recorder, some = sample(sampling, recorder, signals)
        samples.append(np.asarray(some))
        if forced is not None and beside is not None:
            beside, alone = advance(forced, beside, rotation[rows], depth[rows])
            beyond.append(np.sum(np.square(np.asarray(signals.tip - alone.tip)), axis=1))
    displacements, accelerations = sensor_counts(plant)
    excess = None
    if beyond:
        full = depth > 0.999 * np.max(depth) if np.max(depth) > 0.0 else np.zeros(len(depth), bool)
        square = np.mean(np.concatenate(beyond)[full]) if np.any(full) else 0.0
        excess = math.sqrt(square) / float(plant.cut.feed_per_tooth)
    instants = np.arange(count) / sampling.rate
    return LabelledRecording(
        np.concatenate(samples)[sampling.delay :][:count],
        sampling.rate,
        tuple(f"displacement {i + 1}" for i in range(displacements))
        + tuple(f"acceleration {i + 1}" for i in range(accelerations)),
        ("m",) * displacements + ("m/s^2",) * accelerations,
        np.interp(instants, schedule.times, schedule.rotation),
        _truth(plant, schedule, margin, excess),
    )


def replace_regeneration(plant: Plant, regeneration: str) -> Plant:
    """The same plant with another chip.

    Parameters
    ----------
    plant : Plant
        The plant.
    regeneration : str
        As of `Plant`.

    Returns
    -------
    Plant
        Which starts anew: it keeps another length of the past.
    """
    return Plant(
        plant.modes,
        plant.tool,
        plant.cut,
        plant.coefficients,
        step=plant.step,
        slowest=plant.slowest,
        fastest=plant.fastest,
        sensors=plant.sensors,
        noise=plant.noise,
        slices=plant.slices,
        revolutions=plant.revolutions,
        regeneration=regeneration,
    )


def label_of_multiplier(multiplier: complex, margin: float = 0.03) -> str:
    """Label of a cut by the growth of a small vibration.

    Parameters
    ----------
    multiplier : complex
        Largest multiplier per pitch.
    margin : float
        |mu| from 1 - margin to 1 + margin is marginal.

    Returns
    -------
    {"stable", "marginal", "chatter"}
        The label.
    """
    return LABELS[int(abs(multiplier) >= 1.0 - margin) + int(abs(multiplier) > 1.0 + margin)]


def label_of_excess(excess: float) -> str:
    """Label of a cut by its vibration beyond the forced one.

    Parameters
    ----------
    excess : float
        Root mean square over feed per tooth.

    Returns
    -------
    {"stable", "marginal", "chatter"}
        Stable below 0.05, chatter above 0.3.
    """
    return LABELS[int(excess >= _EXCESS[0]) + int(excess > _EXCESS[1])]


def _truth(plant: Plant, schedule: Schedule, margin: float, excess: float | None) -> Truth:
    worst: Stability | None = None
    law = plant.modes, plant.tool, plant.cut, plant.coefficients
    conditions = zip(schedule.rotation, schedule.depth, strict=True)
    for rotation, depth in dict.fromkeys((float(s), float(a)) for s, a in conditions):
        if depth > 0.0:
            found = stability(*law, rotation, depth)
            if worst is None or abs(found.multiplier) > abs(worst.multiplier):
                worst = found
    if worst is None:
        label = "stable"
    elif excess is None:
        label = label_of_multiplier(worst.multiplier, margin)
    else:
        label = label_of_excess(excess)
    cut = np.flatnonzero(schedule.depth > 0.0)
    entry = exit = None
    if len(cut):
        deepest = np.flatnonzero(schedule.depth >= np.max(schedule.depth) * (1.0 - 1e-12))
        times = schedule.times
        entry = float(times[max(cut[0] - 1, 0)]), float(times[deepest[0]])
        if cut[-1] + 1 < len(times):
            exit = float(times[deepest[-1]]), float(times[cut[-1] + 1])
    return Truth(label, worst, excess, entry, exit)


def _require_schedule(schedule: Schedule) -> None:
    arrays = [np.asarray(v, float) for v in schedule]
    if len({a.shape for a in arrays}) > 1 or arrays[0].ndim != 1 or len(arrays[0]) < 2:
        raise InputError(
            "times, rotation and depth of a schedule must be as long as each other, 2 or more."
        )
    times, _, depth = arrays
    if not all(np.all(np.isfinite(a)) for a in arrays):
        raise InputError("a schedule must be of finite numbers.")
    if times[0] != 0.0 or np.any(np.diff(times) <= 0.0):
        raise InputError("the times of a schedule must start at 0 and rise.")
    if np.any(depth < 0.0):
        raise InputError(f"depth is {np.min(depth):g} m in a schedule, but must be at least 0.")
