"""Power spectra of windows of a record.

A spectrum here is a power in every bin, in the square of the signal's unit: its sum is the mean
square of the tapered window over the mean square of the taper (Parseval), so that it does not
depend on the window's length or taper. The functions take the array module they work with,
`jax.numpy` where derivatives are wanted, `numpy` in the stream.

Notation: n window length, w taper, X_k power in bin k, f_k = k f_s / n.

References
----------
.. [1] P. D. Welch, IEEE Trans. Audio Electroacoust. 15(2), 70, 1967 (averaged periodograms).
.. [2] F. J. Harris, Proc. IEEE 66(1), 51, 1978 (tapers).
"""

import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from procmodel.errors import InputError, nearest

TAPERS = ("rectangular", "hann")


@dataclass(frozen=True)
class Windowing:
    """How a record is cut into windows.

    Attributes
    ----------
    rate : float [Hz]
        Samples per second.
    length : int
        Samples of a window n, at least 8.
    hop : int or None
        Samples from the start of one window to that of the next; None for half a window.
    taper : str
        One of `TAPERS`.

    Raises
    ------
    InputError
        If one of them is out of its range.
    """

    rate: float
    length: int
    hop: int | None = None
    taper: str = "hann"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise InputError(f"the rate is {self.rate:g} Hz, but must be positive.")
        if self.length < 8:
            raise InputError(f"the window holds {self.length} samples, but must hold at least 8.")
        if self.hop is not None and self.hop < 1:
            raise InputError(f"the hop is {self.hop} samples, but must be at least 1.")
        if self.taper not in TAPERS:
            raise InputError(f"no taper is called {self.taper!r}{nearest(self.taper, TAPERS)}.")

    @property
    def step(self) -> int:
        """Samples from window to window."""
        return self.length // 2 if self.hop is None else self.hop

    @property
    def resolution(self) -> float:
        """Width of a bin [Hz]."""
        return self.rate / self.length

    @property
    def bins(self) -> int:
        """Number of bins from 0 to half the rate."""
        return self.length // 2 + 1

    @property
    def frequencies(self) -> np.ndarray:
        """Frequency of every bin, shape (bins,) [Hz]."""
        return frequencies(self.length, self.rate, np)

    def count(self, samples: int) -> int:
        """Whole windows in a number of samples."""
        return 0 if samples < self.length else 1 + (samples - self.length) // self.step


def taper(name: str, n: int, xp: Any = jnp) -> Any:
    """Weights of a window.

    Parameters
    ----------
    name : str
        "rectangular", or "hann" for (1 - cos(2 pi i / n)) / 2, the periodic form.
    n : int
        Samples of the window.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (n,)
        The weights.

    Raises
    ------
    InputError
        If there is no taper of that name.
    """
    if name not in TAPERS:
        raise InputError(f"no taper is called {name!r}{nearest(name, TAPERS)}.")
    if name == "rectangular":
        return xp.ones(n)
    return xp.sin(math.pi * xp.arange(n) / n) ** 2


def frequencies(n: int, rate: float, xp: Any = jnp) -> Any:
    """Frequency of every bin, shape (n // 2 + 1,) [Hz], of windows of n samples."""
    return xp.arange(n // 2 + 1) * (rate / n)


def windows_of(samples: np.ndarray, n: int, hop: int) -> np.ndarray:
    """The windows of a record, without a copy.

    Parameters
    ----------
    samples : ndarray, shape (k, c)
        Samples of c channels.
    n, hop : int
        Window length, and samples from window to window.

    Returns
    -------
    ndarray, shape (windows, c, n)
        A read-only view; samples behind the last whole window are left out.
    """
    if len(samples) < n:
        return np.empty((0, samples.shape[1], n))
    return np.lib.stride_tricks.sliding_window_view(samples, n, axis=0)[::hop]


def power_spectra(windows: Any, weights: Any, xp: Any = jnp) -> Any:
    """Power in every bin.

    Parameters
    ----------
    windows : array, shape (..., n) [unit]
        Samples.
    weights : array, shape (n,)
        Taper.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (..., n // 2 + 1) [unit^2]
        X_k = c_k |sum_i w_i x_i exp(-2 pi j i k / n)|^2 / (n sum w^2), with c_k = 2 but for bin 0
        and, of an even n, the last one, where it is 1. Their sum is sum (w x)^2 / sum w^2.
    """
    n = windows.shape[-1]
    line = xp.fft.rfft(windows * weights, axis=-1)
    sides = np.full(n // 2 + 1, 2.0)
    sides[0] = 1.0
    if n % 2 == 0:
        sides[-1] = 1.0
    power = xp.real(line) ** 2 + xp.imag(line) ** 2
    return power * (sides / (n * xp.sum(weights**2)))


def averaged(spectra: Any, m: int, xp: Any = jnp) -> Any:
    """Means of m successive spectra.

    Parameters
    ----------
    spectra : array, shape (windows, ...)
        Spectra in the order of time.
    m : int
        How many are averaged.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (windows - m + 1, ...)
        The means, the last of which ends with the last window.
    """
    kept = spectra.shape[0] - m + 1
    if kept < 1:
        return spectra[:0]
    total = spectra[:kept]
    for i in range(1, m):
        total = total + spectra[i : kept + i]
    return total / m
