"""What the functions of this process refuse before they work, each in one sentence."""

import math
from collections.abc import Sequence

import jax
import numpy as np
from jax.typing import ArrayLike

from procmodel.errors import InputError

# An array of more points would take 16 GB.
MOST_STEPS = 10**9


def number(name: str, value: object, unit: str = "um") -> float:
    """A finite number.

    Parameters
    ----------
    name : str
        What it is called in the sentence.
    value : object
        What was given.
    unit : str
        Its unit, for the sentence.

    Returns
    -------
    float
        The value.

    Raises
    ------
    InputError
        If it is not one finite number.
    """
    refuse_traced(name, value)
    try:
        found = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}, but must be one number of {unit}.") from None
    if not math.isfinite(found):
        raise InputError(f"{name} is {found:g}, but must be a finite number of {unit}.")
    return found


def positive(name: str, value: object, unit: str = "um") -> float:
    """A finite number above 0; see `number`."""
    found = number(name, value, unit)
    if found <= 0.0:
        raise InputError(f"{name} is {found:g} {unit}, but must be above 0.")
    return found


def not_negative(name: str, value: object, unit: str = "um") -> float:
    """A finite number of 0 or more; see `number`."""
    found = number(name, value, unit)
    if found < 0.0:
        raise InputError(f"{name} is {found:g} {unit}, but must be 0 or more.")
    return found


def position(name: str, value: ArrayLike | Sequence[float], axes: tuple[int, ...]) -> np.ndarray:
    """A point with as many coordinates as one of `axes` says.

    Parameters
    ----------
    name : str
        What it is called in the sentence.
    value : array_like, shape (d,) [um]
        Its coordinates.
    axes : tuple of int
        Numbers of coordinates that are allowed.

    Returns
    -------
    numpy.ndarray, shape (d,) [um]
        The point.

    Raises
    ------
    InputError
        If it has another shape or a coordinate is not finite.
    """
    refuse_traced(name, value)
    allowed = " or ".join(map(str, axes))
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not a point: give {allowed} numbers of um.") from None
    if found.ndim != 1 or len(found) not in axes:
        raise InputError(f"{name} has the shape {found.shape}: give {allowed} numbers of um.")
    if not np.all(np.isfinite(found)):
        raise InputError(f"{name} is {found.tolist()}, but every coordinate must be finite.")
    return found


def step_and_resolution(step: object, resolution: object) -> tuple[float, float | None]:
    """Step of the interpolation, not below the resolution of the machine.

    Parameters
    ----------
    step : float [um]
        Greatest step.
    resolution : float or None [um]
        Step of the machine's axes; None rounds nothing.

    Returns
    -------
    tuple of float and float or None [um]
        The two.

    Raises
    ------
    InputError
        If one is not above 0, or the step is smaller than the resolution.
    """
    length = positive("the step", step)
    if resolution is None:
        return length, None
    grid = positive("the resolution", resolution)
    if length < grid:
        raise InputError(
            f"the step of {length:g} um is smaller than the resolution of {grid:g} um, so that "
            "some steps would not move: give a step of the resolution or more."
        )
    return length, grid


def step_count(ratio: float) -> int:
    """Whole number of steps, small enough for an array; see `count_of`."""
    if ratio > MOST_STEPS:
        raise InputError(
            f"the path takes {ratio:.3g} steps, more than {MOST_STEPS:g}: give a larger step or "
            "interpolate it in parts."
        )
    return count_of(ratio)


# Beyond a whole number of steps by less than this share of a step, no further step is taken: that
# little is rounding of the length, and far below what a machine resolves.
WHOLE = 1e-9


def count_of(ratio: float) -> int:
    """Steps that a length of `ratio` steps takes: ceil, guarded at whole numbers."""
    nearest = round(ratio)
    guard = max(WHOLE, 8.0 * float(np.finfo(float).eps) * ratio)
    return nearest if abs(ratio - nearest) <= guard and nearest > 0 else math.ceil(ratio)


def refuse_traced(name: str, value: object) -> None:
    """Refuse a value that JAX is tracing, on which a number of steps cannot depend."""
    if isinstance(value, jax.core.Tracer):
        raise TypeError(
            f"{name} is traced by JAX, and the number of steps may not depend on it: take the "
            "count first and call line_points or arc_points with it."
        )
