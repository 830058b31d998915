"""What an ensemble sampler hands back, and how correlated its steps are."""

from dataclasses import dataclass

import numpy as np
from emcee.autocorr import integrated_time


@dataclass(frozen=True)
class EnsembleDraws:
    """Draws of one ensemble of walkers after its warm-up.

    Attributes
    ----------
    positions : ndarray, shape (steps, walkers, p)
        The draws.
    log_density : ndarray, shape (steps, walkers)
        Log density of each.
    acceptance : float
        Share of moves accepted.
    autocorrelation : float
        Longest integrated autocorrelation time of any parameter, in steps.
    """

    positions: np.ndarray
    log_density: np.ndarray
    acceptance: float
    autocorrelation: float


def longest_autocorrelation(positions: np.ndarray) -> float:
    """Longest integrated autocorrelation time of any parameter.

    Parameters
    ----------
    positions : ndarray, shape (steps, walkers, p)
        Draws of one ensemble.

    Returns
    -------
    float
        In steps; infinite when there are too few steps to estimate it.
    """
    if len(positions) <= 10:
        return float("inf")
    return float(np.max(integrated_time(positions, tol=0)))
