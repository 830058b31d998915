"""Stages of `wear plan` that have an outline: layers that an electrode can make, and its paths."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from calibration.cli.wear_plan_cavity import Cavity
from procmodel.errors import InputError
from procmodel.wear import TargetLayers
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.scanning import (
    ScanningRules,
    coverage,
    finish_layer,
    finishing_caution,
    scan_layers,
)
from procmodel.wear.slicing import Reach, Slices

if TYPE_CHECKING:
    from calibration.plans.schedule import Schedule


@dataclass(frozen=True)
class Finish:
    """The finishing stage that was asked for.

    Attributes
    ----------
    thickness : float [um]
        Ring left for it.
    wear_ratio : float
        Its wear ratio.
    area : float [um^2]
        Section of its electrode.
    """

    thickness: float
    wear_ratio: float
    area: float

    @property
    def electrode(self) -> ElectrodeSection:
        """Its electrode, round."""
        return ElectrodeSection("round", 2.0 * math.sqrt(self.area / math.pi))

    @property
    def cautions(self) -> list[str]:
        """What is wrong with the thickness."""
        caution = finishing_caution(self.thickness, self.electrode)
        return [] if caution is None else [caution]


@dataclass(frozen=True)
class Scan:
    """Paths of a stage.

    Attributes
    ----------
    slices : Slices
        Its layers.
    electrode : ElectrodeSection
        Its electrode.
    paths : list of LayerPath
        Path of every layer.
    uncovered, reachable : float [um^2]
        Area that the paths leave standing, of the area that they were to clear.
    unreachable, wanted : float [um^2]
        Area of corners and necks that the electrode cannot clear, of all layers' area.
    """

    slices: Slices
    electrode: ElectrodeSection
    paths: list[LayerPath]
    uncovered: float
    reachable: float
    unreachable: float
    wanted: float


@dataclass(frozen=True)
class Stage:
    """Layers for one electrode.

    Attributes
    ----------
    slices : Slices
        The wanted layers.
    reach : Reach
        What the electrode makes of them.
    electrode : ElectrodeSection
        Its section.
    layers : TargetLayers
        The layers as the schedule takes them.
    notes : list of str
        What to know of them.
    wear_ratio : float or None
        Of a finishing stage.
    thickness : float or None [um]
        Ring that a finishing stage removes.
    levelling : int
        How many of the layers are levelling passes over the one before them.
    """

    slices: Slices
    reach: Reach
    electrode: ElectrodeSection
    layers: TargetLayers
    notes: list[str]
    wear_ratio: float | None = None
    thickness: float | None = None
    levelling: int = 0

    def levelled(self, schedule: "Schedule", passes: int) -> "Stage":
        """The stage with levelling passes behind its layers.

        Parameters
        ----------
        schedule : Schedule
            Layers and passes.
        passes : int
            How many of them are passes.

        Returns
        -------
        Stage
            The passes have the last layer's outline.
        """
        bottom = np.asarray(schedule.layers.bottom)[: len(self.slices) + passes]

        def again(regions: "tuple[Any, ...]") -> "tuple[Any, ...]":
            return (*regions, *regions[-1:] * passes)

        slices = Slices(
            bottom,
            np.diff(bottom, prepend=0.0),
            again(self.slices.regions),
            self.slices.clipped,
        )
        reach = replace(
            self.reach,
            reachable=again(self.reach.reachable),
            cleared=again(self.reach.cleared),
        )
        return replace(self, slices=slices, reach=reach, layers=schedule.layers, levelling=passes)

    def scanned(self, gap: float, rules: ScanningRules, pattern: str) -> Scan:
        """Paths of the layers, and what they leave standing.

        Parameters
        ----------
        gap : float [um]
            Side gap.
        rules : ScanningRules
            What is alternated and overlapped.
        pattern : {"raster", "contour", "alternate"}
            How a layer is scanned; a finishing stage follows the wall.

        Returns
        -------
        Scan
            The paths.

        Raises
        ------
        InputError
            If the pattern is unknown.
        """
        if self.thickness is None:
            paths = scan_layers(self.slices, self.electrode, gap, rules, pattern, self.reach)  # type: ignore[arg-type]
        else:
            paths = [
                finish_layer(region, self.thickness, self.electrode, gap, rules, n)
                for n, region in enumerate(self.slices.regions, start=1)
            ]
        # To and fro over one and the same path.
        last = len(paths) - self.levelling - 1
        for n in range(self.levelling):
            paths[last + 1 + n] = paths[last + n].reversed()
        uncovered = reachable = unreachable = 0.0
        for path, region, cleared in zip(
            paths, self.slices.regions, self.reach.cleared, strict=True
        ):
            unreachable += region.difference(cleared).area
            if self.thickness is not None:
                cleared = cleared.difference(region.buffer(-self.thickness))
            found = coverage(path, region, self.electrode, gap, cleared)
            uncovered, reachable = uncovered + found.missed, reachable + found.reach
        # The pole by eq. (6) is a layer without a section.
        for _ in range(len(self.layers.bottom) - len(paths)):
            paths.append(LayerPath(np.zeros((1, 2)), np.zeros(0, bool)))
        wanted = float(np.sum(self.slices.areas))
        return Scan(self.slices, self.electrode, paths, uncovered, reachable, unreachable, wanted)


def of_slices(
    slices: Slices, electrode: ElectrodeSection, gap: float, narrow: str, finish: Finish | None
) -> list[Stage]:
    """Stages of a cavity in slices.

    Parameters
    ----------
    slices : Slices
        The wanted layers.
    electrode : ElectrodeSection
        Of the only or the roughing stage.
    gap : float [um]
        Side gap.
    narrow : {"refuse", "plunge", "stop"}
        What becomes of layers narrower than the electrode.
    finish : Finish, optional
        Finishing stage.

    Returns
    -------
    list of Stage
        One or two; areas are those that the electrodes clear.

    Raises
    ------
    InputError
        As `Slices.reach` and `Slices.inset`.
    """
    if finish is None:
        return [_fitted(slices, electrode, gap, narrow)]
    roughing = _fitted(slices.inset(finish.thickness), electrode, gap, narrow)
    finishing = _fitted(slices, finish.electrode, gap, narrow)
    areas = np.array(finishing.layers.area)
    for n, (cleared, roughed) in enumerate(
        zip(finishing.reach.cleared, roughing.reach.cleared, strict=False)
    ):
        areas[n] = cleared.difference(roughed).area
    layers = finishing.layers
    ring = TargetLayers(layers.bottom, layers.thickness, layers.half_width, jnp.asarray(areas))
    return [
        roughing,
        Stage(finishing.slices, finishing.reach, finishing.electrode, ring, finishing.notes,
              finish.wear_ratio, finish.thickness),
    ]  # fmt: skip


def of_shape(
    cavity: Cavity,
    layers: TargetLayers,
    level: str,
    electrode: ElectrodeSection,
    gap: float,
    narrow: str,
) -> Stage:
    """The only stage of a shape whose layers have areas by formula.

    Parameters
    ----------
    cavity : Cavity
        The shape.
    layers : TargetLayers
        Its layers, which are kept.
    level : str
        Where they have taken their sections.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.
    narrow : {"refuse", "plunge"}
        What becomes of layers narrower than the electrode.

    Returns
    -------
    Stage
        The stage.

    Raises
    ------
    InputError
        If the shape is a table, the layers are too narrow, or are to stop above narrow ones.
    """
    if narrow == "stop":
        raise InputError(
            "--narrow stop is for --solid, slot, map and --scallop: for this shape give --depth."
        )
    if cavity.cut is None:
        raise InputError(
            "a table of areas has no outline to scan: give a shape, a --solid or the shape 'map'."
        )
    fitted = _fitted(cavity.cut(np.asarray(layers.bottom), level), electrode, gap, narrow)
    return Stage(fitted.slices, fitted.reach, electrode, layers, fitted.notes)


def require_travel(
    schedules: "list[Schedule]", stages: list[Stage], travel: tuple[float, float, float]
) -> None:
    """Refuse a plan that the machine cannot reach.

    Parameters
    ----------
    schedules : list of Schedule
        Feeds of every stage.
    stages : list of Stage
        Outlines, if there are any; else the half widths are taken as the size.
    travel : tuple of three floats [um]
        Travel along X, Y and Z.

    Raises
    ------
    InputError
        If the cavity or the sum of the feeds is longer than the travel.
    """
    if stages:
        left, low, right, high = stages[-1].slices.bounds
        size = [right - left, high - low]
    else:
        size = [2 * float(np.max(schedules[-1].layers.half_width))] * 2
    feed = max(float(s.cumulative_feed[-1]) for s in schedules)
    for axis, length, limit in zip("XYZ", [*size, feed], travel, strict=True):
        if not (math.isfinite(limit) and limit > 0):
            raise InputError(f"--travel along {axis} is {limit:g}, but must be above 0.")
        if length > limit:
            what = "sum of the feeds" if axis == "Z" else "cavity"
            raise InputError(
                f"the {what} is {length:.6g} um along {axis}, more than the --travel of {limit:g} "
                "um: make it in pieces, or change the electrode more often."
            )


def _fitted(slices: Slices, electrode: ElectrodeSection, gap: float, narrow: str) -> Stage:
    if narrow not in ("refuse", "plunge", "stop"):
        raise InputError(f"--narrow is {narrow!r}, but must be refuse, plunge or stop.")
    notes = []
    if slices.clipped:
        notes.append(f"{_counted(slices.clipped)} undercut: clipped to what is reached from above")
    reach = slices.reach(electrode, gap, "refuse" if narrow == "refuse" else "plunge")
    if narrow == "stop" and reach.narrow:
        first = reach.narrow[0]
        if first == 1:
            slices.reach(electrode, gap, "refuse")  # nothing is left, and this says so
        slices = slices.above(first)
        reach = slices.reach(electrode, gap)
        notes.append(
            f"the cavity ends above layer {first} at a depth of {slices.bottom[-1]:g} um: below, "
            "it is narrower than the electrode with its gap"
        )
    elif reach.narrow:
        notes.append(
            f"{_counted(reach.narrow)} narrower than the electrode with its gap: a single plunge "
            "there cuts more than wanted"
        )
    closed = slices.closed_passages(reach, electrode)
    if closed:
        notes.append(
            "passages that the electrode does not fit through stay uncut from layer "
            f"{closed[0]} on: take a thinner one"
        )
    if reach.lost:
        notes.append(
            f"{_counted(reach.lost)} partly narrower than the electrode with its gap: those parts "
            "stay uncut; take a thinner one"
        )
    return Stage(slices, reach, electrode, slices.target_layers(electrode, gap, reach), notes)


def _counted(layers: tuple[int, ...]) -> str:
    if len(layers) == 1:
        return f"layer {layers[0]} is"
    return f"{len(layers)} layers from layer {layers[0]} on are"
