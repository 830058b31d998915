"""The avoidance loop closed on the plant: cuts under a policy, and what they cost.

Many cuts run side by side, block by block, by one compiled simulation. Beside each of them runs its
twin, the same tool at the same speeds under the same noise without waves on the surface: what the
tool moves beyond its twin is not forced.

Notation: u displacement of the tool's tip, u_f that of the twin, o override.

    chatter energy = integral of |u - u_f|^2 over the time of the cut [m^2 s]
    time lost = time of the cut - its time at an override of 1 [s]

A cut is a way in the stock, and takes longer at a lower override: the integral of o over the time
of every cut is its time at an override of 1.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibration.plans import avoidance_loop
from calibration.plans.avoidance_log import LogRow
from calibration.plans.avoidance_loop import Loop, LoopState, Spindle
from procmodel.chatter import AirCut, Event, Windowing, air_cut
from procmodel.chatter.dynamics import Plant, PlantState, advance
from procmodel.chatter.dynamics import start as at_rest
from procmodel.chatter.recording import replace_regeneration, rotation_ramp
from procmodel.chatter.sampling import SamplerState, Sampling, sample, start_sampling
from procmodel.errors import InputError

Damping = Callable[[float], Any]

# `advance` and `sample` of plants, states, speeds and depths with an axis for those side by side.
advance_together = eqx.filter_jit(eqx.filter_vmap(advance))
sample_together = eqx.filter_jit(eqx.filter_vmap(sample, in_axes=(None, 0, 0)))


@dataclass(frozen=True)
class Trial:
    """One cut under a loop.

    Parameters
    ----------
    plant : Plant
        The plant.
    loop : Loop
        The loop.
    depth : float [m]
        Axial depth.
    work : float [s]
        Time of the cut at an override of 1.
    key : int
        Seed of all noise; trials of one seed meet the same.
    air : float [s]
        Time in the air before.
    entry : float [s]
        Time in which the depth rises.
    damping : callable, optional
        Damping ratios of the modes at a speed of the spindle [rev/s], for damping by the process;
        those of the plant when left out.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    plant: Plant
    loop: Loop
    depth: float
    work: float
    key: int = 0
    air: float = 0.3
    entry: float = 0.05
    damping: Damping | None = None

    def __post_init__(self) -> None:
        for name, unit in (("depth", "m"), ("work", "s"), ("air", "s"), ("entry", "s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} of a trial is {value:g} {unit}, but must be above 0.")


@dataclass(frozen=True)
class Run:
    """What came of a trial.

    Attributes
    ----------
    log : tuple of LogRow
        Windows and decisions.
    events : tuple of Event
        Of the detector.
    time : ndarray, shape (b,) [s]
        End of every block of the cut, from the start of the trial.
    override : ndarray, shape (b,)
        Wanted during the block.
    rotation : ndarray, shape (b,) [rev/s]
        Speed of the spindle at its end.
    vibration : ndarray, shape (b,) [m]
        Root mean square of |u - u_f| in the block.
    energy : float [m^2 s]
        Chatter energy.
    cutting_time : float [s]
        Of the cut.
    time_lost : float [s]
        Against an override of 1.
    changes : int
        Changes of the override.
    """

    log: tuple[LogRow, ...]
    events: tuple[Event, ...]
    time: np.ndarray
    override: np.ndarray
    rotation: np.ndarray
    vibration: np.ndarray
    energy: float
    cutting_time: float
    time_lost: float
    changes: int


def closed_loops(trials: Sequence[Trial], sampling: Sampling, block: int = 1024) -> tuple[Run, ...]:
    """Cuts under their loops, side by side.

    Parameters
    ----------
    trials : sequence of Trial
        Plants of as many modes, teeth, sensors and kept steps; all else may differ.
    sampling : Sampling
        How all are recorded; its rate is that of the detectors.
    block : int
        Samples between two looks of the loop at its sensors.

    Returns
    -------
    tuple of Run
        One for each trial; what comes of one does not depend on the others.

    Raises
    ------
    InputError
        If the plants do not go together, or a rate is not that of the sampling.
    """
    lanes = [_Lane(trial, sampling) for trial in trials]
    plants = stacked([t.plant for t in trials])
    twins = stacked([replace_regeneration(t.plant, "none") for t in trials])
    state = stacked([_rest(t.plant, t) for t in trials])
    beside = stacked([_rest(replace_regeneration(t.plant, "none"), t) for t in trials])
    recorder: SamplerState = stacked(
        [start_sampling(t.plant, sampling, jax.random.fold_in(_key(t), 1)) for t in trials]
    )
    steps = block * sampling.oversampling
    while not all(lane.done for lane in lanes):
        asked = [lane.ahead(steps) for lane in lanes]
        rotation, depth = (np.stack(values) for values in zip(*asked, strict=True))
        now = [_damped(each, trials, rotation) for each in (plants, twins)]
        state, signals = advance_together(now[0], state, rotation, depth)
        beside, alone = advance_together(now[1], beside, rotation, depth)
        recorder, samples = sample_together(sampling, recorder, signals)
        beyond = np.sum(np.square(np.asarray(signals.tip - alone.tip)), axis=2)
        samples = np.asarray(samples)
        for i, lane in enumerate(lanes):
            if not lane.done:
                lane.take(rotation[i], samples[i], beyond[i])
    return tuple(lane.run() for lane in lanes)


def air_baselines(
    plant: Plant,
    sampling: Sampling,
    windowing: Windowing,
    spindle: Spindle,
    overrides: Sequence[float],
    windows: int = 100,
    key: int = 0,
    *,
    settled: float = 0.1,
    block: int = 4096,
    damping: Damping | None = None,
) -> dict[float, AirCut]:
    """Air cutting of the plant at every override.

    Parameters
    ----------
    plant : Plant
        The plant.
    sampling : Sampling
        How it is recorded.
    windowing : Windowing
        How the recording is cut into windows.
    spindle : Spindle
        The spindle.
    overrides : sequence of float
        Where.
    windows : int
        Spectra of each baseline, 100 in the paper's application.
    key : int
        Seed of the noise.
    settled : float [s]
        Time before the recording.
    block : int
        Samples simulated at once.
    damping : callable, optional
        As of `Trial`.

    Returns
    -------
    dict of float to AirCut
        For `Loop`.

    Raises
    ------
    InputError
        If the rate of the windows is not that of the sampling.
    """
    if not math.isclose(windowing.rate, sampling.rate, rel_tol=1e-9):
        raise InputError(
            f"the windows are of {windowing.rate:g} Hz, but the sampling of {sampling.rate:g} Hz."
        )
    speeds = [o * spindle.rotation for o in overrides]
    keys = jax.random.split(jax.random.key(key), (len(speeds), 2))
    plants = stacked([_with_damping(plant, damping, speed) for speed in speeds])
    state = stacked([at_rest(plant, s, k[0]) for s, k in zip(speeds, keys, strict=True)])
    recorder = stacked([start_sampling(plant, sampling, k[1]) for k in keys])
    first = round(settled * sampling.rate) + sampling.delay
    count = first + windowing.length + (windows - 1) * windowing.step
    rotation = np.repeat(np.array(speeds)[:, None], block * sampling.oversampling, axis=1)
    parts = []
    for _ in range(-(-count // block)):
        state, signals = advance_together(plants, state, rotation, np.zeros_like(rotation))
        recorder, samples = sample_together(sampling, recorder, signals)
        parts.append(np.asarray(samples))
    records = np.concatenate(parts, axis=1)[:, first:count]
    return {
        o: air_cut(record, windowing, speed)
        for o, record, speed in zip(overrides, records, speeds, strict=True)
    }


def stacked(trees: Sequence[Any]) -> Any:
    """Trees of one shape as one, with an axis for them.

    Parameters
    ----------
    trees : sequence of pytree
        Plants, or states of them.

    Returns
    -------
    pytree
        Every leaf with a first axis more.

    Raises
    ------
    InputError
        If there are none, or they differ in more than the values of their leaves.
    """
    if not trees:
        raise InputError("no trial is given; give one at least.")
    shapes = {jax.tree.structure(t): None for t in trees}
    sizes = {tuple(np.shape(leaf) for leaf in jax.tree.leaves(t)) for t in trees}
    if len(shapes) > 1 or len(sizes) > 1:
        raise InputError(
            "plants that run side by side must have as many modes, teeth, sensors, slices and "
            "revolutions, one step and one range of speeds; run the others apart."
        )
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


class _Lane:
    """A trial on its way: where spindle and feed are, what the loop knows, what is summed up."""

    def __init__(self, trial: Trial, sampling: Sampling):
        rate = trial.loop.settings.windowing.rate
        if not math.isclose(rate, sampling.rate, rel_tol=1e-9):
            raise InputError(
                f"the detector is for {rate:g} Hz, but the sampling is of {sampling.rate:g} Hz."
            )
        self.trial, self.step = trial, sampling.step
        self.loop: LoopState = avoidance_loop.start(trial.loop, -sampling.delay / sampling.rate)
        self.turning = trial.loop.spindle.rotation
        self.clock = self.worked = self.energy = self.cutting = 0.0
        self.done = False
        self.log: list[LogRow] = []
        self.events: list[Event] = []
        self.blocks: list[tuple[float, float, float, float]] = []
        self.inside = np.zeros(0, bool)

    def ahead(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Speed and depth during the next block."""
        trial, spindle = self.trial, self.trial.loop.spindle
        wanted = self.loop.override * spindle.rotation
        rotation = rotation_ramp(self.turning, wanted, spindle.acceleration, steps, self.step)
        since = self.clock + (np.arange(steps) + 0.5) * self.step - trial.air
        share = np.where(since > 0.0, rotation / spindle.rotation * self.step, 0.0)
        worked = self.worked + np.cumsum(share)
        self.inside = (since > 0.0) & (worked <= trial.work)
        depth = trial.depth * np.clip(since / trial.entry, 0.0, 1.0)
        self.worked = float(worked[-1])
        return rotation, np.where(self.inside, depth, 0.0)

    def take(self, rotation: np.ndarray, samples: np.ndarray, beyond: np.ndarray) -> None:
        """What came of the block, and what the loop makes of it."""
        held = self.loop.override
        self.turning = float(rotation[-1])
        self.clock += len(rotation) * self.step
        cut = int(np.count_nonzero(self.inside))
        if cut:
            total = float(np.sum(beyond[self.inside]))
            self.energy += total * self.step
            self.cutting += cut * self.step
            self.blocks.append((self.clock, held, self.turning, math.sqrt(total / cut)))
        self.done = self.worked >= self.trial.work
        if not self.done:
            self.loop, rows, events = avoidance_loop.step(self.trial.loop, self.loop, samples)
            self.log += rows
            self.events += events

    def run(self) -> Run:
        """What came of it all."""
        time, override, rotation, vibration = np.array(self.blocks).T
        return Run(
            tuple(self.log),
            tuple(self.events),
            time,
            override,
            rotation,
            vibration,
            self.energy,
            self.cutting,
            self.cutting - self.trial.work,
            self.loop.changes,
        )


def _key(trial: Trial) -> jax.Array:
    return jax.random.key(trial.key)


def _rest(plant: Plant, trial: Trial) -> PlantState:
    key = jax.random.fold_in(_key(trial), 0)
    return at_rest(plant, trial.loop.spindle.rotation, key)


def _with_damping(plant: Plant, damping: Damping | None, rotation: float) -> Plant:
    if damping is None:
        return plant
    ratios = jnp.broadcast_to(jnp.asarray(damping(rotation), float), plant.modes.damping.shape)
    return eqx.tree_at(lambda p: p.modes.damping, plant, ratios)


def _damped(plants: Plant, trials: Sequence[Trial], rotation: np.ndarray) -> Plant:
    """Plants with the damping that their processes have at the middle of a block."""
    if all(t.damping is None for t in trials):
        return plants
    rows = [
        old
        if t.damping is None
        else np.broadcast_to(np.asarray(t.damping(float(r)), float), old.shape)
        for t, r, old in zip(
            trials, rotation.mean(axis=1), np.asarray(plants.modes.damping), strict=True
        )
    ]
    return eqx.tree_at(lambda p: p.modes.damping, plants, jnp.asarray(np.stack(rows)))
