"""The true rotation frequency, from the lines that the spindle itself makes.

At order k an error of the rotation counts k times. A spindle that slips by half a percent has its
40th harmonic off by a fifth of the spacing, where no mask for the nominal speed would find it.

Notation: f rotation frequency, k order, df width of a bin.

References
----------
.. [1] A. M. Noll, Proc. Symp. Computer Processing in Communications, 779, 1969 (harmonic sums).
"""

from typing import NamedTuple

import numpy as np
import scipy.ndimage

from procmodel.chatter.distance import vertex
from procmodel.chatter.spectrum import Windowing, power_spectra, taper, windows_of
from procmodel.errors import InputError

FOUND, NOT_FOUND = range(2)

STATUS = {
    FOUND: "found: the harmonics of the rotation stand out and agree",
    NOT_FOUND: "not found: no harmonics stand out, and the nominal speed is kept",
}

# A harmonic sum this many standard deviations over those of the other candidates is no chance,
# whatever the number of candidates (some hundreds).
_PROMINENT = 5.0
# So many times the floor is more than noise reaches, averaged over a baseline.
_STANDS_OUT = 7.0


class Rotation(NamedTuple):
    """Rotation frequency of the spindle.

    Attributes
    ----------
    frequency : float [Hz]
        The rotation frequency.
    uncertainty : float [Hz]
        What it may be off by.
    orders : tuple of int
        Harmonics whose lines agree with it.
    prominence : float
        Height of the harmonic sum over that of all candidates, in their standard deviations.
    status : int
        Key into `STATUS`.
    """

    frequency: float
    uncertainty: float
    orders: tuple[int, ...] = ()
    prominence: float = 0.0
    status: int = NOT_FOUND


def refined_rotation(
    spectrum: np.ndarray,
    windowing: Windowing,
    nominal: float,
    tolerance: float = 0.01,
    nominal_error: float = 0.002,
) -> Rotation:
    """Rotation frequency at which the harmonics hold most, then fitted to their lines.

    Parameters
    ----------
    spectrum : ndarray, shape (bins,) or (c, bins) [unit^2]
        Mean spectrum; channels are searched together.
    windowing : Windowing
        Rate and window length it was made with.
    nominal : float [Hz]
        Commanded rotation frequency.
    tolerance : float
        Largest deviation from it, as a fraction.
    nominal_error : float
        What the nominal rotation is taken to be off by where no harmonics are found, as a fraction.

    Returns
    -------
    Rotation
        Where sum_k log(X(k f) / median) is largest, then the least-squares line through the
        frequencies of the peaks over their orders, with its standard error.

    Raises
    ------
    InputError
        If the nominal rotation is not between the width of four bins, below which harmonics cannot
        be told apart, and half the rate, or the tolerance not between 0 and 0.25.
    """
    df = windowing.resolution
    if not 4.0 * df <= nominal <= 0.5 * windowing.rate:
        raise InputError(
            f"the rotation is {nominal:g} Hz, but must be between {4.0 * df:g} Hz, four bins of a "
            f"window of {windowing.length} samples, and half the rate; "
            "take a longer window or correct the spindle speed."
        )
    if not 0.0 < tolerance < 0.25:
        raise InputError(f"the tolerance is {tolerance:g}, but must be between 0 and 0.25.")
    ratio = _over_floor(np.atleast_2d(spectrum), nominal / df)
    height = np.log(np.maximum(ratio, 1.0))
    top = int((windowing.bins - 2) * df / (nominal * (1.0 + tolerance)))
    orders = np.arange(1, top + 1)
    # The highest order moves by a quarter of a bin from candidate to candidate.
    steps = int(np.ceil(4.0 * top * nominal * tolerance / df))
    candidates = nominal * (1.0 + tolerance * np.arange(-steps, steps + 1) / steps)
    sums = _interpolated(height, np.outer(candidates, orders) / df).mean(axis=1)
    prominence = float((sums.max() - np.median(sums)) / (_spread(sums) or np.inf))
    best = float(candidates[np.argmax(sums)])
    fitted = _fitted(ratio, orders, best, df)
    if fitted is None or prominence < _PROMINENT:
        return Rotation(float(nominal), float(nominal * nominal_error), (), prominence, NOT_FOUND)
    return Rotation(*fitted, prominence, FOUND)


def rotation_of(
    samples: np.ndarray, rate: float, nominal: float, tolerance: float = 0.01
) -> Rotation:
    """Rotation frequency from a record, by windows as long as it allows.

    Parameters
    ----------
    samples : ndarray, shape (k, c) or (k,) [unit]
        A stretch of constant spindle speed.
    rate : float [Hz]
        Its samples per second.
    nominal, tolerance : float [Hz, -]
        As for `refined_rotation`.

    Returns
    -------
    Rotation
        From the mean of at least four Hann windows of at most 65,536 samples, which overlap by
        half. Windows of a detector may be too short to tell the harmonics apart.

    Raises
    ------
    InputError
        As `refined_rotation`.
    """
    samples = samples[:, None] if samples.ndim == 1 else samples
    length = 8
    while length < 1 << 16 and 5 * length <= len(samples):
        length *= 2
    windowing = Windowing(rate, length)
    windows = windows_of(samples, length, windowing.step)
    spectra = power_spectra(windows, taper(windowing.taper, length, np), np)
    return refined_rotation(spectra.mean(axis=0), windowing, nominal, tolerance)


def _over_floor(spectra: np.ndarray, spacing: float) -> np.ndarray:
    """Power over the median within half a spacing, of the channel in which that is largest."""
    size = 2 * round(0.5 * spacing) + 1
    floor = scipy.ndimage.median_filter(spectra, size=(1, size), mode="nearest")
    tiny = np.finfo(float).tiny
    return np.max(np.maximum(spectra, tiny) / np.maximum(floor, tiny), axis=0)


def _interpolated(height: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Heights between bins, on straight lines."""
    return np.interp(place.ravel(), np.arange(len(height)), height).reshape(place.shape)


def _spread(values: np.ndarray) -> float:
    """Standard deviation by the median of the deviations, which the peak itself does not move."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _fitted(
    ratio: np.ndarray, orders: np.ndarray, start: float, df: float
) -> tuple[float, float, tuple[int, ...]] | None:
    """Rotation, its standard error and the orders used, from the peaks at the harmonics."""
    rotation = start
    for _ in range(3):
        near = np.rint(orders * rotation / df).astype(int)
        near = near[near < len(ratio) - 2]
        around = near[:, None] + np.arange(-1, 2)
        peak = around[np.arange(len(near)), np.argmax(ratio[around], axis=1)]
        off = vertex(ratio[peak - 1], ratio[peak], ratio[peak + 1], np)
        line, order = (peak + off) * df, orders[: len(near)]
        is_peak = (ratio[peak] >= ratio[peak - 1]) & (ratio[peak] >= ratio[peak + 1])
        good = is_peak & (ratio[peak] > _STANDS_OUT) & (np.abs(line - order * rotation) < 0.75 * df)
        if good.sum() < 2:
            return None
        k, f, w = order[good], line[good], np.log(ratio[peak[good]])
        rotation = float(np.sum(w * k * f) / np.sum(w * k**2))
    scatter = np.sum(w * (f - k * rotation) ** 2) / (len(k) - 1)
    error = np.sqrt(scatter / np.sum(w * k**2))
    # Interpolation alone is off by some hundredths of a bin, which few peaks cannot show.
    return rotation, float(max(error, 0.05 * df / k.max())), tuple(int(i) for i in k)
