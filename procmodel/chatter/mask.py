"""Bins that are left out of the search: forced lines, mains lines, what is outside the band.

A tool that turns makes lines at every multiple of its rotation, in air and more so in the cut,
whether it chatters or not. A line fills the bins of the taper's main lobe; at order k it may also
lie off by k times what the rotation is uncertain by.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from procmodel.errors import InputError


def in_band(frequencies: Any, low: float, high: float) -> Any:
    """Whether bins lie in a band, ends included, shape (bins,) of bool."""
    return (frequencies >= low) & (frequencies <= high)


def soft_band(frequencies: Any, low: Any, high: Any, width: Any, xp: Any = jnp) -> Any:
    """Weights of a band whose edges have a gradient.

    Parameters
    ----------
    frequencies : array, shape (bins,) [Hz]
        Of the bins.
    low, high : float [Hz]
        Edges of the band.
    width : float [Hz]
        Width of an edge; the limit 0 is `in_band`.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (bins,)
        s((f - low) / width) s((high - f) / width) with s(u) = (1 + tanh(u / 2)) / 2.
    """
    rise = 0.5 * (1.0 + xp.tanh(0.5 * (frequencies - low) / width))
    fall = 0.5 * (1.0 + xp.tanh(0.5 * (high - frequencies) / width))
    return rise * fall


def rotation_lines(
    frequencies: Any, rotation: Any, half_width: Any, uncertainty: Any = 0.0, xp: Any = jnp
) -> Any:
    """Bins at the multiples of the rotation, the constant part (order 0) among them.

    Parameters
    ----------
    frequencies : array, shape (bins,) [Hz]
        Of the bins.
    rotation : float [Hz]
        Rotation frequency of the spindle.
    half_width : float [Hz]
        Of a line.
    uncertainty : float [Hz]
        What the rotation may be off by.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (bins,) of bool
        |f - k rotation| <= half width + k uncertainty, with k the nearest order.
    """
    order = xp.round(frequencies / rotation)
    return xp.abs(frequencies - order * rotation) <= half_width + order * uncertainty


def listed_lines(frequencies: np.ndarray, lines: Sequence[float], half_width: float) -> np.ndarray:
    """Bins at listed frequencies.

    Parameters
    ----------
    frequencies : ndarray, shape (bins,) [Hz]
        Of the bins.
    lines : sequence of float [Hz]
        What is to be ignored.
    half_width : float [Hz]
        Of a line.

    Returns
    -------
    ndarray, shape (bins,) of bool
        |f - line| <= half width for one of the lines.
    """
    listed = np.asarray(lines, float).reshape(-1, 1)
    return (np.abs(frequencies - listed) <= half_width).any(axis=0)


def mains_lines(mains: float, top: float) -> np.ndarray:
    """Multiples of the mains frequency up to a frequency, shape (lines,) [Hz]."""
    return mains * np.arange(1, int(top / mains) + 1)


def free_bins(
    frequencies: np.ndarray,
    band: tuple[float, float],
    rotation: float,
    half_width: float,
    *,
    uncertainty: float = 0.0,
    ignored: Sequence[float] = (),
    mains: float | None = None,
) -> np.ndarray:
    """Bins in which chatter is searched for.

    Parameters
    ----------
    frequencies : ndarray, shape (bins,) [Hz]
        Of the bins.
    band : tuple of float [Hz]
        Lowest and highest frequency of the search.
    rotation : float [Hz]
        Rotation frequency of the spindle.
    half_width : float [Hz]
        Of every line that is left out.
    uncertainty : float [Hz]
        What the rotation may be off by.
    ignored : sequence of float [Hz]
        Lines of the machine that mean nothing.
    mains : float, optional [Hz]
        Mains frequency, whose multiples are left out.

    Returns
    -------
    ndarray, shape (bins,) of bool
        In the band and on no line.

    Raises
    ------
    InputError
        If no bin remains.
    """
    lines = list(ignored)
    if mains is not None:
        lines += list(mains_lines(mains, float(frequencies[-1])))
    forced = rotation_lines(frequencies, rotation, half_width, uncertainty, np)
    free = in_band(frequencies, *band) & ~forced & ~listed_lines(frequencies, lines, half_width)
    if not free.any():
        raise InputError(
            f"no frequency between {band[0]:g} and {band[1]:g} Hz is left beside the multiples of "
            f"the rotation ({rotation:g} Hz) and the ignored lines; "
            "take a longer window, a wider band or narrower lines."
        )
    return free
