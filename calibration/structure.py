"""What of a problem is compiled in, and the traceable functions that follow from it."""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from calibration.noise import HALF_LOG_TWO_PI, Noise
from calibration.parameters import NamedParameters, ParameterLayout
from procmodel.errors import InputError

Model = Callable[[dict[str, Array], Any], Array]


@dataclass(frozen=True)
class ProblemStructure:
    """What of a problem is compiled in: everything but numbers. Hashable."""

    layout: ParameterLayout
    functions: tuple[Model, ...]
    own: tuple[tuple[tuple[str, str], ...], ...]
    noises: tuple[Noise, ...]
    # For each data set: the name of the parameter, True for numbers, False to be estimated.
    sigmas: tuple[str | bool, ...]

    @property
    def noise_known(self) -> tuple[bool, ...]:
        """Whether a data set's noise is given or a parameter, not estimated from residuals."""
        return tuple(bool(sigma) for sigma in self.sigmas)

    @property
    def least_squares(self) -> bool:
        """Whether half the sum of squares of the residuals is what a fit makes small."""
        priors = all(prior.least_squares for _, prior in self.layout.priors)
        return priors and all(map(self._plain, range(len(self.noises))))

    @property
    def own_cost(self) -> Callable[[Array, tuple], Array] | None:
        """The cost where it is not half the sum of squares of the residuals."""
        return None if self.least_squares else self.cost

    def _plain(self, index: int) -> bool:
        """Whether a data set is a matter of least squares."""
        return self.noises[index].least_squares and not isinstance(self.sigmas[index], str)

    def predictions(self, vector: Array, fixed: Array, data: tuple) -> tuple[Array, ...]:
        """Model values of every data set at an internal vector; traceable.

        `data` is one ``(x, y, 1/sigma, x_sigma)`` for each data set.
        """
        return tuple(part.prediction for part in self._parts(vector, fixed, data))

    def _parts(self, vector: Array, fixed: Array, data: tuple) -> list["_Part"]:
        """What every data set's readings are held against."""
        values = NamedParameters(self.layout.natural(vector, fixed))
        parts = []
        for function, own, sigma, (x, y, inverse, _) in zip(
            self.functions, self.own, self.sigmas, data, strict=True
        ):
            renamed = _renamed(values, own)
            model = functools.partial(_evaluated, function, renamed)
            prediction = model(x)
            if prediction.shape != y.shape:
                raise InputError(
                    f"model {model_name(function)!r} returned shape {prediction.shape} for "
                    f"{y.shape[0]} readings: it must return one value for each."
                )
            if isinstance(sigma, str):
                inverse = jnp.broadcast_to(1.0 / renamed[sigma], y.shape)
            parts.append(_Part(prediction, inverse, renamed, model))
        return parts

    def deviations(self, vector: Array, fixed: Array, data: tuple) -> tuple[Array, ...]:
        """Model minus reading over the noise level, for every data set; traceable.

        Where x has errors too, it is the distance from the curve in units of both.
        """
        parts = self._parts(vector, fixed, data)
        return tuple(map(_deviation, parts, data))

    def prior_residuals(self, vector: Array, fixed: Array) -> Array:
        """Standardised distance of each parameter with a prior from it; traceable."""
        values = self.layout.natural(vector, fixed)
        parts = [prior.residual(values[name]) for name, prior in self.layout.priors]
        return jnp.stack(parts) if parts else jnp.zeros(0)

    def __call__(self, vector: Array, arguments: tuple) -> Array:
        """What least squares makes small; `arguments` is (fixed, data).

        First one row for each reading, then those of noise that is fitted along, then those of
        the priors. Times their derivative they are the gradient of the cost, whatever the noise.
        The structure itself is the residual function, so that two problems that differ in their
        numbers alone share what was compiled.
        """
        fixed, data = arguments
        rows, further = [], []
        for i, part in enumerate(self._parts(vector, fixed, data)):
            if self._plain(i):
                rows.append(_deviation(part, data[i]))
                continue
            first, *others = self.noises[i].rows(*part.readings(data[i]))
            rows.append(first)
            if isinstance(self.sigmas[i], str) or self.noises[i].moves_scale:
                further += others
        return jnp.concatenate([*rows, *further, self.prior_residuals(vector, fixed)])

    def data_cost(self, vector: Array, fixed: Array, data: tuple) -> tuple[Array, ...]:
        """Minus the log-likelihood of every data set, up to a constant; traceable."""
        return tuple(
            0.5 * jnp.sum(_deviation(part, data[i]) ** 2)
            if self._plain(i)
            else self.noises[i].cost(*part.readings(data[i]))
            for i, part in enumerate(self._parts(vector, fixed, data))
        )

    def log_likelihoods(self, vector: Array, fixed: Array, data: tuple) -> tuple[Array, ...]:
        """Log density of each reading, for every data set, shapes (n,); traceable.

        `data` holds the noise levels to be used where sigma is not given.
        """
        densities = []
        for i, part in enumerate(self._parts(vector, fixed, data)):
            if data[i][3] is None:
                densities.append(self.noises[i].log_likelihood(*part.readings(data[i])))
            else:
                scale = jnp.log(part.inverse) - HALF_LOG_TWO_PI
                densities.append(-0.5 * _deviation(part, data[i]) ** 2 + scale)
        return tuple(densities)

    def cost(self, vector: Array, arguments: tuple) -> Array:
        """Minus the log density that a fit maximises, up to a constant; traceable, a scalar."""
        fixed, data = arguments
        values = self.layout.natural(vector, fixed)
        total = sum(self.data_cost(vector, fixed, data), start=jnp.zeros(()))
        return total + sum(prior.cost(values[name]) for name, prior in self.layout.priors)

    def in_natural_coordinates(self) -> "ProblemStructure":
        """The same structure on vectors of natural values."""
        return dataclasses.replace(self, layout=self.layout.in_natural_coordinates())

    def log_density(self, vector: Array, arguments: tuple) -> Array:
        """Log posterior density per unit of the natural parameters, up to a constant.

        `vector` holds *natural* values of the free parameters; `arguments` is (fixed, data, lower,
        upper), the last two the bounds. A data set without sigma has its noise level integrated
        out under Jeffreys' prior 1/sigma.
        """
        fixed, data, lower, upper = arguments
        inside = jnp.all((vector >= lower) & (vector <= upper))
        structure = self.in_natural_coordinates()
        total = jnp.zeros(())
        costs = structure.data_cost(vector, fixed, data)
        for known, cost, (_, y, _, _) in zip(self.noise_known, costs, data, strict=True):
            total -= cost if known else 0.5 * y.size * jnp.log(cost)
        values = structure.layout.natural(vector, fixed)
        for name, prior in self.layout.priors:
            total += prior.log_density(values[name])
        return jnp.where(inside & jnp.isfinite(total), total, -jnp.inf)


def _evaluated(function: Model, values: NamedParameters, x: Any) -> Array:
    return jnp.asarray(function(values, x))


# Rounds in which the true x is found; each gains as a Gauss-Newton step does.
_X_ROUNDS = 6


def _distance(
    model: Callable[[Array], Array], x: Array, y: Array, sigma: Array, x_sigma: Array
) -> Array:
    """Signed distance of every reading from the curve, in units of both errors."""
    true = x
    for _ in range(_X_ROUNDS):
        height, slope = jax.jvp(model, (true,), (jnp.ones_like(x),))
        whole = sigma**2 + (slope * x_sigma) ** 2
        # Height above x of the tangent at the true x so far.
        above = height + slope * (x - true) - y
        true = x - slope * x_sigma**2 * above / whole
    height, slope = jax.jvp(model, (true,), (jnp.ones_like(x),))
    whole = sigma**2 + (slope * x_sigma) ** 2
    return (height + slope * (x - true) - y) / jnp.sqrt(whole)


class _Part(NamedTuple):
    """What the readings of a data set are held against."""

    prediction: Array
    inverse: Array  # of sigma
    values: NamedParameters
    model: Callable[[Array], Array]  # of x alone

    def readings(self, data: tuple) -> tuple[Array, Array, Array, NamedParameters]:
        """The arguments of a noise model."""
        return self.prediction, data[1], 1.0 / self.inverse, self.values


def _deviation(part: _Part, data: tuple) -> Array:
    x, y, _, x_sigma = data
    if x_sigma is None:
        return (part.prediction - y) * part.inverse
    return _distance(part.model, x, y, 1.0 / part.inverse, x_sigma)


def _renamed(values: NamedParameters, own: tuple[tuple[str, str], ...]) -> NamedParameters:
    return NamedParameters({**values, **{inner: values[outer] for inner, outer in own}})


def model_name(function: Any) -> str:
    """Name of a model function for reports."""
    return getattr(function, "__name__", None) or type(function).__name__
