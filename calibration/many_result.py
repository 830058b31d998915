"""`ManyFits`: the results of many fits in arrays, and how each of them ended."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.solvers import box_lm

NO_READINGS, FEW_READINGS, OPEN, NO_NOISE = range(100, 104)
STATUS = {
    **box_lm.STATUS,
    NO_READINGS: "not started: readings, or x, that are not finite; remove them",
    FEW_READINGS: "not started: fewer readings than free parameters; add readings",
    OPEN: "converged, but the readings leave some parameters open: their std is NaN; fix some",
    NO_NOISE: "converged, but with no more readings than parameters the noise cannot be "
    "estimated: std is NaN; give sigmas",
}
CONVERGED = (*box_lm.CONVERGED, OPEN, NO_NOISE)


@dataclass(frozen=True)
class ManyFits:
    """What many fits found: arrays with one row for each of n fits.

    Attributes
    ----------
    names : tuple of str
        The p free parameters, in the order of the columns.
    value : ndarray, shape (n, p)
        Best values in natural units; NaN where a fit was not started.
    std : ndarray, shape (n, p)
        Standard deviations; NaN where a bound holds the parameter (see `held`), where the readings
        leave it open, where the noise is not known, or where a fit was not started.
    covariance : ndarray, shape (n, p, p)
        The same with the covariances.
    held : ndarray of bool, shape (n, p)
        Parameters that a bound holds back.
    status : ndarray of int, shape (n,)
        Key into `calibration.many_result.STATUS`; see `status_sentences`.
    steps : ndarray of int, shape (n,)
        Trial steps made.
    chi2 : ndarray, shape (n,)
        Sum of squared residuals over sigma, priors included; over 1 where sigma was left out.
    readings : ndarray of int, shape (n,)
        Readings of each fit.
    degrees_of_freedom : ndarray of int, shape (n,)
        Readings and informative priors less parameters determined.
    noise : ndarray, shape (n,)
        Noise level estimated from the residuals; NaN where sigma was given.
    refitted : ndarray of bool, shape (n,)
        Fits that the fast way gave up and that `calibration.solvers.box_lm` made one by one.
    """

    names: tuple[str, ...]
    value: np.ndarray
    std: np.ndarray
    covariance: np.ndarray
    held: np.ndarray
    status: np.ndarray
    steps: np.ndarray
    chi2: np.ndarray
    readings: np.ndarray
    degrees_of_freedom: np.ndarray
    noise: np.ndarray
    refitted: np.ndarray

    def __len__(self) -> int:
        return len(self.status)

    @cached_property
    def converged(self) -> np.ndarray:
        """Whether each fit converged, shape (n,)."""
        return np.isin(self.status, CONVERGED)

    @property
    def residual_rms(self) -> np.ndarray:
        """Root mean square residual, in units of sigma or, without sigma, of y; shape (n,)."""
        return np.sqrt(self.chi2 / np.maximum(self.readings, 1))

    def status_sentence(self, index: int) -> str:
        """How one fit ended, in words.

        Parameters
        ----------
        index : int
            Which fit.

        Returns
        -------
        str
            The sentence.
        """
        held = [name for name, at in zip(self.names, self.held[index], strict=True) if at]
        end = f"; {' and '.join(held)} at a bound" if held else ""
        return STATUS[int(self.status[index])] + end

    @property
    def status_sentences(self) -> tuple[str, ...]:
        """How every fit ended, in words."""
        return tuple(self.status_sentence(i) for i in range(len(self)))

    @property
    def status_counts(self) -> dict[str, int]:
        """How many fits ended in each way, the most frequent first."""
        counts = Counter(self.status.tolist())
        return {STATUS[code]: count for code, count in counts.most_common()}
