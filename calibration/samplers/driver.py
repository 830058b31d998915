"""Runs a sampler piece by piece: progress, checkpoints, and the same result either way."""

import time
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from calibration.checkpoint import Arrays, Checkpoint
from calibration.progress import Progress

State = Mapping[str, Any]
# A piece of work between two looks at the clock [s].
_PIECE_SECONDS = 0.25


class Steps(NamedTuple):
    """Steps of all ensembles.

    Attributes
    ----------
    positions : ndarray, shape (steps, ensembles, walkers, p)
        Natural values.
    log_density : ndarray, shape (steps, ensembles, walkers)
        Log density of each.
    accepted : ndarray, shape (steps, ensembles, walkers)
        Whether the walker moved, or the mean acceptance of its move.
    trouble : ndarray, shape (steps, ensembles, walkers)
        Whether the move met trouble of its own kind, such as a divergence of NUTS.
    """

    positions: np.ndarray
    log_density: np.ndarray
    accepted: np.ndarray
    trouble: np.ndarray


class Sampler(Protocol):
    """A sampler whose state is a dictionary of arrays.

    Attributes
    ----------
    most : int
        Most steps of one call.
    warmup : int
        Units of warm-up, in whatever the sampler counts.
    """

    most: int
    warmup: int

    def begin(self) -> State:
        """State before the warm-up."""

    def warm_up(self, state: State, count: int) -> State:
        """Some units of warm-up."""

    def advance(self, state: State, count: int) -> tuple[State, Steps]:
        """Some steps; the result must not depend on how many are made in a call."""


def run(sampler: Sampler, steps: int, checkpoint: Checkpoint | None, progress: Progress) -> Steps:
    """Warm up, then make and keep steps.

    Parameters
    ----------
    sampler : Sampler
        What makes them.
    steps : int
        Steps kept.
    checkpoint : Checkpoint, optional
        Where to go on from, and to write to.
    progress : Progress
        What to report to.

    Returns
    -------
    Steps
        All steps kept.
    """
    saved = None if checkpoint is None else checkpoint.load()
    warmed, kept = 0, list[Steps]()
    state: State | None = None
    if saved is not None:
        warmed = int(saved["warmed"])
        state = {n.removeprefix("state_"): a for n, a in saved.items() if n.startswith("state_")}
        kept = [Steps(*(saved[name] for name in Steps._fields))] if "positions" in saved else []
    done = sum(len(part.log_density) for part in kept)

    def save(final: bool = False) -> None:
        if checkpoint is not None and (final or checkpoint.due):
            checkpoint.save(_arrays(state or {}, warmed, kept))

    if state is None:
        progress.compiling("start")
        state = jax.block_until_ready(sampler.begin())
        progress.running("start", 1, 1)
    piece = 1
    try:
        while warmed < sampler.warmup or done < steps:
            warming = warmed < sampler.warmup
            stage, total = ("warm-up", sampler.warmup) if warming else ("sampling", steps)
            before = warmed if warming else done
            if piece == 1:
                progress.compiling(stage)
            else:
                progress.running(stage, before, total)
            count = min(piece, total - before, sampler.most)
            begin = time.monotonic()
            if warming:
                state = jax.block_until_ready(sampler.warm_up(state, count))
                warmed += count
            else:
                state, part = sampler.advance(state, count)
                kept.append(part)
                done += count
            progress.running(stage, before + count, total)
            taken = time.monotonic() - begin
            if piece == 1:
                # The first call may have compiled: the second tells how long a step takes.
                piece = 2
            else:
                wanted = int(count * _PIECE_SECONDS / max(taken, 1e-6))
                piece = max(2, min(sampler.most, wanted, 8 * piece))
            if warming and warmed == sampler.warmup:
                piece = 1  # what makes the steps may have to be compiled now
            save()
    except KeyboardInterrupt:
        save(final=True)
        raise
    save(final=True)
    return _joined(kept)


def _arrays(state: State, warmed: int, kept: list[Steps]) -> Arrays:
    arrays = {f"state_{name}": np.asarray(array) for name, array in state.items()}
    arrays["warmed"] = np.asarray(warmed)
    if kept:
        kept[:] = [_joined(kept)]
        arrays |= kept[0]._asdict()
    return arrays


def _joined(kept: list[Steps]) -> Steps:
    return Steps(*(np.concatenate(parts) for parts in zip(*kept, strict=True)))
