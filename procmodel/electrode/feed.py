"""Speed along a path under limits of feed and acceleration, and how long the path takes.

Lengths in um, times in s.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procmodel.electrode.checks import not_negative, positive
from procmodel.errors import InputError

# A step of less does not move [um].
_STANDS = 1e-9


@dataclass(frozen=True)
class FeedProfile:
    """Speed at every position of a path.

    Attributes
    ----------
    way : numpy.ndarray, shape (n,) [um]
        Way from the start.
    speed : numpy.ndarray, shape (n,) [um/s]
        Speed along the path.
    time : numpy.ndarray, shape (n,) [s]
        When each position is reached.
    """

    way: np.ndarray
    speed: np.ndarray
    time: np.ndarray

    @property
    def duration(self) -> float:
        """Time for the whole path [s]."""
        return float(self.time[-1])


def travel_time(length: float, feed: float, acceleration: float) -> float:
    """Time for a line from rest to rest.

    Parameters
    ----------
    length : float [um]
        Length L.
    feed : float [um/s]
        Greatest speed f.
    acceleration : float [um/s^2]
        Greatest acceleration a, of speeding up and of braking.

    Returns
    -------
    float [s]
        L / f + f / a, or 2 sqrt(L / a) where the feed is not reached.

    Raises
    ------
    InputError
        If an argument is not finite or out of its range.
    """
    way = not_negative("the length", length)
    top = positive("the feed", feed, "um/s")
    a = positive("the acceleration", acceleration, "um/s^2")
    return way / top + top / a if way * a >= top**2 else 2.0 * math.sqrt(way / a)


def feed_along(points: ArrayLike, feed: float, acceleration: float) -> FeedProfile:
    """Fastest speed along positions that starts and ends at rest and keeps the limits.

    Parameters
    ----------
    points : array_like, shape (n, d) [um]
        Positions along the path before rounding, which would look like corners.
    feed : float [um/s]
        Greatest speed.
    acceleration : float [um/s^2]
        Greatest acceleration, along the path and, on its own, across it.

    Returns
    -------
    FeedProfile
        Speeds below the feed; below ``sqrt(a s / (2 tan(turn / 2)))`` where the path turns within
        steps of length s, which is sqrt(a r) on an arc and a stop where the path turns back; and
        such that the square of the speed changes by 2 a s at most in a step.

    Raises
    ------
    InputError
        If there are not two positions, one is not finite, or a limit is not above 0.
    """
    top = positive("the feed", feed, "um/s")
    a = positive("the acceleration", acceleration, "um/s^2")
    path = np.asarray(points, dtype=np.float64)
    if path.ndim != 2 or len(path) < 2:
        raise InputError("a feed needs a path of two positions or more.")
    if not np.all(np.isfinite(path)):
        row = int(np.argmax(~np.all(np.isfinite(path), axis=1)))
        raise InputError(f"position {row + 1} of the path is not finite: correct it.")
    kept, last_kept = _moving(path)
    moves = np.diff(path[kept], axis=0)
    steps = np.sqrt(np.sum(moves**2, axis=1))
    way = np.concatenate([[0.0], np.cumsum(steps)])
    # In the square of the speed the limit of acceleration is a slope of 2 a along the way, so that
    # the greatest speed under it is reached by one sweep forwards and one backwards.
    square = np.zeros(len(kept))
    square[1:-1] = _cornering(moves, steps, a, top)
    square = np.minimum.accumulate(square - 2.0 * a * way) + 2.0 * a * way
    square = np.minimum.accumulate((square + 2.0 * a * way)[::-1])[::-1] - 2.0 * a * way
    speed = np.sqrt(np.maximum(square, 0.0))
    time = np.concatenate([[0.0], np.cumsum(_times(steps, speed, a, top))])
    return FeedProfile(way[last_kept], speed[last_kept], time[last_kept])


def _moving(path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the positions that differ from the one before, and of each the last of them.

    A position that stands twice must not hide the corner at it.
    """
    steps = np.sqrt(np.sum(np.diff(path, axis=0) ** 2, axis=1))
    moves = np.append(True, steps > _STANDS)
    return np.flatnonzero(moves), np.cumsum(moves) - 1


def _cornering(moves: np.ndarray, steps: np.ndarray, a: float, top: float) -> np.ndarray:
    """Square of the speed allowed at the inner positions."""
    along = moves / steps[:, None]
    # tan(turn / 2) of two unit vectors is the length of their difference over that of their sum.
    apart = np.sqrt(np.sum((along[1:] - along[:-1]) ** 2, axis=1))
    together = np.sqrt(np.sum((along[1:] + along[:-1]) ** 2, axis=1))
    mean = 0.5 * (steps[1:] + steps[:-1])
    allowed = np.full(len(apart), top**2)
    turning = apart > 1e-12
    allowed[turning] = np.minimum(
        top**2, a * mean[turning] * together[turning] / (2.0 * apart[turning])
    )
    return allowed


def _times(steps: np.ndarray, speed: np.ndarray, a: float, top: float) -> np.ndarray:
    """Time of every step; one between two stops speeds up and brakes as a line of its own."""
    both = speed[1:] + speed[:-1]
    even = np.divide(2.0 * steps, both, out=np.zeros_like(steps), where=both > 0.0)
    alone = np.where(steps * a >= top**2, steps / top + top / a, 2.0 * np.sqrt(steps / a))
    return np.where(both > 0.0, even, alone)
