"""The no-U-turn sampler by blackjax, on unbounded coordinates whitened by the starting points.

References
----------
.. [1] M. D. Hoffman, A. Gelman, "The No-U-Turn Sampler", JMLR 15, 1593-1623, 2014.
.. [2] B. Carpenter et al., "Stan: a probabilistic programming language", 2017: window adaptation.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
from blackjax.adaptation.mass_matrix import mass_matrix_adaptation
from blackjax.adaptation.step_size import dual_averaging_adaptation
from blackjax.adaptation.window_adaptation import build_schedule
from jax import Array

from calibration.samplers.driver import State, Steps
from calibration.samplers.unbounded import Unbounded

LogDensity = Callable[[Array, Any], Array]

_ACCEPTANCE = 0.8


class NutsSampler:
    """Independent chains that move together, each with its own step size and mass matrix.

    Parameters
    ----------
    log_density : callable
        ``log_density(vector, arguments)`` of natural values of shape (p,); hashable.
    cloud : ndarray, shape (m, p)
        Natural values around the optimum, whose spread sets the scale of the coordinates.
    arguments : pytree
        Handed to `log_density`.
    bounds : (ndarray, ndarray), each of shape (p,)
        Of the natural values.
    chains : int
        Number of chains.
    warmup : int
        Steps of adaptation.
    seed : int
        Same seed, same draws.
    """

    most = 64

    def __init__(
        self,
        log_density: LogDensity,
        cloud: np.ndarray,
        arguments: Any,
        bounds: tuple[np.ndarray, np.ndarray],
        chains: int,
        warmup: int,
        seed: int,
    ):
        self.warmup = warmup
        self._log_density = log_density
        self._coordinates = Unbounded.of(*bounds)
        free = self._coordinates.free(cloud, *bounds)
        centre = np.median(free, axis=0)
        spread = np.cov(free, rowvar=False).reshape(len(centre), len(centre))
        # A ridge keeps the factor regular where the cloud is thin.
        ridge = 1e-9 * np.diag(np.maximum(np.diag(spread), 1e-300))
        self._frame = jax.device_put(
            (centre, np.linalg.cholesky(spread + ridge), *bounds, arguments)
        )
        self._start = np.linalg.solve(
            np.linalg.cholesky(spread + ridge), (free[:chains] - centre).T
        ).T
        self._seed = seed
        stages = np.asarray(build_schedule(warmup), int).reshape(-1, 2)
        # One more, which the steps after the warm-up read and do not use.
        self._stages = jnp.asarray(np.concatenate([stages, np.zeros((1, 2), int)]))

    def begin(self) -> State:
        """Positions with their gradients, the untouched adaptation, and the random keys."""
        key = jax.random.key(self._seed)
        return _begin(self._density, key, jnp.asarray(self._start), self._frame)

    def warm_up(self, state: State, count: int) -> State:
        """Steps of adaptation."""
        return self._advance(state, count)[0]

    def advance(self, state: State, count: int) -> tuple[State, Steps]:
        """Steps that are kept."""
        state, parts = self._advance(state, count)
        return state, Steps(*(np.asarray(part)[:count, :, None] for part in parts))

    def _advance(self, state: State, count: int) -> tuple[State, tuple[Array, ...]]:
        held = {name: jnp.asarray(array) for name, array in state.items()}
        return _advance(
            self._density, held, self._frame, self._stages, self.warmup, count, self.most
        )

    @property
    def _density(self) -> "_Whitened":
        return _Whitened(self._log_density, self._coordinates)


class _Whitened:
    """Log density on whitened unbounded coordinates; equal ones share what was compiled."""

    def __init__(self, log_density: LogDensity, coordinates: Unbounded):
        self._parts = (log_density, coordinates)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Whitened) and self._parts == other._parts

    def __hash__(self) -> int:
        return hash(self._parts)

    def natural(self, point: Array, frame: tuple) -> tuple[Array, Array]:
        """Natural values of a point, and the log of the volume ratio."""
        centre, factor, lower, upper, _ = frame
        return self._parts[1].natural(centre + factor @ point, lower, upper)

    def __call__(self, point: Array, frame: tuple) -> Array:
        values, volume = self.natural(point, frame)
        return self._parts[0](values, frame[4]) + volume


def _tools(density: _Whitened, frame: tuple) -> tuple[Callable, Any]:
    """The log density of a point alone, and blackjax' step."""
    return functools.partial(density, frame=frame), blackjax.nuts.build_kernel()


class _Adaptation(NamedTuple):
    """What the warm-up has learnt of a chain's moves."""

    averaging: Any
    metric: Any
    step_size: Array
    inverse_mass_matrix: Array


def _untouched(point: Array) -> _Adaptation:
    """Before the first step: the coordinates are whitened, so that the unit matrix is near."""
    metric = mass_matrix_adaptation(is_diagonal_matrix=False)[0](point.shape[0])
    averaging = dual_averaging_adaptation(_ACCEPTANCE)[0](0.5)
    return _Adaptation(averaging, metric, jnp.asarray(0.5), metric.inverse_mass_matrix)


def _adapted(adaptation: _Adaptation, stage: Array, point: Array, acceptance: Array) -> _Adaptation:
    """After a step, in the windows of Stan: `stage` is (slow window, end of a window)."""
    learn_metric, end_metric = mass_matrix_adaptation(is_diagonal_matrix=False)[1:]
    restart, average, settle = dual_averaging_adaptation(_ACCEPTANCE)
    averaging = average(adaptation.averaging, acceptance)
    metric = _chosen(stage[0] > 0, learn_metric(adaptation.metric, point), adaptation.metric)
    after = adaptation._replace(averaging=averaging, metric=metric)
    # A window's end: the matrix learnt in it is taken up, and the step size starts again.
    ended = end_metric(metric)
    closed = _Adaptation(
        restart(settle(averaging)), ended, adaptation.step_size, ended.inverse_mass_matrix
    )
    after = _chosen(stage[1] > 0, closed, after)
    return after._replace(step_size=jnp.exp(after.averaging.log_step_size))


def _chosen(first: Array, one: Any, other: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)


@functools.partial(jax.jit, static_argnames="density")
def _begin(density: _Whitened, key: Array, start: Array, frame: tuple) -> dict[str, Array]:
    log_density, _ = _tools(density, frame)
    hmc = jax.vmap(lambda p: blackjax.nuts.init(p, log_density))(start)
    adaptation = jax.vmap(_untouched)(start)
    keys = jax.random.key_data(jax.random.split(key, len(start)))
    return _flat(keys, hmc, adaptation, jnp.zeros((), int))


@functools.partial(jax.jit, static_argnames=("density", "most"))
def _advance(
    density: _Whitened,
    state: dict[str, Array],
    frame: tuple,
    stages: Array,
    warmup: Array,
    count: Array,
    most: int,
) -> tuple[dict[str, Array], tuple[Array, Array, Array, Array]]:
    """Make `count` steps of at most `most`, adapting while `warmup` is not over.

    One program for warm-up and run, for the step of NUTS takes long to compile.
    """
    log_density, kernel = _tools(density, frame)

    def one(key: Array, hmc: Any, adaptation: Any, done: Array) -> tuple:
        key, now = jax.random.split(key)
        hmc, info = kernel(
            now, hmc, log_density, adaptation.step_size, adaptation.inverse_mass_matrix
        )
        values, volume = density.natural(hmc.position, frame)
        seen = (values, hmc.logdensity - volume, info.acceptance_rate, info.is_divergent)
        adapted = _adapted(adaptation, stages[done], hmc.position, info.acceptance_rate)
        # At the end the averaged step size takes the place of the last one tried.
        settled = jnp.exp(adapted.averaging.log_step_size_avg)
        step_size = jnp.where(done + 1 == warmup, settled, adapted.step_size)
        adapted = adapted._replace(step_size=step_size)
        adaptation = _chosen(done < warmup, adapted, adaptation)
        return key, hmc, adaptation, seen

    def step(i: Array, carry: tuple) -> tuple:
        keys, hmc, adaptation, done, chain = carry
        keys, hmc, adaptation, seen = jax.vmap(one, (0, 0, 0, None))(keys, hmc, adaptation, done)
        chain = tuple(
            jax.lax.dynamic_update_index_in_dim(part, new, i, 0)
            for part, new in zip(chain, seen, strict=True)
        )
        return keys, hmc, adaptation, jnp.minimum(done + 1, warmup), chain

    keys, hmc, adaptation, done = _unflat(state)
    chains, size = hmc.position.shape
    chain = (
        jnp.zeros((most, chains, size)),
        jnp.zeros((most, chains)),
        jnp.zeros((most, chains)),
        jnp.zeros((most, chains), bool),
    )
    carry = (jax.random.wrap_key_data(keys), hmc, adaptation, done, chain)
    keys, hmc, adaptation, done, chain = jax.lax.fori_loop(0, count, step, carry)
    return _flat(jax.random.key_data(keys), hmc, adaptation, done), chain


def _flat(keys: Array, hmc: Any, adaptation: Any, done: Array) -> dict[str, Array]:
    leaves = jax.tree.leaves((keys, hmc, adaptation, done))
    # Of a plain dtype: a weakly typed leaf, as blackjax begins with, would be compiled for anew.
    return {
        f"leaf_{i}": jax.lax.convert_element_type(leaf, leaf.dtype) for i, leaf in enumerate(leaves)
    }


def _unflat(state: dict[str, Array]) -> tuple[Array, Any, Any, Array]:
    """The parts again; their structure follows from the number of parameters and chains."""
    chains, size = state["leaf_1"].shape

    def example() -> tuple:
        start = jnp.zeros((chains, size))
        hmc = jax.vmap(lambda p: blackjax.nuts.init(p, lambda v: jnp.sum(v)))(start)
        adaptation = jax.vmap(_untouched)(start)
        return jnp.zeros((chains, 2), jnp.uint32), hmc, adaptation, jnp.zeros((), int)

    structure = jax.tree.structure(jax.eval_shape(example))
    return jax.tree.unflatten(structure, [state[f"leaf_{i}"] for i in range(len(state))])
