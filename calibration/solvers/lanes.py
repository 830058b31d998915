"""Many small bounded least-squares fits side by side, one in each lane.

One compiled loop makes Levenberg-Marquardt steps in all lanes at once; the caller takes out the
lanes that have finished and puts the next fits there, so that no fit waits for the slowest.
Damping, scaling and bounds are those of `calibration.solvers.box_lm`, on J'J; residuals and
Jacobian are taken together at the trial point. Readings lie lane by lane (W, m), everything of
the size of the parameters has the lanes last (p, W): loops then run through memory in order.

A lane gives up (`HARD`) on anything unusual: a start that is not finite, an ill-conditioned
Jacobian, a model with kinks. Those fits are for `box_lm` with QR.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, PartitionSpec

from calibration.parameters import NamedParameters, ParameterLayout
from calibration.solvers.box_lm import EXACT, REDUCTION, RUNNING, STEP
from procmodel.errors import InputError

HARD = -1
IDLE = -2

# Squared distance to the optimum, in standard deviations, that the last step may still go.
_NEAR = 1e-16
# Relative change of the misfit that rounding makes doubtful.
_LEVEL = 1e-12
# Squared relative step that counts as none.
_NO_MOVE = 1e-24
# With more damping than this a step is short by itself and says nothing about the distance.
_CALM = 1e-2
_HOPELESS = 1e8
_FIRST_DAMPING = 1e-3
# Up to here sums over the readings and factorisations are written out, one array per element.
_WRITTEN_OUT = 8


class State(NamedTuple):
    """Where every lane stands.

    Attributes
    ----------
    vector, move : Array, shape (p, W)
        Parameters, and the step to be tried next.
    slope, scale : Array, shape (p, W)
        J'r at `vector`, and the greatest squared column norm so far.
    gram : Array, shape (p (p + 1) / 2, W)
        Lower triangle of J'J there, row by row.
    misfit, expected : Array, shape (1, W)
        Sum of squares there, infinite before the first evaluation; its fall that the linear
        model expects of the step.
    damping, growth : Array, shape (1, W)
        As Nielsen's.
    freedom : Array, shape (1, W)
        Readings less parameters, at least 1.
    status, steps : Array, shape (1, W)
        Key into `box_lm.STATUS`, `HARD` or `IDLE`; evaluations after the first. Floats, so that
        all fields can travel as one array.
    """

    vector: Any
    move: Any
    slope: Any
    scale: Any
    gram: Any
    misfit: Any
    expected: Any
    damping: Any
    growth: Any
    freedom: Any
    status: Any
    steps: Any

    @classmethod
    def rows(cls, count: int) -> "State":
        """Rows of each field in the packed array, for `count` parameters."""
        sizes = (count,) * 4 + (count * (count + 1) // 2,) + (1,) * 7
        ends = tuple(itertools.accumulate(sizes))
        return cls(*(slice(end - size, end) for end, size in zip(ends, sizes, strict=True)))

    @classmethod
    def unpacked(cls, packed: Any, count: int) -> "State":
        """The fields of a packed array (K, W)."""
        return cls(*(packed[rows] for rows in cls.rows(count)))


def idle(count: int, width: int) -> np.ndarray:
    """Packed lanes without fits, shape (K, W)."""
    rows = State.rows(count)
    packed = np.zeros((rows.steps.stop, width))
    packed[rows.status] = IDLE
    return packed


def begin(packed: np.ndarray, lanes: np.ndarray, starts: np.ndarray, freedom: np.ndarray) -> None:
    """Put new fits into some lanes, in place.

    Parameters
    ----------
    packed : ndarray, shape (K, W)
        From `idle` or `advance`.
    lanes : ndarray of int, shape (k,)
        Where.
    starts : ndarray, shape (p, k) or (p, 1)
        Internal start inside the box.
    freedom : ndarray, shape (k,) or ()
        Readings less parameters, at least 1.
    """
    rows = State.rows(len(starts))
    packed[:, lanes] = 0.0
    packed[rows.vector, lanes] = starts
    packed[rows.misfit, lanes] = np.inf
    packed[rows.damping, lanes] = _FIRST_DAMPING
    packed[rows.growth, lanes] = 2.0
    packed[rows.freedom, lanes] = freedom
    packed[rows.steps, lanes] = -1.0


@dataclass(frozen=True)
class OneFit:
    """Residuals of one fit. Hashable: all that differs between fits is an argument.

    Attributes
    ----------
    function : callable
        ``function(params, x)``.
    layout : ParameterLayout
        Its parameters.
    x_tree : PyTreeDef
        How the leaves make x.
    """

    function: Callable[[dict[str, Array], Any], Array]
    layout: ParameterLayout
    x_tree: Any

    def __call__(self, vector: Array, arguments: tuple) -> Array:
        """Residuals, priors included; `arguments` is (fixed, leaves of x, y, 1/sigma)."""
        fixed, leaves, y, inverse_sigma = arguments
        values = NamedParameters(self.layout.natural(vector, fixed))
        prediction = jnp.asarray(self.function(values, jax.tree.unflatten(self.x_tree, leaves)))
        if prediction.shape != y.shape:
            raise InputError(
                f"model {self.name!r} returned shape {prediction.shape} for {y.shape[0]} "
                "readings: it must return one value for each."
            )
        deviations = (prediction - y) * inverse_sigma
        if not self.layout.priors:
            return deviations
        priors = [prior.residual(values[name]) for name, prior in self.layout.priors]
        return jnp.concatenate([deviations, jnp.stack(priors)])

    @property
    def name(self) -> str:
        """Name of the model."""
        return getattr(self.function, "__name__", None) or type(self.function).__name__


@dataclass(frozen=True)
class LaneProgram:
    """Everything that the compiled loop depends on but numbers. Hashable.

    Attributes
    ----------
    fit : OneFit
        The residuals of one fit.
    x_axes : tuple of (0 or None)
        For every leaf of x, whether each lane has its own.
    sigma_axis : 0 or None
        The same for 1/sigma.
    max_steps : int
        Steps after which a lane gives up.
    mesh : Mesh, optional
        Devices that share the lanes.
    """

    fit: OneFit
    x_axes: tuple[int | None, ...]
    sigma_axis: int | None
    max_steps: int
    mesh: Mesh | None = None

    @property
    def count(self) -> int:
        """Number of free parameters."""
        return len(self.fit.layout.free)

    def residuals(self, vector: Array, numbers: "Numbers") -> Array:
        """Residuals of every lane, shape (W, m), at parameters (p, W)."""

        def one(vector: Array, leaves: tuple, y: Array, inverse: Array) -> Array:
            return self.fit(vector, (numbers.fixed, leaves, y, inverse))

        mapped = jax.vmap(one, in_axes=(1, self.x_axes, 0, self.sigma_axis))
        return mapped(vector, numbers.x, numbers.y, numbers.inverse_sigma)


class Numbers(NamedTuple):
    """Numbers of the fits that are in the lanes.

    Attributes
    ----------
    fixed : Array, shape (q,)
        Values of the fixed parameters.
    lower, upper : Array, shape (p, 1)
        The box.
    x : tuple of Array
        Leaves of x, (W, ...) or one for all.
    y : Array, shape (W, m)
        Readings.
    inverse_sigma : Array, shape (), (m,) or (W, m)
        1/sigma; 0 where a reading is padding.
    """

    fixed: Any
    lower: Any
    upper: Any
    x: tuple
    y: Any
    inverse_sigma: Any


@functools.partial(jax.jit, static_argnames="program")
def advance(program: LaneProgram, packed: Array, numbers: Numbers, leave: Array) -> Array:
    """Make steps until few lanes are still running.

    Parameters
    ----------
    program : LaneProgram
        What to run.
    packed : Array, shape (K, W)
        From `idle` or the last call, new fits put in by `begin`.
    numbers : Numbers
        Data of all lanes.
    leave : Array of int, shape ()
        Return when no more than this many lanes are running (on each device).

    Returns
    -------
    Array, shape (K, W)
        The lanes.
    """
    if program.mesh is None:
        return _advance(program, packed, numbers, leave)
    lane, last, whole = PartitionSpec("lanes"), PartitionSpec(None, "lanes"), PartitionSpec()
    own = Numbers(
        fixed=whole,
        lower=whole,
        upper=whole,
        x=tuple(whole if axis is None else lane for axis in program.x_axes),
        y=lane,
        inverse_sigma=whole if program.sigma_axis is None else lane,
    )
    run = jax.shard_map(
        functools.partial(_advance, program),
        mesh=program.mesh,
        in_specs=(last, own, whole),
        out_specs=last,
        # Every device runs its own loop; there is nothing to check between them.
        check_vma=False,
    )
    return run(packed, numbers, leave)


def _advance(program: LaneProgram, packed: Array, numbers: Numbers, leave: Array) -> Array:
    def busy(state: State) -> Array:
        return jnp.sum(state.status == RUNNING) > leave

    state = State.unpacked(packed, program.count)
    state = jax.lax.while_loop(busy, lambda s: _step(program, s, numbers), state)
    return jnp.concatenate(state)


def _step(program: LaneProgram, state: State, numbers: Numbers) -> State:
    """One evaluation in every lane, and the step after it."""
    box = (numbers.lower, numbers.upper)
    running = state.status == RUNNING
    trial = _moved(state.vector, state.move, box)
    products, descent, misfit = _normal_equations(program, trial, numbers)
    reduction = state.misfit - misfit
    first = jnp.isinf(state.misfit)
    sound = jnp.isfinite(misfit + sum(descent) + sum(products))
    # So near to the optimum rounding decides the sign of the reduction.
    small = _LEVEL * state.misfit
    level = ~first & (state.expected <= small) & (jnp.abs(reduction) <= small)
    better = running & sound & ((reduction > 0) | level)
    ratio = reduction / jnp.where(state.expected > 0, state.expected, jnp.inf)
    shrink = jnp.clip(1.0 - (2.0 * ratio - 1.0) ** 3, 0.1, 1.0)
    shrink = jnp.where(first, 1.0, jnp.where(level, 0.1, shrink))
    damping = jnp.maximum(state.damping * jnp.where(better, shrink, state.growth), 1e-14)
    # Without the barrier the compiler works all this out again in each of its users.
    better, level, damping = jax.lax.optimization_barrier((better, level, damping))
    vector = jnp.where(better, trial, state.vector)
    gram = jnp.where(better, jnp.concatenate(products), state.gram)
    slope = jnp.where(better, jnp.concatenate(descent), state.slope)
    misfit = jnp.where(better, misfit, state.misfit)
    diagonal = jnp.stack([gram[k * (k + 3) // 2] for k in range(program.count)])
    scale = jnp.maximum(state.scale, diagonal)
    growth = jnp.where(better, 2.0, 2.0 * state.growth)
    vector, gram, slope, scale = jax.lax.optimization_barrier((vector, gram, slope, scale))
    move, expected = _bounded_move(vector, gram, slope, scale, damping, box)
    move, expected = jax.lax.optimization_barrier((move, expected))

    calm = (damping <= _CALM) & jnp.isfinite(expected)
    near = expected * state.freedom <= _NEAR * misfit
    # No nearer in spite of a full step: rounding allows no more.
    floor = level & (expected >= state.expected)
    length, size = _norm2(scale * move**2), _norm2(scale * vector**2)
    steps = state.steps + 1
    given_up = (damping > _HOPELESS) | (steps >= program.max_steps)
    status = jnp.where(given_up, float(HARD), float(RUNNING))
    status = jnp.where(calm & (length <= _NO_MOVE * size), float(STEP), status)
    status = jnp.where(calm & (near | floor), float(REDUCTION), status)
    # The last step costs nothing: it is too short to need another evaluation.
    done = running & sound & ((status == REDUCTION) | (status == STEP))
    status = jnp.where(misfit == 0, float(EXACT), status)
    status = jnp.where(first & ~sound, float(HARD), status)
    return State(
        vector=jnp.where(done, _moved(vector, move, box), vector),
        move=jnp.where(running & (status == RUNNING), move, 0.0),
        slope=slope,
        scale=scale,
        gram=gram,
        misfit=misfit,
        expected=expected,
        damping=damping,
        growth=growth,
        freedom=state.freedom,
        status=jnp.where(running, status, state.status),
        steps=jnp.where(running, steps, state.steps),
    )


def _norm2(terms: Array) -> Array:
    return jnp.sum(terms, axis=0, keepdims=True)


def _normal_equations(
    program: LaneProgram, vector: Array, numbers: Numbers
) -> tuple[list[Array], list[Array], Array]:
    """Lower triangle of J'J, J'r and r'r, each element of shape (1, W)."""
    residuals, derivative = jax.linearize(lambda v: program.residuals(v, numbers), vector)
    count = program.count
    ones = (jnp.zeros_like(vector).at[i].set(1.0) for i in range(count))
    columns = [*(derivative(one) for one in ones), residuals]
    pairs = [(i, j) for i in range(count + 1) for j in range(i + 1)]
    if count > _WRITTEN_OUT:
        stacked = jnp.stack(columns, axis=2)
        products = jnp.einsum("wmi,wmj->ijw", stacked, stacked)
        summed = [products[i, j][None] for i, j in pairs]
    else:
        # One reduction of all products: the compiler makes one pass over the readings of it.
        reduced = jax.lax.reduce(
            tuple(columns[i] * columns[j] for i, j in pairs),
            (jnp.zeros(()),) * len(pairs),
            lambda sums, terms: tuple(a + b for a, b in zip(sums, terms, strict=True)),
            (1,),
        )
        summed = [one[None] for one in reduced]
    triangle = len(pairs) - count - 1
    return summed[:triangle], summed[triangle:-1], summed[-1]


def _bounded_move(
    vector: Array,
    gram: Array,
    slope: Array,
    scale: Array,
    damping: Array,
    box: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Damped step inside the box, and the fall of the sum of squares expected of it."""
    room_down, room_up = box[0] - vector, box[1] - vector
    held = ((room_down >= 0) & (slope > 0)) | ((room_up <= 0) & (slope < 0))
    damped = damping * jnp.where(scale > 0, scale, 1.0)
    move = _damped(gram, slope, damped, held, jnp.zeros_like(slope))
    crossing = ~held & ((move < room_down) | (move > room_up))

    def around(move: Array) -> Array:
        stopped = jnp.where(crossing, jnp.clip(move, room_down, room_up), 0.0)
        again = _damped(gram, slope, damped, held | crossing, stopped)
        # The others keep theirs to the bit, whichever lanes are beside them.
        return jnp.where(jnp.any(crossing, axis=0), again, move)

    move = jax.lax.cond(jnp.any(crossing), around, lambda move: move, move)
    move = jnp.clip(move, room_down, room_up)
    return move, -_norm2(move * (2.0 * slope + _times(gram, move)))


def _times(gram: Array, move: Array) -> Array:
    """J'J times a move, from the lower triangle."""
    count = move.shape[0]
    rows = [_dot([gram[_place(i, j)] for j in range(count)], list(move)) for i in range(count)]
    return jnp.stack(rows)


def _place(i: int, j: int) -> int:
    """Row of an element of a symmetric matrix in its lower triangle."""
    i, j = max(i, j), min(i, j)
    return i * (i + 1) // 2 + j


def _places(count: int) -> np.ndarray:
    """The same for all elements, shape (p, p)."""
    return np.array([[_place(i, j) for j in range(count)] for i in range(count)])


def _damped(gram: Array, slope: Array, damped: Array, pinned: Array, kept: Array) -> Array:
    """Step of the parameters that are not pinned, those making the step `kept`."""
    right = jnp.where(pinned, 0.0, -(slope + _times(gram, kept)))
    count = right.shape[0]
    if count > _WRITTEN_OUT:
        either = pinned[:, None] | pinned[None]
        diagonal = jnp.where(pinned, 1.0, damped + gram[np.diag(_places(count))])
        full = jnp.where(either | np.eye(count, dtype=bool)[..., None], 0.0, gram[_places(count)])
        full = full + np.eye(count)[..., None] * diagonal
        lower = jnp.linalg.cholesky(jnp.moveaxis(full, 2, 0))
        solution = jax.scipy.linalg.cho_solve((lower, True), right.T[..., None])[..., 0].T
    else:
        factor = factorised(reduced(gram, pinned, damped, jnp), jnp)
        solution = jnp.stack(solved(factor, list(right)))
    return jnp.where(pinned, kept, solution)


Triangle = list[list[Any]]


def reduced(gram: Any, pinned: Any, diagonal: Any, xp: Any) -> Triangle:
    """Lower triangle of the system without the pinned parameters, which keep 1 on the diagonal."""
    count = len(pinned)
    rows = []
    for i in range(count):
        row = [xp.where(pinned[i] | pinned[j], 0.0, gram[_place(i, j)]) for j in range(i)]
        rows.append([*row, xp.where(pinned[i], 1.0, gram[_place(i, i)] + diagonal[i])])
    return rows


def factorised(matrix: Triangle, xp: Any) -> Triangle:
    """Cholesky factor, written out; NaN where the matrix is not positive definite.

    Parameters
    ----------
    matrix : list of list of array, shape (W,)
        Lower triangle.
    xp : module
        NumPy or jax.numpy.

    Returns
    -------
    list of list of array, shape (W,)
        Lower triangle of the factor.
    """
    rows: Triangle = []
    for i, given in enumerate(matrix):
        row: list[Any] = []
        for j in range(i):
            row.append((given[j] - _dot(row, rows[j][:j])) / rows[j][j])
        row.append(xp.sqrt(given[i] - _dot(row, row)))
        rows.append(row)
    return rows


def solved(factor: Triangle, right: list[Any]) -> list[Any]:
    """Solution of a system whose factor is given, one array for each unknown."""
    forward: list[Any] = []
    for row, value in zip(factor, right, strict=True):
        forward.append((value - _dot(row[:-1], forward)) / row[-1])
    solution = list(forward)
    for i in reversed(range(len(factor))):
        below = range(i + 1, len(factor))
        known = _dot([factor[k][i] for k in below], [solution[k] for k in below])
        solution[i] = (forward[i] - known) / factor[i][i]
    return solution


def _dot(left: Sequence[Any], right: Sequence[Any]) -> Any:
    return sum((a * b for a, b in zip(left, right, strict=True)), start=0.0)


def _moved(vector: Array, move: Array, box: tuple[Array, Array]) -> Array:
    """The vector after a move, on the bound itself where the move reaches it."""
    lower, upper = box
    inside = jnp.clip(vector + move, lower, upper)
    low = jnp.where((move < 0) & (move <= lower - vector), lower, inside)
    return jnp.where((move > 0) & (move >= upper - vector), upper, low)
