"""Bounded parameters on the whole line, for samplers that follow gradients."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


@dataclass(frozen=True)
class Unbounded:
    """Coordinates without bounds: a logit between two bounds, a logarithm beside one.

    Attributes
    ----------
    kinds : tuple of {"line", "above", "below", "between"}
        Which bounds each parameter has. Static; the bounds themselves are arguments.
    """

    kinds: tuple[str, ...]

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray) -> "Unbounded":
        """The coordinates that bounds of shape (p,) call for."""
        names = {
            (False, False): "line",
            (True, False): "above",
            (False, True): "below",
            (True, True): "between",
        }
        pairs = zip(np.isfinite(lower), np.isfinite(upper), strict=True)
        return cls(tuple(names[bool(low), bool(high)] for low, high in pairs))

    def natural(self, free: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Natural values (p,) of unbounded ones, and the log of the volume ratio; traceable."""
        values, volume = [], jnp.zeros(())
        for i, kind in enumerate(self.kinds):
            u = free[i]
            if kind == "line":
                values.append(u)
            elif kind == "above":
                values.append(lower[i] + jnp.exp(u))
                volume += u
            elif kind == "below":
                values.append(upper[i] - jnp.exp(u))
                volume += u
            else:
                width = upper[i] - lower[i]
                values.append(lower[i] + width * jax.nn.sigmoid(u))
                volume += jnp.log(width) + jax.nn.log_sigmoid(u) + jax.nn.log_sigmoid(-u)
        return jnp.stack(values), volume

    def free(self, values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Unbounded values of natural ones strictly inside, shape (..., p)."""
        columns = []
        for i, kind in enumerate(self.kinds):
            v = values[..., i]
            if kind == "line":
                columns.append(v)
            elif kind == "above":
                columns.append(np.log(v - lower[i]))
            elif kind == "below":
                columns.append(np.log(upper[i] - v))
            else:
                columns.append(np.log(v - lower[i]) - np.log(upper[i] - v))
        return np.stack(columns, axis=-1)
