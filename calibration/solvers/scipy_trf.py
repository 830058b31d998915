"""scipy's trust region reflective least squares: the independent check of our own solver."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize

from calibration.solvers.box_lm import Residuals
from calibration.solvers.outcome import Outcome, finished, jacobian_at, value_at
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
