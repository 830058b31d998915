"""A plan as its files will hold it: arcs within a tolerance, coordinates rounded, checked again."""

import numpy as np

from calibration.plans.path import PathPlan, Survey, survey
from procmodel.engagement.biarcs import simplified
from procmodel.engagement.contour import Contour, contour
from procmodel.engagement.surface import Surface, cleared_by

# Four decimals of a millimetre, as programs are written.
_DECIMALS = 4
# A path of more pieces than this for its length [1/mm] was marched, not constructed.
_MARCHED = 20.0


def as_written(plan: PathPlan, tolerance: float) -> tuple[list[list[Contour]], Survey]:
    """Paths as they are written, and the engagement of the last one along them.

    Parameters
    ----------
    plan : PathPlan
        The plan.
    tolerance : float [mm]
        Of arcs through marched paths; constructed lines and arcs are kept as they are.

    Returns
    -------
    passes : list of list of Contour
        In the order of cutting, coordinates rounded to 0.1 um.
    engagement : Survey
        Of the last pass on the surface that the pass before leaves, both as written.
    """
    passes = [[_rounded(_thinned(c, tolerance)) for c in one] for one in plan.passes]
    met = plan.after.surface
    if len(passes) > 1:
        tool = plan.previous_radius
        met = Surface(cleared_by(passes[-2], tool))
    spacing = 0.002 * plan.radius
    return passes, survey(passes[-1], met, plan.radius, plan.target, spacing)


def _thinned(path: Contour, tolerance: float) -> Contour:
    dense = len(path.bulges) > _MARCHED * path.length
    return simplified(path, tolerance) if dense else path


def _rounded(path: Contour) -> Contour:
    points = np.round(np.asarray(path.points), _DECIMALS)
    count = len(path.bulges)
    following = np.roll(points, -1, axis=0)[:count]
    kept = np.any(points[:count] != following, axis=1)
    bulges = np.asarray(path.bulges)[kept]
    points = points[kept] if path.closed else np.concatenate([points[:count][kept], points[-1:]])
    return contour(points, bulges, path.closed, path.name)
