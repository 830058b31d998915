"""Wear ratio, gaps and spread width from the measured surface of a cavity.

The cavity is simulated along the path that cut it, and what the simulation is given is fitted until
its surface is the measured one. Lengths in um.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.fitting import fit
from calibration.parameters import Parameter
from calibration.problem import Problem
from calibration.result import FitResult
from calibration.wear_surface_columns import one_by_one
from calibration.wear_surface_model import CavityModel
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64
from procmodel.wear.zmap_run import LARGEST_WEAR_RATIO

# What the simulation is given, and how the map lies in the instrument's frame.
_CUT = ("wear_ratio", "side_gap", "bottom_gap", "spread_width")
_FRAME = ("zero", "tilt_x", "tilt_y", "shift_x", "shift_y")
UNKNOWN = _CUT + _FRAME
# Of the electrode: a wider spread is even wear.
_EVEN = 20.0
# Of the depth of the map: what a cavity cut along other paths leaves, and noise does not.
_MISS = 0.1


class HeightReadings(Protocol):
    """Heights measured at places in any order; see `procmodel.io.height_maps.read_height_map`."""

    @property
    def x(self) -> np.ndarray:
        """Places, shape (n,) [um]."""

    @property
    def y(self) -> np.ndarray:
        """Places, shape (n,) [um]."""

    @property
    def z(self) -> np.ndarray:
        """Depth or height at each, shape (n,) [um]."""

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each z, shape (n,) [um]; None where it is not known."""


@dataclass(frozen=True, eq=False)
class SurfaceModel:
    """Surface of a cavity cut with known feeds, as an instrument sees it.

    Attributes
    ----------
    cavity : CavityModel
        Paths, cells and wear mode; the reach of its electrode is the largest side gap that is
        considered.
    feeds : ndarray, shape (layers,) [um]
        Feed of every layer.

    Raises
    ------
    InputError
        If there is not one finite feed for every layer.
    """

    cavity: CavityModel
    feeds: np.ndarray

    def __post_init__(self) -> None:
        feeds = np.asarray(self.feeds, float)
        if feeds.shape != (self.cavity.layers,) or not np.all(np.isfinite(feeds)):
            raise InputError(
                f"feeds have shape {feeds.shape}: give one finite feed for each of "
                f"{self.cavity.layers} layers."
            )
        object.__setattr__(self, "feeds", feeds)

    @property
    def __name__(self) -> str:
        return f"simulated surface of a cavity, {self.cavity.wear_mode} wear"

    def depth(self, params: dict[str, Array]) -> Array:
        """Depth of every cell by `wear_ratio`, `side_gap`, `bottom_gap`, `spread_width`."""
        return self.cavity.depth(
            self.feeds,
            params["wear_ratio"],
            side_gap=params["side_gap"],
            bottom_gap=params["bottom_gap"],
            spread_width=params["spread_width"],
        )

    def __call__(self, params: dict[str, Array], x: dict[str, Any]) -> Array:
        """Depth at places of the instrument, bilinear between cells, shape (n,) [um].

        Parameters
        ----------
        params : dict of str to Array
            What the simulation is given, and `zero` [um], `tilt_x`, `tilt_y` [um/um], `shift_x`,
            `shift_y` [um]: where the instrument sees the workpiece's surface and origin.
        x : dict of str to array_like, shape (n,) [um]
            Places ``x`` and ``y``.
        """
        depth = one_by_one(self.depth, {name: jnp.asarray(params[name]) for name in _CUT})
        across, along = (jnp.asarray(x[a]) - params[f"shift_{a}"] for a in "xy")
        seen = _between(depth, self.cavity, across, along)
        return seen + params["zero"] + params["tilt_x"] * across + params["tilt_y"] * along


@dataclass(frozen=True)
class SurfaceFit:
    """A fitted surface.

    Attributes
    ----------
    result : FitResult
        Parameters `wear_ratio`, `wear_per_area` [1/um^2], `side_gap`, `bottom_gap`,
        `spread_width`, and those of the instrument's frame.
    model : SurfaceModel
        What was fitted.
    x, y, depth : ndarray, shape (n,) [um]
        The readings as fitted, depth positive downwards.
    flipped : bool
        Whether the instrument's z counted upwards.
    left_out : int
        Readings beyond the simulated map, which were not used.
    unknown : tuple of str
        What was to be found.
    """

    result: FitResult
    model: SurfaceModel
    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray
    flipped: bool
    left_out: int
    unknown: tuple[str, ...]

    @cached_property
    def surface(self) -> np.ndarray:
        """Depth of every cell as fitted, without the instrument's frame, shape (nx, ny) [um]."""
        values = {n: jnp.asarray(self.result.parameters[n].value) for n in _CUT}
        return np.asarray(jax.jit(self.model.depth)(values))

    @property
    def told(self) -> tuple[str, ...]:
        """Those of the unknown that the map tells."""
        found = self.result.parameters
        return tuple(n for n in self.unknown if found[n].verdict == "identified")

    @property
    def notes(self) -> tuple[str, ...]:
        """What the map cannot tell, and what was assumed, as sentences."""
        section = self.model.cavity.electrode.section
        notes = []
        for name in self.unknown:
            estimate = self.result.parameters[name]
            if estimate.verdict != "identified":
                reason = estimate.reason or "the readings leave it open"
                notes.append(f"the map does not tell {name} ({estimate.verdict}: {reason})")
        if "wear_ratio" in self.unknown:
            notes.append(
                "depths determine the wear per area alone: wear_ratio is proportional to the "
                f"electrode area of {section.area:.6g} um^2 that was given"
            )
        if "spread_width" in self.unknown and self.model.cavity.wear_mode != "spread":
            notes.append(
                f"wear mode {self.model.cavity.wear_mode} has no spread width: fit with wear mode "
                "spread to find one"
            )
        if "side_gap" in self.unknown:
            notes.append(
                "side_gap is told by the walls, where an instrument that rounds edges moves it"
            )
        depth = float(np.ptp(self.depth))
        misses = float(np.std(np.concatenate(list(self.result.residuals.values()))))
        if misses > _MISS * depth:
            notes.append(
                f"the simulated cavity misses the map by {misses:.3g} um in a depth of {depth:.4g} "
                "um: check that paths, feeds, electrode and wear mode are those of this cavity, "
                "and do not plan on this fit"
            )
        if self.left_out:
            notes.append(f"{self.left_out} readings lie beyond the simulated map and were left out")
        return tuple(notes)


def fit_surface(
    measured: HeightReadings,
    model: SurfaceModel,
    unknown: Sequence[str] = ("wear_ratio", "side_gap", "spread_width"),
    start: Mapping[str, float] | None = None,
    sigma: float | None = None,
    solver: str = "box_lm",
    **options: Any,
) -> SurfaceFit:
    """Fit a simulated surface to a measured one.

    Parameters
    ----------
    measured : HeightReadings
        Heights at places in any order; missing places are just not compared.
    model : SurfaceModel
        The cavity as it was cut. Fits with the same model share what was compiled.
    unknown : sequence of str
        What to find, of `UNKNOWN`: "wear_ratio", "side_gap", "bottom_gap", "spread_width", and
        "zero", "tilt_x", "tilt_y", "shift_x", "shift_y" of the instrument.
    start : mapping of str to float, optional
        Where the search starts, and the values of what is not unknown: a wear ratio of 0.1, a
        spread width of half the electrode, and 0 when left out. An unknown side gap is searched
        from inside every cell up to the reach as well, for the misfit has a minimum in several.
    sigma : float, optional [um]
        Standard deviation of the heights; that of `measured` when left out, and estimated from
        the residuals where it has none.
    solver : str
        See `calibration.fit`, as the further options.

    Returns
    -------
    SurfaceFit
        The fit. Its verdicts say which of the unknown the map tells.

    Raises
    ------
    InputError
        If a name is unknown, a start is out of range, or too few readings lie on the map.
    RuntimeError
        If JAX makes 32-bit floats.
    """
    require_float64("A fit of a surface")
    names = (unknown,) if isinstance(unknown, str) else tuple(unknown)
    for name in (*names, *(start or {})):
        if name not in UNKNOWN:
            raise InputError(f"unknown {name!r} is not known{nearest(name, UNKNOWN)}.")
    if not names:
        raise InputError(f"there is nothing to fit: name some of {', '.join(UNKNOWN)}.")
    x, y, z = (np.asarray(values, float) for values in (measured.x, measured.y, measured.z))
    inside = _on_map(model.cavity, x, y)
    parameters = _parameters(model, names, start or {})
    starts = _starts(model, parameters)
    if np.count_nonzero(inside) <= len(names):
        raise InputError(
            f"{np.count_nonzero(inside)} of {len(z)} readings lie on the simulated map, too few "
            f"for {len(names)} unknown: the map's origin is that of the paths, check x and y."
        )
    scatter = measured.sigma if sigma is None else sigma
    if scatter is not None and np.ndim(scatter):
        scatter = np.asarray(scatter)[inside]
    x, y, z = x[inside], y[inside], z[inside]
    first = {name: jnp.asarray(p.value) for name, p in parameters.items() if p.tied is None}
    begun = np.asarray(jax.jit(model)(first, {"x": x, "y": y}))
    flipped = bool(np.dot(begun - begun.mean(), z - z.mean()) < 0)
    depth = -z if flipped else z
    if solver == "box_lm":
        # Nearly straight, and every evaluation is a simulation.
        options.setdefault("bend", False)
    fits = [
        fit(Problem.from_function(model, p, {"x": x, "y": y}, depth, scatter), solver, **options)
        for p in starts
    ]
    weight = 1.0 if scatter is None else scatter
    result = min(fits, key=lambda one: float(np.sum((one.residuals["data"] / weight) ** 2)))
    left_out = int(np.count_nonzero(~inside))
    return SurfaceFit(result, model, x, y, depth, flipped, left_out, names)


def wear_per_area(params: dict[str, Array]) -> Array:
    """Wear per area rho = R / S_e [1/um^2], which is all that depths determine."""
    return params["wear_ratio"] / params["electrode_area"]


def _parameters(
    model: SurfaceModel, unknown: tuple[str, ...], start: Mapping[str, float]
) -> dict[str, Parameter]:
    electrode, workpiece = model.cavity.electrode, model.cavity.workpiece
    size, cell = electrode.section.size, electrode.cell
    deepest = float(np.sum(model.feeds))
    wide = max(workpiece.depth.shape) * cell
    ranges = {
        "wear_ratio": ("", 0.0, LARGEST_WEAR_RATIO, 0.1),
        "side_gap": ("um", 0.0, electrode.reach, 0.0),
        "bottom_gap": ("um", -deepest, deepest, 0.0),
        "spread_width": ("um", 0.1 * cell, _EVEN * size, 0.5 * size),
        "zero": ("um", -deepest, deepest, 0.0),
        "tilt_x": ("um/um", -1.0, 1.0, 0.0),
        "tilt_y": ("um/um", -1.0, 1.0, 0.0),
        "shift_x": ("um", -wide, wide, 0.0),
        "shift_y": ("um", -wide, wide, 0.0),
    }
    parameters = {}
    for name, (unit, low, high, usual) in ranges.items():
        fixed = name not in unknown
        if name == "side_gap" and high <= low:
            if not fixed or start.get(name, 0.0) != 0.0:
                raise InputError(
                    "side_gap needs an electrode map that reaches beyond the section: give the "
                    "cavity's model a reach, the largest side gap that may be."
                )
            high = 1.0
        # A gap of 0 is a bound: from it the derivative is one-sided, and the search starts off it.
        usual = 0.25 * high if name == "side_gap" and not fixed else usual
        value = float(start.get(name, usual))
        if not low <= value <= high:
            raise InputError(
                f"start of {name} is {f'{value:g} {unit}'.strip()}, but must lie from {low:g} to "
                f"{high:g}."
            )
        transform = "log" if name == "spread_width" else "identity"
        parameters[name] = Parameter(value, unit, (low, high), transform=transform, fixed=fixed)
    parameters["electrode_area"] = Parameter(electrode.section.area, "um^2", fixed=True)
    rho = parameters["wear_ratio"].value / electrode.section.area
    parameters["wear_per_area"] = Parameter(rho, "1/um^2", tied=wear_per_area)
    return parameters


def _starts(model: SurfaceModel, parameters: dict[str, Parameter]) -> list[dict[str, Parameter]]:
    """The parameters with the side gap where it was given and in the middle of every cell."""
    gap = parameters["side_gap"]
    if gap.fixed:
        return [parameters]
    cell, reach = model.cavity.electrode.cell, model.cavity.electrode.reach
    edges = np.append(np.arange(0.0, reach - 1e-9 * cell, cell), reach)
    middles = [float(m) for m in 0.5 * (edges[1:] + edges[:-1])]
    # One search in a cell is enough.
    middles = [m for m in middles if m // cell != gap.value // cell]
    return [parameters | {"side_gap": replace(gap, value=v)} for v in (gap.value, *middles)]


def _on_map(cavity: CavityModel, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Places between the middles of the map's outer cells."""
    lines = (cavity.workpiece.x, cavity.workpiece.y)
    inside = [(c >= line[0]) & (c <= line[-1]) for c, line in zip((x, y), lines, strict=True)]
    return inside[0] & inside[1]


def _between(depth: Array, cavity: CavityModel, x: Array, y: Array) -> Array:
    """Depth at places, bilinear between the middles of the cells and even beyond the map."""
    first, share = [], []
    for place, line in ((x, cavity.workpiece.x), (y, cavity.workpiece.y)):
        cells = jnp.clip((place - line[0]) / cavity.workpiece.cell, 0.0, len(line) - 1.0)
        before = jnp.clip(jnp.floor(cells), 0, max(len(line) - 2, 0)).astype(int)
        first.append(before)
        share.append(cells - before)
    (i, j), (a, b) = first, share
    ends = jnp.minimum(i + 1, depth.shape[0] - 1), jnp.minimum(j + 1, depth.shape[1] - 1)
    near = (1.0 - b) * depth[i, j] + b * depth[i, ends[1]]
    far = (1.0 - b) * depth[ends[0], j] + b * depth[ends[0], ends[1]]
    return (1.0 - a) * near + a * far
