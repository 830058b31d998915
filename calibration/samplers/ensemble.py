"""What an ensemble sampler hands back."""

from dataclasses import dataclass

import numpy as np


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
