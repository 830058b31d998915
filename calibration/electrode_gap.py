"""The posterior of the gap's mean and spread in exact form, updated reading by reading.

Given the spread, the mean is normal (the prior of the mean is), so that a row of spreads, each
with its weight and the normal distribution of the mean, holds the whole posterior. An update
multiplies weights and moves normal distributions; its order does not matter. What is predicted is
a mixture of normal distributions. `calibration.electrode.gap_problem` is the same posterior for
the samplers, and the tests hold one against the other.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray
from scipy.special import logsumexp, ndtr

from calibration.electrode import WEAK_PRIOR, GapData, GapPrior, require_scatter
from procmodel.errors import InputError

# Spreads reach this many standard deviations of the log to both sides of the prior's median.
_REACH = 5.0
_SPREADS = 1601
# Halvings of a search for a quantile, and how far out it starts, in standard deviations.
_HALVINGS = 64
_FARTHEST = 40.0
_NO_WEIGHT = 1e-17
# Values of the mean, for each spread, that a joint probability is summed over.
_MEANS = 32


@dataclass(frozen=True)
class NormalMixture:
    """A mixture of normal distributions.

    Attributes
    ----------
    weight, centre, std : ndarray, shape (k,)
        Weight, mean and standard deviation of every part; the weights add up to 1.
    """

    weight: np.ndarray
    centre: np.ndarray
    std: np.ndarray

    @property
    def mean(self) -> float:
        """Mean."""
        return float(self.weight @ self.centre)

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        return math.sqrt(float(self.weight @ (self.std**2 + (self.centre - self.mean) ** 2)))

    def density(self, value: Any) -> np.ndarray:
        """Probability density.

        Parameters
        ----------
        value : array_like, shape (...)
            Where.

        Returns
        -------
        ndarray, shape (...)
            The density.
        """
        z = (np.asarray(value, float)[..., None] - self.centre) / self.std
        return np.exp(-0.5 * z**2) / self.std @ self.weight / math.sqrt(2.0 * math.pi)

    def below(self, value: Any) -> np.ndarray:
        """Probability of less.

        Parameters
        ----------
        value : array_like, shape (...)
            Than what.

        Returns
        -------
        ndarray, shape (...)
            The probability.
        """
        return ndtr((np.asarray(value, float)[..., None] - self.centre) / self.std) @ self.weight

    def quantile(self, level: Any) -> np.ndarray:
        """Value below which a share of the probability lies.

        Parameters
        ----------
        level : array_like, shape (...)
            The share, between 0 and 1.

        Returns
        -------
        ndarray, shape (...)
            The value.
        """
        wanted = np.asarray(level, float)
        # Parts of no weight would only make the search start farther out.
        heavy = self.weight > _NO_WEIGHT
        parts = NormalMixture(self.weight[heavy], self.centre[heavy], self.std[heavy])
        low = np.full(wanted.shape, float(np.min(parts.centre - _FARTHEST * parts.std)))
        high = np.full(wanted.shape, float(np.max(parts.centre + _FARTHEST * parts.std)))
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            less = parts.below(middle) < wanted
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        return 0.5 * (low + high)

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Interval with as much probability below as above.

        Parameters
        ----------
        level : float
            Probability inside.

        Returns
        -------
        (float, float)
            Its ends.
        """
        low, high = self.quantile([0.5 * (1.0 - level), 0.5 * (1.0 + level)])
        return float(low), float(high)

    def draws(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Independent draws, shape (count,)."""
        part = rng.choice(len(self.weight), count, p=self.weight)
        return rng.normal(self.centre[part], self.std[part])


@dataclass(frozen=True)
class GapPosterior:
    """What is known of the gap's mean and spread.

    Attributes
    ----------
    spread : ndarray, shape (k,) [um]
        Spreads, equally far apart in their logs.
    log_weight : ndarray, shape (k,)
        Log of the weight of each; the weights add up to 1.
    centre, std : ndarray, shape (k,) [um]
        Mean and standard deviation of the mean gap, given each spread.
    readings : int
        How many readings it knows.
    """

    spread: np.ndarray
    log_weight: np.ndarray
    centre: np.ndarray
    std: np.ndarray
    readings: int = 0

    @classmethod
    def before(cls, prior: GapPrior = WEAK_PRIOR) -> "GapPosterior":
        """What is known before any reading.

        Parameters
        ----------
        prior : GapPrior
            The prior.

        Returns
        -------
        GapPosterior
            The same as a row of spreads.
        """
        steps = np.linspace(-_REACH, _REACH, _SPREADS)
        log_weight = -0.5 * steps**2
        return cls(
            spread=prior.spread * np.exp(prior.spread_log_std * steps),
            log_weight=log_weight - logsumexp(log_weight),
            centre=np.full(_SPREADS, prior.mean),
            std=np.full(_SPREADS, prior.mean_std),
        )

    @property
    def weight(self) -> np.ndarray:
        """Weight of each spread, shape (k,)."""
        return np.exp(self.log_weight)

    def updated(self, data: GapData) -> "GapPosterior":
        """What is known after further readings; one alone will do.

        Parameters
        ----------
        data : GapData
            The readings.

        Returns
        -------
        GapPosterior
            Equal to that of all readings at once.
        """
        variance = data.sigma**2 + self.spread[:, None] ** 2 / data.passes
        told = np.sum(1.0 / variance, axis=1)
        average = np.sum(data.gap / variance, axis=1) / told
        off = average - self.centre
        # Density of the readings with the mean integrated out: they scatter about their own
        # average, and that about the mean known so far.
        square = np.sum((data.gap - average[:, None]) ** 2 / variance, axis=1)
        square = square + off**2 / (self.std**2 + 1.0 / told)
        determinant = np.sum(np.log(variance), axis=1) + np.log1p(told * self.std**2)
        log_weight = self.log_weight - 0.5 * (square + determinant)
        precision = 1.0 / self.std**2 + told
        return GapPosterior(
            spread=self.spread,
            log_weight=log_weight - logsumexp(log_weight),
            centre=self.centre + off * told / precision,
            std=1.0 / np.sqrt(precision),
            readings=self.readings + len(data),
        )

    @property
    def mean(self) -> NormalMixture:
        """Distribution of the mean gap [um]."""
        return NormalMixture(self.weight, self.centre, self.std)

    def next_gap(self, passes: int = 1, sigma: float = 0.0) -> NormalMixture:
        """Distribution of the next gap, or of the next reading of it.

        Parameters
        ----------
        passes : int
            Over how many independent gaps it goes.
        sigma : float [um]
            Standard deviation of measuring it; 0 for the gap itself.

        Returns
        -------
        NormalMixture
            In um.
        """
        if passes < 1 or not (math.isfinite(sigma) and sigma >= 0):
            raise InputError(
                f"passes is {passes} and sigma {sigma:g}, but must be 1 or more and 0 or more."
            )
        scatter = self.spread**2 / passes + sigma**2
        return NormalMixture(self.weight, self.centre, np.sqrt(self.std**2 + scatter))

    def chance(self, windows: Sequence[tuple[float, float, int]]) -> float:
        """Probability that several gaps to come all lie where they are wanted.

        Parameters
        ----------
        windows : sequence of (float, float, int) [um, um, 1]
            For each gap, lowest and highest value and over how many passes it goes. The gaps are
            independent but share mean and spread, so that they hit or miss together more often
            than by the product of their probabilities.

        Returns
        -------
        float
            The probability.
        """
        nodes, weights = np.polynomial.hermite_e.hermegauss(_MEANS)
        mean = self.centre[:, None] + self.std[:, None] * nodes
        each = np.ones_like(mean)
        for low, high, passes in windows:
            scatter = self.spread[:, None] / math.sqrt(passes)
            inside = ndtr((high - mean) / scatter) - ndtr((low - mean) / scatter)
            each *= np.where(high > low, inside, 0.0)
        return float(self.weight @ (each @ (weights / np.sum(weights))))

    def spread_below(self, value: Any) -> np.ndarray:
        """Probability that the spread is less.

        Parameters
        ----------
        value : array_like, shape (...) [um]
            Than what.

        Returns
        -------
        ndarray, shape (...)
            The probability, between the spreads of the row interpolated.
        """
        edges = np.log(self.spread)
        edges = np.append(edges, 2.0 * edges[-1] - edges[-2]) - 0.5 * (edges[1] - edges[0])
        shares = np.concatenate([[0.0], np.cumsum(self.weight)])
        return np.interp(np.log(np.asarray(value, float)), edges, shares)

    def spread_quantile(self, level: Any) -> np.ndarray:
        """Spread below which a share of the probability lies.

        Parameters
        ----------
        level : array_like, shape (...)
            The share.

        Returns
        -------
        ndarray, shape (...) [um]
            The spread.
        """
        edges = np.log(self.spread)
        edges = np.append(edges, 2.0 * edges[-1] - edges[-2]) - 0.5 * (edges[1] - edges[0])
        shares = np.concatenate([[0.0], np.cumsum(self.weight)])
        return np.exp(np.interp(np.asarray(level, float), shares, edges))

    def draws(self, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Independent draws of both.

        Parameters
        ----------
        count : int
            How many.
        seed : int
            Same seed, same draws.

        Returns
        -------
        ndarray, ndarray, each of shape (count,) [um]
            Mean gap and spread.
        """
        rng = np.random.default_rng(seed)
        part = rng.choice(len(self.spread), count, p=self.weight)
        return rng.normal(self.centre[part], self.std[part]), self.spread[part]

    def as_tree(self, count: int = 4000, seed: int = 0) -> xarray.DataTree:
        """Draws as a DataTree, as `calibration.sample` gives them.

        Parameters
        ----------
        count : int
            Draws of each of four chains; they are independent.
        seed : int
            Same seed, same draws.

        Returns
        -------
        xarray.DataTree
            Group ``posterior`` with `gap_mean` and `gap_spread`.
        """
        import arviz_base

        mean, spread = self.draws(4 * count, seed)
        columns = {"gap_mean": mean.reshape(4, count), "gap_spread": spread.reshape(4, count)}
        tree = arviz_base.from_dict({"posterior": columns})
        for name in columns:
            tree["posterior"][name].attrs["unit"] = "um"
        tree.attrs = {
            "sampler": "independent draws of the exact posterior",
            "converged": 1,
            "status": f"independent draws of the exact posterior of {self.readings} readings",
        }
        return tree

    def as_dict(self) -> dict[str, Any]:
        """Estimates and intervals as plain types."""
        ahead = self.next_gap()
        low, middle, high = self.spread_quantile([0.025, 0.5, 0.975]).tolist()
        return {
            "readings": self.readings,
            "gap_mean": {
                "value": self.mean.mean,
                "std": self.mean.deviation,
                "interval95": list(self.mean.interval(0.95)),
            },
            "gap_spread": {"value": middle, "interval95": [low, high]},
            "next_gap": {
                "value": ahead.mean,
                "std": ahead.deviation,
                "interval90": list(ahead.interval(0.9)),
            },
        }


def fit_gap(data: GapData, prior: GapPrior = WEAK_PRIOR) -> GapPosterior:
    """Mean and spread of the gap from readings.

    Parameters
    ----------
    data : GapData
        Two readings or more.
    prior : GapPrior
        What is known before.

    Returns
    -------
    GapPosterior
        The posterior.

    Raises
    ------
    InputError
        If there is a single reading.
    """
    require_scatter(data)
    return GapPosterior.before(prior).updated(data)
