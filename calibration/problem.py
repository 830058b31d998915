"""A problem: a model, its parameters and the readings it has to explain."""

import dataclasses
import hashlib
import itertools
import math
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.parameters import NamedParameters, Parameter, ParameterLayout
from procmodel.errors import InputError, nearest

Model = Callable[[dict[str, Array], Any], Array]


@dataclass(frozen=True)
class Dataset:
    """Readings and where they were taken.

    Parameters
    ----------
    x : array_like or nested dict, tuple, list of array_like
        Handed to the model as it is.
    y : array_like, shape (n,)
        Readings.
    sigma : float or array_like, shape (n,), optional
        Standard deviation of each reading. Left out, one noise level for the data set is
        estimated from its residuals.
    function : callable, optional
        Model of this data set, when it differs from the problem's.
    own : mapping of str to str
        Parameters that this data set does not share: the model's name for it to the problem's,
        such as ``{"gap": "gap_second_cavity"}``.

    Raises
    ------
    InputError
        If readings or sigma are not finite, sigma is not above 0, or lengths differ.
    """

    x: Any
    y: Any
    sigma: Any = None
    function: Model | None = None
    own: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        y = np.asarray(self.y, float)
        if y.ndim != 1 or len(y) == 0:
            raise InputError(f"y must be a list of readings, not an array of shape {y.shape}.")
        _require_finite("y", y)
        x = self.x
        if isinstance(x, list | tuple) and all(isinstance(v, numbers.Real) for v in x):
            x = np.asarray(x, float)
        object.__setattr__(self, "x", jax.tree.map(np.asarray, x))
        for leaf in jax.tree.leaves(self.x):
            if np.issubdtype(leaf.dtype, np.floating):
                _require_finite("x", leaf)
        object.__setattr__(self, "y", y)
        if self.sigma is not None:
            sigma = np.asarray(self.sigma, float)
            if sigma.shape not in ((), y.shape):
                raise InputError(
                    f"sigma has {sigma.size} values for {y.size} readings: give one, or one each."
                )
            sigma = np.array(np.broadcast_to(sigma, y.shape))
            _require_finite("sigma", sigma)
            if not np.all(sigma > 0):
                raise InputError(
                    f"sigma of reading {int(np.argmin(sigma > 0)) + 1} is not above 0: "
                    "correct it, or leave sigma out to have the noise estimated."
                )
            object.__setattr__(self, "sigma", sigma)


@dataclass(frozen=True)
class ProblemStructure:
    """What of a problem is compiled in: everything but numbers. Hashable."""

    layout: ParameterLayout
    functions: tuple[Model, ...]
    own: tuple[tuple[tuple[str, str], ...], ...]
    noise_known: tuple[bool, ...]

    def predictions(self, vector: Array, fixed: Array, xs: tuple) -> tuple[Array, ...]:
        """Model values of every data set at an internal vector; traceable."""
        values = NamedParameters(self.layout.natural(vector, fixed))
        return tuple(
            jnp.asarray(function(_renamed(values, own), x))
            for function, own, x in zip(self.functions, self.own, xs, strict=True)
        )

    def deviations(self, vector: Array, fixed: Array, data: tuple) -> tuple[Array, ...]:
        """Model minus reading over the noise level, for every data set; traceable.

        `data` is one ``(x, y, 1/sigma)`` for each data set.
        """
        predictions = self.predictions(vector, fixed, tuple(x for x, _, _ in data))
        for prediction, (_, y, _), function in zip(predictions, data, self.functions, strict=True):
            if prediction.shape != y.shape:
                raise InputError(
                    f"model {model_name(function)!r} returned shape {prediction.shape} for "
                    f"{y.shape[0]} readings: it must return one value for each."
                )
        return tuple(
            (prediction - y) * inverse
            for prediction, (_, y, inverse) in zip(predictions, data, strict=True)
        )

    def prior_residuals(self, vector: Array, fixed: Array) -> Array:
        """Standardised distance of each parameter with a prior from it; traceable."""
        values = self.layout.natural(vector, fixed)
        parts = [prior.residual(values[name]) for name, prior in self.layout.priors]
        return jnp.stack(parts) if parts else jnp.zeros(0)

    def __call__(self, vector: Array, arguments: tuple) -> Array:
        """Everything least squares makes small; `arguments` is (fixed, data).

        The structure itself is the residual function, so that two problems that differ in
        their numbers alone share what was compiled.
        """
        fixed, data = arguments
        parts = [*self.deviations(vector, fixed, data), self.prior_residuals(vector, fixed)]
        return jnp.concatenate(parts)

    def cost(self, vector: Array, arguments: tuple) -> Array:
        """Minus the log density that a fit maximises, up to a constant; traceable, a scalar."""
        return 0.5 * jnp.sum(self(vector, arguments) ** 2)

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
        for known, deviation in zip(
            self.noise_known, structure.deviations(vector, fixed, data), strict=True
        ):
            square = jnp.sum(deviation**2)
            total += -0.5 * square if known else -0.5 * deviation.size * jnp.log(square)
        values = structure.layout.natural(vector, fixed)
        for name, prior in self.layout.priors:
            total += prior.log_density(values[name])
        return jnp.where(inside & jnp.isfinite(total), total, -jnp.inf)


def _renamed(values: NamedParameters, own: tuple[tuple[str, str], ...]) -> NamedParameters:
    return NamedParameters({**values, **{inner: values[outer] for inner, outer in own}})


class Problem:
    """Model, parameters and one or several data sets.

    Parameters
    ----------
    parameters : mapping of str to Parameter or float
        The parameters by name; a plain number is a fixed one.
    datasets : mapping of str to Dataset
        The data sets by name.
    function : callable, optional
        ``function(params, x)`` with ``params`` a dictionary of scalars: the model of every data
        set without one of its own. Written with jax.numpy, it returns shape (n,).
    name : str, optional
        Name of the model in reports; that of the function when left out.

    Raises
    ------
    InputError
        If something in parameters or data sets cannot be used.
    """

    def __init__(
        self,
        parameters: Mapping[str, Parameter | float],
        datasets: Mapping[str, Dataset],
        function: Model | None = None,
        name: str | None = None,
    ):
        if not datasets:
            raise InputError("datasets is empty: give at least one.")
        self.parameters = {n: _as_parameter(n, p) for n, p in parameters.items()}
        self.datasets = dict(datasets)
        functions = []
        for dataset_name, dataset in self.datasets.items():
            chosen = dataset.function or function
            if chosen is None:
                raise InputError(f"dataset {dataset_name!r} has no model: give function.")
            functions.append(chosen)
            for outer in dataset.own.values():
                if outer not in self.parameters:
                    raise InputError(
                        f"dataset {dataset_name!r} uses unknown parameter {outer!r}"
                        f"{nearest(outer, list(self.parameters))}."
                    )
        self.name = name or model_name(functions[0])
        self.layout = ParameterLayout.of(self.parameters)
        self.structure = ProblemStructure(
            layout=self.layout,
            functions=tuple(functions),
            own=tuple(tuple(d.own.items()) for d in self.datasets.values()),
            noise_known=tuple(d.sigma is not None for d in self.datasets.values()),
        )

    @classmethod
    def from_function(
        cls,
        function: Model,
        parameters: Mapping[str, Parameter | float],
        x: Any,
        y: Any,
        sigma: Any = None,
        name: str | None = None,
    ) -> "Problem":
        """Problem with a single data set.

        Parameters
        ----------
        function : callable
            ``function(params, x)``, written with jax.numpy, returning shape (n,).
        parameters : mapping of str to Parameter or float
            The parameters by name; a plain number is a fixed one.
        x : array_like or nested dict, tuple, list of array_like
            Handed to the model as it is.
        y : array_like, shape (n,)
            Readings.
        sigma : float or array_like, shape (n,), optional
            Standard deviation of the readings; estimated from the residuals when left out.
        name : str, optional
            Name of the model in reports.

        Returns
        -------
        Problem
            The problem.
        """
        return cls(parameters, {"data": Dataset(x, y, sigma)}, function, name)

    @property
    def size(self) -> int:
        """Number of readings in all data sets."""
        return sum(len(d.y) for d in self.datasets.values())

    @property
    def informing_priors(self) -> int:
        """Number of priors that count like a reading each."""
        return sum(prior.informs for _, prior in self.layout.priors)

    @property
    def noise_known(self) -> bool:
        """Whether every data set came with its sigma."""
        return all(self.structure.noise_known)

    @property
    def slices(self) -> list[slice]:
        """Where each data set's residuals stand in the vector of all."""
        edges = np.cumsum([0, *(len(d.y) for d in self.datasets.values())])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]

    @property
    def fixed_values(self) -> np.ndarray:
        """Values of the fixed parameters, shape (q,)."""
        return np.array([self.parameters[n].value for n in self.layout.fixed])

    @property
    def start(self) -> np.ndarray:
        """Start of the fit in internal coordinates, shape (p,)."""
        return self.layout.internal(np.array([self.parameters[n].value for n in self.layout.free]))

    def data(self, noise: tuple[float, ...] | None = None) -> tuple:
        """The arrays a solver works on: one ``(x, y, 1/sigma)`` for each data set.

        Parameters
        ----------
        noise : tuple of float, optional
            Noise level of each data set, used where it has no sigma; 1 when left out.

        Returns
        -------
        tuple
            The data part of the arguments of `ProblemStructure`.
        """
        levels = noise or (1.0,) * len(self.datasets)
        return tuple(
            (d.x, d.y, np.full(d.y.shape, 1.0 / level) if d.sigma is None else 1.0 / d.sigma)
            for d, level in zip(self.datasets.values(), levels, strict=True)
        )

    @property
    def data_hash(self) -> str:
        """First 12 digits of the SHA-256 of all data sets; tells which data a result is from."""
        digest = hashlib.sha256()
        for name, dataset in self.datasets.items():
            digest.update(name.encode())
            leaves = [*jax.tree.leaves(dataset.x), dataset.y]
            leaves += [] if dataset.sigma is None else [dataset.sigma]
            for leaf in leaves:
                digest.update(np.ascontiguousarray(leaf).tobytes())
        return digest.hexdigest()[:12]


def model_name(function: Any) -> str:
    """Name of a model function for reports."""
    return getattr(function, "__name__", None) or type(function).__name__


def _as_parameter(name: str, value: Parameter | float) -> Parameter:
    if isinstance(value, Parameter):
        return value
    if isinstance(value, int | float | np.floating | np.integer) and math.isfinite(value):
        return Parameter(float(value), fixed=True)
    raise InputError(f"parameter {name!r} is {value!r}: give a calibration.Parameter or a number.")


def _require_finite(name: str, values: np.ndarray) -> None:
    finite = np.isfinite(values)
    if not np.all(finite):
        count = int(np.size(values) - np.count_nonzero(finite))
        raise InputError(
            f"{name} has {count} values that are NaN or infinite, the first at reading "
            f"{int(np.argmin(np.ravel(finite))) + 1}: remove them."
        )
