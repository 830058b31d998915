"""What is known of a parameter before the data: priors.

Each prior gives its log density (for sampling) and a residual whose half square is minus the
log density up to a constant (for least squares).
"""

import abc
import math
from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array

from procmodel.errors import InputError


class Prior(abc.ABC):
    """Base of all priors."""

    @property
    @abc.abstractmethod
    def support(self) -> tuple[float, float]:
        """Range in which the density is not zero."""

    @property
    def informs(self) -> bool:
        """Whether the density changes inside its support, so that it counts like a reading."""
        return True

    @abc.abstractmethod
    def residual(self, value: Array) -> Array:
        """Standardised distance from the centre: the half square is minus the log density."""

    def log_density(self, value: Array) -> Array:
        """Log density up to a constant; minus infinity outside the support."""
        low, high = self.support
        inside = (value >= low) & (value <= high)
        # The double `where` keeps log(0) of a value outside from reaching the gradient.
        centre = 1.0 if low == 0 else 0.5 * (low + high) if math.isfinite(high - low) else 0.0
        guarded = jnp.where(inside, value, centre)
        return jnp.where(inside, -0.5 * self.residual(guarded) ** 2, -jnp.inf)


@dataclass(frozen=True)
class Normal(Prior):
    """Normal prior.

    Parameters
    ----------
    mean, std : float
        In the parameter's unit; std > 0.
    """

    mean: float
    std: float

    def __post_init__(self) -> None:
        _require_positive("std", self.std)

    @property
    def support(self) -> tuple[float, float]:
        """The whole line."""
        return -math.inf, math.inf

    def residual(self, value: Array) -> Array:
        """(value - mean) / std."""
        return (value - self.mean) / self.std


@dataclass(frozen=True)
class LogNormal(Prior):
    """Log-normal prior: log(value) is normal about log(median).

    The density is taken per unit of log(value), so the least-squares optimum is the median.

    Parameters
    ----------
    median : float
        In the parameter's unit, > 0.
    log_std : float
        Standard deviation of log(value), > 0; 0.1 is about 10 %.
    """

    median: float
    log_std: float

    def __post_init__(self) -> None:
        _require_positive("median", self.median)
        _require_positive("log_std", self.log_std)

    @property
    def support(self) -> tuple[float, float]:
        """Positive values."""
        return 0.0, math.inf

    def residual(self, value: Array) -> Array:
        """log(value / median) / log_std."""
        positive = jnp.where(value > 0, value, jnp.finfo(float).tiny)
        return jnp.log(positive / self.median) / self.log_std

    def log_density(self, value: Array) -> Array:
        """Log density per unit of the value itself, up to a constant."""
        positive = jnp.where(value > 0, value, 1.0)
        return jnp.where(value > 0, super().log_density(value) - jnp.log(positive), -jnp.inf)


@dataclass(frozen=True)
class HalfNormal(Prior):
    """Half-normal prior on values >= 0.

    Parameters
    ----------
    std : float
        Scale, in the parameter's unit, > 0.
    """

    std: float

    def __post_init__(self) -> None:
        _require_positive("std", self.std)

    @property
    def support(self) -> tuple[float, float]:
        """Zero and above."""
        return 0.0, math.inf

    def residual(self, value: Array) -> Array:
        """Value over std."""
        return value / self.std


@dataclass(frozen=True)
class Uniform(Prior):
    """Uniform prior.

    Parameters
    ----------
    low, high : float
        In the parameter's unit, low < high, both finite.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise InputError(f"uniform prior needs finite low < high, not {self.low}, {self.high}.")

    @property
    def support(self) -> tuple[float, float]:
        """From low to high."""
        return self.low, self.high

    @property
    def informs(self) -> bool:
        """A uniform prior only bounds."""
        return False

    def residual(self, value: Array) -> Array:
        """Zero: the data alone decide inside the range."""
        return 0.0 * value


def _require_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"prior {name} is {value}, but must be a number above 0.")
