"""The search for feeds through the simulator: cost, its derivative, and the minimiser.

Lengths in um.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from scipy.optimize import minimize

from calibration.wear_surface_model import CavityModel
from procmodel.wear.surface_error import cleared_cells

# Fall of the cost, as a share of it, that is no longer worth a step.
_NO_GAIN = 1e-4


@dataclass(frozen=True)
class Search:
    """Outcome of a search.

    Attributes
    ----------
    feeds : ndarray, shape (n,) [um]
        The best feeds found.
    evaluations : int
        How often cost and derivative were computed.
    converged : bool
        Whether no feed inside the bounds lowers the cost.
    why : str
        How the search ended, as half a sentence.
    """

    feeds: np.ndarray
    evaluations: int
    converged: bool
    why: str


def search_feeds(
    model: CavityModel,
    more: Mapping[str, Any],
    target: np.ndarray,
    wear_ratios: np.ndarray,
    start: np.ndarray,
    bounds: tuple[float, float],
    stay: float,
    evaluations: int,
    progress: Callable[[int, float], None] | None,
) -> Search:
    """Feeds with the least mean square error over cells and wear ratios.

    Reverse mode gives all derivatives for about five simulations, whatever the number of layers;
    Gauss-Newton would need two for every layer.

    Parameters
    ----------
    model : CavityModel
        What is simulated.
    more : mapping
        Gaps and spread width, as `CavityModel.cut` takes them.
    target : ndarray, shape (nx, ny) [um]
        Wanted depth; NaN in cells that do not count.
    wear_ratios : ndarray, shape (k,)
        Equally likely wear ratios.
    start : ndarray, shape (n,) [um]
        Feeds to start from.
    bounds : (float, float) [um]
        Least and greatest feed.
    stay : float [um]
        Root mean square error that it is worth to leave all feeds at their start, against
        changing every one by all of itself.
    evaluations : int
        Most evaluations.
    progress : callable, optional
        Called with the number of evaluations and the root mean square error [um] after each.

    Returns
    -------
    Search
        Where it ended.
    """
    begin = np.clip(start, *bounds)
    middle = wear_ratios[len(wear_ratios) // 2]
    cleared = cleared_cells(model.depth(begin, middle, **more), target)
    region = np.flatnonzero(cleared & np.isfinite(target))
    wanted = jnp.asarray(target.ravel()[region])
    size = np.maximum(start, bounds[0])

    def square(feeds: Array, ratio: Array) -> Array:
        return jnp.mean((model.depth(feeds, ratio, **more).ravel()[region] - wanted) ** 2)

    @jax.jit
    @jax.value_and_grad
    def cost(shares: Array) -> Array:
        squares = lax.map(lambda ratio: square(shares * size, ratio), jnp.asarray(wear_ratios))
        return jnp.mean(squares) + stay**2 * jnp.mean((shares - start / size) ** 2)

    best: list = [math.inf, begin]
    count = 0

    def evaluated(shares: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal count
        value, slope = cost(jnp.asarray(shares))
        count += 1
        if float(value) < best[0]:
            best[:] = [float(value), shares * size]
        if progress is not None:
            progress(count, math.sqrt(float(value)))
        return float(value), np.asarray(slope)

    box = np.column_stack([bounds[0] / size, np.full(len(size), bounds[1]) / size])
    options = {"maxfun": evaluations, "maxiter": evaluations, "ftol": _NO_GAIN}
    why = "no feed inside the bounds lowers the error further"
    try:
        end = minimize(
            evaluated, begin / size, jac=True, method="L-BFGS-B", bounds=box, options=options
        )
        converged = bool(end.success)
        if not converged:
            why = f"stopped after {count} evaluations, short of the optimum"
    except KeyboardInterrupt:
        converged, why = False, f"stopped by hand after {count} evaluations"
    return Search(np.clip(best[1], *bounds), count, converged, why)
