"""Ways of the electrode through its layers, sampled at steps of equal length for a simulation.

Lengths in um.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from procmodel.errors import InputError
from procmodel.wear.layer_path import LayerPath

# Steps of a layer come in whole chunks, 1, 2, 3, 4, 6, 8, 12, 16 ... of them, so that few different
# shapes are ever compiled. A simulation skips chunks without a step in them.
CHUNK = 128


class PathSteps(NamedTuple):
    """Positions at depth, layer by layer, padded to the same number of steps.

    Attributes
    ----------
    x, y : ndarray, shape (layers, steps) [um]
        Positions of the electrode's axis; padding repeats the layer's last position.
    length : ndarray, shape (layers, steps) [um]
        Way cut to reach the position from the one before; 0 where the electrode comes down,
        and in padding.
    valid : ndarray of bool, shape (layers, steps)
        False in padding, where nothing happens.
    quarter_turns : ndarray of int, shape (layers,)
        Quarter turns of the electrode, from how it was mounted, counter-clockwise from above.
    """

    x: np.ndarray
    y: np.ndarray
    length: np.ndarray
    valid: np.ndarray
    quarter_turns: np.ndarray

    @property
    def counts(self) -> np.ndarray:
        """Number of steps of every layer, shape (layers,)."""
        return np.sum(self.valid, axis=1)

    def layers(self, start: int, stop: int) -> "PathSteps":
        """The layers from ``start`` up to before ``stop``, padded no more than these need."""
        part = [np.asarray(field)[start:stop] for field in self]
        width = _padded(int(np.max(np.sum(part[3], axis=1), initial=0)))
        x, y, length, valid = (field[:, :width] for field in part[:4])
        return PathSteps(x, y, length, valid, part[4])


def path_steps(paths: Sequence[LayerPath], step: float) -> PathSteps:
    """Positions along every cutting move, both ends included, no further apart than a step.

    Parameters
    ----------
    paths : sequence of LayerPath
        The way through every layer, from the top. A path of one point is a plunge there.
    step : float [um]
        Greatest distance between two positions, > 0. Every move is divided evenly.

    Returns
    -------
    PathSteps
        Arrays of shape (layers, steps). Lifted moves leave no position but their ends.

    Raises
    ------
    InputError
        If there is no layer, a layer cuts nothing, or the step is not above 0.
    """
    if not (math.isfinite(step) and step > 0):
        raise InputError(f"step {step:g} um must be above 0.")
    if len(paths) == 0:
        raise InputError("there are no layers: give a path for at least one.")
    sampled = [_sampled(path, step, number) for number, path in enumerate(paths, start=1)]
    width = _padded(max(len(x) for x, _, _ in sampled))
    count = len(sampled)
    x, y, length = np.empty((3, count, width))
    valid = np.zeros((count, width), bool)
    for row, (xs, ys, lengths) in enumerate(sampled):
        used = len(xs)
        x[row, :used], x[row, used:] = xs, xs[-1]
        y[row, :used], y[row, used:] = ys, ys[-1]
        length[row, :used], length[row, used:] = lengths, 0.0
        valid[row, :used] = True
    turns = np.array([path.quarter_turns for path in paths], dtype=int)
    return PathSteps(x, y, length, valid, turns)


def _sampled(path: LayerPath, step: float, number: int) -> tuple[np.ndarray, ...]:
    """x, y and length of the positions of one layer."""
    points, lengths = path.points, path.move_lengths
    if len(points) == 1:
        return points[:, 0], points[:, 1], np.zeros(1)
    if not np.any(path.cutting):
        raise InputError(f"layer {number}: no move of its path cuts; leave the layer out.")
    xs: list[np.ndarray] = []
    ways: list[np.ndarray] = []
    down = False
    for move in np.flatnonzero(path.cutting):
        if not (down and path.cutting[move - 1]):
            xs.append(points[move : move + 1])
            ways.append(np.zeros(1))
        down = True
        if lengths[move] == 0.0:
            continue
        # A length that is a multiple of the step but for rounding is not divided once more.
        parts = max(1, math.ceil(lengths[move] / step - 1e-9))
        share = (np.arange(1, parts + 1) / parts)[:, None]
        # Ends are met exactly: a * (1 - s) + b * s gives b at s = 1.
        xs.append(points[move] * (1.0 - share) + points[move + 1] * share)
        ways.append(np.full(parts, lengths[move] / parts))
    x, y = np.concatenate(xs).T
    return x, y, np.concatenate(ways)


def _padded(count: int) -> int:
    """Least of the padded numbers of steps that holds as many as given."""
    width = CHUNK
    while width < count:
        width *= 2
    # Three quarters of a power of two, where that is a whole number of chunks and enough.
    return width * 3 // 4 if width >= 4 * CHUNK and width * 3 // 4 >= count else width
