"""The rules of the detector, one by one: votes, outcomes, growth, windows that are not scored."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

STABLE, MARGINAL, CHATTER = "stable", "marginal", "chatter"

OUTCOMES = {
    "": "not judged: the tool does not cut, or has only begun to",
    STABLE: "stable: no rule comes near its threshold",
    MARGINAL: "marginal: a rule has passed the margin below its threshold, but not the threshold",
    CHATTER: "chatter: a rule has passed its threshold",
}

DISTANCE, AVERAGED, SUBHARMONIC = "distance", "averaged distance", "subharmonic"

NOT_FINITE, STUCK, CLIPPED = "not finite", "stuck", "clipped"

FAULTS = {
    NOT_FINITE: "a sample is not a finite number",
    STUCK: "the sensor gives the same value for longer than a signal would",
    CLIPPED: "the signal stands at its limit, so that its true height is unknown",
}


class BadWindows(NamedTuple):
    """Windows that were counted, but not scored.

    Attributes
    ----------
    not_finite, stuck, clipped : int
        How many for each of `FAULTS`.
    """

    not_finite: int = 0
    stuck: int = 0
    clipped: int = 0

    def and_one(self, fault: str) -> "BadWindows":
        """One more of a fault."""
        field = fault.replace(" ", "_")
        return self._replace(**{field: getattr(self, field) + 1})

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each fault that occurred."""
        counts = zip(self, FAULTS.values(), strict=True)
        return tuple(
            f"{count} {'windows were' if count > 1 else 'window was'} not scored: {why}."
            for count, why in counts
            if count
        )


def passed(scores: Sequence[float], threshold: float, votes: int) -> bool:
    """Whether a threshold is exceeded in at least so many of the windows given."""
    return sum(score > threshold for score in scores) >= votes


def outcome_after(before: str, chatter: bool, marginal: bool) -> str:
    """Outcome of a window.

    Parameters
    ----------
    before : str
        Outcome of the window before.
    chatter, marginal : bool
        Whether a rule has passed its threshold, or the margin below it.

    Returns
    -------
    str
        Key into `OUTCOMES`. Chatter ends only below the margin, so that it does not come and go.
    """
    if chatter or (before == CHATTER and marginal):
        return CHATTER
    return MARGINAL if marginal else STABLE


def growth_rate(time: Sequence[float], power: Sequence[float]) -> float | None:
    """Growth rate of a line.

    Parameters
    ----------
    time : sequence of float, shape (k,) [s]
        Of the windows.
    power : sequence of float, shape (k,) [unit^2]
        Of the line, positive.

    Returns
    -------
    float or None [1/s]
        Least-squares slope of log(power) / 2, the logarithm of the amplitude; None of fewer than
        three windows.
    """
    if len(time) < 3:
        return None
    since = np.asarray(time) - np.mean(time)
    return float(np.sum(since * np.log(power)) / (2.0 * np.sum(since**2)))


def fault_of(window: np.ndarray, level: float, stuck: int, limit: float | None) -> str:
    """What is wrong with a window.

    Parameters
    ----------
    window : ndarray, shape (n, c) [unit]
        Samples.
    level : float
        Level of the window, which is not finite if one of its samples is not.
    stuck : int
        Equal samples in a row from which on a sensor counts as stuck.
    limit : float, optional [unit]
        Range of the sensor; without it a flat top tells.

    Returns
    -------
    str
        Key into `FAULTS`, or "".
    """
    if not np.isfinite(level):
        return NOT_FINITE
    # A run that long covers two neighbours of this coarse comb: a cheap look before the true one.
    comb = window[:: max(1, stuck // 2)]
    if (comb[1:] == comb[:-1]).any() and longest_run(window) >= stuck:
        return STUCK
    # Channel by channel in memory, where searches for extremes are several times faster.
    return CLIPPED if _clipped(np.ascontiguousarray(window.T), limit) else ""


def longest_run(window: np.ndarray) -> int:
    """Most equal samples in a row of any channel of a window, shape (n, c)."""
    longest = 1
    for channel in window.T:
        ends = np.flatnonzero(np.concatenate([[True], channel[1:] != channel[:-1], [True]]))
        longest = max(longest, int(np.diff(ends).max()))
    return longest


def _clipped(channels: np.ndarray, limit: float | None) -> bool:
    """Whether samples (c, n) stand at the limit, or form flat tops at their extremes."""
    high, low = channels.max(axis=1, keepdims=True), channels.min(axis=1, keepdims=True)
    if limit is not None:
        return bool((high >= limit).any() or (low <= -limit).any())
    extreme = (channels == high) | (channels == low)
    few = max(8, channels.shape[1] // 200)
    for channel, at in zip(channels, extreme, strict=True):
        if np.count_nonzero(at) < few:
            continue
        # The middles of three in a row; a sensor that holds each value twice has none but by
        # chance. A signal of a few digits stands at its extremes without being cut off.
        flat = np.count_nonzero(at[1:-1] & at[:-2] & at[2:])
        if flat >= few and len(np.unique(channel)) > 16:
            return True
    return False
