"""What is believed of a parameter, from a number, a fit or a posterior alike."""

from typing import Any

import numpy as np

from calibration.result import FitResult
from procmodel.errors import InputError

NODES = 33


def believed_values(source: Any, name: str, nodes: int = NODES) -> np.ndarray:
    """Equally likely values of a parameter, in increasing order.

    Parameters
    ----------
    source : float, FitResult, xarray.DataTree or ndarray of shape (m,)
        A number is certain. A fit gives the quantiles of its interval's distribution, a
        posterior or an array of equally likely draws those of its draws.
    name : str
        Name of the parameter in the fit or posterior.
    nodes : int
        Number of values for an uncertain parameter; odd, so that the median is among them.

    Returns
    -------
    ndarray, shape (1,) or (nodes,)
        The values.

    Raises
    ------
    InputError
        If the number is not finite, or the source does not know the parameter.
    """
    levels = (np.arange(nodes) + 0.5) / nodes
    if isinstance(source, FitResult):
        return _from_fit(source, name, levels)
    if hasattr(source, "groups") and "posterior" in getattr(source, "children", {}):
        draws = source["posterior"].dataset
        if name not in draws:
            raise InputError(f"the posterior has no {name!r}; it has {', '.join(draws)}.")
        return np.quantile(np.asarray(draws[name]).ravel(), levels)
    if isinstance(source, np.ndarray) and source.ndim == 1 and source.size > 1:
        if not np.all(np.isfinite(source)):
            raise InputError(f"{name} has draws that are not finite: remove them.")
        return np.quantile(source, levels)
    try:
        value = float(source)
    except (TypeError, ValueError):
        raise InputError(
            f"{name} must be a number, a FitResult or a posterior, not {type(source).__name__}."
        ) from None
    if not np.isfinite(value):
        raise InputError(f"{name} is {value}, but must be a finite number.")
    return np.array([value])


def _from_fit(fit: FitResult, name: str, levels: np.ndarray) -> np.ndarray:
    if name not in fit.parameters:
        raise InputError(f"the fit has no {name!r}; it has {', '.join(fit.parameters)}.")
    estimate = fit.parameters[name]
    if estimate.verdict == "fixed":
        return np.array([estimate.value])
    if estimate.std is None:
        raise InputError(
            f"the fit leaves {name!r} without a standard deviation ({estimate.reason}): "
            "plan on a posterior, or on a number."
        )
    lower, upper = fit.problem.parameters[name].bounds
    return np.clip(fit.quantiles(name, levels), lower, upper)
