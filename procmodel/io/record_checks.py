"""Faults of a sensor or of a recording that show in its samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from procmodel.errors import InputError

NOT_FINITE = "not finite"
VALUES_REPEATED = "values repeated"
STUCK = "stuck"
CLIPPED = "clipped"
OUTLIER_AT_START = "outlier at the start"

_MOST_HELD = 16
# Changes of value that may fall outside the rhythm of a hold.
_OUT_OF_RHYTHM = 0.01
_FEWEST_CHANGES = 32
# A run is stuck if chance makes one as long in fewer than this share of recordings.
_CHANCE = 1e-3
_FEW_LEVELS = 6
_FEWEST_CLIPPED, _CLIPPED_EXCESS, _LEVELS_BESIDE = 10, 5.0, 3
_START, _START_NEIGHBOURS, _OUTLYING = 4, 4096, 10.0


class Finding(NamedTuple):
    """A fault of a recording.

    Attributes
    ----------
    name : str
        "not finite", "values repeated", "stuck", "clipped" or "outlier at the start".
    first_sample : int
        First sample concerned, from 0.
    count : int
        Samples concerned; of repeated values those that add nothing.
    sentence : str
        What was found, in which channel, and what to do.
    """

    name: str
    first_sample: int
    count: int  # type: ignore[assignment]  # hides a method of tuple that has no use here
    sentence: str


def flags(
    samples: np.ndarray, channels: Sequence[str] | None = None, stuck_length: int = 16
) -> list[Finding]:
    """Faults in a recording.

    Parameters
    ----------
    samples : array_like, shape (n,) or (n, c)
        The recording, in any unit.
    channels : sequence of str, optional
        Names for the sentences; left out, the channels are numbered.
    stuck_length : int
        Shortest run of one value that may count as a sensor that is stuck; where values repeat
        by chance or because they are held, only longer ones do.

    Returns
    -------
    list of Finding
        Channel by channel; empty where nothing was found.

    Raises
    ------
    InputError
        If the shape is another, or `channels` does not name each channel.
    """
    table = np.asarray(samples, np.float64)
    if table.ndim == 1:
        table = table[:, None]
    if table.ndim != 2:
        raise InputError(f"samples have shape {table.shape}: give one column per channel")
    count = table.shape[1]
    names = [f"channel {i + 1}" for i in range(count)] if channels is None else list(channels)
    if len(names) != count:
        raise InputError(f"{len(names)} names for {count} channels: name each")
    if stuck_length < 2:
        raise InputError(f"stuck_length is {stuck_length}: give at least 2")
    findings: list[Finding] = []
    for name, values in zip(names, table.T, strict=True):
        findings += _flags_of_channel(np.ascontiguousarray(values), name, stuck_length)
    return findings


def held_samples(samples: np.ndarray) -> int:
    """How many times each value stands in a row; 1 where values are not held.

    Parameters
    ----------
    samples : array_like, shape (n,)
        One channel.

    Returns
    -------
    int
        Largest k up to 16 such that values change at every k-th sample only; the true sampling
        rate is lower by this factor.
    """
    values = np.asarray(samples, np.float64)
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    if len(changes) < _FEWEST_CHANGES:
        return 1
    if len(np.unique(values[np.isfinite(values)])) <= _FEW_LEVELS:
        # Pulses of a switch, say one per revolution, may keep a rhythm without being held.
        return 1
    for factor in range(_MOST_HELD, 1, -1):
        in_rhythm = np.bincount(changes % factor, minlength=factor).max()
        if in_rhythm >= (1.0 - _OUT_OF_RHYTHM) * len(changes):
            return factor
    return 1


def _flags_of_channel(values: np.ndarray, name: str, stuck_length: int) -> list[Finding]:
    findings = []
    faulty = ~np.isfinite(values)
    if faulty.any():
        first, count = int(np.argmax(faulty)), int(faulty.sum())
        findings.append(
            Finding(
                NOT_FINITE,
                first,
                count,
                f"{name}: {count} samples are not finite, the first is number {first + 1}: cut "
                "them out",
            )
        )
    if len(values) < 2:
        return findings
    held = held_samples(values)
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    lengths = np.diff(starts, append=len(values))
    if held > 1:
        repeated = len(values) - len(values) // held
        first = int(starts[np.argmax(lengths >= held)]) + 1
        findings.append(
            Finding(
                VALUES_REPEATED,
                first,
                repeated,
                f"{name}: every value stands {held} times in a row, so the true sampling rate is "
                f"lower by {held}: use nothing above 1/{2 * held} of the rate",
            )
        )
    clipped = _clipped(values[starts], lengths, held)
    findings += _stuck(values, starts, lengths, held, stuck_length, clipped, name)
    for level, side in clipped.items():
        at = values == level
        first, count = int(np.argmax(at)), int(at.sum())
        findings.append(
            Finding(
                CLIPPED,
                first,
                count,
                f"{name}: {count} samples stand exactly at the {side}, {level:g}: widen the range "
                "of the sensor or turn down its gain",
            )
        )
    return findings + _outlier_at_start(values, held, name)


def _clipped(run_values: np.ndarray, lengths: np.ndarray, held: int) -> dict[float, str]:
    """Extreme values that occur far more often than those beside them, and on which side."""
    finite = np.isfinite(run_values)
    levels, inverse = np.unique(run_values[finite], return_inverse=True)
    if len(levels) <= _FEW_LEVELS:
        return {}
    counts = np.bincount(inverse, np.maximum(lengths[finite] // held, 1))
    found = {}
    sides = (
        (counts[0], counts[1 : 1 + _LEVELS_BESIDE], levels[0], "minimum"),
        (counts[-1], counts[-1 - _LEVELS_BESIDE : -1], levels[-1], "maximum"),
    )
    for count, beside, level, side in sides:
        # A sine has 2.4 times as many readings at its top level as at the next one.
        if count >= _FEWEST_CLIPPED and count > _CLIPPED_EXCESS * beside.max():
            found[float(level)] = side
    return found


def _stuck(
    values: np.ndarray,
    starts: np.ndarray,
    lengths: np.ndarray,
    held: int,
    stuck_length: int,
    clipped: dict[float, str],
    name: str,
) -> list[Finding]:
    """Runs of one value that neither a hold nor chance explains."""
    in_steps = lengths // held
    candidates = (in_steps >= stuck_length) & ~np.isin(values[starts], list(clipped))
    if not candidates.any():
        return []
    # How often a value follows its like elsewhere, as in a quiet signal of few digits.
    others = np.maximum(np.delete(in_steps, np.argmax(in_steps)), 1)
    alike = float(np.sum(others - 1)) / max(float(np.sum(others)), 1.0)
    by_chance = len(values) / held * alike ** (in_steps - 1.0)
    stuck = np.flatnonzero(candidates & (by_chance < _CHANCE))
    if not len(stuck):
        return []
    longest = int(stuck[np.argmax(lengths[stuck])])
    count = int(lengths[stuck].sum())
    return [
        Finding(
            STUCK,
            int(starts[stuck[0]]),
            count,
            f"{name}: {count} samples stand still, {int(lengths[longest])} of them at "
            f"{values[starts[longest]]:g} from number {int(starts[longest]) + 1} on: check sensor "
            "and cable",
        )
    ]


def _outlier_at_start(values: np.ndarray, held: int, name: str) -> list[Finding]:
    """The first samples, where they lie far outside of what follows."""
    start = _START * held
    beside = values[start : start + _START_NEIGHBOURS]
    beside = beside[np.isfinite(beside)]
    if len(beside) < _FEWEST_CHANGES:
        return []
    middle = float(np.median(beside))
    deviations = np.abs(beside - middle)
    # Outlying has to be so against the largest of the neighbours as well: signals may be spiky.
    limit = max(_OUTLYING * 1.4826 * float(np.median(deviations)), 2.0 * float(deviations.max()))
    outside = np.flatnonzero(np.abs(values[:start] - middle) > limit)
    if not len(outside) or limit == 0.0:
        return []
    first, count = int(outside[0]), len(outside)
    return [
        Finding(
            OUTLIER_AT_START,
            first,
            count,
            f"{name}: {count} of the first {start} samples lie far outside of what follows, "
            f"number {first + 1} is {values[first]:g}: start later",
        )
    ]
