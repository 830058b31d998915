"""Parameters of a model: value, unit, bounds, prior, transform, fixed or tied.

A solver sees a plain vector of *internal* coordinates of the free parameters; the model
sees a dictionary of natural values. `ParameterLayout` is the bridge, hashable so that a
compiled solver can be reused for every data set of the same problem.
"""

import dataclasses
import math
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.priors import Prior
from procmodel.errors import InputError, nearest

TRANSFORMS = ("identity", "log", "logit")


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Parameters
    ----------
    value : float
        Start of the fit, or the value when fixed, in `unit`.
    unit : str
        Unit, for reports.
    bounds : (float, float)
        Lowest and highest allowed value; infinite when open.
    prior : Prior, optional
        What is known beforehand; see `calibration.priors`.
    transform : {"identity", "log", "logit"}
        Coordinate in which the solver works and the interval is symmetric. "log" needs a lower
        bound of 0 or more, "logit" two finite bounds; an optimum *on* such a bound lies at
        infinity, so leave the identity where a bound may be active.
    fixed : bool
        Keep the value.
    tied : str or callable, optional
        Name of the parameter that this one equals, or a function of the dictionary of all
        parameters that are not tied.

    Raises
    ------
    InputError
        If value, bounds and transform contradict each other.
    """

    value: float
    unit: str = ""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    prior: Prior | None = None
    transform: str = "identity"
    fixed: bool = False
    tied: str | Callable[[dict[str, Array]], Array] | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.value, numbers.Real) and math.isfinite(self.value)):
            raise InputError(f"parameter value {self.value!r} is not a finite number.")
        if self.prior is not None and not isinstance(self.prior, Prior):
            raise InputError(
                f"prior {self.prior!r} is not one of calibration's, such as Normal(mean, std)."
            )
        try:
            lower, upper = (float(b) for b in self.bounds)
        except (TypeError, ValueError):
            raise InputError(f"bounds {self.bounds!r} must be two numbers, (low, high).") from None
        object.__setattr__(self, "value", float(self.value))
        object.__setattr__(self, "bounds", (lower, upper))
        if not lower < upper:
            raise InputError(f"bounds ({lower:g}, {upper:g}) must be (low, high) with low < high.")
        if self.tied is None and not lower <= self.value <= upper:
            raise InputError(
                f"value {self.value:g} is outside its bounds ({lower:g}, {upper:g}): "
                "move the start or widen the bounds."
            )
        if self.tied is not None and (
            self.fixed or self.transform != "identity" or (lower, upper) != (-math.inf, math.inf)
        ):
            raise InputError(
                "a tied parameter follows others: give it no bounds or transform, do not fix it."
            )
        if self.transform not in TRANSFORMS:
            raise InputError(
                f"transform {self.transform!r} is unknown{nearest(self.transform, TRANSFORMS)}."
            )
        if self.transform == "log" and not (lower >= 0 and self.value > 0):
            raise InputError(
                "transform 'log' needs a lower bound of 0 or more and a value above 0."
            )
        if self.transform == "logit" and not (
            math.isfinite(lower) and math.isfinite(upper) and lower < self.value < upper
        ):
            raise InputError("transform 'logit' needs finite bounds and a value between them.")


def as_parameter(name: str, value: Parameter | float) -> Parameter:
    """A parameter as it is, or a fixed one of a plain number; anything else is explained."""
    if isinstance(value, Parameter):
        return value
    if isinstance(value, numbers.Real) and math.isfinite(value):
        return Parameter(float(value), fixed=True)
    raise InputError(f"parameter {name!r} is {value!r}: give a calibration.Parameter or a number.")


class NamedParameters(dict):
    """Parameters as models and ties see them; a name that is not there is explained."""

    def __missing__(self, key: str) -> Array:
        raise InputError(
            f"parameter {key!r} is asked for, which is not there{nearest(str(key), list(self))}."
        )


@dataclass(frozen=True)
class ParameterLayout:
    """Which parameters are free, fixed and tied, and in which coordinates they are solved for.

    Attributes
    ----------
    names : tuple of str
        All parameters, in the order given.
    free : tuple of str
        Those solved for, in the order of the vector.
    transforms : tuple of str
        Of the free ones.
    ranges : tuple of (float, float) or None
        Bounds of those with a logit transform, which are part of the transform.
    priors : tuple of (str, Prior)
        Priors of free and tied parameters.
    fixed : tuple of str
        Those that keep their value.
    tied : tuple of (str, str or callable)
        Those that follow others.
    bounds : tuple of (float, float)
        Of the free ones, cut to where their priors are not zero.
    """

    names: tuple[str, ...]
    free: tuple[str, ...]
    transforms: tuple[str, ...]
    ranges: tuple[tuple[float, float] | None, ...]
    priors: tuple[tuple[str, Prior], ...]
    fixed: tuple[str, ...]
    tied: tuple[tuple[str, str | Callable], ...] = ()
    # Not compared: bounds that follow from the data must not make a solver compile again.
    bounds: tuple[tuple[float, float], ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, parameters: Mapping[str, Parameter]) -> "ParameterLayout":
        """Read the layout off a dictionary of parameters.

        Parameters
        ----------
        parameters : mapping of str to Parameter
            The parameters.

        Returns
        -------
        ParameterLayout
            The layout.

        Raises
        ------
        InputError
            If a parameter is tied to an unknown or another tied one, or none is free.
        """
        names = tuple(parameters)
        tied = tuple((n, p.tied) for n, p in parameters.items() if p.tied is not None)
        free = tuple(n for n, p in parameters.items() if p.tied is None and not p.fixed)
        for name, target in tied:
            if isinstance(target, str) and target not in names:
                raise InputError(
                    f"parameter {name!r} is tied to unknown {target!r}{nearest(target, names)}."
                )
            if isinstance(target, str) and parameters[target].tied is not None:
                raise InputError(
                    f"parameter {name!r} is tied to {target!r}, which is tied itself: "
                    "tie both to the same free parameter."
                )
        if not free:
            raise InputError("no parameter is free: leave at least one neither fixed nor tied.")
        priors = []
        for name, parameter in parameters.items():
            if parameter.prior is not None and parameter.fixed:
                raise InputError(f"parameter {name!r} is fixed and has a prior: drop one of them.")
            if parameter.prior is not None:
                priors.append((name, parameter.prior))
        return cls(
            names=names,
            free=free,
            transforms=tuple(parameters[n].transform for n in free),
            ranges=tuple(
                parameters[n].bounds if parameters[n].transform == "logit" else None for n in free
            ),
            priors=tuple(priors),
            fixed=tuple(n for n, p in parameters.items() if p.tied is None and p.fixed),
            tied=tied,
            bounds=tuple(_supported_bounds(n, parameters[n]) for n in free),
        )

    def natural(self, vector: Array | np.ndarray, fixed: Array | np.ndarray) -> dict[str, Array]:
        """All parameters by name from the solver's vector; traceable.

        Parameters
        ----------
        vector : Array, shape (p,)
            Internal coordinates of the free parameters.
        fixed : Array, shape (q,)
            Values of the fixed ones.

        Returns
        -------
        dict of str to Array
            Natural values, in the order of `names`.
        """
        values = {
            name: _to_natural(vector[i], self.transforms[i], self.ranges[i])
            for i, name in enumerate(self.free)
        }
        values |= {name: fixed[i] for i, name in enumerate(self.fixed)}
        untied = NamedParameters(values)
        for name, target in self.tied:
            values[name] = untied[target] if isinstance(target, str) else target(untied)
        return {name: values[name] for name in self.names}

    def in_natural_coordinates(self) -> "ParameterLayout":
        """The same layout with natural values as internal coordinates."""
        count = len(self.free)
        return dataclasses.replace(self, transforms=("identity",) * count, ranges=(None,) * count)

    def internal(self, values: np.ndarray) -> np.ndarray:
        """Internal coordinates of natural values of the free ones, shape (p,) or (p, n)."""
        pairs = zip(values, self.transforms, self.ranges, strict=True)
        return np.array([_to_internal(v, t, b) for v, t, b in pairs])

    def free_values(self, vector: np.ndarray) -> np.ndarray:
        """Natural values of the free parameters from internal ones, shape (p,) or (p, n)."""
        pairs = zip(vector, self.transforms, self.ranges, strict=True)
        return np.array([_to_natural(v, t, b, np) for v, t, b in pairs], float)

    def around(self, vector: np.ndarray, name: str, offsets: np.ndarray) -> np.ndarray:
        """Values of one free parameter away from a vector, in the solver's coordinate.

        Parameters
        ----------
        vector : ndarray, shape (p,)
            Internal coordinates.
        name : str
            The free parameter.
        offsets : ndarray, shape (m,)
            Distances in natural units, taken along the tangent of the transform.

        Returns
        -------
        ndarray, shape (m,)
            Natural values.
        """
        index = self.free.index(name)
        internal = vector[index] + offsets / self.slopes(vector)[index]
        return _to_natural(internal, self.transforms[index], self.ranges[index], np)

    def slopes(self, vector: np.ndarray) -> np.ndarray:
        """Derivative of natural by internal coordinate, shape (p,) or (p, n)."""
        slopes = np.ones(np.shape(vector))
        for i, (transform, between) in enumerate(zip(self.transforms, self.ranges, strict=True)):
            if transform == "log":
                slopes[i] = _to_natural(vector[i], transform, between, np)
            elif between is not None:
                share = 0.5 + 0.5 * np.tanh(0.5 * vector[i])
                slopes[i] = (between[1] - between[0]) * share * (1.0 - share)
        return slopes

    def natural_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the free parameters' natural values: lower and upper, each of shape (p,)."""
        lower, upper = np.array(self.bounds, float).T
        return lower, upper

    def internal_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the solver's vector: lower and upper, each of shape (p,)."""
        lower, upper = [], []
        for transform, between, (low, high) in zip(
            self.transforms, self.ranges, self.bounds, strict=True
        ):
            open_low, open_high = (0.0, math.inf) if between is None else between
            if transform == "identity":
                open_low, open_high = -math.inf, math.inf
            # The ends of a transform's own range lie at infinity.
            lower.append(_to_internal(low, transform, between) if low > open_low else -math.inf)
            upper.append(_to_internal(high, transform, between) if high < open_high else math.inf)
        return np.array(lower), np.array(upper)


def _supported_bounds(name: str, parameter: Parameter) -> tuple[float, float]:
    """Bounds of the parameter, cut to where its prior is not zero."""
    if parameter.prior is None:
        return parameter.bounds
    low, high = parameter.prior.support
    lower, upper = max(low, parameter.bounds[0]), min(high, parameter.bounds[1])
    if not lower < upper:
        raise InputError(
            f"parameter {name!r}: its prior {parameter.prior} is zero between its bounds "
            f"({parameter.bounds[0]:g}, {parameter.bounds[1]:g}): change one of them."
        )
    if not lower <= parameter.value <= upper:
        raise InputError(
            f"parameter {name!r} starts at {parameter.value:g}, where its prior "
            f"{parameter.prior} is zero: start between {lower:g} and {upper:g}."
        )
    return lower, upper


def _to_natural(
    value: Any, transform: str, between: tuple[float, float] | None, xp: Any = jnp
) -> Any:
    if transform == "log":
        with np.errstate(over="ignore"):
            return xp.exp(value)
    if between is not None:
        with np.errstate(over="ignore"):
            return between[0] + (between[1] - between[0]) / (1.0 + xp.exp(-value))
    return value


def _to_internal(value: Any, transform: str, between: tuple[float, float] | None) -> Any:
    if transform == "log":
        return np.log(value)
    if between is not None:
        return np.log((value - between[0]) / (between[1] - value))
    return value
