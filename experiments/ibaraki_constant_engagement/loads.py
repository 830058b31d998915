"""Force and wall error along the open wall, with a stiffness fitted to the paper's 14 um.

The paper's 14 um may be what is left on the wall in the arc, or what is left there more than on the
lines, which are its reference faces A and B. Both readings are fitted. Lengths in mm, forces in N.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.milling_wall import FormErrorFit, fit_form_error
from calibration.plans.path_load import PathLoad, load_along
from experiments.ibaraki_constant_engagement.conditions import Conditions
from experiments.ibaraki_constant_engagement.passes import OpenWall
from procmodel.engagement import (
    ForceCoefficients,
    MeasuredStiffness,
    engagement_angle_constant_curvature,
    published_coefficients,
)


@dataclass(frozen=True)
class Reading:
    """What follows from one way to read the paper's 14 um.

    Attributes
    ----------
    name : str
        Which way.
    fit : FormErrorFit
        Stiffness, on published coefficients of another material.
    on_line : float [mm]
        Wall error on a line as the paper would have measured it: 0 where lines are the reference.
    before, after : PathLoad
        Along the plain and the corrected pass.
    """

    name: str
    fit: FormErrorFit
    on_line: float
    before: PathLoad
    after: PathLoad

    @property
    def stiffness(self) -> float:
        """The fitted one [N/mm]."""
        return self.fit.result.parameters["stiffness"].value

    @property
    def offset(self) -> float:
        """What the reference takes off every wall error [mm]."""
        return self.fit.result.parameters["zero"].value

    def read(self, load: PathLoad) -> np.ndarray:
        """Wall error as the paper would have measured it, shape (n,) [mm]."""
        assert load.form_error is not None
        return load.form_error + self.offset

    @property
    def left_at_junction(self) -> float:
        """Greatest error of the corrected wall, more than on its lines [mm]."""
        return float(np.max(self.read(self.after))) - self.on_line

    @property
    def left_in_arc(self) -> float:
        """Greatest error of the plain wall [mm]."""
        return float(np.max(self.read(self.before)))


@dataclass(frozen=True)
class Loads:
    """Forces with published coefficients, and both readings.

    Attributes
    ----------
    coefficients : ForceCoefficients
        Of `Conditions.material`.
    wall_force : tuple of float [N]
        Across the wall as it is generated: on a line, in the arc, at the floor.
    absolute, relative : Reading
        The 14 um as what is left, and as what is left more than on the lines.
    """

    coefficients: ForceCoefficients
    wall_force: tuple[float, float, float]
    absolute: Reading
    relative: Reading

    def variation(self, law: str, corrected: bool) -> float:
        """Greatest less least force along the pass [N]; `law` is "peak" or "mean"."""
        load = self.absolute.after if corrected else self.absolute.before
        return float(np.ptp(getattr(load, law)))


def loads(wall: OpenWall, conditions: Conditions) -> Loads:
    """Forces along both passes, and the wall error for both readings of the 14 um."""
    coefficients = published_coefficients(conditions.material).coefficients
    cut, height = conditions.cut, conditions.reading_height
    arc = float(
        engagement_angle_constant_curvature(
            conditions.radial_depth, conditions.radius, 1.0 / conditions.corner
        )
    )
    left = conditions.paper.left_in_arc
    places = np.array([wall.target, arc, wall.floor])
    across = np.asarray(cut.wall_force(coefficients, places, np.array([height])))[:, 0, 1]

    # Wall errors are in proportion to 1 / stiffness: one evaluation serves both readings.
    one = MeasuredStiffness(1.0)
    before, after = (load_along(s, cut, coefficients, one) for s in (wall.before, wall.after))

    def reading(name: str, fit: FormErrorFit) -> Reading:
        k, zero = (fit.result.parameters[n].value for n in ("stiffness", "zero"))
        return Reading(
            name,
            fit,
            float(across[0]) / k + zero,
            _softened(before, k),
            _softened(after, k),
        )

    sigma = conditions.reading_sigma
    absolute = fit_form_error([arc], [left], cut, coefficients, heights=height, sigma=sigma)
    relative = fit_form_error(
        [wall.target, arc], [0.0, left], cut, coefficients,
        heights=height, fit_zero=True, sigma=sigma,
    )  # fmt: skip
    return Loads(
        coefficients,
        (float(across[0]), float(across[1]), float(across[2])),
        reading("14 µm are what is left in the arc", absolute),
        reading("14 µm are arc less lines", relative),
    )


def _softened(load: PathLoad, stiffness: float) -> PathLoad:
    """The same load on a tool of another stiffness than 1 N/mm."""
    assert load.form_error is not None
    return replace(load, form_error=load.form_error / stiffness)
