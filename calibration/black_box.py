"""Models outside JAX: NumPy code, a simulator, a look-up, with derivatives by differences."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


@dataclass(frozen=True)
class BlackBox:
    """A model of plain NumPy, made usable for fits and samplers.

    Derivatives are central differences: 2 p evaluations for p parameters, good to about eight
    digits for a smooth model.

    Parameters
    ----------
    function : callable
        ``function(params, x)`` with ``params`` a dictionary of floats and ``x`` NumPy arrays.
    step : float
        Step of the differences, relative to the parameter.
    """

    function: Callable[[dict[str, float], Any], Any]
    step: float = 1e-5

    @property
    def __name__(self) -> str:
        return getattr(self.function, "__name__", type(self.function).__name__)

    def __call__(self, params: dict[str, Array], x: Any) -> Array:
        """The model's values, shape (n,), traceable."""
        names = tuple(params)
        vector = jnp.stack([jnp.asarray(params[name], float) for name in names])

        def evaluate(vector: np.ndarray, x: Any) -> np.ndarray:
            values = {n: float(v) for n, v in zip(names, np.asarray(vector), strict=True)}
            return np.asarray(self.function(values, jax.tree.map(np.asarray, x)), float)

        leaf = jax.tree.leaves(x)[0]
        shape = jax.ShapeDtypeStruct(np.shape(leaf)[:1], jnp.result_type(float))

        def called(vector: Array) -> Array:
            return jax.pure_callback(evaluate, shape, vector, x, vmap_method="sequential")

        @jax.custom_jvp
        def model(vector: Array) -> Array:
            return called(vector)

        @model.defjvp
        def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
            (point,), (direction,) = primals, tangents
            # One column for each parameter, so that all tangents share the same evaluations.
            widths = self.step * jnp.maximum(jnp.abs(point), 1e-3)
            columns = [
                (called(point.at[i].add(w)) - called(point.at[i].add(-w))) / (2.0 * w)
                for i, w in enumerate(widths)
            ]
            return called(point), jnp.stack(columns, axis=1) @ direction

        return model(vector)
