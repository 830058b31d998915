"""Pictures of fitted cutting forces."""

import numpy as np
from matplotlib.figure import Figure

from calibration.milling import ForceFit
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, two_panels

_COLOURS = {"Fx": BLUE, "Fy": ORANGE, "Fz": GREEN}


def draw_forces(found: ForceFit) -> Figure:
    """Measured against fitted force of every axis, and the residuals.

    Parameters
    ----------
    found : ForceFit
        From `calibration.milling.fit_force_coefficients`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure, (against, left) = two_panels()
    ends = []
    for axis, residuals in found.result.residuals.items():
        measured = found.readings.forces[axis]
        fitted, colour = measured - residuals, _COLOURS[axis]
        against.plot(fitted, measured, ".", color=colour, ms=4, label=axis)
        left.plot(fitted, residuals, ".", color=colour, ms=4)
        ends += [np.min(fitted), np.max(fitted)]
    along = [min(ends), max(ends)]
    against.plot(along, along, color=GREY, lw=0.8, zorder=0)
    left.axhline(0.0, color=GREY, lw=0.8, zorder=0)
    against.set_title(found.result.problem.name, fontsize=10, loc="left")
    against.set_ylabel("measured force [N]")
    against.legend(frameon=False, fontsize=9)
    left.set_xlabel("fitted force [N]")
    left.set_ylabel("measured − fitted [N]")
    return figure
