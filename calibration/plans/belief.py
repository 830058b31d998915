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


def believed_wear_ratio(source: Any, electrode_area: float) -> tuple[np.ndarray, tuple[str, ...]]:
    """Equally likely wear ratios for one electrode, and what to know about them.

    Depths determine the wear per area, so a fit that leaves wear ratio and electrode area open
    can be planned on all the same.

    Parameters
    ----------
    source : float, FitResult, xarray.DataTree or ndarray of shape (m,)
        See `believed_values`.
    electrode_area : float [um^2]
        Cross-section of the electrode that is planned for.

    Returns
    -------
    ndarray, shape (1,) or (NODES,)
        The wear ratios.
    tuple of str
        Cautions, as sentences.

    Raises
    ------
    InputError
        As `believed_values`.
    """
    open_ratio = (
        "wear_ratio and electrode_area were both open: planned on wear_per_area, which holds for "
        "the electrode of the test cavity alone"
    )
    fitted_area = None
    if isinstance(source, FitResult):
        ratio = source.parameters.get("wear_ratio")
        per_area = source.parameters.get("wear_per_area")
        if ratio and ratio.std is None and ratio.verdict == "flat" and per_area and per_area.std:
            return believed_values(source, "wear_per_area") * electrode_area, (open_ratio,)
        area = source.parameters.get("electrode_area")
        fitted_area = area.value if area else None
    elif hasattr(source, "attrs"):
        if {"wear_per_area", "electrode_area"} <= set(source["posterior"].dataset):
            return believed_values(source, "wear_per_area") * electrode_area, (open_ratio,)
        fitted_area = source.attrs.get("fixed_electrode_area")
    cautions = []
    if fitted_area is not None and abs(fitted_area / electrode_area - 1.0) > 1e-6:
        cautions.append(different_area(fitted_area, electrode_area))
    if hasattr(source, "attrs") and not source.attrs.get("converged", 1):
        cautions.append(f"the posterior is not to be trusted yet: {source.attrs['status']}")
    return believed_values(source, "wear_ratio"), tuple(cautions)


def different_area(fitted: float, planned: float) -> str:
    """Caution for a wear ratio that comes from another electrode, as a sentence."""
    return (
        f"the wear ratio was found with an electrode area of {fitted:.6g} um^2 and the plan has "
        f"{planned:.6g}: it carries over only as far as the first was right"
    )


def _from_fit(fit: FitResult, name: str, levels: np.ndarray) -> np.ndarray:
    if name not in fit.parameters:
        raise InputError(f"the fit has no {name!r}; it has {', '.join(fit.parameters)}.")
    if not fit.converged:
        raise InputError(f"the fit cannot be planned on ({fit.status}): fit again first.")
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
