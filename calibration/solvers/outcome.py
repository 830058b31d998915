"""What every solver hands back, and the residuals compiled for those outside JAX."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.solvers.box_lm import Residuals


@dataclass(frozen=True)
class Outcome:
    """Where a solver stopped.

    Attributes
    ----------
    vector : ndarray, shape (p,)
        Last parameters, internal coordinates.
    residuals : ndarray, shape (n,)
        Residuals there.
    jacobian : ndarray, shape (n, p)
        Their derivative.
    status : str
        Why it stopped, as a sentence.
    converged : bool
        Whether that is an optimum.
    steps : int
        Steps or evaluations made.
    """

    vector: np.ndarray
    residuals: np.ndarray
    jacobian: np.ndarray
    status: str
    converged: bool
    steps: int


@functools.partial(jax.jit, static_argnames="residuals")
def value_at(residuals: Residuals, vector: Array, arguments: Any) -> Array:
    """Residuals, compiled once for each function and shape."""
    return residuals(vector, arguments)


@functools.partial(jax.jit, static_argnames="residuals")
def jacobian_at(residuals: Residuals, vector: Array, arguments: Any) -> Array:
    """Jacobian of the residuals, compiled once for each function and shape."""
    return jax.jacfwd(residuals)(vector, arguments)


@functools.partial(jax.jit, static_argnames="residuals")
def cost_at(residuals: Residuals, vector: Array, arguments: Any) -> Array:
    """What is made small: the residuals' own cost, or half the sum of their squares."""
    return cost_of(residuals)(vector, arguments)


def cost_of(residuals: Residuals) -> Callable[[Array, Any], Array]:
    """The cost as a function of its own."""
    own = getattr(residuals, "own_cost", None)
    return own or (lambda vector, arguments: 0.5 * jnp.sum(residuals(vector, arguments) ** 2))


def finished(
    residuals: Residuals,
    vector: np.ndarray,
    arguments: Any,
    status: str,
    converged: bool,
    steps: int,
) -> Outcome:
    """Outcome at a vector that a foreign solver returned."""
    return Outcome(
        vector=np.asarray(vector, float),
        residuals=np.asarray(value_at(residuals, vector, arguments)),
        jacobian=np.asarray(jacobian_at(residuals, vector, arguments)),
        status=status,
        converged=converged,
        steps=steps,
    )


# A parameter is at a bound when the way there moves the residuals by less than this of their rms.
AT_BOUND = 1e-6


def held_at_bounds(
    vector: np.ndarray,
    residuals: np.ndarray,
    jacobian: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    count: int | None = None,
) -> np.ndarray:
    """Which parameters a bound holds back: the misfit would fall outside, shape (p,).

    Parameters
    ----------
    vector : ndarray, shape (p,)
        Where a solver stopped.
    residuals : ndarray, shape (n,)
        Residuals there.
    jacobian : ndarray, shape (n, p)
        Their derivative.
    lower, upper : ndarray, shape (p,)
        The bounds.
    count : int, optional
        Number of residuals that count, where others are padding.

    Returns
    -------
    ndarray of bool, shape (p,)
        True for the held ones.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # readings near the greatest number
        gradient = jacobian.T @ residuals
        rms = np.sqrt(np.sum(residuals**2) / (len(residuals) if count is None else count))
        effect = np.linalg.norm(jacobian, axis=0)
    # Solvers of other libraries stop just inside: near is what hardly moves the residuals.
    near = np.divide(AT_BOUND * rms, effect, out=np.zeros_like(effect), where=effect > 0)
    at_lower = (vector - lower <= near) & (gradient >= 0)
    return at_lower | ((upper - vector <= near) & (gradient <= 0))
