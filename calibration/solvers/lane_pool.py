"""Feeds fits to the lanes of `calibration.solvers.lanes` and takes their results out."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from calibration.many_readings import SOUND, Readings
from calibration.solvers import lanes
from calibration.solvers.box_lm import RUNNING
from calibration.solvers.lanes import LaneProgram, Numbers, OneFit, State

# Memory that the readings of all lanes of one loop may take: what stays in a core's cache on
# a processor, what keeps an accelerator busy.
_BYTES = {"cpu": 2**20, "other": 2**28}
_WIDEST = {"cpu": 1024, "other": 2**16}
# Width for few fits; wider in steps of 4, so that few widths are ever compiled.
_NARROW = 32
_MAX_STEPS = 60
_MOST_THREADS = 8


@dataclass(frozen=True)
class Box:
    """Numbers that all fits share: fixed values (q,), and bounds (p,) in internal coordinates."""

    fixed: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def solve_all(
    fit: OneFit,
    box: Box,
    readings: Readings,
    starts: np.ndarray,
    progress: Callable[[int], None] | None = None,
) -> State:
    """Run every sound fit of a group through the lanes.

    Parameters
    ----------
    fit : OneFit
        Residuals of one fit.
    box : Box
        Fixed values and bounds.
    readings : Readings
        The group, k fits.
    starts : ndarray, shape (p, k) or (p, 1)
        Internal starts.
    progress : callable, optional
        Called with the number of fits that have just finished; one thread at a time.

    Returns
    -------
    State
        Where each fit ended, arrays (..., k). Those that were not sound have status `lanes.IDLE`.
    """
    source = _Source(fit, box, readings, starts, progress)
    if len(source.order) == 0:
        return State.unpacked(source.ended, len(box.lower))
    devices = jax.local_devices()
    on_cpu = devices[0].platform == "cpu"
    width = _width(len(source.order), readings.y.shape[1], len(box.lower), on_cpu)
    mesh = Mesh(np.array(devices), ("lanes",)) if len(devices) > 1 else None
    program = LaneProgram(fit, readings.x_axes, readings.sigma_axis, _MAX_STEPS, mesh)
    # XLA itself hardly uses a second core for loops of this size; a second loop does.
    threads = min(usable_cores(), _MOST_THREADS, -(-len(source.order) // width))
    threads = threads if on_cpu and mesh is None else 1
    if threads == 1:
        source.work(program, width * len(devices))
    else:
        with ThreadPoolExecutor(threads) as executor:
            try:
                runs = [executor.submit(source.work, program, width) for _ in range(threads)]
                for run in runs:
                    run.result()
            except BaseException:
                source.stop()
                raise
    return State.unpacked(source.ended, len(box.lower))


def _width(fits: int, readings: int, parameters: int, on_cpu: bool) -> int:
    kind = "cpu" if on_cpu else "other"
    bytes_per_lane = 8 * readings * (parameters + 4)
    lanes_in_memory = max(_BYTES[kind] // bytes_per_lane, _NARROW)
    widest = min(2 ** (lanes_in_memory.bit_length() - 1), _WIDEST[kind])
    width = _NARROW
    while width < min(fits, widest):
        width *= 4
    return min(width, widest)


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Source:
    """The fits that wait, and those that have ended; shared by the threads."""

    def __init__(
        self,
        fit: OneFit,
        box: Box,
        readings: Readings,
        starts: np.ndarray,
        progress: Callable[[int], None] | None,
    ):
        self.box, self.readings, self.progress = box, readings, progress
        self.starts = np.broadcast_to(starts, (len(box.lower), len(readings.y)))
        informing = sum(prior.informs for _, prior in fit.layout.priors)
        self.freedom = np.maximum(readings.count + informing - len(box.lower), 1)
        self.order = np.flatnonzero(readings.state == SOUND)
        self.ended = lanes.idle(len(box.lower), len(readings.y))
        self._taken = 0
        self._lock = threading.Lock()
        self._compiling = threading.Lock()

    def stop(self) -> None:
        self._taken = len(self.order)

    def _take(self, most: int) -> np.ndarray:
        with self._lock:
            begin, self._taken = self._taken, min(self._taken + most, len(self.order))
            return self.order[begin : self._taken]

    def work(self, program: LaneProgram, width: int) -> None:
        """Keep `width` lanes busy until no fit is left."""
        readings, rows = self.readings, State.rows(program.count)
        packed = lanes.idle(program.count, width)
        of_lane = np.full(width, -1)
        own: dict[str, Any] = {
            "x": tuple(
                leaf if axis is None else np.repeat(leaf[self.order[:1]], width, axis=0)
                for leaf, axis in zip(readings.x, readings.x_axes, strict=True)
            ),
            "y": np.zeros((width, readings.y.shape[1])),
            "inverse_sigma": readings.inverse_sigma,
        }
        if readings.sigma_axis == 0:
            own["inverse_sigma"] = np.zeros_like(own["y"])
        numbers = Numbers(
            fixed=self.box.fixed,
            lower=self.box.lower[:, None],
            upper=self.box.upper[:, None],
            **own,
        )
        free, first = np.arange(width), True
        while True:
            fits = self._take(len(free))
            into = free[: len(fits)]
            of_lane[into] = fits
            lanes.begin(packed, into, self.starts[:, fits], self.freedom[fits])
            self._copy(numbers, into, fits)
            if np.all(of_lane < 0):
                return
            # While others wait, half of the lanes empty is reason to fill them.
            share = program.mesh.size if program.mesh else 1
            leave = np.int32(width // share // 2 if len(fits) == len(free) else 0)
            if first:
                with self._compiling:
                    packed = np.array(lanes.advance(program, packed, numbers, leave))
            else:
                packed = np.array(lanes.advance(program, packed, numbers, leave))
            first = False
            free = np.flatnonzero(packed[rows.status][0] != RUNNING)
            done = free[of_lane[free] >= 0]
            self.ended[:, of_lane[done]] = packed[:, done]
            of_lane[done] = -1
            if self.progress is not None:
                with self._lock:
                    self.progress(len(done))

    def _copy(self, numbers: Numbers, into: np.ndarray, fits: np.ndarray) -> None:
        numbers.y[into] = self.readings.y[fits]
        for lane_x, x, axis in zip(numbers.x, self.readings.x, self.readings.x_axes, strict=True):
            if axis is not None:
                lane_x[into] = x[fits]
        if self.readings.sigma_axis is not None:
            numbers.inverse_sigma[into] = self.readings.inverse_sigma[fits]
