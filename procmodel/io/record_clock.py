"""The clock of a recording: its rate, and whether it went evenly, stood still or jumped."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from typing import NamedTuple

import numpy as np

from procmodel.errors import InputError

# Steps may differ by this share besides the rounding of the printed times.
_UNEVEN = 1e-3
_MOST_DIGITS_LOOKED_AT = 201


class Flaw(NamedTuple):
    """Where a clock first leaves its beat.

    Attributes
    ----------
    at : int
        First reading after the flaw.
    missing : int
        Samples missing before it; 0 where the step is no multiple of the beat.
    sentence : str
        What is wrong, without a place.
    """

    at: int
    missing: int
    sentence: str


def rate_of_clock(times: np.ndarray, resolution: float = 0.0) -> float:
    """Sampling rate of evenly spaced times.

    Parameters
    ----------
    times : numpy.ndarray, shape (n,) [s]
        Times of successive samples, the beginning of a recording at least.
    resolution : float [s]
        Unit of the last digit with which they were written.

    Returns
    -------
    float
        In Hz: the roundest number that the digits allow, from the readings up to the first flaw.

    Raises
    ------
    InputError
        If there are fewer than two times, they do not rise, or are uneven from the start on.
    """
    steps = np.diff(times)
    if not len(steps):
        raise InputError("one time does not tell the rate: record more, or give the rate")
    median = float(np.median(steps))
    if not (np.isfinite(times).all() and median > 0.0):
        raise InputError("the times do not rise: correct them, or leave them out and give the rate")
    # Where digits are few, a step that is half as long again is still a gap.
    slack = min(2.0 * resolution, 0.5 * median) + _UNEVEN * median + _float_spacing(times)
    flaws = np.flatnonzero(np.abs(steps - median) > slack)
    even = int(flaws[0]) if len(flaws) else len(steps)
    if even == 0:
        raise InputError(
            f"the first step of {steps[0]:g} s is not like the others of {median:g} s: delete "
            "what was recorded before it"
        )
    span = float(times[even] - times[0])
    rate = even / span
    tolerance = resolution / span + 1e-12
    if tolerance < 1e-4:
        for digits in range(1, 12):
            rounded = float(f"{rate:.{digits}g}")
            if abs(rounded - rate) <= tolerance * rate:
                return rounded
    return rate


def rate_of_even_clock(times: np.ndarray) -> float:
    """`rate_of_clock` of an array from a binary file, refused at its first flaw.

    Raises
    ------
    InputError
        As for `rate_of_clock`, or if the times are not even throughout.
    """
    seconds = np.asarray(times, np.float64)
    resolution = float(np.spacing(np.max(np.abs(times)))) if times.dtype == np.float32 else 0.0
    rate = rate_of_clock(seconds, resolution)
    flaw = first_flaw(seconds, rate, resolution)
    if flaw is not None:
        raise InputError(f"sample {flaw.at + 1}: {flaw.sentence}")
    return rate


def first_flaw(
    times: np.ndarray, rate: float, resolution: float = 0.0, unit: str = "s"
) -> Flaw | None:
    """First place where times do not rise by one sampling interval, or None.

    Parameters
    ----------
    times : numpy.ndarray, shape (n,) [s]
        Times of successive samples.
    rate : float [Hz]
        The beat they should keep.
    resolution : float [s]
        Unit of the last digit with which they were written.
    unit : str
        In which the sentence speaks; a count of samples is a clock with rate 1 and unit "samples".
    """
    step = 1.0 / rate
    steps = np.diff(times)
    if not len(steps):
        return None
    slack = resolution * 1.001 + _UNEVEN * step + _float_spacing(times)
    # Written so that a time that is not a number counts as a flaw too.
    flaws = np.flatnonzero(~(np.abs(steps - step) <= slack))
    if not len(flaws):
        mean = float(times[-1] - times[0]) / len(steps)
        if abs(mean - step) <= 2.0 * resolution / len(steps) + _UNEVEN * step:
            return None
        return Flaw(
            1, 0, f"it rises by {mean:g} {unit} on average, not by {step:g} {unit}: check the rate"
        )
    index = int(flaws[0])
    found = float(steps[index])
    multiple = round(found / step) if np.isfinite(found) else 0
    if multiple >= 2 and abs(found - multiple * step) <= slack * multiple:
        count = multiple - 1
        return Flaw(
            index + 1,
            count,
            f"{count} sample{'s are' if count > 1 else ' is'} missing before it: read the parts "
            "before and after the gap on their own",
        )
    if found <= 0.0:
        return Flaw(index + 1, 0, "it does not rise: delete what is there twice")
    return Flaw(
        index + 1,
        0,
        f"an uneven step of {found:g} {unit} where {step:g} {unit} is due: record at a constant "
        "rate",
    )


def rounding(rate: float, resolution: float) -> float:
    """By how much printed times of this rate are rounded, at most, from step to step [s].

    Parameters
    ----------
    rate : float [Hz]
        Sampling rate.
    resolution : float [s]
        Unit of the last digit with which the times were written; where the sampling interval is a
        multiple of it, nothing is rounded. More than half an interval leaves a gap unseen.
    """
    if resolution == 0.0:
        return 0.0
    multiple = 1.0 / (rate * resolution)
    return 0.0 if round(multiple) and abs(multiple - round(multiple)) < 1e-6 else resolution


def printed_resolution(cells: Sequence[str]) -> float:
    """Unit of the last digit of numbers as printed; 0 where they are no numbers.

    Numbers may have lost zeros at their end; of those near the end of `cells` the median counts.
    """
    exponents = []
    for cell in cells[-_MOST_DIGITS_LOOKED_AT:]:
        try:
            exponent = Decimal(cell.strip()).as_tuple().exponent
        except InvalidOperation:
            continue
        if isinstance(exponent, int):
            exponents.append(exponent)
    return float(10.0 ** float(np.median(exponents))) if exponents else 0.0


def _float_spacing(times: np.ndarray) -> float:
    """Rounding of a difference of times as floats."""
    return 4.0 * float(np.spacing(np.max(np.abs(times), initial=0.0)))
