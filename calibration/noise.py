"""How readings scatter around the model: noise models.

A noise model gives its cost (minus the log-likelihood, up to a constant) and *rows* r with a
derivative J such that J'r is the gradient of that cost and J'J its expected curvature, so that one
least-squares solver serves them all (Fisher scoring). Readings are taken apart by
``z = (reading - model) / sigma``.

References
----------
.. [1] K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t
   distribution", JASA 84, 881-896, 1989: expected information of Student's t.
.. [2] P. J. Huber, "Robust Statistics", 1981: covariance of an M-estimate.
"""

import abc
import functools
import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import gammaln, polygamma

from procmodel.errors import InputError, nearest

Values = Mapping[str, Array]
HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


class Noise(abc.ABC):
    """Base of all noise models; frozen and hashable, for it is compiled in."""

    @property
    def names(self) -> dict[str, tuple[float, float]]:
        """Parameters that the noise uses, with the open range each has to stay in."""
        return {}

    @property
    def least_squares(self) -> bool:
        """Whether half the sum of z squared is the cost when sigma is a number."""
        return False

    @property
    def moves_scale(self) -> bool:
        """Whether the scale depends on parameters even where sigma is a number."""
        return bool(self.names)

    @property
    def takes(self) -> tuple[str, ...]:
        """Kinds of sigma it works with: of "given", "parameter", "estimated"."""
        return ("given", "parameter")

    def scale(self, prediction: Any, sigma: Any, values: Values) -> Array:
        """Standard deviation (or scale) of each reading, shape (n,)."""
        return sigma

    @abc.abstractmethod
    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Log density of each reading, shape (n,); their sum is the log-likelihood."""

    @abc.abstractmethod
    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Rows of the readings, shape (n,), then those of scale and shape."""

    @abc.abstractmethod
    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """New readings around a prediction, shape (n,)."""

    def cost(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Minus the log-likelihood."""
        return -jnp.sum(self.log_likelihood(prediction, y, sigma, values))


@dataclass(frozen=True)
class Gaussian(Noise):
    """Normal noise; what a data set has when nothing is said."""

    @property
    def least_squares(self) -> bool:
        """Yes."""
        return True

    @property
    def takes(self) -> tuple[str, ...]:
        """All kinds of sigma."""
        return ("given", "parameter", "estimated")

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Of the normal distribution."""
        z = (y - prediction) / sigma
        return -0.5 * z**2 - jnp.log(sigma) - HALF_LOG_TWO_PI

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Deviations, and the log of sigma."""
        z = _fixed((y - prediction) / sigma)
        return _anchored(prediction, -z, 1.0 / sigma), _anchored(
            jnp.log(sigma), (1.0 - z**2) / math.sqrt(2.0), math.sqrt(2.0)
        )

    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """Normal readings."""
        return rng.normal(prediction, sigma)


NORMAL = Gaussian()


@dataclass(frozen=True)
class Relative(Noise):
    """Normal noise that grows with the reading: sigma^2 + (share * model)^2.

    Parameters
    ----------
    share : float or str
        Standard deviation as a share of the model's value, > 0, or the name of the parameter.
    """

    share: float | str

    def __post_init__(self) -> None:
        _require_number_or_name("share", self.share, 0.0, math.inf)

    @property
    def names(self) -> dict[str, tuple[float, float]]:
        """The share, if a parameter."""
        return {self.share: (0.0, math.inf)} if isinstance(self.share, str) else {}

    @property
    def moves_scale(self) -> bool:
        """It follows the model."""
        return True

    def scale(self, prediction: Any, sigma: Any, values: Values) -> Array:
        """Both parts together."""
        return jnp.sqrt(sigma**2 + (_value(self.share, values) * prediction) ** 2)

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Of the normal distribution."""
        scale = self.scale(prediction, sigma, values)
        return NORMAL.log_likelihood(prediction, y, scale, values)

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Deviations, and the log of the standard deviations."""
        return NORMAL.rows(prediction, y, self.scale(prediction, sigma, values), values)

    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """Normal readings."""
        return rng.normal(prediction, np.asarray(self.scale(prediction, sigma, values)))


@dataclass(frozen=True)
class StudentT(Noise):
    """Student's t: a few readings may be far off.

    Parameters
    ----------
    freedom : float or str
        Degrees of freedom, > 0 (4 is a common choice), or the name of the parameter.
    """

    freedom: float | str = 4.0

    def __post_init__(self) -> None:
        _require_number_or_name("freedom", self.freedom, 0.0, math.inf)

    @property
    def names(self) -> dict[str, tuple[float, float]]:
        """The degrees of freedom, if a parameter."""
        return {self.freedom: (0.0, math.inf)} if isinstance(self.freedom, str) else {}

    def _freedom(self, values: Values) -> Array:
        """Degrees of freedom; where they make no difference any more they have no effect."""
        return jnp.minimum(jnp.asarray(_value(self.freedom, values), float), _NORMAL_FROM)

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Of Student's t with scale sigma."""
        freedom = self._freedom(values)
        return _student((y - prediction) / sigma, freedom) - jnp.log(sigma)

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Deviations, the log of sigma, and the degrees of freedom."""
        freedom = self._freedom(values)
        z, nu = _fixed((y - prediction) / sigma), _fixed(freedom)
        pull = (nu + 1.0) * z / (nu + z**2)
        located = jnp.sqrt((nu + 1.0) / (nu + 3.0))
        location = _anchored(prediction, -pull / located, located / sigma)
        scaled = jnp.sqrt(2.0 * nu / (nu + 3.0))
        score = (1.0 - z * pull) / scaled
        if not isinstance(self.freedom, str):
            return location, _anchored(jnp.log(sigma), score, scaled)
        # Scale and shape inform each other: rows by the Cholesky factor of their information.
        cross = -2.0 / ((nu + 1.0) * (nu + 3.0)) / scaled
        left = jnp.sqrt(_shape_information(nu) - cross**2)
        of_shape = -jax.vmap(jax.grad(_student, argnums=1), (0, None))(z, nu)
        moves = jnp.broadcast_to(freedom, z.shape)
        first = _anchored(jnp.log(sigma), score, scaled) + _anchored(moves, 0.0 * score, cross)
        return location, first, _anchored(moves, (of_shape - cross * score) / left, left)

    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """Readings with the tails of Student's t."""
        return prediction + sigma * rng.standard_t(
            float(_value(self.freedom, values)), size=np.shape(prediction)
        )


@dataclass(frozen=True)
class AR1(Noise):
    """Normal noise in which a reading's error is a share of that of the reading before it.

    The readings stand in order and at equal distances. sigma is the standard deviation of a single
    reading (not of its innovation).

    Parameters
    ----------
    correlation : float or str
        Of neighbouring readings, between -1 and 1, or the name of the parameter.
    """

    correlation: float | str

    def __post_init__(self) -> None:
        _require_number_or_name("correlation", self.correlation, -1.0, 1.0)

    @property
    def names(self) -> dict[str, tuple[float, float]]:
        """The correlation, if a parameter."""
        return {self.correlation: (-1.0, 1.0)} if isinstance(self.correlation, str) else {}

    def _innovations(
        self, prediction: Array, y: Array, sigma: Array, correlation: Array
    ) -> tuple[Array, Array]:
        """Standardised errors of readings, and of their innovations, each of shape (n,)."""
        z = (y - prediction) / sigma
        share = jnp.sqrt(1.0 - correlation**2)
        return z, jnp.concatenate([z[:1], (z[1:] - correlation * z[:-1]) / share])

    def _log_scale(self, sigma: Array, correlation: Array) -> Array:
        """Log of the standard deviation of every innovation, shape (n,)."""
        later = jnp.arange(sigma.shape[0]) > 0
        return jnp.log(sigma) + jnp.where(later, 0.5 * jnp.log1p(-(correlation**2)), 0.0)

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Of each reading given those before it."""
        correlation = jnp.asarray(_value(self.correlation, values))
        _, w = self._innovations(prediction, y, sigma, correlation)
        return -0.5 * w**2 - self._log_scale(sigma, correlation) - HALF_LOG_TWO_PI

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Innovations, the log of their scale, and the correlation."""
        correlation = jnp.asarray(_value(self.correlation, values))
        phi = _fixed(correlation)
        z, w = self._innovations(prediction, y, _fixed(sigma), phi)
        u = _fixed(w)
        scale = _anchored(
            self._log_scale(sigma, correlation), (1.0 - u**2) / math.sqrt(2.0), math.sqrt(2.0)
        )
        moves = jnp.broadcast_to(correlation, u[1:].shape)
        score = -u[1:] * _fixed(z[:-1])
        return -w, scale, _anchored(moves, score, 1.0 / jnp.sqrt(1.0 - phi**2))

    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """Readings whose errors follow each other."""
        correlation = float(_value(self.correlation, values))
        errors = rng.normal(size=len(prediction))
        for i in range(1, len(errors)):
            errors[i] = correlation * errors[i - 1] + math.sqrt(1 - correlation**2) * errors[i]
        return prediction + sigma * errors


_LOSSES = {"huber": 1.345, "soft_l1": 1.5, "cauchy": 2.385}


@dataclass(frozen=True)
class Robust(Noise):
    """A robust loss: outliers count less, without a model of how they come about.

    Intervals follow from the spread of the readings' pulls (Huber's formula). Where sigma is left
    out, the scale is the median absolute residual, times 1.4826.

    Parameters
    ----------
    loss : {"huber", "soft_l1", "cauchy"}
        Linear tails, smooth linear tails, or logarithmic ones.
    threshold : float, optional
        In units of sigma, > 0 (> 1 for "cauchy"): where a reading begins to count less. The usual
        value of each loss when left out.
    """

    loss: str = "huber"
    threshold: float | None = None

    def __post_init__(self) -> None:
        if self.loss not in tuple(_LOSSES):
            raise InputError(f"loss {self.loss!r} is unknown{nearest(self.loss, tuple(_LOSSES))}.")
        least = 1.0 if self.loss == "cauchy" else 0.0
        if self.threshold is not None and not least < self.threshold < math.inf:
            raise InputError(f"threshold is {self.threshold}, but must be above {least:g}.")

    @property
    def takes(self) -> tuple[str, ...]:
        """A number, or nothing."""
        return ("given", "estimated")

    @property
    def _k(self) -> float:
        return self.threshold or _LOSSES[self.loss]

    def _rho(self, z: Any, xp: Any = jnp) -> Any:
        """Cost of one standardised deviation."""
        k = self._k
        if self.loss == "huber":
            return xp.where(abs(z) <= k, 0.5 * z**2, k * abs(z) - 0.5 * k**2)
        if self.loss == "soft_l1":
            return k**2 * (xp.sqrt(1.0 + (z / k) ** 2) - 1.0)
        return 0.5 * k**2 * xp.log1p((z / k) ** 2)

    def weight(self, z: Any) -> Array:
        """Derivative of the cost over z: 1 for a good reading, less for one far off."""
        k = self._k
        if self.loss == "huber":
            return jnp.minimum(1.0, k / jnp.maximum(jnp.abs(z), k))
        if self.loss == "soft_l1":
            return 1.0 / jnp.sqrt(1.0 + (z / k) ** 2)
        return 1.0 / (1.0 + (z / k) ** 2)

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Log of the density that is proportional to exp(-cost)."""
        z = (y - prediction) / sigma
        return -self._rho(z) - jnp.log(sigma) - _log_integral(self)

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Deviations, weighted."""
        z = _fixed((y - prediction) / sigma)
        root = jnp.sqrt(self.weight(z))
        return (_anchored(prediction, -z * root, root / sigma),)

    def information(self, z: np.ndarray) -> np.ndarray:
        """Factor on the rows' derivative that makes J'J the inverse covariance, shape (n,)."""
        pull = z * np.asarray(self.weight(z))
        slope = np.asarray(jax.vmap(jax.grad(lambda v: v * self.weight(v)))(jnp.asarray(z)))
        whole = max(float(np.mean(slope)), 1e-3) / max(math.sqrt(np.mean(pull**2)), 1e-300)
        return whole / np.sqrt(np.asarray(self.weight(z)))

    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """Readings of the density that is proportional to exp(-cost)."""
        if self.loss == "cauchy":
            # Student's t in another scale; its tails may be too long for any table.
            freedom = self._k**2 - 1.0
            stretch = self._k / math.sqrt(freedom)
            return prediction + sigma * stretch * rng.standard_t(freedom, np.shape(prediction))
        grid = np.sinh(np.linspace(-12.0, 12.0, 20_001))
        density = np.exp(-np.asarray(self._rho(grid, np)))
        steps = 0.5 * (density[1:] + density[:-1]) * np.diff(grid)
        share = np.concatenate([[0.0], np.cumsum(steps)])
        return prediction + sigma * np.interp(
            rng.uniform(size=np.shape(prediction)), share / share[-1], grid
        )


@functools.cache
def _log_integral(noise: Robust) -> float:
    import scipy.integrate  # slow to load, and needed by few

    def density(z: float) -> float:
        return math.exp(-float(noise._rho(z, np)))

    # Huber's loss has a kink in its curvature at the threshold.
    near, _ = scipy.integrate.quad(density, 0.0, noise._k, epsabs=0.0, epsrel=1e-12)
    far, _ = scipy.integrate.quad(density, noise._k, math.inf, epsabs=0.0, epsrel=1e-11)
    return math.log(2.0 * (near + far))


# Degrees of freedom from which on Student's t is taken for normal: the optimum of readings without
# outliers lies at infinity, and a fit has to end on the way there.
_NORMAL_FROM = 1e6
# From here on differences of gamma functions lose digits, and their series in 1/freedom has all.
_MANY_FREEDOM = 50.0


def _student(z: Array, freedom: Array) -> Array:
    """Log density of Student's t."""
    many = freedom > _MANY_FREEDOM
    few = jnp.where(many, _MANY_FREEDOM, freedom)
    at_zero = gammaln(0.5 * (few + 1.0)) - gammaln(0.5 * few) - 0.5 * jnp.log(few * jnp.pi)
    part = 1.0 / jnp.where(many, freedom, _MANY_FREEDOM)
    series = 1 / 4 - part**2 * (1 / 24 - part**2 * (1 / 20 - part**2 * 17 / 112))
    at_zero = jnp.where(many, -HALF_LOG_TWO_PI - part * series, at_zero)
    return at_zero - 0.5 * (freedom + 1.0) * jnp.log1p(z**2 / freedom)


def _shape_information(freedom: Array) -> Array:
    """Expected information of one reading about the degrees of freedom [1]."""
    many = freedom > _MANY_FREEDOM
    few = jnp.where(many, _MANY_FREEDOM, freedom)
    exact = 0.25 * (polygamma(1, 0.5 * few) - polygamma(1, 0.5 * (few + 1.0)))
    exact = exact - 0.5 * (few + 5.0) / (few * (few + 1.0) * (few + 3.0))
    nu = jnp.where(many, freedom, _MANY_FREEDOM)
    series = -0.5 / nu**5 + 1.5 / nu**7 - 8.5 / nu**9
    series = series + 0.5 * (7.0 * nu + 3.0) / (nu**3 * (nu + 1.0) * (nu + 3.0))
    return jnp.where(many, series, exact)


def _anchored(moving: Array, value: Any, slope: Any) -> Array:
    """Something of the given value that follows `moving` with the given slope."""
    return _fixed(slope) * (moving - _fixed(moving)) + _fixed(value)


def _fixed(value: Any) -> Any:
    return jax.lax.stop_gradient(value)


def _value(number_or_name: float | str, values: Values) -> Any:
    return values[number_or_name] if isinstance(number_or_name, str) else number_or_name


def _require_number_or_name(what: str, value: Any, low: float, high: float) -> None:
    if isinstance(value, str):
        return
    if not (isinstance(value, numbers.Real) and low < float(value) < high):
        between = f"above {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
        raise InputError(
            f"{what} is {value!r}, but must be a number {between} or the name of a parameter."
        )
