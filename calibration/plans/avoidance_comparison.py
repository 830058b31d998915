"""Policies of avoidance compared on the same cuts."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calibration.plans.avoidance import Run
from procmodel.errors import InputError


class Paired(NamedTuple):
    """Mean of paired differences.

    Attributes
    ----------
    mean : float
        Over the pairs.
    interval90 : tuple of float
        By the bootstrap over pairs.
    pairs : int
        How many.
    """

    mean: float
    interval90: tuple[float, float]
    pairs: int


def paired(
    ours: Sequence[float] | np.ndarray,
    theirs: Sequence[float] | np.ndarray,
    seed: int = 0,
    draws: int = 4000,
) -> Paired:
    """Mean difference of what two policies came to on the same cuts.

    Parameters
    ----------
    ours, theirs : array_like, shape (n,)
        Figures of the same cuts in the same order.
    seed : int
        Of the bootstrap.
    draws : int
        Bootstrap samples.

    Returns
    -------
    Paired
        Of ours - theirs, with its 90 % interval: quantiles of the means of resampled pairs.

    Raises
    ------
    InputError
        If they are not as many as each other, two at least.
    """
    off = np.asarray(ours, float) - np.asarray(theirs, float)
    if np.shape(ours) != np.shape(theirs) or off.ndim != 1 or len(off) < 2:
        raise InputError("paired figures must be as many as each other, two at least.")
    picked = np.random.default_rng(seed).integers(len(off), size=(draws, len(off)))
    low, high = np.quantile(off[picked].mean(axis=1), (0.05, 0.95))
    return Paired(float(off.mean()), (float(low), float(high)), len(off))


def summary(runs: Mapping[str, Sequence[Run]], against: str, seed: int = 0) -> str:
    """Policies on the same cuts as a table in text.

    Parameters
    ----------
    runs : mapping of str to sequence of Run
        Runs of every policy, cuts in the same order.
    against : str
        The policy with which the others are compared.
    seed : int
        Of the bootstrap.

    Returns
    -------
    str
        Sum of the chatter energies and mean time lost, and paired differences with their 90 %
        intervals: of the decimal logarithm of the energy, and of the time lost.
    """
    width = max(map(len, runs))
    lines = [
        f"{'policy':<{width}}  energy [m^2 s]  lost [s]  changes  "
        f"log10 energy against {against}    time lost against it [s]"
    ]
    base = runs[against]
    for name, found in runs.items():
        energy, lost = _figures(found)
        less = paired(np.log10(energy), np.log10(_figures(base)[0]), seed)
        later = paired(lost, _figures(base)[1], seed)
        changes = float(np.mean([r.changes for r in found]))
        lines.append(
            f"{name:<{width}}  {energy.sum():>14.3g}  {lost.mean():>8.3f}  {changes:>7.2f}  "
            f"{_told(less):<32}  {_told(later)}"
        )
    return "\n".join(lines)


def _figures(runs: Sequence[Run]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([r.energy for r in runs]), np.array([r.time_lost for r in runs])


def _told(figure: Paired) -> str:
    low, high = figure.interval90
    return f"{figure.mean:+.3f} ({low:+.3f} to {high:+.3f})"
