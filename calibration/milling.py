"""From measured cutting forces to the coefficients of a tool in a material.

Mean forces are linear in the six coefficients, instantaneous ones too, but for the angle at which
the spindle's rotation counts from 0. Lengths in mm, forces in N, angles in rad.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.fitting import fit
from calibration.parameters import Parameter
from calibration.problem import Dataset, Problem
from calibration.result import FitResult
from calibration.structure import Model
from procmodel.engagement import ForceCoefficients, instantaneous_force, mean_force
from procmodel.engagement.form_error import require_flutes, require_helix
from procmodel.errors import InputError, nearest
from procmodel.io import ForceReadings

AXES = ("Fx", "Fy", "Fz")
# Each coefficient with its unit and what it usually is about, where a fit starts.
COEFFICIENTS = {
    "tangential_shear": ("N/mm^2", 1000.0),
    "radial_shear": ("N/mm^2", 300.0),
    "axial_shear": ("N/mm^2", 200.0),
    "tangential_edge": ("N/mm", 20.0),
    "radial_edge": ("N/mm", 20.0),
    "axial_edge": ("N/mm", 2.0),
}
_AXIAL = ("axial_shear", "axial_edge")
# Angles tried in a pitch for where the rotation counts from, and the readings used for that.
_OFFSETS, _MOST_READINGS = 120, 2000
# Correlation of neighbouring residuals, times the root of their number, that chance explains in
# less than one of 4000 records.
_FOLLOWING = 3.5


@dataclass(frozen=True)
class MeanForce:
    """Mean force along an axis, as a model: coefficients by name, conditions in x.

    Parameters
    ----------
    axis : int
        0, 1, 2 for x, y, z.
    flutes : int
        Number of flutes.
    """

    axis: int
    flutes: int

    def __call__(self, params: Mapping[str, Array], x: Mapping[str, Array]) -> Array:
        """Force, shape (n,) [N]."""
        coefficients = coefficients_in(params)
        where = x["start"], x["exit"]
        force = mean_force(coefficients, *where, self.flutes, x["axial_depth"], x["feed_per_tooth"])
        return force[..., self.axis]


@dataclass(frozen=True)
class InstantaneousForce:
    """Force along an axis at an angle of the spindle; parameters radius, helix, rotation_offset.

    Parameters
    ----------
    axis : int
        0, 1, 2 for x, y, z.
    flutes : int
        Number of flutes.
    """

    axis: int
    flutes: int

    def __call__(self, params: Mapping[str, Array], x: Mapping[str, Array]) -> Array:
        """Force, shape (n,) [N]."""
        force = instantaneous_force(
            coefficients_in(params),
            jnp.mod(x["rotation"] + params["rotation_offset"], 2.0 * jnp.pi),
            x["start"],
            x["exit"],
            self.flutes,
            x["axial_depth"],
            x["feed_per_tooth"],
            params["radius"],
            params["helix"],
        )
        return force[..., self.axis]


@dataclass(frozen=True)
class ForceFit:
    """Fitted cutting forces.

    Attributes
    ----------
    result : FitResult
        Parameters named as in `ForceCoefficients` (the axial ones only where Fz was measured) and,
        for instantaneous forces, `radius`, `helix`, `rotation_offset`; data sets Fx, Fy, Fz.
    readings : ForceReadings
        The readings.
    flutes : int
        Number of flutes.
    """

    result: FitResult
    readings: ForceReadings
    flutes: int

    @property
    def coefficients(self) -> ForceCoefficients:
        """Best values; 0 for axial ones that were not fitted."""
        values = {name: estimate.value for name, estimate in self.result.parameters.items()}
        return coefficients_in(values)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What the fit's own verdicts do not say, as sentences."""
        notes = []
        if "Fz" not in self.readings.forces:
            notes.append("no Fz was measured: the axial coefficients are not fitted")
        for name in COEFFICIENTS:
            estimate = self.result.parameters.get(name)
            if estimate and estimate.interval95 and estimate.interval95[1] < 0.0:
                notes.append(
                    f"{name} is below 0: check the signs of the axes (x along the feed, y across, "
                    "forces on the tool) and where a flute enters"
                )
        if self.readings.rotation is not None:
            notes.append("all flutes are taken as alike: runout shows in the residuals")
            if not self.result.problem.parameters["rotation_offset"].fixed:
                pitch = 360.0 / self.flutes
                notes.append(f"rotation_offset is known up to the flutes' pitch of {pitch:g} deg")
        for axis, residuals in self.result.residuals.items():
            square = float(residuals @ residuals)
            follow = float(residuals[1:] @ residuals[:-1]) / square if square > 0 else 0.0
            if follow > _FOLLOWING / math.sqrt(len(residuals)):
                notes.append(
                    f"neighbouring residuals of {axis} are alike (correlation {follow:.2f}): the "
                    "model misses part of the force and the intervals are too narrow"
                )
        return tuple(notes)

    def as_dict(self) -> dict[str, Any]:
        """The fit as plain JSON types, which `procmodel.io.read_coefficients` reads."""
        found = self.result.as_dict()
        found["warnings"] = [*found["warnings"], *self.notes]
        found["flutes"] = self.flutes
        return found


def fit_force_coefficients(
    readings: ForceReadings,
    flutes: int,
    *,
    radius: float | None = None,
    helix: float | None = None,
    sigma: float | Mapping[str, Any] | None = None,
    rotation_offset: float = 0.0,
    fit_rotation_offset: bool = False,
    parameters: Mapping[str, Parameter | float] | None = None,
    solver: str = "box_lm",
) -> ForceFit:
    """Fit the force coefficients to measured forces.

    Parameters
    ----------
    readings : ForceReadings
        Mean forces, or instantaneous ones where it has a rotation.
    flutes : int
        Number of flutes.
    radius, helix : float, optional [mm], [rad]
        Of the tool; needed for instantaneous forces, for mean ones they do not matter.
    sigma : float or mapping of str to float or array_like, optional [N]
        Standard deviation of all forces, or by axis; estimated for every axis when left out.
    rotation_offset : float [rad]
        Angle of a flute at the tool's end, from +y, when the rotation reads 0.
    fit_rotation_offset : bool
        Fit that angle too, wherever in a pitch it may be.
    parameters : mapping of str to Parameter or float, optional
        Instead of the free ones: a number fixes a coefficient, a `Parameter` gives it bounds or a
        prior.
    solver : str
        See `calibration.fit`.

    Returns
    -------
    ForceFit
        The fit. Coefficients that the forces leave open (such as shearing and edge ones, from one
        feed at one engagement) are named by its result.

    Raises
    ------
    InputError
        If the tool is not known well enough for this kind of readings, or a name is unknown.
    """
    require_flutes(flutes)
    instantaneous = readings.rotation is not None
    chosen = {
        name: Parameter(typical, unit)
        for name, (unit, typical) in COEFFICIENTS.items()
        if "Fz" in readings.forces or name not in _AXIAL
    }
    chosen |= _tool(instantaneous, radius, helix, rotation_offset, fit_rotation_offset)
    for name, given in (parameters or {}).items():
        if name not in chosen:
            raise InputError(f"parameter {name!r} is unknown{nearest(name, tuple(chosen))}.")
        unit = chosen[name].unit
        chosen[name] = given if isinstance(given, Parameter) else Parameter(given, unit, fixed=True)
    problem = _problem(readings, flutes, chosen, sigma)
    if fit_rotation_offset:
        problem = _problem(readings, flutes, _started(problem, flutes), sigma)
    return ForceFit(fit(problem, solver), readings, flutes)


def coefficients_in(params: Mapping[str, Any]) -> ForceCoefficients:
    """The coefficients among parameters.

    Parameters
    ----------
    params : mapping of str to array_like
        Parameters by name.

    Returns
    -------
    ForceCoefficients
        Those of the same names; axial ones that are absent are 0.
    """
    return ForceCoefficients(
        **{n: 0.0 if n in _AXIAL and n not in params else params[n] for n in COEFFICIENTS}
    )


def _tool(
    instantaneous: bool,
    radius: float | None,
    helix: float | None,
    rotation_offset: float,
    fit_rotation_offset: bool,
) -> dict[str, Parameter]:
    """What instantaneous forces depend on besides the coefficients."""
    if not instantaneous:
        if fit_rotation_offset:
            raise InputError(
                "a rotation offset shows in instantaneous forces alone: give the rotation of each "
                "reading, or leave the offset out."
            )
        return {}
    if radius is None or helix is None:
        missing = "radius" if radius is None else "helix"
        raise InputError(f"{missing} is missing: instantaneous forces depend on the tool's.")
    if not (math.isfinite(radius) and radius > 0):
        raise InputError(f"radius is {radius:g} mm, but must be above 0.")
    require_helix(helix)
    return {
        "radius": Parameter(radius, "mm", fixed=True),
        "helix": Parameter(helix, "rad", fixed=True),
        "rotation_offset": Parameter(rotation_offset, "rad", fixed=not fit_rotation_offset),
    }


def _problem(
    readings: ForceReadings,
    flutes: int,
    parameters: Mapping[str, Parameter],
    sigma: float | Mapping[str, Any] | None,
) -> Problem:
    names = ("feed_per_tooth", "axial_depth", "start", "exit", "rotation")
    x = {name: getattr(readings, name) for name in names if getattr(readings, name) is not None}
    if isinstance(sigma, Mapping):
        for axis in sigma:
            if axis not in readings.forces:
                known = tuple(readings.forces)
                raise InputError(f"sigma names unknown force {axis!r}{nearest(axis, known)}.")
    datasets = {}
    for axis, force in readings.forces.items():
        number = AXES.index(axis)
        model: Model = (
            MeanForce(number, flutes)
            if readings.rotation is None
            else InstantaneousForce(number, flutes)
        )
        spread = sigma.get(axis) if isinstance(sigma, Mapping) else sigma
        datasets[axis] = Dataset(x, force, spread, model)
    kind = "mean" if readings.rotation is None else "instantaneous"
    name = f"{kind} cutting force of {flutes} flutes, shearing and edge coefficients"
    return Problem(parameters, datasets, name=name)


def _started(problem: Problem, flutes: int) -> dict[str, Parameter]:
    """Parameters that start at the best of many offsets, each with its best coefficients."""
    values = {name: p.value for name, p in problem.parameters.items()}
    names = [n for n in COEFFICIENTS if n in problem.layout.free]
    pitch = 2.0 * math.pi / flutes
    first = values["rotation_offset"]
    offsets = first + pitch * np.arange(_OFFSETS) / _OFFSETS
    step = max(1, -(-problem.size // _MOST_READINGS))
    thinned = [
        (d.function, jax.tree.map(lambda v: v[::step], d.x)) for d in problem.datasets.values()
    ]
    measured = np.concatenate([d.y[::step] for d in problem.datasets.values()])
    size = np.array([max(abs(values[n]), 1.0) for n in names])

    def forces(shares: Array, offset: Array) -> Array:
        moved = dict(zip(names, shares * size, strict=True))
        at: dict[str, Any] = {**values, **moved, "rotation_offset": offset}
        return jnp.concatenate([function(at, x) for function, x in thinned if function])

    none = jnp.zeros(len(names))
    linear = jax.jit(lambda offset: (forces(none, offset), jax.jacfwd(forces)(none, offset)))
    best, least = (offsets[0], np.ones(len(names))), math.inf
    for offset in offsets:
        rest, slopes = (np.asarray(a) for a in linear(offset))
        shares = np.linalg.lstsq(slopes, measured - rest, rcond=1e-9)[0]
        misfit = float(np.sum((slopes @ shares + rest - measured) ** 2))
        if misfit < least:
            best, least = (offset, shares), misfit
    offset, shares = best
    starts = dict(zip(names, (shares * size).tolist(), strict=True)) | {
        "rotation_offset": float(offset)
    }
    return {n: _moved(p, starts.get(n, p.value)) for n, p in problem.parameters.items()}


def _moved(parameter: Parameter, start: float) -> Parameter:
    """The parameter with another start, as near to it as its bounds allow."""
    lower, upper = parameter.bounds
    return replace(parameter, value=min(max(start, lower), upper))
