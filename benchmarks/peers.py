"""The alternatives: NumPy models and scipy, lmfit or emcee as a user would write them.

Nothing of ours and no JAX is imported here.
Lengths in um, areas in um^2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import Bounds, curve_fit, lsq_linear, minimize

ELECTRODE_AREA = np.pi * 50.0**2

NumpyModel = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Estimate:
    """Values and standard deviations in the order of the model's arguments."""

    values: np.ndarray
    stds: np.ndarray


def depths_model(half_widths: np.ndarray, feed: float) -> NumpyModel:
    """Depth after every layer of a square cavity, eq. (4) of Yu and Masuzawa."""

    def depths(x: np.ndarray, wear_ratio: float) -> np.ndarray:
        area = 4.0 * half_widths**2
        return np.cumsum(feed / (1.0 + wear_ratio * area / ELECTRODE_AREA))

    return depths


def wall_model(half_widths: np.ndarray, feed: float, edge_width: float) -> NumpyModel:
    """Wall of a square cavity as an instrument sees it, through the corners of the layers."""

    def wall(
        x: np.ndarray,
        wear_ratio: float,
        gap: float = 0.0,
        centre: float = 0.0,
        zero: float = 0.0,
        tilt: float = 0.0,
    ) -> np.ndarray:
        across = x - centre
        distance = np.abs(across)
        walls = half_widths + gap
        depths = np.cumsum(feed / (1.0 + wear_ratio * 4.0 * walls**2 / ELECTRODE_AREA))
        inside = np.interp(distance, walls[::-1], depths[::-1])
        edge = depths[0] * np.clip(1.0 - (distance - walls[0]) / edge_width, 0.0, 1.0)
        return np.where(distance > walls[0], edge, inside) + zero + tilt * across

    return wall


def scipy_fit(
    model: NumpyModel,
    x: np.ndarray,
    y: np.ndarray,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> Estimate:
    """Bounded curve_fit with everything else left at its default."""
    values, covariance = curve_fit(model, x, y, p0=start, bounds=(lower, upper))
    return Estimate(values, np.sqrt(np.diag(covariance)))


@dataclass(frozen=True)
class LmfitFit:
    """lmfit.Model with bounds, made once, fitted to any readings."""

    model: NumpyModel
    names: tuple[str, ...]

    @cached_property
    def _lmfit_model(self) -> Any:
        import lmfit

        return lmfit.Model(self.model, independent_vars=["x"])

    def __call__(
        self,
        x: np.ndarray,
        y: np.ndarray,
        start: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
    ) -> Estimate:
        model = self._lmfit_model
        params = model.make_params()
        for name in params:
            params[name].set(vary=name in self.names)
        for name, value, low, high in zip(self.names, start, lower, upper, strict=True):
            params[name].set(value=value, min=low, max=high)
        result = model.fit(y, params, x=x)
        errors = [result.params[name].stderr for name in self.names]
        stds = [float("nan") if error is None else error for error in errors]
        return Estimate(
            np.array([result.params[name].value for name in self.names]), np.array(stds)
        )


class PlanProblem:
    """Feeds for wanted depths as a user would pose it: mean square wall error, feeds in a box."""

    def __init__(
        self,
        bottom: np.ndarray,
        area: np.ndarray,
        wear_ratios: np.ndarray,
        bounds: tuple[float, float],
        start: np.ndarray,
    ):
        self.bottom, self.bounds = bottom, bounds
        # One row for each believed wear ratio.
        self.share = 1.0 / (1.0 + np.outer(wear_ratios, area) / ELECTRODE_AREA)
        self.start = np.clip(start, *bounds)

    def cost(self, feeds: np.ndarray) -> float:
        """Mean square wall error over layers and believed wear ratios [um^2]."""
        return float(np.mean((np.cumsum(feeds * self.share, axis=1) - self.bottom) ** 2))

    def minimize(self, method: str) -> np.ndarray:
        box = Bounds(*(np.full(self.start.shape, side) for side in self.bounds))
        return minimize(self.cost, self.start, method=method, bounds=box).x

    def lsq_linear(self) -> np.ndarray:
        count = len(self.bottom)
        matrix = np.concatenate([np.tril(np.ones((count, count))) * row for row in self.share])
        return lsq_linear(matrix, np.tile(self.bottom, len(self.share)), self.bounds).x


def exact_feeds(thickness: np.ndarray, area: np.ndarray, wear_ratio: float) -> np.ndarray:
    """Feed of every layer, eq. (3) solved for dZ."""
    return thickness * (1.0 + wear_ratio * area / ELECTRODE_AREA)


FIT_SCRIPT = '''\
"""Wear ratio of a square test cavity from its profile, with scipy."""

import json
import sys

import numpy as np
from scipy.optimize import curve_fit

HALF_WIDTH, FEED, STEP, LAYERS = 250.0, 2.0, 2.0, {layers}
ELECTRODE_AREA = np.pi * 50.0**2

x, z = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1, unpack=True)
walls = HALF_WIDTH - STEP * np.arange(LAYERS)


def wall(x, wear_ratio):
    depths = np.cumsum(FEED / (1.0 + wear_ratio * 4.0 * walls**2 / ELECTRODE_AREA))
    return np.interp(x, walls[::-1], depths[::-1])


values, covariance = curve_fit(wall, x, z, p0=[0.1], bounds=(0.0, np.inf))
std = float(np.sqrt(covariance[0, 0]))
value = float(values[0])
interval = [value - 1.96 * std, value + 1.96 * std]
print(json.dumps({{"wear_ratio": {{"value": value, "std": std, "interval95": interval}}}}))
'''
