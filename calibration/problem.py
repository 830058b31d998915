"""A problem: a model, its parameters and the readings it has to explain."""

import hashlib
import itertools
import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from calibration.noise import NORMAL, Noise
from calibration.parameters import Parameter, ParameterLayout, as_parameter
from calibration.structure import Model, ProblemStructure, model_name
from procmodel.errors import InputError, nearest


@dataclass(frozen=True)
class Dataset:
    """Readings and where they were taken.

    Parameters
    ----------
    x : array_like or nested dict, tuple, list of array_like
        Handed to the model as it is.
    y : array_like, shape (n,)
        Readings.
    sigma : float, array_like of shape (n,), or str, optional
        Standard deviation of each reading, or the name of the parameter that is to be fitted as
        such. Left out, one noise level for the data set is estimated from its residuals.
    function : callable, optional
        Model of this data set, when it differs from the problem's.
    own : mapping of str to str
        Parameters that this data set does not share: the model's name for it to the problem's,
        such as ``{"gap": "gap_second_cavity"}``.
    noise : Noise
        How readings scatter around the model; see `calibration.noise`.
    x_sigma : float or array_like, shape (n,), optional
        Standard deviation of x, for x of shape (n,) and a model that takes each reading from its
        own x alone: the distance to the curve counts, not the height above it.

    Raises
    ------
    InputError
        If readings or sigma are not finite, sigma is not above 0, lengths differ, or the noise
        model cannot work with this kind of sigma.

    References
    ----------
    .. [1] P. T. Boggs, J. E. Rogers, "Orthogonal distance regression", 1990: errors in x.
    """

    x: Any
    y: Any
    sigma: Any = None
    function: Model | None = None
    own: Mapping[str, str] = field(default_factory=dict)
    noise: Noise = NORMAL
    x_sigma: Any = None

    def __post_init__(self) -> None:
        y = _numbers("y", self.y)
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
        if self.sigma_kind == "given":
            object.__setattr__(self, "sigma", _deviations_of("sigma", self.sigma, y.shape))
        if not isinstance(self.noise, Noise):
            raise InputError(f"noise {self.noise!r} is not one of calibration's, such as StudentT.")
        if self.sigma_kind not in self.noise.takes:
            raise InputError(
                f"noise {self.noise} cannot work with sigma {self.sigma_kind}: "
                f"{_SIGMA_REMEDY[self.noise.takes[-1]]}."
            )
        if self.x_sigma is not None:
            if self.noise != NORMAL or self.sigma_kind != "given":
                raise InputError("errors in x need normal noise with sigma given as a number.")
            if not (isinstance(self.x, np.ndarray) and self.x.shape == y.shape):
                raise InputError("errors in x need x to be one array with a value per reading.")
            object.__setattr__(self, "x", self.x.astype(float))
            spread = _deviations_of("x_sigma", self.x_sigma, y.shape)
            object.__setattr__(self, "x_sigma", spread)

    def simulated(
        self,
        rng: np.random.Generator,
        prediction: np.ndarray,
        values: Mapping[str, float],
        level: float | None = None,
    ) -> np.ndarray:
        """New readings around a prediction, shape (n,).

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of the noise.
        prediction : ndarray, shape (n,)
            What the model says.
        values : mapping of str to float
            All parameters of the problem.
        level : float, optional
            Noise level, for a data set without sigma.
        """
        at = {**values, **{inner: values[outer] for inner, outer in self.own.items()}}
        sigma: Any = at[self.sigma] if self.sigma_kind == "parameter" else self.sigma
        sigma = level if sigma is None else sigma
        spread = np.broadcast_to(sigma, self.y.shape)
        return self.noise.draw(rng, prediction, spread, at)

    @property
    def sigma_kind(self) -> str:
        """Where sigma comes from: "given", "parameter" or "estimated"."""
        if self.sigma is None:
            return "estimated"
        return "parameter" if isinstance(self.sigma, str) else "given"


_SIGMA_REMEDY = {
    "parameter": "give it as a number or as the name of a parameter",
    "estimated": "give it as a number or leave it out",
}


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
        self.parameters = {n: as_parameter(n, p) for n, p in parameters.items()}
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
            noises=tuple(d.noise for d in self.datasets.values()),
            sigmas=tuple(
                d.sigma if isinstance(d.sigma, str) else d.sigma is not None
                for d in self.datasets.values()
            ),
        )
        for dataset_name, dataset in self.datasets.items():
            self._check_noise(dataset_name, dataset)

    def _check_noise(self, dataset_name: str, dataset: Dataset) -> None:
        """Refuse noise parameters that are not there or may leave their range."""
        ranges = dict(dataset.noise.names)
        if isinstance(dataset.sigma, str):
            ranges[dataset.sigma] = (0.0, math.inf)
        for inner, (low, high) in ranges.items():
            name = dataset.own.get(inner, inner)
            if name not in self.parameters:
                raise InputError(
                    f"dataset {dataset_name!r}: its noise uses unknown parameter {name!r}"
                    f"{nearest(name, list(self.parameters))}."
                )
            parameter = self.parameters[name]
            lower = upper = parameter.value
            if name in self.layout.free:
                lower, upper = self.layout.bounds[self.layout.free.index(name)]
            if parameter.tied is None and not (
                low < parameter.value < high and low <= lower and upper <= high
            ):
                raise InputError(
                    f"noise parameter {name!r} must stay between {low:g} and {high:g}: start and "
                    "bound it there."
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
        noise: Noise = NORMAL,
        x_sigma: Any = None,
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
        sigma : float, array_like of shape (n,), or str, optional
            Standard deviation of the readings, or the name of the parameter to be fitted as such;
            estimated from the residuals when left out.
        name : str, optional
            Name of the model in reports.
        noise : Noise
            How readings scatter around the model; normally when left out.
        x_sigma : float or array_like, shape (n,), optional
            Standard deviation of x; see `Dataset`.

        Returns
        -------
        Problem
            The problem.
        """
        return cls(
            parameters, {"data": Dataset(x, y, sigma, noise=noise, x_sigma=x_sigma)}, function, name
        )

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
    def noise_scales_all(self) -> bool:
        """Whether a noise level scales all that is made small alike, so that it does not matter."""
        return (
            len(self.datasets) == 1 and not self.informing_priors and self.structure.least_squares
        )

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
        """The arrays a solver works on: one ``(x, y, 1/sigma, x_sigma)`` for each data set.

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
            (
                d.x,
                d.y,
                1.0 / d.sigma if d.sigma_kind == "given" else np.full(d.y.shape, 1.0 / level),
                d.x_sigma,
            )
            for d, level in zip(self.datasets.values(), levels, strict=True)
        )

    @property
    def data_hash(self) -> str:
        """First 12 digits of the SHA-256 of all data sets; tells which data a result is from."""
        return self._hash(with_errors=True)

    @property
    def readings_hash(self) -> str:
        """The same of x and y alone: models of the same readings may differ in their noise."""
        return self._hash(with_errors=False)

    def _hash(self, with_errors: bool) -> str:
        digest = hashlib.sha256()
        for name, dataset in self.datasets.items():
            digest.update(name.encode())
            leaves = [*jax.tree.leaves(dataset.x), dataset.y]
            if with_errors:
                leaves += [dataset.sigma] if dataset.sigma_kind == "given" else []
                leaves += [] if dataset.x_sigma is None else [dataset.x_sigma]
            for leaf in leaves:
                digest.update(np.ascontiguousarray(leaf).tobytes())
        return digest.hexdigest()[:12]


def _numbers(name: str, given: Any) -> np.ndarray:
    try:
        return np.asarray(given, float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers, not {str(given)[:60]!r}.") from None


def _deviations_of(name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Standard deviations, one for each reading."""
    sigma = _numbers(name, given)
    if sigma.shape not in ((), shape):
        raise InputError(
            f"{name} has shape {sigma.shape} for {shape[0]} readings: give one, or one each."
        )
    sigma = np.array(np.broadcast_to(sigma, shape))
    _require_finite(name, sigma)
    if not np.all(sigma > 0):
        raise InputError(
            f"{name} of reading {int(np.argmin(sigma > 0)) + 1} is not above 0: correct it, or "
            f"leave {name} out."
        )
    return sigma


def _require_finite(name: str, values: np.ndarray) -> None:
    finite = np.isfinite(values)
    if not np.all(finite):
        count = int(np.size(values) - np.count_nonzero(finite))
        raise InputError(
            f"{name} has {count} values that are NaN or infinite, the first at reading "
            f"{int(np.argmin(np.ravel(finite))) + 1}: remove them."
        )
