"""optimistix least squares: the general engine for problems without active bounds.

optimistix has no bounds, so this adapter solves without them and refuses an answer outside.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax import Array

from calibration.solvers.box_lm import Residuals
from calibration.solvers.outcome import Outcome, cost_of, finished
from procmodel.errors import InputError, nearest

METHODS: dict[str, Any] = {
    "levenberg_marquardt": optimistix.LevenbergMarquardt,
    "dogleg": optimistix.Dogleg,
    "gauss_newton": optimistix.GaussNewton,
    "bfgs": optimistix.BFGS,
}


@dataclass(frozen=True)
class OptimistixOptions:
    """Settings of `optimistix.least_squares`.

    Parameters
    ----------
    method : {"levenberg_marquardt", "dogleg", "gauss_newton", "bfgs"}
        Which of its solvers.
    max_steps : int
        Most steps.
    tolerance : float
        rtol and atol.

    Raises
    ------
    InputError
        If the method is unknown.
    """

    method: str = "levenberg_marquardt"
    max_steps: int = 500
    tolerance: float = 1e-12

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            hint = nearest(self.method, tuple(METHODS))
            raise InputError(f"optimistix method {self.method!r} is unknown{hint}.")


def solve(
    residuals: Residuals,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    arguments: Any,
    options: OptimistixOptions,
) -> Outcome:
    """Minimise without bounds; see `calibration.solvers.box_lm.solve` for the arguments."""
    if getattr(residuals, "own_cost", None) is not None and options.method != "bfgs":
        raise InputError(
            f"optimistix {options.method} makes sums of squares small, which this noise model or "
            "prior is not: use method='bfgs', or the solver 'box_lm'."
        )
    vector, done, steps = _solve_compiled(residuals, start, arguments, options)
    vector, steps = np.asarray(vector), int(steps)
    converged = bool(done) and bool(np.all(np.isfinite(vector)))
    status = f"converged: optimistix {options.method} met its tolerances"
    if not converged:
        status = f"not converged: optimistix {options.method} stopped after {steps} steps"
        vector = np.where(np.isfinite(vector), vector, start)
    outside = (vector < lower) | (vector > upper)
    if np.any(outside):
        converged = False
        status = (
            "not converged: optimistix keeps no bounds and left them; use solver 'box_lm', "
            "the values are moved back to the bounds"
        )
        vector = np.clip(vector, lower, upper)
    return finished(residuals, vector, arguments, status, converged, steps)


@functools.partial(jax.jit, static_argnames=("residuals", "options"))
def _solve_compiled(
    residuals: Residuals, start: Array, arguments: Any, options: OptimistixOptions
) -> tuple[Array, Array, Array]:
    solver = METHODS[options.method](rtol=options.tolerance, atol=options.tolerance)
    if getattr(residuals, "own_cost", None) is None:
        solution: optimistix.Solution = optimistix.least_squares(
            residuals, solver, start, args=arguments, max_steps=options.max_steps, throw=False
        )
    else:
        solution = optimistix.minimise(
            cost_of(residuals),
            solver,
            start,
            args=arguments,
            max_steps=options.max_steps,
            throw=False,
        )
    done = jnp.asarray(solution.result == optimistix.RESULTS.successful)
    return solution.value, done, solution.stats["num_steps"]
