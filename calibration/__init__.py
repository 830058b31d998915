"""Calibration: everything that solves for an unknown.

`Parameter`, `Problem`, `fit` and `sample` are the way through. Names are loaded when first
used, so that importing the package (as the command does for its help) does not load JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.archive import SavedResult, load_result, save_result
    from calibration.black_box import BlackBox
    from calibration.comparison import compare_models
    from calibration.design import next_measurement
    from calibration.fitting import fit
    from calibration.intervals import compare_intervals
    from calibration.many import ManyFits, fit_many, fit_stream
    from calibration.noise import AR1, Gaussian, Noise, Relative, Robust, StudentT
    from calibration.parameters import Parameter
    from calibration.posterior import with_predictions
    from calibration.priors import (
        Beta,
        Custom,
        HalfNormal,
        LogNormal,
        Normal,
        Prior,
        Truncated,
        Uniform,
    )
    from calibration.problem import Dataset, Problem
    from calibration.profiling import ProfileLikelihood, profile
    from calibration.ranks import simulation_check
    from calibration.result import FitResult, ParameterEstimate
    from calibration.sampling import sample
    from calibration.solvers.multistart import Multistart, multistart

_HOMES = {
    "AR1": "calibration.noise",
    "Beta": "calibration.priors",
    "BlackBox": "calibration.black_box",
    "Custom": "calibration.priors",
    "Dataset": "calibration.problem",
    "FitResult": "calibration.result",
    "Gaussian": "calibration.noise",
    "HalfNormal": "calibration.priors",
    "LogNormal": "calibration.priors",
    "ManyFits": "calibration.many",
    "Multistart": "calibration.solvers.multistart",
    "Noise": "calibration.noise",
    "Normal": "calibration.priors",
    "Parameter": "calibration.parameters",
    "ParameterEstimate": "calibration.result",
    "Prior": "calibration.priors",
    "Problem": "calibration.problem",
    "ProfileLikelihood": "calibration.profiling",
    "Relative": "calibration.noise",
    "Robust": "calibration.noise",
    "SavedResult": "calibration.archive",
    "StudentT": "calibration.noise",
    "Truncated": "calibration.priors",
    "Uniform": "calibration.priors",
    "compare_intervals": "calibration.intervals",
    "compare_models": "calibration.comparison",
    "fit": "calibration.fitting",
    "fit_many": "calibration.many",
    "fit_stream": "calibration.many",
    "load_result": "calibration.archive",
    "multistart": "calibration.solvers.multistart",
    "next_measurement": "calibration.design",
    "profile": "calibration.profiling",
    "sample": "calibration.sampling",
    "save_result": "calibration.archive",
    "simulation_check": "calibration.ranks",
    "with_predictions": "calibration.posterior",
}

__all__ = [
    "AR1",
    "Beta",
    "BlackBox",
    "Custom",
    "Dataset",
    "FitResult",
    "Gaussian",
    "HalfNormal",
    "LogNormal",
    "ManyFits",
    "Multistart",
    "Noise",
    "Normal",
    "Parameter",
    "ParameterEstimate",
    "Prior",
    "Problem",
    "ProfileLikelihood",
    "Relative",
    "Robust",
    "SavedResult",
    "StudentT",
    "Truncated",
    "Uniform",
    "compare_intervals",
    "compare_models",
    "fit",
    "fit_many",
    "fit_stream",
    "load_result",
    "multistart",
    "next_measurement",
    "profile",
    "sample",
    "save_result",
    "simulation_check",
    "with_predictions",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
