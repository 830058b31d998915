"""The wear ratio that `wear plan` plans with: a number, a fit or a posterior."""

import json
import math
from pathlib import Path
from typing import Any

from procmodel.errors import InputError


def believed_of(
    wear_ratio: float | None, fit: Path | None, posterior: Path | None, area: float
) -> tuple[Any, list[str]]:
    """Wear ratio as the plans take it, and what to note about where it came from.

    Parameters
    ----------
    wear_ratio : float, optional
        Number taken as exact.
    fit : Path, optional
        JSON of `wear fit --out`.
    posterior : Path, optional
        netCDF of `wear fit --posterior`.
    area : float [um^2]
        Cross-section of the electrode that is planned for.

    Returns
    -------
    (float, ndarray or xarray.DataTree, list of str)
        The wear ratio, and notes.

    Raises
    ------
    InputError
        If not exactly one of the three is given, or its file cannot be used.
    """
    given = [value is not None for value in (wear_ratio, fit, posterior)]
    if sum(given) != 1:
        raise InputError("give one of --wear-ratio, --fit and --posterior.")
    if wear_ratio is not None:
        from procmodel.wear.zmap_run import LARGEST_WEAR_RATIO

        if not 0.0 <= wear_ratio <= LARGEST_WEAR_RATIO:
            raise InputError(
                f"--wear-ratio is {wear_ratio:g}, but must be from 0 to {LARGEST_WEAR_RATIO:g}: "
                "the electrode's volume lost over the workpiece's removed, not in percent."
            )
        notes = ["a wear ratio of 0 is an electrode that does not wear"] if wear_ratio == 0 else []
        return wear_ratio, notes
    if posterior is not None:
        return _read_posterior(posterior), []
    assert fit is not None
    return _read_fit(fit, area)


def _read_posterior(path: Path) -> Any:
    import xarray

    if not path.is_file():
        raise InputError(f"{path.name} is not a file: give the netCDF of 'wear fit --posterior'.")
    try:
        tree = xarray.load_datatree(path, engine="h5netcdf")
    except (OSError, ValueError):
        raise InputError(
            f"{path.name} cannot be read as netCDF: give the file of 'wear fit --posterior'."
        ) from None
    return tree


def _read_fit(path: Path, area: float) -> tuple[Any, list[str]]:
    """Equally likely wear ratios from the JSON of a fit."""
    import numpy as np

    from calibration.plans.belief import NODES, different_area
    from calibration.result import student_quantile
    from procmodel.io.textfile import read_utf8

    try:
        result = json.loads(read_utf8(path))
        estimate = result["parameters"]["wear_ratio"]
        fitted_area = result["parameters"]["electrode_area"]["value"]
        value, std = estimate["value"], estimate["std"]
        freedom = estimate["degrees_of_freedom"] or math.inf
    except (json.JSONDecodeError, KeyError, TypeError):
        raise InputError(
            f"{path.name} is not a result of a fit: give the JSON of 'wear fit --out'."
        ) from None
    if not result.get("converged") or std is None:
        raise InputError(
            f"{path.name} has no usable wear_ratio ({estimate['reason'] or result['status']}): "
            "fit again, or give --wear-ratio."
        )
    differs = abs(fitted_area / area - 1) > 1e-6
    notes = [different_area(fitted_area, area)] if differs else []
    levels = (np.arange(NODES) + 0.5) / NODES
    return np.maximum(value + std * student_quantile(levels, freedom), 0.0), notes
