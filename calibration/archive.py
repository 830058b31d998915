"""Results in files: fit, intervals and draws as one netCDF, readable without the model."""

import functools
import importlib.metadata
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray
from jax import Array

from calibration.intervals import IntervalTable, compare_intervals
from calibration.profiling import ProfileLikelihood
from calibration.result import FitResult
from calibration.structure import ProblemStructure
from procmodel.errors import InputError
from procmodel.io import check_target, writing

_FORMAT = "procmodel result 1"


@dataclass(frozen=True)
class SavedResult:
    """A result as read back from its file, without the model's code.

    Attributes
    ----------
    tree : xarray.DataTree
        Everything in the file: groups ``fit``, ``residuals``, and those of the posterior.
    fit : dict
        What `FitResult.as_dict` gave.
    intervals : IntervalTable
        The three kinds of interval side by side.
    information : dict of str to float
        ``log_likelihood``, ``parameters``, ``readings``, ``aic``, ``aicc`` and ``bic`` of the fit.
    """

    tree: xarray.DataTree
    fit: dict[str, Any]
    intervals: IntervalTable
    information: dict[str, float | None]

    @property
    def has_draws(self) -> bool:
        """Whether there are draws from the posterior."""
        return "posterior" in self.tree.children

    def report(self) -> str:
        """The fit's report, the intervals side by side, and how the draws came about.

        Returns
        -------
        str
            Several lines.
        """
        parts = [str(self.tree.attrs["fit_report"]), self.intervals.report()]
        attrs = self.tree.attrs
        if self.has_draws:
            parts.append(
                f"draws     {attrs['sampler']} ({attrs['sampler_reason']}), seed {attrs['seed']}\n"
                f"status    {attrs['status']}"
            )
        known = [
            f"{name} {self.information[key]:.6g}"
            for key, name in (("log_likelihood", "log-likelihood"), ("aic", "AIC"), ("bic", "BIC"))
            if self.information[key] is not None
        ]
        parts.append(f"{', '.join(known)}\nwritten by procmodel {attrs['procmodel_version']}")
        return "\n\n".join(parts)


def save_result(
    path: str | Path,
    result: FitResult,
    profile: ProfileLikelihood | None = None,
    posterior: xarray.DataTree | None = None,
) -> None:
    """Write a result, complete or not at all.

    Parameters
    ----------
    path : path-like
        The file, ending in .nc.
    result : FitResult
        The fit.
    profile : ProfileLikelihood, optional
        Its profile likelihood.
    posterior : xarray.DataTree, optional
        Draws, with predictions where `with_predictions` made them.

    Raises
    ------
    InputError
        If the file cannot be written there, or profile or posterior are of other data.
    """
    path = Path(path)
    if path.suffix != ".nc":
        raise InputError(f"{path.name}: a result ends in .nc: rename it.")
    check_target(path)
    table = compare_intervals(result, profile, posterior, profile.level if profile else 0.95)
    tree = xarray.DataTree() if posterior is None else posterior.copy()
    tree.attrs = {
        **tree.attrs,
        "format": _FORMAT,
        "model": result.problem.name,
        "data_hash": result.problem.data_hash,
        "readings_hash": result.problem.readings_hash,
        "procmodel_version": importlib.metadata.version("procmodel"),
        "jax_version": jax.__version__,
        "fit": json.dumps(result.as_dict()),
        "fit_report": result.report(),
        "intervals": json.dumps(table.as_dict()),
        "information": json.dumps(information(result)),
    }
    free = list(result.free)
    estimates = [result.parameters[name] for name in result.parameters]
    tree["fit"] = xarray.Dataset(
        {
            "value": ("parameter", [p.value for p in estimates]),
            "std": ("parameter", [math.nan if p.std is None else p.std for p in estimates]),
            "verdict": ("parameter", [p.verdict for p in estimates]),
            "unit": ("parameter", [p.unit for p in estimates]),
            "covariance": (("free", "free_too"), result.covariance),
        },
        coords={"parameter": list(result.parameters), "free": free, "free_too": free},
    )
    tree["residuals"] = xarray.Dataset(
        {name: (f"{name}_reading", values) for name, values in result.residuals.items()}
    )
    with writing(path) as draft:
        tree.to_netcdf(draft, engine="h5netcdf")


def load_result(path: str | Path) -> SavedResult:
    """Read a result; the model's code is not needed.

    Parameters
    ----------
    path : path-like
        A file of `save_result`.

    Returns
    -------
    SavedResult
        The result.

    Raises
    ------
    InputError
        If the file is missing or not a result of this library.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: check the name.")
    try:
        with xarray.open_datatree(path, engine="h5netcdf") as opened:
            tree = opened.load()
        written_as = str(tree.attrs["format"])
        if written_as == _FORMAT:
            fit, table, criteria = (
                json.loads(tree.attrs[name]) for name in ("fit", "intervals", "information")
            )
            return SavedResult(tree, fit, IntervalTable.from_dict(table), criteria)
    except (OSError, KeyError, ValueError, TypeError):
        raise InputError(
            f"{path.name} is not a result of this library: give a file that `procmodel fit` or "
            "save_result wrote."
        ) from None
    raise InputError(
        f"{path.name} is {written_as!r}, but this version reads {_FORMAT!r}: read it with the "
        "version that wrote it."
    )


def information(result: FitResult) -> dict[str, float | None]:
    """Log-likelihood of a fit and the information criteria that follow from it.

    A noise level that was estimated counts as a parameter, at its value of greatest likelihood.

    Parameters
    ----------
    result : FitResult
        The fit.

    Returns
    -------
    dict of str to float or None
        ``log_likelihood``, ``parameters``, ``readings``, ``aic``, ``aicc``, ``bic``; None for a
        criterion that needs more readings than there are.
    """
    problem = result.problem
    levels = []
    for name in problem.datasets:
        level = result.noise[name]
        if level is not None:
            level = max(float(np.sqrt(np.mean(result.residuals[name] ** 2))), np.finfo(float).tiny)
        levels.append(1.0 if level is None else level)
    densities = _log_likelihoods(
        problem.structure, result.vector, problem.fixed_values, problem.data(tuple(levels))
    )
    total = float(sum(np.sum(np.asarray(part)) for part in densities))
    count = len(result.free) + sum(level is not None for level in result.noise.values())
    readings = problem.size
    room = readings - count - 1
    aic = 2.0 * count - 2.0 * total
    found: Mapping[str, float | None] = {
        "log_likelihood": total,
        "parameters": count,
        "readings": readings,
        "aic": aic,
        "aicc": aic + 2.0 * count * (count + 1) / room if room > 0 else None,
        "bic": count * math.log(readings) - 2.0 * total,
    }
    return {
        name: value if value is None or math.isfinite(value) else None
        for name, value in found.items()
    }


@functools.partial(jax.jit, static_argnames="structure")
def _log_likelihoods(
    structure: ProblemStructure, vector: Array, fixed: Array, data: tuple
) -> tuple[Array, ...]:
    return structure.log_likelihoods(vector, fixed, data)
