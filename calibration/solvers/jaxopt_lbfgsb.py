"""jaxopt's L-BFGS-B: a second bounded minimiser, kept as a test oracle.

jaxopt is no longer maintained. This is the only file that may import it, and the only place
where its DeprecationWarning is silenced.
"""

import functools
import warnings
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.solvers.box_lm import Residuals
from calibration.solvers.outcome import Outcome, cost_of, finished

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import jaxopt


@dataclass(frozen=True)
class JaxoptOptions:
    """Settings of `jaxopt.LBFGSB`.

    Parameters
    ----------
    max_steps : int
        Most iterations.
    tolerance : float
        On the projected gradient of the misfit over its value at the start, each parameter
        taken in units of its own effect.
    """

    max_steps: int = 2000
    tolerance: float = 1e-9


def solve(
    residuals: Residuals,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    arguments: Any,
    options: JaxoptOptions,
) -> Outcome:
    """Minimise inside the bounds; see `calibration.solvers.box_lm.solve` for the arguments."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        vector, error, steps = _solve_compiled(residuals, start, lower, upper, arguments, options)
    vector, steps = np.asarray(vector), int(steps)
    converged = bool(error <= options.tolerance)
    status = f"converged: jaxopt L-BFGS-B, projected gradient {float(error):.1e}"
    if not converged:
        status = (
            f"not converged: jaxopt L-BFGS-B stopped after {steps} steps with a projected "
            f"gradient of {float(error):.1e}"
        )
        vector = np.where(np.isfinite(vector), vector, start)
    return finished(residuals, vector, arguments, status, converged, steps)


@functools.partial(jax.jit, static_argnames=("residuals", "options"))
def _solve_compiled(
    residuals: Residuals,
    start: Array,
    lower: Array,
    upper: Array,
    arguments: Any,
    options: JaxoptOptions,
) -> tuple[Array, Array, Array]:
    # L-BFGS-B has no scaling of its own: without it, parameters of very different size stall.
    norms = jnp.linalg.norm(jax.jacfwd(residuals)(start, arguments), axis=0)
    misfit = 0.5 * jnp.sum(residuals(start, arguments) ** 2)
    misfit = jnp.where(misfit > 0, misfit, 1.0)
    unit = jnp.sqrt(misfit) / jnp.where(norms > 0, norms, 1.0)

    def objective(scaled: Array) -> Array:
        return cost_of(residuals)(scaled * unit, arguments) / misfit

    solver = jaxopt.LBFGSB(
        objective, maxiter=options.max_steps, tol=options.tolerance, maxls=50, implicit_diff=False
    )
    found, state = solver.run(start / unit, bounds=(lower / unit, upper / unit))
    return found * unit, state.error, state.iter_num
