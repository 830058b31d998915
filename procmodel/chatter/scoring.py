"""Distances of many windows at the price of little more than their Fourier transforms.

The same laws as in `spectrum` and `distance`, arranged for the stream: only the bins of the band
are worked on, in blocks that stay in the cache. The Hann taper is applied after the transform, as
the second difference of neighbouring bins, -(z_{k+1} - 2 z_k + z_{k-1}) / 4, on the band alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft

from procmodel.chatter.baseline import AirCut, deviation
from procmodel.chatter.distance import vertex
from procmodel.chatter.spectrum import Windowing, windows_of
from procmodel.errors import InputError

# Samples of a block of windows: its transforms fit into a second-level cache.
_BLOCK = 1 << 17
_NEAR = np.arange(-1, 2)


class Scores(NamedTuple):
    """What every window of a record says by itself.

    Attributes
    ----------
    time : ndarray, shape (w,) [s]
        End of the window, when its score is known.
    score : ndarray, shape (w,)
        Largest distance over the free bins of all channels; NaN where the window is not sound.
    frequency : ndarray, shape (w,) [Hz]
        Where it is; NaN where the window is not sound.
    channel : ndarray, shape (w,) of int
        Of which channel.
    level : ndarray, shape (w,)
        Power over that of air cutting, from which the engagement is told.
    sound : ndarray, shape (w,) of bool
        Whether every sample is finite.
    """

    time: np.ndarray
    score: np.ndarray
    frequency: np.ndarray
    channel: np.ndarray
    level: np.ndarray
    sound: np.ndarray


@dataclass(frozen=True)
class Scorer:
    """Distances on the bins of a band, ready for the stream.

    Attributes
    ----------
    windowing : Windowing
        How a record is cut into windows.
    low : int
        First bin of the band; bin i of the arrays below is bin low + i of the spectrum.
    scale : float
        Factor from the raw power of `raw_power` to that of `spectrum.power_spectra`.
    gain, offset : ndarray, shape (c, bins)
        D = gain raw - offset; 0 and infinite where a bin is left out.
    weights : ndarray, shape (c, bins)
        Of the raw power in the level.
    """

    windowing: Windowing
    low: int
    scale: float
    gain: np.ndarray
    offset: np.ndarray
    weights: np.ndarray

    @property
    def bins(self) -> int:
        """Number of bins of the band."""
        return self.gain.shape[1]


class Measured(NamedTuple):
    """What a block of windows gives.

    Attributes
    ----------
    raw : ndarray, shape (w, c, bins)
        Raw power.
    score : ndarray, shape (w,)
        Largest distance over the free bins of all channels.
    where : ndarray, shape (w,) of int
        Where it is: channel times bins of the band, plus bin of the band.
    level : ndarray, shape (w,)
        Power over that of air cutting.
    """

    raw: np.ndarray
    score: np.ndarray
    where: np.ndarray
    level: np.ndarray


class Workspace(NamedTuple):
    """Arrays that the blocks of one record are worked on in, one after the other.

    Attributes
    ----------
    first : ndarray, shape (w, c, 2 bins + 2)
        First differences of real and imaginary parts.
    second : ndarray, shape (w, c, 2 bins)
        Second differences, then squares.
    raw, distances : ndarray, shape (w, c, bins)
        Raw power and distances.
    """

    first: np.ndarray
    second: np.ndarray
    raw: np.ndarray
    distances: np.ndarray


def scorer_for(air: AirCut, free: np.ndarray, counted: np.ndarray) -> Scorer:
    """A scorer on the free bins of a baseline.

    Parameters
    ----------
    air : AirCut
        Air cutting.
    free : ndarray, shape (bins,) of bool
        Where chatter is searched for.
    counted : ndarray, shape (bins,) of bool
        Bins whose power counts for the engagement.

    Returns
    -------
    Scorer
        On the bins from the first to the last that is free or counted, the constant part and the
        last bin always left out.

    Raises
    ------
    InputError
        If no bin is free, or if air cutting does not vary in any free bin.
    """
    windowing = air.windowing
    inner = np.arange(1, windowing.bins - 1)
    used = inner[(free | counted)[inner]]
    if not len(used) or not free[used].any():
        raise InputError("no bin is free for the search; take a longer window or a wider band.")
    band = slice(used[0], used[-1] + 1)
    mean = np.asarray(air.baseline.mean)[:, band]
    sigma = deviation(air.baseline, np)[:, band]
    searched = free[band] & (sigma > 0.0)
    alive = counted[band] & (mean > 0.0)
    if not searched.any() or not alive.any():
        raise InputError(
            "air cutting does not vary in any free bin, so that nothing can be compared with it; "
            "look whether the sensor was connected when the baseline was recorded."
        )
    scale = _scale(windowing)
    safe = np.where(searched, sigma, 1.0)
    gain = np.where(searched, scale / safe, 0.0)
    offset = np.where(searched, mean / safe, np.inf)
    weights = np.where(alive, scale / np.where(alive, mean, 1.0), 0.0) / alive.sum()
    return Scorer(windowing, int(used[0]), scale, gain, offset, weights)


def workspace(windows: int, scorer: Scorer) -> Workspace:
    """Room for a number of windows."""
    rows, bins = (windows, len(scorer.gain)), scorer.bins
    return Workspace(*(np.empty((*rows, k)) for k in (2 * bins + 2, 2 * bins, bins, bins)))


def raw_power(windows: np.ndarray, scorer: Scorer, room: Workspace | None = None) -> np.ndarray:
    """Squared magnitude of the tapered transform on the bins of the band, times a constant.

    Parameters
    ----------
    windows : ndarray, shape (w, c, n) [unit]
        Samples.
    scorer : Scorer
        Band and taper.
    room : Workspace, optional
        Room for as many windows, which the result then lies in.

    Returns
    -------
    ndarray, shape (w, c, bins) [unit^2]
        To be multiplied with `scale` for the power.
    """
    room = room or workspace(len(windows), scorer)
    start, stop = 2 * scorer.low, 2 * (scorer.low + scorer.bins)
    # Always with three axes: of a single one the transform takes another way, with other rounding.
    pairs = scipy.fft.rfft(windows, axis=-1, workers=1).view(np.float64)
    line = pairs[..., start:stop]
    if scorer.windowing.taper == "hann":
        np.subtract(pairs[..., start : stop + 2], pairs[..., start - 2 : stop], out=room.first)
        line = np.subtract(room.first[..., 2:], room.first[..., :-2], out=room.second)
    np.multiply(line, line, out=room.second)
    return np.add(room.second[..., 0::2], room.second[..., 1::2], out=room.raw)


def measured(windows: np.ndarray, scorer: Scorer, room: Workspace | None = None) -> Measured:
    """Scores of a block of windows.

    Parameters
    ----------
    windows : ndarray, shape (w, c, n) [unit]
        Samples.
    scorer : Scorer
        Band, taper and baseline.
    room : Workspace, optional
        Room for as many windows, which the raw power then lies in.

    Returns
    -------
    Measured
        One entry for each window; what a window gives does not depend on the others.
    """
    room = room or workspace(len(windows), scorer)
    raw = raw_power(windows, scorer, room)
    distances = np.multiply(raw, scorer.gain, out=room.distances)
    np.subtract(distances, scorer.offset, out=distances)
    flat = distances.reshape(len(raw), -1)
    where = flat.argmax(axis=1)
    level = np.vecdot(raw, scorer.weights).sum(axis=1)
    return Measured(raw, flat[np.arange(len(raw)), where], where, level)


def around(raw: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Raw powers below, in and above places of spectra, shape (w, 3)."""
    start = np.arange(len(raw)) * raw[0].size
    return raw.ravel().take((start + where)[:, None] + _NEAR, mode="clip")


def frequency_of(where: np.ndarray, powers: np.ndarray, scorer: Scorer) -> np.ndarray:
    """Frequency of maxima.

    Parameters
    ----------
    where : ndarray, shape (w,) of int
        Their places, as in `Measured`.
    powers : ndarray, shape (w, 3)
        Of the bin below, of it, of the bin above; unused at the ends of the band.
    scorer : Scorer
        Band.

    Returns
    -------
    ndarray, shape (w,) [Hz]
        By the parabola through the logarithms, `distance.vertex`.
    """
    place = where % scorer.bins
    inside = (place > 0) & (place < scorer.bins - 1)
    off = np.where(inside, vertex(powers[:, 0], powers[:, 1], powers[:, 2], np), 0.0)
    return (scorer.low + place + off) * scorer.windowing.resolution


def scored(samples: np.ndarray, scorer: Scorer) -> Scores:
    """Scores of a whole record, window by window.

    Parameters
    ----------
    samples : ndarray, shape (k, c) [unit]
        The record.
    scorer : Scorer
        Band, taper and baseline.

    Returns
    -------
    Scores
        One entry for each whole window.
    """
    windowing, channels = scorer.windowing, samples.shape[1]
    total = windowing.count(len(samples))
    windows = windows_of(samples, windowing.length, windowing.step)
    batch = max(1, _BLOCK // (windowing.length * channels))
    room = workspace(min(batch, total), scorer)
    score, level, powers = np.empty(total), np.empty(total), np.empty((total, 3))
    where = np.empty(total, int)
    with np.errstate(invalid="ignore", over="ignore"):
        for i in range(0, total, batch):
            stop = min(i + batch, total)
            part = measured(windows[i:stop], scorer, Workspace(*(x[: stop - i] for x in room)))
            score[i:stop], level[i:stop], where[i:stop] = part.score, part.level, part.where
            powers[i:stop] = around(part.raw, part.where)
        sound = np.isfinite(level)
        frequency = frequency_of(where, powers, scorer)
    score[~sound], frequency[~sound] = np.nan, np.nan
    time = (np.arange(total) * windowing.step + windowing.length) / windowing.rate
    return Scores(time, score, frequency, where // scorer.bins, level, sound)


def _scale(windowing: Windowing) -> float:
    """2 / (n sum w^2), with sum w^2 = 3 n / 8 and a sixteenth for the Hann taper."""
    n = windowing.length
    return 2.0 / n**2 if windowing.taper == "rectangular" else 1.0 / (3.0 * n**2)
