"""Models outside JAX: NumPy code, a simulator, a look-up, with derivatives by differences."""

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from calibration.parameters import NamedParameters
from calibration.structure import model_name
from procmodel.errors import InputError

# A parameter below this may be on its way through zero: then its own size says nothing of a step.
_NEAR_ZERO = 1e-3
# Differences smaller than this share of the values are spoilt by rounding.
_ROUNDING = 1e5 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class BlackBox:
    """A model of plain NumPy, made usable for fits and samplers.

    Derivatives are central differences: two evaluations for each free parameter (two more for one
    that is nearly zero), good to about eight digits for a smooth model.

    Parameters
    ----------
    function : callable
        ``function(params, x)`` with ``params`` a dictionary of floats and ``x`` NumPy arrays. It
        returns as many values as the longest array of x.
    step : float
        Step of the differences, relative to the parameter.

    Raises
    ------
    InputError
        If the function cannot be called, or step is not above 0.
    """

    function: Callable[[dict[str, float], Any], Any]
    step: float = 1e-5

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise InputError(f"black box {self.function!r} cannot be called: give a function.")
        if not 0.0 < self.step < 1.0:
            raise InputError(f"step of a black box is {self.step}, but must be between 0 and 1.")

    @property
    def __name__(self) -> str:
        return getattr(self.function, "__name__", type(self.function).__name__)

    def __call__(self, params: dict[str, Array], x: Any) -> Array:
        """The model's values, shape (n,), traceable."""
        if not any(np.ndim(leaf) for leaf in jax.tree.leaves(x)):
            raise InputError(
                f"black box {self.__name__!r} needs an array in x, with a value for each reading."
            )
        return _values(self, {n: jnp.asarray(v, float) for n, v in params.items()}, x)


# Why the last evaluation of a model failed. JAX passes on no more than the beginning of a
# traceback, and equal black boxes share what was compiled, so that it cannot be kept in them.
_failures: dict[BlackBox, str] = {}


@contextmanager
def failures_explained(functions: Sequence[Any]) -> Iterator[None]:
    """A block in which what stopped one of these models is raised as its `InputError`.

    Told are models that want plain numbers, and black boxes that failed: JAX itself tells of a
    failure inside a callback in several lines, cut short.
    """
    try:
        yield
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError):
        names = ", ".join(sorted({model_name(function) for function in functions}))
        raise InputError(
            f"model {names} needs its parameters as plain numbers, as NumPy, math and 'if' do: "
            "write it with jax.numpy (and jnp.where), or wrap it: BlackBox(function)."
        ) from None
    except jax.errors.JaxRuntimeError as error:
        boxes = [f for f in functions if isinstance(f, BlackBox) and f in _failures]
        if not boxes:
            raise
        raise InputError(_failures.pop(boxes[0])) from error


def _evaluate(box: BlackBox, params: dict[str, np.ndarray], x: Any) -> np.ndarray:
    """The model's values, outside JAX."""
    values = NamedParameters({name: float(value) for name, value in params.items()})
    x = jax.tree.map(np.asarray, x)
    wanted = _shape(x)
    try:
        result = np.asarray(box.function(values, x), float)
        if result.shape != wanted:
            raise InputError(
                f"black box {box.__name__!r} returned shape {result.shape} for {wanted[0]} "
                "readings: it must return one value for each."
            )
    except InputError as error:
        _failures[box] = str(error)
        raise
    except Exception as error:
        at = ", ".join(f"{name} = {value:g}" for name, value in values.items())
        _failures[box] = (
            f"black box {box.__name__!r} stopped at {at} with {type(error).__name__}: "
            f"{' '.join(str(error).split())}; correct it, or keep the parameters away by bounds."
        )
        raise
    return result


def _shape(x: Any) -> tuple[int]:
    """Shape of the readings: as long as the longest array of x."""
    return (max(np.shape(leaf)[0] for leaf in jax.tree.leaves(x) if np.ndim(leaf)),)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _values(box: BlackBox, params: dict[str, Array], x: Any) -> Array:
    shape = jax.ShapeDtypeStruct(_shape(x), jnp.result_type(float))
    evaluate = functools.partial(_evaluate, box)
    return jax.pure_callback(evaluate, shape, params, x, vmap_method="sequential")


@functools.partial(_values.defjvp, symbolic_zeros=True)
def _directional(box: BlackBox, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (params, x), (directions, along_x) = primals, tangents
    if not all(isinstance(leaf, SymbolicZero) for leaf in jax.tree.leaves(along_x)):
        raise InputError(
            f"black box {box.__name__!r} has no derivative over x: leave x_sigma out, or write it "
            "with jax.numpy."
        )
    # All tangents share the evaluations; parameters that do not move are left alone.
    moving = [n for n, along in directions.items() if not isinstance(along, SymbolicZero)]
    columns = _slopes(box, params, x, moving)
    return _values(box, params, x), jnp.stack([directions[name] for name in moving]) @ columns


def _slopes(box: BlackBox, params: dict[str, Array], x: Any, names: list[str]) -> Array:
    """Derivatives of the values by some of the parameters, shape (q, n)."""
    point = jnp.stack([params[name] for name in names])

    def at(vector: Array) -> Array:
        return _values(box, params | dict(zip(names, vector, strict=True)), x)

    def differences(i: Array, width: Array) -> tuple[Array, Array]:
        above, below = at(point.at[i].add(width)), at(point.at[i].add(-width))
        seen = jnp.max(jnp.abs(above - below)) > _ROUNDING * jnp.max(jnp.abs(above))
        return (above - below) / (2.0 * jnp.where(width > 0, width, 1.0)), seen

    def slope(i: Array) -> Array:
        size = jnp.abs(point[i])
        own, seen = differences(i, box.step * size)
        return jax.lax.cond(
            seen | (size >= _NEAR_ZERO),
            lambda: own,
            lambda: differences(i, jnp.asarray(box.step * _NEAR_ZERO))[0],
        )

    return jax.lax.map(slope, jnp.arange(len(names)))
