"""How far a spectrum is from air cutting, and how far it may be by chance.

Notation: X_i power in bin i, a_i and sigma_i mean and standard deviation of n spectra of air
cutting, D_i distance, M number of free bins, m number of averaged spectra.

References
----------
.. [1] T. Nishikawa, K. Kikuta, H. Yamashita, S. Uchida, S. Abe, system for preventing chatter in
   end milling (in Japanese), eq. (1).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats

from procmodel.chatter.baseline import Baseline, deviation
from procmodel.errors import InputError


def distance(spectrum: Any, baseline: Baseline, xp: Any = jnp) -> Any:
    """Distance from air cutting in every bin, eq. (1) of [1]_.

    Parameters
    ----------
    spectrum : array, shape (..., c, bins) [unit^2]
        Power while cutting.
    baseline : Baseline
        Moments of air cutting.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (..., c, bins)
        D_i = (X_i - a_i) / sigma_i, and 0 where air cutting does not vary at all.

    Raises
    ------
    InputError
        If the baseline is of fewer than two spectra.
    """
    sigma = deviation(baseline, xp)
    alive = sigma > 0.0
    return xp.where(alive, (spectrum - baseline.mean) / xp.where(alive, sigma, 1.0), 0.0)


def score(distances: Any, free: Any, xp: Any = jnp) -> Any:
    """The largest distance over the free bins of one channel, shape (...).

    Parameters
    ----------
    distances : array, shape (..., bins)
        D.
    free : array, shape (bins,) of bool
        Where chatter is searched for.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (...)
        max D_i, -inf where no bin is free.
    """
    return xp.max(xp.where(free, distances, -xp.inf), axis=-1)


def soft_score(distances: Any, weights: Any, temperature: Any, xp: Any = jnp) -> Any:
    """A largest distance with a gradient in every bin and in the edges of the band.

    Parameters
    ----------
    distances : array, shape (..., bins)
        D.
    weights : array, shape (bins,)
        1 for a free bin, 0 for one that is left out, between the two at soft edges; one at least
        is positive.
    temperature : float
        T > 0, in units of D.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (...)
        T log sum w_i exp(D_i / T): of weights 0 and 1 at least the score and at most T log M more,
        and the score in the limit T = 0.
    """
    counted = weights > 0.0
    top = xp.max(xp.where(counted, distances, -xp.inf), axis=-1, keepdims=True)
    # The shift cancels, so that its derivative must not be taken.
    top = jax.lax.stop_gradient(top) if xp is jnp else top
    lift = xp.where(counted, distances - top, 0.0) / temperature
    total = xp.sum(xp.where(counted, weights, 0.0) * xp.exp(lift), axis=-1)
    return temperature * xp.log(total) + top[..., 0]


def vertex(below: Any, peak: Any, above: Any, xp: Any = jnp) -> Any:
    """Where between its bins a line lies, by the parabola through three logarithms.

    Parameters
    ----------
    below, peak, above : array, shape (...) [unit^2]
        Powers in the bin of the largest and in its two neighbours.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (...) [bins]
        Offset from the middle bin, -1/2 to 1/2; 0 where a power is 0.
    """
    known = (below > 0.0) & (peak > 0.0) & (above > 0.0)
    low, mid, high = (xp.log(xp.where(known, x, 1.0)) for x in (below, peak, above))
    bend = 2.0 * mid - low - high
    bent = bend > 0.0
    off = 0.5 * (high - low) / xp.where(bent, bend, 1.0)
    # Beside a line that is left out the largest free bin need not be a peak at all.
    off = xp.where(bent, off, 0.5 * xp.sign(high - low))
    return xp.where(known, xp.clip(off, -0.5, 0.5), 0.0)


def null_threshold(count: int, free_bins: int, alpha: float, averaged: int = 1) -> float:
    """Threshold on the largest X / a that noise alone passes with a given probability.

    Parameters
    ----------
    count : int
        Number n of air-cutting spectra in the baseline.
    free_bins : int
        Number M of bins in the search, of all channels together.
    alpha : float
        Probability of a false alarm per window, 0 to 1.
    averaged : int
        Number m of spectra averaged before the ratio is taken.

    Returns
    -------
    float
        Of m = 1, n ((1 - (1 - alpha)^(1/M))^(-1/n) - 1), from X / a ~ F(2, 2n); else the upper
        quantile of F(2m, 2n) at 1 - (1 - alpha)^(1/M). Exact for Gaussian noise, windows that do
        not overlap and the rectangular taper; with another taper neighbouring bins go together and
        it is passed less often. X / a = 1 + D sigma / a, with sigma = a of noise.

    Raises
    ------
    InputError
        If a count is below 1 or alpha is not between 0 and 1.
    """
    if min(count, free_bins, averaged) < 1:
        raise InputError("the null threshold needs at least one spectrum and one free bin.")
    if not 0.0 < alpha < 1.0:
        raise InputError(f"the false-alarm probability is {alpha:g}, but must be between 0 and 1.")
    # 1 - (1 - alpha)^(1/M) loses all its digits at small alpha.
    single = -np.expm1(np.log1p(-alpha) / free_bins)
    if averaged == 1:
        return float(count * np.expm1(-np.log(single) / count))
    return float(scipy.stats.f.isf(single, 2 * averaged, 2 * count))
