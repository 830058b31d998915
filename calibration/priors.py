"""What is known of a parameter before the data: priors.

Each prior gives its log density (for sampling), its cost (minus the log density that a fit
maximises) and a row for least squares: a residual whose product with its derivative is the
gradient of that cost.
"""

import abc
import math
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
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

    @property
    def least_squares(self) -> bool:
        """Whether half the squared residual is the cost."""
        return True

    @abc.abstractmethod
    def residual(self, value: Array) -> Array:
        """Standardised distance from the centre: the half square is minus the log density."""

    def cost(self, value: Array) -> Array:
        """Minus the log density that a fit maximises, up to a constant."""
        return 0.5 * self.residual(value) ** 2

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size,), in the parameter's unit."""
        raise InputError(f"prior {self} has no way to draw from it: use one of the named priors.")

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
        if not math.isfinite(self.mean):
            raise InputError(f"prior mean is {self.mean}, but must be a finite number.")
        _require_positive("std", self.std)

    @property
    def support(self) -> tuple[float, float]:
        """The whole line."""
        return -math.inf, math.inf

    def residual(self, value: Array) -> Array:
        """(value - mean) / std."""
        return (value - self.mean) / self.std

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws."""
        return rng.normal(self.mean, self.std, size)


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

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws."""
        return self.median * np.exp(rng.normal(0.0, self.log_std, size))


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

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws."""
        return np.abs(rng.normal(0.0, self.std, size))


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

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws."""
        return rng.uniform(self.low, self.high, size)


# Small beside the curvature of anything that the data or the prior tell.
_LEAST_CURVATURE = 1e-4


class _ByDensity(Prior):
    """A prior known by its log density alone; its row follows from the density's derivatives."""

    @property
    def least_squares(self) -> bool:
        """No."""
        return False

    def cost(self, value: Array) -> Array:
        """Minus the log density."""
        return -self.log_density(value)

    def residual(self, value: Array) -> Array:
        """A row with the gradient of the cost, and its curvature where that is positive."""
        fixed = jax.lax.stop_gradient(jnp.asarray(value, float))
        slope, bend = jax.grad(self.cost)(fixed), jax.grad(jax.grad(self.cost))(fixed)
        # Where the log density is straight or bends upwards it has no information to give; a share
        # of the squared slope keeps the row finite.
        least = _LEAST_CURVATURE * slope**2 + jnp.finfo(float).tiny
        root = jnp.sqrt(jnp.maximum(bend, least))
        return root * (value - fixed) + slope / root


@dataclass(frozen=True)
class Beta(_ByDensity):
    """Beta prior, stretched to a range.

    Parameters
    ----------
    a, b : float
        Shapes, at least 1, so that the density is bounded: Beta(1, 1) is uniform, equal shapes
        are symmetric, greater ones narrower.
    low, high : float
        The range, in the parameter's unit.
    """

    a: float
    b: float
    low: float = 0.0
    high: float = 1.0

    def __post_init__(self) -> None:
        for name, shape in (("a", self.a), ("b", self.b)):
            if not (math.isfinite(shape) and shape >= 1.0):
                raise InputError(f"beta prior shape {name} is {shape}, but must be at least 1.")
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise InputError(f"beta prior needs finite low < high, not {self.low}, {self.high}.")

    @property
    def support(self) -> tuple[float, float]:
        """From low to high."""
        return self.low, self.high

    @property
    def informs(self) -> bool:
        """Unless it is uniform."""
        return self.a > 1.0 or self.b > 1.0

    def log_density(self, value: Array) -> Array:
        """Log density up to a constant; minus infinity outside the range."""
        share = (value - self.low) / (self.high - self.low)
        inside = (share >= 0.0) & (share <= 1.0)
        total = jnp.zeros_like(share)
        for shape, part in ((self.a, share), (self.b, 1.0 - share)):
            if shape > 1.0:
                positive = jnp.where(part > 0.0, part, 1.0)
                total = total + (shape - 1.0) * jnp.where(part > 0.0, jnp.log(positive), -jnp.inf)
        return jnp.where(inside, total, -jnp.inf)

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws."""
        return self.low + (self.high - self.low) * rng.beta(self.a, self.b, size)


@dataclass(frozen=True)
class Truncated(Prior):
    """Another prior, cut to a range.

    Parameters
    ----------
    prior : Prior
        What is cut.
    low, high : float
        Range in the parameter's unit; infinite where open.
    """

    prior: Prior
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if not isinstance(self.prior, Prior):
            raise InputError(f"{self.prior!r} is not a prior: cut one such as Normal(mean, std).")
        if math.isnan(self.low) or math.isnan(self.high):
            raise InputError(f"truncated prior needs numbers, not {self.low}, {self.high}.")
        low, high = self.support
        if not low < high:
            raise InputError(
                f"prior {self.prior} is zero between {self.low:g} and {self.high:g}: cut elsewhere."
            )

    @property
    def support(self) -> tuple[float, float]:
        """What is left of the other's."""
        low, high = self.prior.support
        return max(low, self.low), min(high, self.high)

    @property
    def informs(self) -> bool:
        """As the other."""
        return self.prior.informs

    @property
    def least_squares(self) -> bool:
        """As the other."""
        return self.prior.least_squares

    def residual(self, value: Array) -> Array:
        """That of the other."""
        return self.prior.residual(value)

    def cost(self, value: Array) -> Array:
        """That of the other."""
        return self.prior.cost(value)

    def log_density(self, value: Array) -> Array:
        """That of the other inside the range."""
        low, high = self.support
        inside = (value >= low) & (value <= high)
        return jnp.where(inside, self.prior.log_density(value), -jnp.inf)

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws of the other, those outside thrown away."""
        low, high = self.support
        kept = np.empty(0)
        for _ in range(1000):
            if len(kept) >= size:
                return kept[:size]
            drawn = self.prior.draw(rng, 4 * size)
            kept = np.concatenate([kept, drawn[(drawn >= low) & (drawn <= high)]])
        raise InputError(f"prior {self} keeps almost none of its draws: cut it less far out.")


@dataclass(frozen=True)
class Custom(_ByDensity):
    """A prior of your own.

    Parameters
    ----------
    function : callable
        Log density of a value, up to a constant, written with jax.numpy: a scalar for a scalar.
    low, high : float
        Where the density is not zero.
    """

    function: Callable[[Array], Array]
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise InputError(f"prior function {self.function!r} cannot be called.")
        if not self.low < self.high:
            raise InputError(f"custom prior needs low < high, not {self.low}, {self.high}.")

    @property
    def support(self) -> tuple[float, float]:
        """From low to high."""
        return self.low, self.high

    def log_density(self, value: Array) -> Array:
        """What the function says; minus infinity outside the range."""
        inside = (value >= self.low) & (value <= self.high)
        finite = [end for end in (self.low, self.high) if math.isfinite(end)]
        guarded = jnp.where(inside, value, sum(finite) / len(finite) if finite else 0.0)
        return jnp.where(inside, self.function(guarded), -jnp.inf)


def _require_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"prior {name} is {value}, but must be a number above 0.")
