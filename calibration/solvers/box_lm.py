"""Bounded Levenberg-Marquardt for small dense least-squares problems.

Minimises half the sum of squares of the residuals inside a box. Parameters whose bound holds
them back are taken out of the step (projected active set); a step that would leave the box is
stopped at the bound and the other parameters solve again around it. Columns are scaled by
their greatest norm so far (Moré), steps come from a QR of the Jacobian, never from J'J, and
the damping follows Nielsen.

References
----------
.. [1] J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory", 1978.
.. [2] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

Residuals = Callable[[Array, Any], Array]

RUNNING, GRADIENT, REDUCTION, STEP, EXACT, STALLED, OUT_OF_STEPS, BAD_START = range(8)

STATUS = {
    GRADIENT: "converged: no direction inside the bounds makes the misfit smaller",
    REDUCTION: "converged: a further step would not reduce the misfit",
    STEP: "converged: a further step would not move the parameters",
    EXACT: "converged: the model passes through every reading",
    STALLED: "not converged: no step, however short, gives finite residuals and a smaller misfit; "
    "check the model near the last values",
    OUT_OF_STEPS: "not converged: out of steps; raise max_steps or start nearer",
    BAD_START: "not started: the model or its derivative is not finite at the start; "
    "move the start values",
}
CONVERGED = (GRADIENT, REDUCTION, STEP, EXACT)


@dataclass(frozen=True)
class BoxLMOptions:
    """Settings of the solver; the defaults aim at the last digits.

    Parameters
    ----------
    max_steps : int
        Most trial steps.
    tolerance : float
        Relative tolerance on the misfit, on the parameters, and on the cosine between residuals
        and any free column of the Jacobian.
    """

    max_steps: int = 500
    tolerance: float = 1e-12


class BoxLMOutcome(NamedTuple):
    """Where the solver stopped. All arrays, so that it can be mapped over.

    Attributes
    ----------
    vector : Array, shape (p,)
        Last parameters.
    residuals : Array, shape (n,)
        Residuals there.
    jacobian : Array, shape (n, p)
        Their derivative.
    status : Array of int
        Key into `STATUS`.
    steps : Array of int
        Trial steps made.
    """

    vector: Array
    residuals: Array
    jacobian: Array
    status: Array
    steps: Array


class _State(NamedTuple):
    vector: Array
    residuals: Array
    jacobian: Array
    triangle: Array  # R of the Jacobian's QR
    projected: Array  # Q' residuals
    scale: Array
    damping: Array
    growth: Array
    status: Array
    steps: Array


def solve(
    residuals: Residuals,
    start: Array,
    lower: Array,
    upper: Array,
    arguments: Any,
    options: BoxLMOptions = BoxLMOptions(),
) -> BoxLMOutcome:
    """Minimise half the sum of squares inside a box; traceable and mappable.

    Parameters
    ----------
    residuals : callable
        ``residuals(vector, arguments)`` of shape (n,), n >= 1.
    start : Array, shape (p,)
        Start, moved into the box if outside.
    lower, upper : Array, shape (p,)
        The box; infinite where open.
    arguments : pytree
        Handed to `residuals`.
    options : BoxLMOptions
        Settings.

    Returns
    -------
    BoxLMOutcome
        The last point, converged or not.
    """
    count = start.shape[0]

    @jax.jit  # traced once for its two uses below
    def linearise(vector: Array) -> tuple[Array, Array, Array, Array]:
        jacobian, value = jax.jacfwd(_twice(residuals), has_aux=True)(vector, arguments)
        padded = jnp.concatenate([jacobian, jnp.zeros((count, count))])
        q, triangle = jnp.linalg.qr(padded)
        return value, jacobian, triangle, q[: value.shape[0]].T @ value

    def advance(state: _State) -> _State:
        gradient = state.triangle.T @ state.projected
        held = ((state.vector <= lower) & (gradient > 0)) | (
            (state.vector >= upper) & (gradient < 0)
        )
        move = _bounded_step(state, lower, upper, held)
        trial = jnp.clip(state.vector + move, lower, upper)
        trial_residuals = residuals(trial, arguments)

        misfit = 0.5 * jnp.sum(state.residuals**2)
        reduction = misfit - 0.5 * jnp.sum(trial_residuals**2)
        after = state.projected + state.triangle @ move
        expected = 0.5 * (jnp.sum(state.projected**2) - jnp.sum(after**2))
        ratio = reduction / jnp.where(expected > 0, expected, 1.0)
        better = jnp.isfinite(reduction) & (reduction > 0) & (expected > 0)

        new = jax.lax.cond(
            better,
            lambda: linearise(trial),
            lambda: (state.residuals, state.jacobian, state.triangle, state.projected),
        )
        # A better point with a derivative that is not finite is no place to go on from.
        better = better & jnp.all(jnp.isfinite(new[1]))
        value, jacobian, triangle, projected = (
            jnp.where(better, a, b)
            for a, b in zip(
                new,
                (state.residuals, state.jacobian, state.triangle, state.projected),
                strict=True,
            )
        )
        vector = jnp.where(better, trial, state.vector)
        scale = jnp.maximum(state.scale, _column_norms(triangle))
        shrink = jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping = jnp.where(
            better, jnp.maximum(state.damping * shrink, 1e-16), state.damping * state.growth
        )
        growth = jnp.where(better, 2.0, 2.0 * state.growth)

        steps = state.steps + 1
        tolerance = options.tolerance
        small = tolerance * misfit
        no_reduction = (jnp.abs(reduction) <= small) & (expected <= small) & (ratio <= 2.0)
        length = jnp.linalg.norm(scale * move)
        no_move = length <= tolerance * jnp.linalg.norm(scale * vector)
        at_rest = _projected_cosine(vector, value, triangle, projected, lower, upper) <= tolerance
        status = jnp.select(
            [
                jnp.all(value == 0),
                at_rest,
                no_reduction,
                no_move & jnp.isfinite(reduction),
                ~jnp.isfinite(damping) | (damping > 1e32),
                steps >= options.max_steps,
            ],
            [EXACT, GRADIENT, REDUCTION, STEP, STALLED, OUT_OF_STEPS],
            RUNNING,
        )
        return _State(
            vector, value, jacobian, triangle, projected, scale, damping, growth, status, steps
        )

    vector = jnp.clip(start, lower, upper)
    value, jacobian, triangle, projected = linearise(vector)
    norms = _column_norms(triangle)
    sound = jnp.all(jnp.isfinite(value)) & jnp.all(jnp.isfinite(jacobian))
    at_rest = _projected_cosine(vector, value, triangle, projected, lower, upper)
    status = jnp.select(
        [~sound, jnp.all(value == 0), at_rest <= options.tolerance],
        [BAD_START, EXACT, GRADIENT],
        RUNNING,
    )
    state = _State(
        vector=vector,
        residuals=value,
        jacobian=jacobian,
        triangle=triangle,
        projected=projected,
        scale=jnp.where(norms > 0, norms, 1.0),
        damping=jnp.asarray(1e-3, vector.dtype),
        growth=jnp.asarray(2.0, vector.dtype),
        status=status,
        steps=jnp.asarray(0),
    )
    state = jax.lax.while_loop(lambda s: s.status == RUNNING, advance, state)
    return BoxLMOutcome(state.vector, state.residuals, state.jacobian, state.status, state.steps)


@functools.partial(jax.jit, static_argnames=("residuals", "options"))
def solve_compiled(
    residuals: Residuals,
    start: Array,
    lower: Array,
    upper: Array,
    arguments: Any,
    options: BoxLMOptions,
) -> BoxLMOutcome:
    """`solve`, compiled once for each residual function and shape of the arguments."""
    return solve(residuals, start, lower, upper, arguments, options)


def _bounded_step(state: _State, lower: Array, upper: Array, held: Array) -> Array:
    """Damped step of the parameters that are not held, stopped at the bounds."""
    count = state.vector.shape[0]
    room_down, room_up = lower - state.vector, upper - state.vector

    def damped(pinned: Array, move: Array) -> Array:
        """Solve for the parameters that are not pinned, those keeping their move."""
        free = ~pinned
        kept = jnp.where(pinned, move, 0.0)
        right = -(state.projected + state.triangle @ kept)
        columns = jnp.where(free, state.triangle, 0.0)
        # A pinned column keeps only its damping row, so its own solution is 0. Scaling the
        # damping row alone by 1 there keeps the system regular.
        damping = jnp.where(free, jnp.sqrt(state.damping) * state.scale, 1.0)
        stacked = jnp.concatenate([columns, jnp.diag(damping)])
        q, r = jnp.linalg.qr(stacked)
        solution = jax.scipy.linalg.solve_triangular(r, q[:count].T @ right)
        return jnp.where(free, solution, kept)

    def crossing(carry: tuple[Array, Array]) -> Array:
        pinned, move = carry
        return ~pinned & ((move < room_down) | (move > room_up))

    def stop_at_bounds(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        pinned, move = carry
        stopped = jnp.clip(move, room_down, room_up)
        pinned = pinned | crossing(carry)
        return pinned, damped(pinned, jnp.where(pinned, stopped, move))

    carry = (held, damped(held, jnp.zeros_like(state.vector)))
    _, move = jax.lax.while_loop(lambda c: jnp.any(crossing(c)), stop_at_bounds, carry)
    return move


def _projected_cosine(
    vector: Array, value: Array, triangle: Array, projected: Array, lower: Array, upper: Array
) -> Array:
    """Greatest cosine between the residuals and a column that is free to move."""
    gradient = triangle.T @ projected
    held = ((vector <= lower) & (gradient >= 0)) | ((vector >= upper) & (gradient <= 0))
    lengths = _column_norms(triangle) * jnp.linalg.norm(value)
    cosine = jnp.abs(gradient) / jnp.where(lengths > 0, lengths, 1.0)
    return jnp.max(jnp.where(held | (lengths == 0), 0.0, cosine))


def _column_norms(matrix: Array) -> Array:
    return jnp.sqrt(jnp.sum(matrix**2, axis=0))


def _twice(residuals: Residuals) -> Callable[[Array, Any], tuple[Array, Array]]:
    def value_and_value(vector: Array, arguments: Any) -> tuple[Array, Array]:
        value = residuals(vector, arguments)
        return value, value

    return value_and_value
