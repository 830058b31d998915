"""From the profile of a test cavity to the problem that finds its wear ratio.

The test cavity is cut with constant feed, layer n with half width X0 - (n - 1) dX; its wall is
the curve through the outer bottom corners of the layers (Yu and Masuzawa, figs 15 and 16).
Lengths in um, areas in um^2.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.fitting import fit
from calibration.parameters import Parameter
from calibration.problem import Problem
from calibration.result import FitResult
from calibration.wear_profile import (
    LEAST_READINGS,
    centre_and_surface,
    depth_reached,
    downwards,
    looks_full,
    near_upper_edge,
    require_half_profile,
    require_profile,
)
from procmodel.errors import InputError, nearest
from procmodel.wear import CircleSection, LayeredCavity, Section, SquareSection

# Fewer layers than the half width allows are believed only when they lower the squared misfit
# by this many noise variances.
_LAYER_EVIDENCE = 20.0
# Numbers of layers whose misfit is this little worse are as good (chi-square, 95 %).
_LAYER_DOUBT = 4.0
_UNEXPLAINED_GAP = 1.0
# Correlation of neighbouring residuals, times the root of their number, that chance explains in
# less than one of 4000 profiles.
_FOLLOWING = 3.5


@dataclass(frozen=True)
class TestCavity:
    """How a test cavity was cut.

    Parameters
    ----------
    section : {"square", "circle"}
        Shape of every layer.
    half_width : float [um]
        Programmed half width of the first layer, X0.
    step : float [um]
        How much narrower every layer is than the one above, dX.
    feed : float [um]
        Feed of every layer, dZ.
    electrode_area : float [um^2]
        Cross-section of the electrode, S_e.
    layers : int, optional
        Number of layers; read off the profile when left out.
    corner_radius : float [um]
        Radius of a round electrode whose uncut corners are to be counted; 0 to neglect them.

    Raises
    ------
    InputError
        If a length is not above 0 or the cavity has more layers than its half width allows.
    """

    __test__ = False  # the name is the shop's, not pytest's

    section: str
    half_width: float
    step: float
    feed: float
    electrode_area: float
    layers: int | None = None
    corner_radius: float = 0.0

    def __post_init__(self) -> None:
        if self.section not in ("square", "circle"):
            raise InputError(f"section {self.section!r} is unknown; known are square, circle.")
        if not (math.isfinite(self.corner_radius) and self.corner_radius >= 0):
            raise InputError(f"corner radius {self.corner_radius:g} um must be 0 or more.")
        if self.layers is not None and not isinstance(self.layers, int):
            raise InputError(f"layers is {self.layers!r}, but must be a whole number.")
        for name in ("half_width", "step", "feed", "electrode_area"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name.replace('_', ' ')} {value:g} must be above 0.")
        if self.step > self.half_width:
            raise InputError(
                f"step {self.step:g} um is greater than the half width {self.half_width:g} um: "
                "not even a second layer fits."
            )
        if self.layers is not None and not 1 <= self.layers <= self.most_layers:
            raise InputError(
                f"layers is {self.layers}, but with half width {self.half_width:g} um and step "
                f"{self.step:g} um there can be 1 to {self.most_layers}."
            )

    @property
    def most_layers(self) -> int:
        """Layers until the half width is used up."""
        return max(1, math.ceil(self.half_width / self.step - 1e-9))

    @property
    def half_widths(self) -> np.ndarray:
        """Programmed half width of every possible layer, shape (most_layers,) [um]."""
        return self.half_width - self.step * np.arange(self.most_layers)

    @property
    def feeds(self) -> np.ndarray:
        """Feed of every possible layer, 0 for those not cut, shape (most_layers,) [um]."""
        cut = np.arange(self.most_layers) < (self.layers or self.most_layers)
        return np.where(cut, self.feed, 0.0)


@dataclass(frozen=True)
class CavityFit:
    """A fitted test cavity.

    Attributes
    ----------
    result : FitResult
        Parameters `wear_ratio`, `wear_per_area` [1/um^2], `gap`, `centre`, `zero`, `tilt`.
    cavity : TestCavity
        As fitted, with the number of layers.
    reach : str
        "half" (from the centre out) or "full" (both walls).
    position, depth : ndarray, shape (n,) [um]
        The readings as fitted, depth positive downwards.
    flipped : bool
        Whether the instrument's z counted upwards.
    possible_layers : tuple of int
        Numbers of layers that explain the profile about as well, where it had to be counted.
    left_out : int
        Readings at the upper edge that were not used, for they tell its place and not the wear.
    """

    result: FitResult
    cavity: TestCavity
    reach: str
    position: np.ndarray
    depth: np.ndarray
    flipped: bool
    possible_layers: tuple[int, ...] = ()
    left_out: int = 0

    def predict(
        self, position: np.ndarray, parameters: dict[str, float] | None = None
    ) -> np.ndarray:
        """Fitted curve in the instrument's frame, depth positive downwards.

        Parameters
        ----------
        position : ndarray, shape (m,) [um]
            Where.
        parameters : dict of str to float, optional
            Instead of the fitted values.

        Returns
        -------
        ndarray, shape (m,) [um]
            Depth.
        """
        values = parameters or {n: p.value for n, p in self.result.parameters.items()}
        model = _MODELS[self.cavity.section]
        x = {**self.result.problem.datasets["data"].x, "position": np.asarray(position, float)}
        return np.asarray(model({n: jnp.asarray(v) for n, v in values.items()}, x))

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What moves the wear ratio and cannot be seen in the misfit, as sentences."""
        notes = [
            "depths determine wear_per_area alone: wear_ratio is proportional to the electrode "
            f"area of {self.cavity.electrode_area:.6g} um^2 that was given",
            f"one wear ratio is taken for all depths: a trend with depth is not to be told from a "
            f"profile {float(np.ptp(self.depth)):.3g} um deep",
        ]
        if self.left_out:
            notes.append(
                f"{self.left_out} readings beside the upper edge were left out, where gap or "
                "centre decides between wall and surface"
            )
        residuals = self.result.residuals["data"]
        follow = float(residuals[1:] @ residuals[:-1]) / max(float(residuals @ residuals), 1e-300)
        if follow > _FOLLOWING / math.sqrt(len(residuals)):
            notes.append(
                f"neighbouring residuals are alike (correlation {follow:.2f}): the model misses "
                "part of the shape and the intervals are too narrow; check half width, step, feed, "
                "gap and layers"
            )
        if len(self.possible_layers) > 1:
            low, high = min(self.possible_layers), max(self.possible_layers)
            notes.append(
                f"the number of layers, {self.cavity.layers}, was read off the floor, and {low} to "
                f"{high} fit about as well: give the number that was cut, above all when the gap "
                "is fitted, which a layer more or less shifts by about one step"
            )
        if self.result.problem.parameters["gap"].fixed:
            assumed = self.result.parameters["gap"].value
            wider = self._refitted(gap=assumed + _UNEXPLAINED_GAP)
            notes.append(
                f"the side gap is taken as {assumed:g} um: 1 um more would change wear_ratio by "
                f"{self._change(wider)} and the rms misfit from {self.result.residual_rms:.4g} to "
                f"{wider.residual_rms:.4g} um"
            )
        radius = math.sqrt(self.cavity.electrode_area / math.pi)
        if self.cavity.section == "square" and self.cavity.corner_radius == 0:
            rounded = self._refitted(corner_radius=radius)
            notes.append(
                "corners are taken as sharp: if the electrode is round, it leaves them rounded and "
                f"wear_ratio is {self._change(rounded)} off unless they are counted"
            )
        return tuple(notes)

    def _refitted(self, gap: float | None = None, corner_radius: float | None = None) -> FitResult:
        parameters = dict(self.result.problem.parameters)
        if gap is not None:
            parameters["gap"] = replace(parameters["gap"], value=gap)
        cavity = self.cavity
        if corner_radius is not None:
            cavity = replace(cavity, corner_radius=corner_radius)
        data = self.result.problem.datasets["data"]
        shift = data.x["shift"]
        problem = _problem(cavity, self.position, self.depth, data.sigma, parameters, shift)
        return fit(problem)

    def _change(self, other: FitResult) -> str:
        """How far the wear ratio of another fit is from this one, in per cent."""
        here, there = (r.parameters["wear_ratio"].value for r in (self.result, other))
        return f"{100 * (there / here - 1):+.2g} %" if here > 0 else f"{there - here:+.2g}"


def fit_cavity(
    x: np.ndarray,
    z: np.ndarray,
    cavity: TestCavity,
    sigma: np.ndarray | float | None = None,
    *,
    gap: float = 0.0,
    fit_gap: bool = False,
    fit_electrode_area: bool = False,
    reach: str = "auto",
    readings: str = "wall",
    solver: str = "box_lm",
    source: str = "the profile",
) -> CavityFit:
    """Fit the wear ratio to a measured profile.

    Parameters
    ----------
    x, z : ndarray, shape (n,) [um]
        Lateral position and height or depth; x strictly increasing. z may count either way.
    cavity : TestCavity
        How the cavity was cut.
    sigma : float or ndarray, optional [um]
        Standard deviation of z; estimated when left out.
    gap : float [um]
        Side gap, or its start when fitted.
    fit_gap : bool
        Fit the side gap.
    fit_electrode_area : bool
        Fit the electrode area too; depths cannot tell it from the wear ratio, and the result
        says so.
    reach : {"auto", "half", "full"}
        "half": x counts from the centre and z from the surface. "full": both walls, and centre,
        zero and tilt of the instrument are fitted. "auto" looks at the profile.
    readings : {"wall", "depths"}
        "wall": x is where the instrument saw the wall, gap included. "depths": x is the
        programmed half width of the layer that z belongs to, so that the gap shows in the depths
        alone.
    solver : str
        See `calibration.fit`.
    source : str
        What to call the profile in errors.

    Returns
    -------
    CavityFit
        The fit.

    Raises
    ------
    InputError
        If the profile cannot come from this cavity.
    """
    position, height = np.asarray(x, float), np.asarray(z, float)
    require_profile(position, height, source)
    for name, value, known in (
        ("reach", reach, ("auto", "half", "full")),
        ("readings", readings, ("wall", "depths")),
    ):
        if value not in known:
            raise InputError(f"{name} {value!r} is unknown{nearest(value, known)}.")
    if not 0 <= gap < cavity.half_width:
        raise InputError(f"gap {gap:g} um must be 0 or more and below the half width.")
    if reach == "auto":
        reach = "full" if looks_full(height) else "half"
    depth, flipped = downwards(height, reach)
    if reach == "half":
        require_half_profile(position, depth, source)
    _require_possible_depth(depth_reached(position, depth, reach), cavity, source)
    left_out = 0
    if readings == "wall" and (fit_gap or reach == "full"):
        centre = centre_and_surface(position, depth)[0] if reach == "full" else 0.0
        used = ~near_upper_edge(position - centre, cavity.half_width, 0.0 if fit_gap else gap)
        left_out = int(np.count_nonzero(~used))
        position, depth = position[used], depth[used]
        if sigma is not None and np.ndim(sigma):
            sigma = np.asarray(sigma, float)[used]
        if len(position) < LEAST_READINGS:
            raise InputError(f"{source} has no {LEAST_READINGS} readings inside the cavity.")
    parameters = _parameters(cavity, position, depth, reach, gap, fit_gap, fit_electrode_area)
    shift = 1.0 if readings == "wall" else 0.0

    def solved(candidate: TestCavity) -> FitResult:
        problem = _problem(candidate, position, depth, sigma, parameters, shift)
        return fit(problem, solver)

    result = solved(cavity)
    possible: tuple[int, ...] = ()
    if cavity.layers is None:
        cavity, result, possible = _count_layers(cavity, position, depth, result, solved)
    return CavityFit(result, cavity, reach, position, depth, flipped, possible, left_out)


def square_wall(params: dict[str, Array], x: dict[str, Any]) -> Array:
    """Wall curve of a square test cavity as the instrument sees it; see `fit_cavity`."""
    return _wall(params, x, SquareSection(x["corner_radius"]))


def circle_wall(params: dict[str, Array], x: dict[str, Any]) -> Array:
    """Wall curve of a circular test cavity as the instrument sees it; see `fit_cavity`."""
    return _wall(params, x, CircleSection())


def wear_per_area(params: dict[str, Array]) -> Array:
    """Wear per area rho = R / S_e [1/um^2], which is all that depths determine."""
    return params["wear_ratio"] / params["electrode_area"]


_MODELS = {"square": square_wall, "circle": circle_wall}


def _wall(params: dict[str, Array], x: dict[str, Any], section: Section) -> Array:
    cavity = LayeredCavity(
        half_widths=x["half_widths"],
        feeds=x["feeds"],
        section=section,
        wear_ratio=params["wear_ratio"],
        electrode_area=params["electrode_area"],
        gap=params["gap"],
    )
    across = jnp.asarray(x["position"]) - params["centre"]
    # Depths that belong to programmed half widths do not move sideways with the gap.
    seen = jnp.abs(across) + (1.0 - x["shift"]) * params["gap"]
    return cavity.wall_depth(seen, x["edge_width"]) + params["zero"] + params["tilt"] * across


def _problem(
    cavity: TestCavity,
    position: np.ndarray,
    depth: np.ndarray,
    sigma: Any,
    parameters: dict[str, Parameter],
    shift: float,
) -> Problem:
    placed = parameters["gap"].fixed and parameters["centre"].fixed
    x = {
        "position": position,
        "half_widths": cavity.half_widths,
        "feeds": cavity.feeds,
        # A sharp step where its place is given; else a slope, for a step has no derivative.
        "edge_width": 0.0 if placed else float(np.median(np.diff(position))),
        "corner_radius": cavity.corner_radius,
        "shift": shift,
    }
    name = f"wall of a {cavity.section} cavity cut in layers, uniform wear"
    return Problem.from_function(_MODELS[cavity.section], parameters, x, depth, sigma, name)


def _parameters(
    cavity: TestCavity,
    position: np.ndarray,
    depth: np.ndarray,
    reach: str,
    gap: float,
    fit_gap: bool,
    fit_electrode_area: bool,
) -> dict[str, Parameter]:
    full = reach == "full"
    centre, zero = centre_and_surface(position, depth) if full else (0.0, 0.0)
    span = float(np.ptp(position))
    area = cavity.electrode_area
    widest = cavity.half_width
    parameters = {
        "wear_ratio": Parameter(0.1, "", bounds=(0.0, 1e3)),
        "electrode_area": Parameter(
            area, "um^2", bounds=(1e-3 * area, 1e3 * area), fixed=not fit_electrode_area
        ),
        "gap": Parameter(gap, "um", bounds=(0.0, widest + _UNEXPLAINED_GAP), fixed=not fit_gap),
        "centre": Parameter(centre, "um", bounds=(centre - span, centre + span), fixed=not full),
        "zero": Parameter(zero, "um", fixed=not full),
        "tilt": Parameter(0.0, "um/um", bounds=(-1.0, 1.0), fixed=not full),
    }
    parameters["wear_per_area"] = Parameter(0.1 / area, "1/um^2", tied=wear_per_area)
    return parameters


def _require_possible_depth(reached: float, cavity: TestCavity, source: str) -> None:
    layers = cavity.layers or cavity.most_layers
    if reached > 1.02 * layers * cavity.feed:
        raise InputError(
            f"{source} is {reached:.4g} um deep, but {layers} layers of {cavity.feed:g} um feed "
            f"cut {layers * cavity.feed:.4g} um at most: check feed, step, layers and unit of z."
        )


def _count_layers(
    cavity: TestCavity, position: np.ndarray, depth: np.ndarray, result: FitResult, solved: Any
) -> tuple[TestCavity, FitResult, tuple[int, ...]]:
    """Number of layers that the flat floor of the profile shows, if it shows one.

    Returns the cavity with its layers, its fit, and all the numbers that fit about as well.
    """
    most = cavity.most_layers
    distance = np.abs(position - result.parameters["centre"].value)
    innermost = depth[np.argsort(distance)[: max(3, len(depth) // 20)]]
    noise = max(float(np.std(innermost)), 1e-3 * float(np.ptp(depth)))
    deep = distance[depth >= np.median(innermost) - 2.0 * noise]
    guess = round((cavity.half_width - float(np.max(deep))) / cavity.step) + 1
    fits = {most: result}
    for count in range(max(1, guess - 4), min(most, guess + 8)):
        outcome = solved(replace(cavity, layers=count))
        if outcome.converged:
            fits[count] = outcome
    best = min(fits, key=lambda count: _square(fits[count]))
    variance = _square(fits[best]) / max(1, fits[best].degrees_of_freedom)
    if _square(result) - _square(fits[best]) < _LAYER_EVIDENCE * variance:
        best = most
    possible = tuple(
        count
        for count in sorted(fits)
        if _square(fits[count]) - _square(fits[best]) < _LAYER_DOUBT * variance
    )
    return replace(cavity, layers=best), fits[best], possible if best != most else ()


def _square(result: FitResult) -> float:
    """Squared misfit, each reading in units of its own sigma where it has one."""
    sigma = result.problem.datasets["data"].sigma
    return float(np.sum((result.residuals["data"] / (1.0 if sigma is None else sigma)) ** 2))
