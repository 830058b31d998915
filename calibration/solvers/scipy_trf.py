"""scipy's solvers: the independent check of our own.

Least squares go to the trust region reflective method, other costs to the interior point method
with a trust region.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize

from calibration.solvers.box_lm import Residuals
from calibration.solvers.outcome import Outcome, cost_at, finished, jacobian_at, value_at
from procmodel.errors import InputError


@dataclass(frozen=True)
class ScipyTrfOptions:
    """Settings of `scipy.optimize.least_squares(method="trf")`.

    Parameters
    ----------
    max_steps : int
        Most evaluations of the residuals.
    tolerance : float
        ftol, xtol and gtol.
    """

    max_steps: int = 1000
    tolerance: float = 1e-12

    def __post_init__(self) -> None:
        if self.max_steps < 1:
            raise InputError(f"max_steps is {self.max_steps}, but must be 1 or more.")


def solve(
    residuals: Residuals,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    arguments: Any,
    options: ScipyTrfOptions,
) -> Outcome:
    """Minimise inside the bounds; see `calibration.solvers.box_lm.solve` for the arguments."""
    if not np.all(np.isfinite(np.asarray(value_at(residuals, start, arguments)))):
        return finished(
            residuals,
            start,
            arguments,
            "not started: the model is not finite at the start; move the start values",
            False,
            0,
        )
    if getattr(residuals, "own_cost", None) is not None:
        return _minimise(residuals, start, lower, upper, arguments, options)
    result = scipy.optimize.least_squares(
        lambda v: np.asarray(value_at(residuals, v, arguments)),
        start,
        jac=lambda v: np.asarray(jacobian_at(residuals, v, arguments)),
        bounds=(lower, upper),
        method="trf",
        x_scale="jac",
        ftol=options.tolerance,
        xtol=options.tolerance,
        gtol=options.tolerance,
        max_nfev=options.max_steps,
    )
    word = "converged" if result.success else "not converged"
    status = f"{word}: {result.message[0].lower()}{result.message[1:].rstrip('.')}"
    return finished(residuals, result.x, arguments, status, bool(result.success), int(result.nfev))


def _minimise(
    residuals: Residuals,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    arguments: Any,
    options: ScipyTrfOptions,
) -> Outcome:
    # No scaling of its own: each parameter is taken in units of its effect.
    norms = np.linalg.norm(np.asarray(jacobian_at(residuals, start, arguments)), axis=0)
    unit = 1.0 / np.where(norms > 0, norms, 1.0)

    def rows(scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        vector = scaled * unit
        jacobian = np.asarray(jacobian_at(residuals, vector, arguments)) * unit
        return np.asarray(value_at(residuals, vector, arguments)), jacobian

    def gradient(scaled: np.ndarray) -> np.ndarray:
        value, jacobian = rows(scaled)
        return jacobian.T @ value

    def curvature(scaled: np.ndarray) -> np.ndarray:
        _, jacobian = rows(scaled)
        return jacobian.T @ jacobian

    result = scipy.optimize.minimize(
        lambda scaled: float(cost_at(residuals, scaled * unit, arguments)),
        start / unit,
        jac=gradient,
        hess=curvature,
        method="trust-constr",
        bounds=scipy.optimize.Bounds(lower / unit, upper / unit, keep_feasible=True),
        options={
            "maxiter": options.max_steps,
            "gtol": options.tolerance**0.5,
            "xtol": options.tolerance,
        },
    )
    done = result.status in (1, 2)
    word = "converged" if done else "not converged"
    status = f"{word}: {str(result.message).lower().rstrip('.')}"
    vector = np.clip(result.x * unit, lower, upper)
    return finished(residuals, vector, arguments, status, done, int(result.nfev))
