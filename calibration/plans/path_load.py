"""Force and form error along a path, from its engagement. Lengths in mm, forces in N."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from calibration.plans.path import Survey
from procmodel.engagement import Cut, ForceCoefficients, ToolStiffness

# Angles at which the laws are evaluated; between them they are smooth enough for straight lines.
_NODES = 1025
_HEIGHTS = 9


@dataclass(frozen=True)
class PathLoad:
    """What the engagement along a path does to tool and wall.

    Attributes
    ----------
    peak : ndarray, shape (n,) [N]
        Greatest force across the tool's axis in a turn.
    mean : ndarray, shape (n,) [N]
        Mean force across the tool's axis.
    form_error : ndarray, shape (n,) [mm], or None
        Greatest over the heights; positive where material is left. None without a stiffness.
    """

    peak: np.ndarray
    mean: np.ndarray
    form_error: np.ndarray | None

    def as_dict(self) -> dict[str, Any]:
        """Range of each along the path, form errors in um."""
        figures: dict[str, Any] = {
            "peak_n": {"min": float(self.peak.min()), "max": float(self.peak.max())},
            "mean_n": {"min": float(self.mean.min()), "max": float(self.mean.max())},
        }
        if self.form_error is not None:
            error = 1e3 * self.form_error
            figures["form_error_um"] = {"min": float(error.min()), "max": float(error.max())}
        return figures


def load_along(
    survey: Survey, cut: Cut, coefficients: ForceCoefficients, tool: ToolStiffness | None = None
) -> PathLoad:
    """Force and form error at every place of a survey.

    Parameters
    ----------
    survey : Survey
        Engagement along the path.
    cut : Cut
        How the tool cuts.
    coefficients : ForceCoefficients
        Of tool and material.
    tool : ToolStiffness, optional
        How the tool gives way; without it there is no form error.

    Returns
    -------
    PathLoad
        At the places of the survey.
    """
    angles = np.linspace(float(survey.angle.min()), float(survey.angle.max()), _NODES)

    def along(law: Callable[[Any], Any]) -> np.ndarray:
        values = np.asarray(jax.jit(jax.vmap(law))(jnp.asarray(angles)))
        return np.interp(survey.angle, angles, values)

    heights = jnp.linspace(0.0, cut.axial_depth, _HEIGHTS)
    error = None
    if tool is not None:
        error = along(lambda a: jnp.max(cut.form_error(coefficients, a, tool, heights)))
    return PathLoad(
        along(lambda a: cut.peak_force(coefficients, a)),
        along(lambda a: jnp.hypot(*cut.mean_force(coefficients, a)[:2])),
        error,
    )
