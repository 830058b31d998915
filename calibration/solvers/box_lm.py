"""Bounded Levenberg-Marquardt for small dense least-squares problems.

Minimises half the sum of squares of the residuals inside a box. Parameters whose bound holds
them back are taken out of the step (projected active set); a step that would leave the box is
stopped at the bound and the other parameters solve again around it. Columns are scaled by
their norms, which may fall by half a step at most (after Moré, who never lets them fall: a start
far off then cripples the rest of the way). Steps come from a QR of the Jacobian (from J'J only
where speed over many fits is asked for), are bent along the curvature of the model (geodesic
acceleration), and the damping follows Nielsen.

References
----------
.. [1] J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory", 1978.
.. [2] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05.
.. [3] M. K. Transtrum, J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for
   nonlinear least-squares minimization", arXiv:1201.5885, 2012.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from calibration.solvers.local_model import Gram, Triangular
from procmodel.errors import InputError, nearest

Residuals = Callable[[Array, Any], Array]

RUNNING, GRADIENT, REDUCTION, STEP, EXACT, FLOOR, STALLED, OUT_OF_STEPS, BAD_START = range(9)

# A small step or reduction counts as converged only where the residuals are this nearly
# perpendicular to every free column: damping alone makes steps small too.
_NEARLY_AT_REST = 1e-8
# At a kink of the model the optimum is not smooth; there the angle may be this far off.
_AT_REST_ON_A_KINK = 1e-2
# Damping, as a multiple of the squared column norms, from which on a step is too short to matter.
_HOPELESS = 1e14
# How far along the step the curvature of the model is probed, and how long the bend may be beside
# the step before the linear model is not believed; both from [3].
_PROBE = 0.1
_LONGEST_BEND = 0.75
# A step whose fall the linear model foretells this well needs no short bend: where the residuals
# themselves end in rounding, the probe sees curvature that is not there.
_FORETOLD = 0.01
# Expected reductions below this share of the misfit need no bend, and rounding would blur it.
_NO_BEND_BELOW = 1e-6

STATUS = {
    GRADIENT: "converged: no direction inside the bounds makes the misfit smaller",
    REDUCTION: "converged: a further step would not reduce the misfit",
    STEP: "converged: a further step would not move the parameters",
    EXACT: "converged: the model passes through every reading",
    FLOOR: "converged: no step, however short, makes the misfit smaller",
    STALLED: "not converged: no step makes the misfit smaller although its slope says one should; "
    "check the model and its derivative near the last values",
    OUT_OF_STEPS: "not converged: out of steps; raise max_steps or start nearer",
    BAD_START: "not started: the model or its derivative is not finite at the start; "
    "move the start values",
}
CONVERGED = (GRADIENT, REDUCTION, STEP, EXACT, FLOOR)
LOCAL_MODELS: dict[str, type[Triangular] | type[Gram]] = {"qr": Triangular, "gram": Gram}


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
    linear_algebra : {"qr", "gram"}
        "qr" for the last digits, "gram" (J'J) for many well-conditioned fits.
    bend : bool
        Bend each step along the curvature of the model, for one more evaluation. Saves most of
        the steps in curved valleys and keeps far starts from running off; a model that is linear
        does not need it.
    watch : callable, optional
        Called after every step with its number, the cost and the parameters; `calibration.fit`
        hands over the parameters by name, in natural units. Hashable; compiled in.

    Raises
    ------
    InputError
        If the linear algebra is unknown.
    """

    max_steps: int = 2000
    tolerance: float = 1e-12
    linear_algebra: str = "qr"
    bend: bool = True
    watch: Callable[..., None] | None = None

    def __post_init__(self) -> None:
        if self.linear_algebra not in LOCAL_MODELS:
            hint = nearest(self.linear_algebra, tuple(LOCAL_MODELS))
            raise InputError(f"linear algebra {self.linear_algebra!r} is unknown{hint}.")


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


class _Point(NamedTuple):
    vector: Array
    residuals: Array
    cost: Array
    jacobian: Array
    local: Triangular | Gram


class _State(NamedTuple):
    point: _Point
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
    """Minimise half the sum of squares, or a cost, inside a box; traceable and mappable.

    Parameters
    ----------
    residuals : callable
        ``residuals(vector, arguments)`` of shape (n,), n >= 1. Where it has a method
        ``own_cost(vector, arguments)`` that is not None, that is made small instead: then the
        residuals r and their derivative J are such that J'r is its gradient and J'J its expected
        curvature (Fisher scoring).
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
    local_model = LOCAL_MODELS[options.linear_algebra]
    own_cost = getattr(residuals, "own_cost", None)

    def cost_at(vector: Array, value: Array) -> Array:
        if own_cost is None:
            return 0.5 * jnp.sum(value**2)
        return own_cost(vector, arguments)

    @jax.jit  # traced once for its two uses below
    def linearise(vector: Array) -> _Point:
        jacobian, value = jax.jacfwd(_twice(residuals), has_aux=True)(vector, arguments)
        local = local_model.of(value, jacobian)
        return _Point(vector, value, cost_at(vector, value), jacobian, local)

    def advance(state: _State) -> _State:
        here = state.point
        move, pinned = _bounded_step(state, lower, upper)
        expected = here.local.reduction(move)
        believed = jnp.asarray(True)
        if options.bend and own_cost is None:
            probe = residuals(here.vector + _PROBE * move, arguments)
            move, believed = _bent(state, move, pinned, probe, lower, upper)
        trial = _moved(here.vector, move, lower, upper)
        trial_residuals = residuals(trial, arguments) if own_cost is None else here.residuals

        misfit = 0.5 * jnp.sum(here.residuals**2)
        reduction = here.cost - cost_at(trial, trial_residuals)
        if own_cost is None:  # the same with less rounding
            total = here.residuals + trial_residuals
            reduction = 0.5 * jnp.sum((here.residuals - trial_residuals) * total)
        ratio = reduction / jnp.where(expected > 0, expected, 1.0)
        believed = believed | (jnp.abs(ratio - 1.0) <= _FORETOLD)
        better = believed & jnp.isfinite(reduction) & (reduction > 0) & (expected > 0)
        there = jax.lax.cond(better, lambda: linearise(trial), lambda: here)
        # A better point with a derivative that is not finite is no place to go on from.
        better = better & jnp.all(jnp.isfinite(there.jacobian))
        point = jax.tree.map(lambda a, b: jnp.where(better, a, b), there, here)

        norms = point.local.column_norms()
        fallen = jnp.where(better & (norms > 0), 0.5 * state.scale, state.scale)
        scale = jnp.maximum(fallen, norms)
        shrink = jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping = jnp.where(
            better, jnp.maximum(state.damping * shrink, 1e-16), state.damping * state.growth
        )
        growth = jnp.where(better, 2.0, 2.0 * state.growth)

        steps = state.steps + 1
        if options.watch is not None:
            jax.debug.callback(options.watch, steps, point.cost, point.vector, ordered=True)
        small = options.tolerance * misfit
        no_reduction = (jnp.abs(reduction) <= small) & (expected <= small) & (ratio <= 2.0)
        length = jnp.linalg.norm(scale * move)
        no_move = length <= options.tolerance * jnp.linalg.norm(scale * point.vector)
        cosine = _projected_cosine(point, lower, upper)
        # What rounding of the parameters alone does to the residuals.
        rounding = jnp.finfo(scale.dtype).eps * jnp.linalg.norm(scale * point.vector)
        rest = jnp.linalg.norm(point.residuals)
        settled = cosine * rest <= _NEARLY_AT_REST * rest + 1e2 * rounding
        hopeless = ~jnp.isfinite(damping) | (damping > _HOPELESS)
        status = jnp.select(
            [
                (rest == 0) & (own_cost is None),
                cosine <= options.tolerance,
                no_reduction & settled,
                no_move & jnp.isfinite(reduction) & settled,
                hopeless & jnp.isfinite(reduction) & (settled | (cosine <= _AT_REST_ON_A_KINK)),
                hopeless,
                steps >= options.max_steps,
            ],
            [EXACT, GRADIENT, REDUCTION, STEP, FLOOR, STALLED, OUT_OF_STEPS],
            RUNNING,
        )
        return _State(point, scale, damping, growth, status, steps)

    point = linearise(jnp.clip(start, lower, upper))
    norms = point.local.column_norms()
    sound = jnp.all(jnp.isfinite(point.residuals)) & jnp.all(jnp.isfinite(point.jacobian))
    sound = sound & jnp.isfinite(point.cost)
    status = jnp.select(
        [
            ~sound,
            jnp.all(point.residuals == 0) & (own_cost is None),
            _projected_cosine(point, lower, upper) <= options.tolerance,
        ],
        [BAD_START, EXACT, GRADIENT],
        RUNNING,
    )
    state = _State(
        point=point,
        scale=jnp.where(norms > 0, norms, 1.0),
        damping=jnp.asarray(1e-3, point.vector.dtype),
        growth=jnp.asarray(2.0, point.vector.dtype),
        status=status,
        steps=jnp.asarray(0),
    )
    state = jax.lax.while_loop(lambda s: s.status == RUNNING, advance, state)
    end = state.point
    return BoxLMOutcome(end.vector, end.residuals, end.jacobian, state.status, state.steps)


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


def _bounded_step(state: _State, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Damped step of the parameters that no bound holds, stopped at the bounds, and who is."""
    point = state.point
    gradient = point.local.gradient()
    held = ((point.vector <= lower) & (gradient > 0)) | ((point.vector >= upper) & (gradient < 0))
    room_down, room_up = lower - point.vector, upper - point.vector
    damping = state.damping * state.scale**2

    def damped(pinned: Array, move: Array) -> Array:
        return point.local.damped_move(~pinned, damping, jnp.where(pinned, move, 0.0))

    def crossing(carry: tuple[Array, Array]) -> Array:
        pinned, move = carry
        return ~pinned & ((move < room_down) | (move > room_up))

    def stop_at_bounds(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        pinned, move = carry
        stopped = jnp.clip(move, room_down, room_up)
        pinned = pinned | crossing(carry)
        return pinned, damped(pinned, jnp.where(pinned, stopped, move))

    carry = (held, damped(held, jnp.zeros_like(point.vector)))
    pinned, move = jax.lax.while_loop(lambda c: jnp.any(crossing(c)), stop_at_bounds, carry)
    return move, pinned


def _bent(
    state: _State, move: Array, pinned: Array, probe: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The step bent along the curvature of the model, and whether it is worth trying [3].

    `probe` holds the residuals at `_PROBE` of the step; if they are not finite, it is not.
    """
    point = state.point
    curvature = 2.0 / _PROBE * ((probe - point.residuals) / _PROBE - point.jacobian @ move)
    local = point.local.against(curvature, point.jacobian)
    bend = local.damped_move(~pinned, state.damping * state.scale**2, jnp.zeros_like(move))
    length, limit = jnp.linalg.norm(state.scale * bend), jnp.linalg.norm(state.scale * move)
    believed = length <= _LONGEST_BEND * limit
    expected = point.local.reduction(move)
    near = expected <= _NO_BEND_BELOW * 0.5 * jnp.sum(point.residuals**2)
    whole = move + 0.5 * bend
    end = point.vector + whole
    inside = jnp.all((end >= lower) & (end <= upper))
    return jnp.where(believed & inside & ~near, whole, move), believed | near


def _moved(vector: Array, move: Array, lower: Array, upper: Array) -> Array:
    """The vector after a move, on the bound itself where the move reaches it."""
    inside = jnp.clip(vector + move, lower, upper)
    low = jnp.where(move <= lower - vector, lower, inside)
    return jnp.where(move >= upper - vector, jnp.where(move > 0, upper, low), low)


def _projected_cosine(point: _Point, lower: Array, upper: Array) -> Array:
    """Greatest cosine between the residuals and a column that is free to move."""
    gradient = point.local.gradient()
    held = ((point.vector <= lower) & (gradient >= 0)) | ((point.vector >= upper) & (gradient <= 0))
    lengths = point.local.column_norms() * jnp.linalg.norm(point.residuals)
    cosine = jnp.abs(gradient) / jnp.where(lengths > 0, lengths, 1.0)
    return jnp.max(jnp.where(held | (lengths == 0), 0.0, cosine))


def _twice(residuals: Residuals) -> Callable[[Array, Any], tuple[Array, Array]]:
    def value_and_value(vector: Array, arguments: Any) -> tuple[Array, Array]:
        value = residuals(vector, arguments)
        return value, value

    return value_and_value
