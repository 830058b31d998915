"""Period-doubling chatter, which hides on the multiples of the rotation.

Flip chatter stands at the odd multiples of half the tooth-passing frequency. With an even number of
teeth these are multiples of the rotation, where the search for forced lines is blind, and where
runout stands as well. What tells them apart is a cut known to be stable: runout stays with the tool
and grows as the tooth-passing lines do, chatter grows beyond both.

Notation: N teeth, f rotation frequency, L_j power of the line at (2 j + 1) N f / 2, T power of the
lines at multiples of N f, primed in the stable cut.

References
----------
.. [1] T. Insperger, G. Stepan, P. V. Bayly, B. P. Mann, J. Sound Vib. 262(2), 333, 2003 (the
   frequencies of chatter in milling).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np


class Lines(NamedTuple):
    """Which bins belong to which line.

    Attributes
    ----------
    frequencies : ndarray, shape (l,) [Hz]
        Of the lines.
    bins : ndarray, shape (l, w) of int
        Their bins.
    weights : ndarray, shape (l, w)
        1, and 0 where a line has fewer than w bins.
    """

    frequencies: np.ndarray
    bins: np.ndarray
    weights: np.ndarray


class CuttingReference(NamedTuple):
    """Mean powers of the lines in a stable cut.

    Attributes
    ----------
    windows : int
        How many they are of.
    half : ndarray, shape (c, l) [unit^2]
        Of every line at an odd multiple of half the tooth-passing frequency.
    tooth : ndarray, shape (c,) [unit^2]
        Of the tooth-passing lines together.
    """

    windows: int
    half: Any
    tooth: Any


def half_tooth_frequencies(rotation: float, teeth: int, low: float, high: float) -> np.ndarray:
    """Odd multiples of half the tooth-passing frequency between two frequencies.

    Parameters
    ----------
    rotation : float [Hz]
        Rotation frequency of the spindle.
    teeth : int
        Teeth of the tool.
    low, high : float [Hz]
        Ends of the band.

    Returns
    -------
    ndarray, shape (l,) [Hz]
        (2 j + 1) N f / 2.
    """
    half = 0.5 * teeth * rotation
    lines = half * np.arange(1, high / half + 1, 2)
    return lines[(lines >= low) & (lines <= high)]


def tooth_frequencies(rotation: float, teeth: int, low: float, high: float) -> np.ndarray:
    """Multiples of the tooth-passing frequency between two frequencies, shape (l,) [Hz]."""
    passing = teeth * rotation
    lines = passing * np.arange(1, high / passing + 1)
    return lines[(lines >= low) & (lines <= high)]


def lines_in(
    frequencies: np.ndarray,
    lines: np.ndarray,
    half_width: float,
    uncertainty: float = 0.0,
    usable: np.ndarray | None = None,
) -> Lines:
    """The bins of lines.

    Parameters
    ----------
    frequencies : ndarray, shape (bins,) [Hz]
        Of the bins.
    lines : ndarray, shape (l,) [Hz]
        Where the lines stand.
    half_width : float [Hz]
        Of a line.
    uncertainty : float
        What their frequencies may be off by, as a fraction.
    usable : ndarray, shape (bins,) of bool, optional
        Bins that may be used; a line that has others is left out.

    Returns
    -------
    Lines
        Those with all their bins usable.
    """
    found = []
    for line in lines:
        bins = np.flatnonzero(np.abs(frequencies - line) <= half_width + line * uncertainty)
        if len(bins) and (usable is None or usable[bins].all()):
            found.append((line, bins))
    width = max((len(bins) for _, bins in found), default=0)
    index, weights = np.zeros((len(found), width), int), np.zeros((len(found), width))
    for i, (_, bins) in enumerate(found):
        index[i, : len(bins)], weights[i, : len(bins)] = bins, 1.0
    return Lines(np.array([line for line, _ in found]), index, weights)


def line_powers(spectrum: Any, lines: Lines, xp: Any = jnp) -> Any:
    """Power of lines.

    Parameters
    ----------
    spectrum : array, shape (..., bins) [unit^2]
        Power in every bin.
    lines : Lines, l of them
        Which bins belong to which.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (..., l) [unit^2]
        Sum over the bins of each.
    """
    return xp.sum(spectrum[..., lines.bins] * lines.weights, axis=-1)


def added(reference: CuttingReference | None, half: Any, tooth: Any) -> CuttingReference:
    """A reference with one more window of a stable cut.

    Parameters
    ----------
    reference : CuttingReference or None
        The windows so far.
    half : ndarray, shape (c, l) [unit^2]
        Powers of the lines at odd multiples of half the tooth-passing frequency.
    tooth : ndarray, shape (c,) [unit^2]
        Power of the tooth-passing lines together.

    Returns
    -------
    CuttingReference
        Means of all of them.
    """
    if reference is None:
        return CuttingReference(1, half, tooth)
    count = reference.windows + 1
    mean = reference.half + (half - reference.half) / count
    return CuttingReference(count, mean, reference.tooth + (tooth - reference.tooth) / count)


def growth_over_reference(
    half: Any, tooth: Any, reference: CuttingReference, floor: Any, xp: Any = jnp
) -> Any:
    """How many times more power a line holds than a stable cut explains.

    Parameters
    ----------
    half : array, shape (..., c, l) [unit^2]
        Powers of the lines at odd multiples of half the tooth-passing frequency.
    tooth : array, shape (..., c) [unit^2]
        Power of the tooth-passing lines together.
    reference : CuttingReference
        The same of a stable cut.
    floor : array, shape (c, l) [unit^2]
        Power of the lines in air, below which a reference does not count.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (..., c, l)
        (L / L') / max(1, T / T'): a deeper cut that raises all lines alike stays at 1; 0 where the
        reference is 0.
    """
    known = xp.maximum(reference.half, floor)
    ratio = xp.where(known > 0.0, half / xp.where(known > 0.0, known, 1.0), 0.0)
    passing = reference.tooth > 0.0
    deeper = xp.where(passing, tooth / xp.where(passing, reference.tooth, 1.0), 1.0)
    return ratio / xp.maximum(deeper, 1.0)[..., None]
