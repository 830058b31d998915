"""The ten-hole experiment: gaps simulated with the paper's range, and the range alone."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from calibration.electrode import WEAK_PRIOR, GapData, GapPrior, measured_std
from calibration.electrode_gap import GapPosterior, fit_gap
from experiments.guo_wedg_electrodes.conditions import Conditions

# Half widths of the grid of the posterior from the range, in standard deviations, and its size.
_GRID, _REACH = 241, 4.0


def simulated_gaps(conditions: Conditions, seed: int | None = None) -> np.ndarray:
    """Ten readings with the paper's lowest and highest one; NOT the paper's.

    Given the extremes of normal readings, the others are independent and normal, cut to lie
    between. Their mean is taken in the middle, their standard deviation from the range.
    """
    low, high = conditions.lowest_gap, conditions.highest_gap
    spread = (high - low) / conditions.range_constant
    half = 0.5 * (high - low) / spread
    rng = np.random.default_rng(conditions.seed if seed is None else seed)
    share = rng.uniform(ndtr(-half), ndtr(half), conditions.holes - 2)
    between = 0.5 * (low + high) + spread * ndtri(share)
    return np.round(rng.permutation([low, high, *between]), 1)


def readings(conditions: Conditions, seed: int | None = None) -> GapData:
    """The simulated gaps with the error of measuring them."""
    sigma = measured_std(conditions.diameter_error) / math.sqrt(2.0)
    return GapData(simulated_gaps(conditions, seed), sigma)


@dataclass(frozen=True)
class RangePosterior:
    """Mean and spread of the gap from the lowest and highest reading and their number alone.

    `weight` belongs to the grid of means and spreads, shapes (m, 1) and (1, k).
    """

    mean: np.ndarray
    spread: np.ndarray
    weight: np.ndarray

    def next_below(self, gap: float) -> float:
        """Probability that the next gap is below."""
        return float(np.sum(self.weight * ndtr((gap - self.mean) / self.spread)))

    def next_quantile(self, level: float) -> float:
        """Gap that the next is below with this probability."""
        low, high = 0.0, 60.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.next_below(middle) < level else (low, middle)
        return 0.5 * (low + high)

    @property
    def spread_median(self) -> float:
        """Median of the spread."""
        return float(np.interp(0.5, np.cumsum(np.sum(self.weight, axis=0)), self.spread[0]))

    @property
    def mean_mean(self) -> float:
        """Mean of the mean gap."""
        return float(np.sum(self.weight * self.mean))


def from_range(conditions: Conditions, prior: GapPrior = WEAK_PRIOR) -> RangePosterior:
    """What the paper's range tells by itself: the joint density of both extremes [um].

    n (n - 1) phi(a) phi(b) (Phi(b) - Phi(a))^(n - 2) / tau^2 with a, b the standardised extremes
    and tau^2 the squares of spread and measuring error together.
    """
    low, high, count = conditions.lowest_gap, conditions.highest_gap, conditions.holes
    sigma = measured_std(conditions.diameter_error) / math.sqrt(2.0)
    typical = (high - low) / conditions.range_constant
    mean = 0.5 * (low + high) + _REACH * typical * np.linspace(-1, 1, _GRID)[:, None]
    logs = np.linspace(math.log(0.1 * typical), math.log(10.0 * typical), _GRID)[None, :]
    spread = np.exp(logs)
    scale = np.sqrt(spread**2 + sigma**2)
    a, b = (low - mean) / scale, (high - mean) / scale
    between = np.maximum(ndtr(b) - ndtr(a), 1e-300)
    density = -0.5 * (a**2 + b**2) + (count - 2) * np.log(between) - 2.0 * np.log(scale)
    density = density - 0.5 * ((mean - prior.mean) / prior.mean_std) ** 2
    density = density - 0.5 * ((logs - math.log(prior.spread)) / prior.spread_log_std) ** 2
    weight = np.exp(density - np.max(density))
    return RangePosterior(mean, spread, weight / np.sum(weight))


@dataclass(frozen=True)
class Learning:
    """Expected absolute size error by electrodes measured so far, and the least possible [um]."""

    electrodes: np.ndarray
    error: np.ndarray
    least: float


def learning(conditions: Conditions, electrodes: int = 20, repeats: int = 40) -> Learning:
    """Grind, measure, correct, again and again, beginning with the prior alone.

    The true gaps are normal about the middle of the paper's range with its standard deviation.
    The expected error of the next size is known in closed form from the gap counted on.
    """
    rng = np.random.default_rng(conditions.seed)
    middle = 0.5 * (conditions.lowest_gap + conditions.highest_gap)
    spread = (conditions.highest_gap - conditions.lowest_gap) / conditions.range_constant
    error = np.zeros(electrodes + 1)
    sigma = 0.5 * measured_std(conditions.diameter_error)
    for _ in range(repeats):
        known = GapPosterior.before()
        for i in range(electrodes + 1):
            # The median of the next gap is what a least absolute error counts on.
            counted = float(known.next_gap().quantile(0.5))
            z = (counted - middle) / spread
            density = math.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
            error[i] += 2.0 * spread * (z * (2.0 * float(ndtr(z)) - 1.0) + 2.0 * density)
            measured = rng.normal(middle, spread) + 0.5 * rng.uniform(-1, 1) * (
                conditions.diameter_error
            )
            known = known.updated(GapData(max(measured, 0.0), sigma))
    least = 2.0 * spread * math.sqrt(2.0 / math.pi)
    return Learning(np.arange(electrodes + 1), error / repeats, least)


def posterior(conditions: Conditions, seed: int | None = None) -> GapPosterior:
    """Mean and spread of the gap from the simulated readings."""
    return fit_gap(readings(conditions, seed))
