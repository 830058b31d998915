"""Calibration: everything that solves for an unknown.

`Parameter`, `Problem`, `fit` and `sample` are the way through. Names are loaded when first
used, so that importing the package (as the command does for its help) does not load JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.fitting import fit
    from calibration.parameters import Parameter
    from calibration.priors import HalfNormal, LogNormal, Normal, Prior, Uniform
    from calibration.problem import Dataset, Problem
    from calibration.result import FitResult, ParameterEstimate
    from calibration.sampling import sample

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
    "Normal": "calibration.priors",
    "Parameter": "calibration.parameters",
    "ParameterEstimate": "calibration.result",
    "Prior": "calibration.priors",
    "Problem": "calibration.problem",
    "Relative": "calibration.noise",
    "Robust": "calibration.noise",
    "StudentT": "calibration.noise",
    "Truncated": "calibration.priors",
    "Uniform": "calibration.priors",
    "fit": "calibration.fitting",
    "sample": "calibration.sampling",
    "with_predictions": "calibration.posterior",
}

__all__ = [
    "Dataset",
    "FitResult",
    "HalfNormal",
    "LogNormal",
    "Normal",
    "Parameter",
    "ParameterEstimate",
    "Prior",
    "Problem",
    "Uniform",
    "fit",
    "sample",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
