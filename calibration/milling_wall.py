"""From measured deflections and wall errors to the stiffness of an end mill in its machine.

The error of a milled wall is proportional to the force coefficients and inversely proportional to
the stiffness: walls alone determine no more than their quotient. Lengths in mm, forces in N, angles
in rad.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from calibration.fitting import fit
from calibration.milling import COEFFICIENTS, ForceFit, coefficients_in
from calibration.parameters import Parameter
from calibration.priors import LogNormal
from calibration.problem import Dataset, Problem
from calibration.result import FitResult
from procmodel.engagement import (
    Cut,
    ForceCoefficients,
    MeasuredStiffness,
    ToolStiffness,
    form_error,
)
from procmodel.errors import InputError, nearest

# Published coefficients of one alloy differ by a factor of five between sources, end to end: a
# standard deviation on either side of the middle. What a force scale may be with no force measured.
PUBLISHED_SPREAD = LogNormal(1.0, 0.5 * math.log(5.0))


@dataclass(frozen=True)
class WallError:
    """Error of a wall, as a model: coefficients and stiffness by name, places and cut in x.

    Parameters
    ----------
    flutes : int
        Number of flutes.
    milling : {"down", "up"}
        Direction of milling.
    """

    flutes: int
    milling: str

    def __call__(self, params: Mapping[str, Array], x: Mapping[str, Any]) -> Array:
        """Error, shape (n,) [mm]."""
        coefficients, tool = coefficients_in(params), x.get("tool")
        tool = MeasuredStiffness(params["stiffness"]) if tool is None else tool

        def at(angle: Array, height: Array, feed: Array) -> Array:
            return form_error(
                coefficients,
                angle,
                self.flutes,
                x["axial_depth"],
                feed,
                x["radius"],
                x["helix"],
                tool,
                height[None],
                self.milling,
            )[0]

        places = x["angle"], x["height"], x["feed_per_tooth"]
        return params["force_scale"] * jax.vmap(at)(*places) + params["zero"]


@dataclass(frozen=True)
class FormErrorFit:
    """Fitted wall errors.

    Attributes
    ----------
    result : FitResult
        Parameters `stiffness` [N/mm] (unless a tool was given), `force_scale`, `zero` [mm], the
        coefficients, and `scale_per_stiffness` [mm/N]; data set `wall`, and those of the forces
        where they were fitted along.
    cut : Cut
        The cut.
    """

    result: FitResult
    cut: Cut

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What the wall errors cannot tell, whatever was held fixed, as sentences."""
        parameters = self.result.problem.parameters
        forces_measured = len(self.result.problem.datasets) > 1
        notes = []
        if not forces_measured and "stiffness" in parameters:
            notes.append(
                "stiffness and the force coefficients cannot be told apart by walls: +1 % in "
                "stiffness with +1 % in every coefficient changes no wall error, which determine "
                "scale_per_stiffness alone; measure forces, or the stiffness, to part them"
            )
        elif not forces_measured and not parameters["force_scale"].fixed:
            notes.append(
                "force_scale takes up what the tool was given too stiff or too soft: +1 % in "
                "force_scale with +1 % in the tool's stiffness changes no wall error"
            )
        return tuple(notes)

    def as_dict(self) -> dict[str, Any]:
        """The fit as plain JSON types."""
        found = self.result.as_dict()
        found["warnings"] = [*found["warnings"], *self.notes]
        return found


def fit_stiffness(
    force: ArrayLike,
    deflection: ArrayLike,
    sigma: ArrayLike | None = None,
    *,
    fit_zero: bool = False,
    solver: str = "box_lm",
) -> FitResult:
    """Fit the stiffness of a tool to deflections under known forces.

    Parameters
    ----------
    force, deflection : array_like, shape (n,) [N], [mm]
        Force across the tool, and how far it gave way in that direction.
    sigma : float or array_like, shape (n,), optional [mm]
        Standard deviation of the deflections; estimated when left out.
    fit_zero : bool
        Fit the deflection that the gauge shows without a force.
    solver : str
        See `calibration.fit`.

    Returns
    -------
    FitResult
        Parameters `stiffness` [N/mm] and `zero` [mm].

    Raises
    ------
    InputError
        If lengths differ, or the tool gives way against the force.
    """
    f, d = np.atleast_1d(np.asarray(force, float)), np.atleast_1d(np.asarray(deflection, float))
    if f.shape != d.shape:
        raise InputError(f"there are {f.size} forces for {d.size} deflections: give one each.")
    mean = (np.mean(f), np.mean(d)) if fit_zero else (0.0, 0.0)
    along = float((f - mean[0]) @ (d - mean[1]))
    if not along > 0:
        raise InputError(
            "the deflections do not grow with the force: give them positive in its direction, and "
            "more than one force where the zero is fitted."
        )
    parameters = {
        "stiffness": _stiffness(float((f - mean[0]) @ (f - mean[0])) / along),
        "zero": Parameter(0.0, "mm", fixed=not fit_zero),
    }
    problem = Problem.from_function(given_way, parameters, f, d, sigma, "stiffness of a tool")
    return fit(problem, solver)


def given_way(params: Mapping[str, Array], x: Array) -> Array:
    """Deflection under forces x: x / stiffness + zero; see `fit_stiffness`."""
    return x / params["stiffness"] + params["zero"]


def fit_form_error(
    angles: ArrayLike,
    errors: ArrayLike,
    cut: Cut,
    coefficients: ForceCoefficients | ForceFit | Mapping[str, Parameter | float],
    *,
    heights: ArrayLike,
    tool: ToolStiffness | None = None,
    stiffness: Parameter | float | None = None,
    force_scale: Parameter | float | None = None,
    fit_zero: bool = False,
    sigma: ArrayLike | None = None,
    solver: str = "box_lm",
) -> FormErrorFit:
    """Fit stiffness, or a scale of the forces, to measured errors of a wall.

    Parameters
    ----------
    angles : array_like, shape (n,) [rad]
        Engagement angle where each error was measured.
    errors : array_like, shape (n,) [mm]
        Wall errors, positive where material is left.
    cut : Cut
        Tool and conditions.
    coefficients : ForceCoefficients, ForceFit, or mapping of str to Parameter or float
        Known ones; a fit of measured forces, whose readings are then fitted along; or each by
        name, where a `Parameter` may be free.
    heights : array_like, shape (n,) or scalar [mm]
        Height above the tool's end of each reading.
    tool : ToolStiffness, optional
        A tool whose stiffness is known, such as a `Cantilever`; `force_scale` is fitted then.
    stiffness : Parameter or float, optional [N/mm]
        Without `tool`: a number fixes it; fitted when left out.
    force_scale : Parameter or float, optional
        Factor on all coefficients; 1 when left out, and free where `tool` is given. For forces
        that nobody measured, ``Parameter(1.0, transform="log", bounds=(0, inf),
        prior=PUBLISHED_SPREAD)``.
    fit_zero : bool
        Fit an error common to all readings, as where the datum was milled too.
    sigma : float or array_like, shape (n,), optional [mm]
        Standard deviation of the errors; estimated when left out.
    solver : str
        See `calibration.fit`.

    Returns
    -------
    FormErrorFit
        The fit. Where stiffness and scale or coefficients are free together, its result says that
        the walls cannot tell them apart.

    Raises
    ------
    InputError
        If lengths differ, the tool's stiffness is given twice, the errors have the wrong sign, or
        one reading is to part what it cannot.

    Notes
    -----
    Before sampling stiffness and scale together, give the stiffness a prior too: without one every
    N/mm counts alike, which favours stiff tools and great forces.
    """
    if tool is not None and stiffness is not None:
        raise InputError("tool and stiffness are both given: drop one.")
    x, y = _places(angles, errors, heights, cut)
    if tool is not None:
        x["tool"] = tool
    forces = coefficients.result.problem if isinstance(coefficients, ForceFit) else None
    if forces is not None and force_scale is not None:
        raise InputError("force_scale has no place where the forces were measured: leave it out.")
    if isinstance(coefficients, ForceFit):
        parameters = dict(coefficients.result.problem.parameters)
    else:
        parameters = _coefficients(coefficients)
    scale_free = tool is not None and forces is None
    scale = Parameter(1.0, "", (0.0, math.inf), transform="log", fixed=not scale_free)
    parameters["force_scale"] = _chosen(force_scale, scale)
    parameters["zero"] = Parameter(0.0, "mm", fixed=not fit_zero)
    model = WallError(cut.flutes, cut.milling)
    if tool is None:
        start = _first_stiffness(model, parameters, x, y, fit_zero)
        parameters["stiffness"] = _chosen(stiffness, _stiffness(start))
        parameters["scale_per_stiffness"] = Parameter(0.0, "mm/N", tied=scale_per_stiffness)
    _require_parting(parameters, len(y))
    datasets = {**(forces.datasets if forces else {}), "wall": Dataset(x, y, sigma, model)}
    name = f"form error of a wall, {cut.milling} milling, {cut.flutes} flutes"
    return FormErrorFit(fit(Problem(parameters, datasets, name=name), solver), cut)


def scale_per_stiffness(params: Mapping[str, Array]) -> Array:
    """Force scale per stiffness [mm/N], which is all that walls determine."""
    return params["force_scale"] / params["stiffness"]


def _stiffness(start: float) -> Parameter:
    return Parameter(start, "N/mm", (0.0, math.inf), transform="log")


def _chosen(given: Parameter | float | None, otherwise: Parameter) -> Parameter:
    """The parameter asked for: a number fixes it."""
    if given is None or isinstance(given, Parameter):
        return otherwise if given is None else given
    return Parameter(given, otherwise.unit, otherwise.bounds, fixed=True)


def _places(
    angles: ArrayLike, errors: ArrayLike, heights: ArrayLike, cut: Cut
) -> tuple[dict[str, Any], np.ndarray]:
    """Where each error was measured, as the model takes it, and the errors."""
    y = np.atleast_1d(np.asarray(errors, float))
    x: dict[str, Any] = {n: np.asarray(getattr(cut, n)) for n in ("axial_depth", "radius", "helix")}
    for name, given in (
        ("angle", angles),
        ("height", heights),
        ("feed_per_tooth", cut.feed_per_tooth),
    ):
        values = np.asarray(given, float)
        if values.shape not in ((), (1,), y.shape):
            raise InputError(
                f"{name.replace('_', ' ')} has shape {values.shape} for {y.size} wall errors: "
                "give one, or one each."
            )
        x[name] = np.array(np.broadcast_to(values, y.shape))
    top = float(x["axial_depth"])
    for name, high, unit in (("angle", math.pi, "rad"), ("height", top, "mm")):
        outside = np.flatnonzero(~((x[name] >= 0.0) & (x[name] <= high)))
        if len(outside):
            raise InputError(
                f"{name} of wall error {outside[0] + 1} is {x[name][outside[0]]:g} {unit}, but "
                f"must be between 0 and {high:g}."
            )
    return x, y


def _coefficients(
    given: ForceCoefficients | Mapping[str, Parameter | float],
) -> dict[str, Parameter]:
    if isinstance(given, ForceCoefficients):
        given = {name: float(getattr(given, name)) for name in COEFFICIENTS}
    for name in given:
        if name not in COEFFICIENTS:
            raise InputError(
                f"coefficient {name!r} is unknown{nearest(name, tuple(COEFFICIENTS))}."
            )
    missing = [n for n in COEFFICIENTS if n not in given and not n.startswith("axial")]
    if missing:
        raise InputError(f"coefficient {missing[0]!r} is missing: give it.")
    return {
        name: p if isinstance(p, Parameter) else Parameter(p, COEFFICIENTS[name][0], fixed=True)
        for name, p in given.items()
    }


def _first_stiffness(
    model: WallError,
    parameters: Mapping[str, Parameter],
    x: dict[str, Any],
    errors: np.ndarray,
    fit_zero: bool,
) -> float:
    """Stiffness that explains the errors best, by linear least squares in its inverse."""
    at = {name: jnp.asarray(p.value) for name, p in parameters.items()}
    at |= {"stiffness": jnp.asarray(1.0), "zero": jnp.asarray(0.0)}
    force = np.asarray(model(at, x))
    if fit_zero:
        force, errors = force - np.mean(force), errors - np.mean(errors)
    along = float(force @ errors)
    if not along > 0:
        raise InputError(
            "the wall errors do not follow the force on the wall: check their sign (positive where "
            "material is left), the direction of milling, and that heights lie where a flute cuts."
        )
    return float(force @ force) / along


def _require_parting(parameters: Mapping[str, Parameter], readings: int) -> None:
    """Refuse one reading for stiffness and forces together with nothing known of either."""
    free = [n for n in ("stiffness", "force_scale") if n in parameters and not parameters[n].fixed]
    known = any(parameters[name].prior is not None for name in free)
    if readings < len(free) and not known:
        raise InputError(
            "stiffness and force_scale cannot be told apart, and least of all by one wall error: "
            "fix one of them, or give one a prior such as PUBLISHED_SPREAD."
        )
