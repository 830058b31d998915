"""Feed schedules found through the simulator of electrode and cavity.

`exact_schedule` knows a layer by its area. Here every layer is cut by its path, the electrode keeps
the shape that it wore into, and the feeds are moved until the surface that comes out, averaged over
what is believed of the wear ratio, is as near to the wanted one as it gets. Lengths in um.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely

from calibration.plans.belief import believed_wear_ratio
from calibration.plans.schedule import Machine, Schedule
from calibration.plans.simulated_outlook import (
    Belief,
    Foresight,
    Outlook,
    electrode_changes,
    touch_offs,
)
from calibration.plans.simulated_search import search_feeds
from calibration.wear_surface_model import CavityModel
from procmodel.errors import InputError
from procmodel.precision import require_float64
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.target_map import Target, cells_inside, target_map
from procmodel.wear.zmap_maps import WorkpieceMap
from procmodel.wear.zmap_wear import WearMode

_MACHINE = Machine()


@dataclass(frozen=True)
class SimulationSettings:
    """How the simulator is used for a plan.

    Parameters
    ----------
    cell : float [um]
        Side of the cells with which feeds are judged.
    plan_cell : float, optional [um]
        Side of the cells with which they are searched: coarser ones cost a fraction. Twice `cell`
        when left out, but at most a fifth of the electrode.
    step : float, optional [um]
        Distance of positions along the path; the cell of each simulation when left out.
    side_gap, bottom_gap : float [um]
        Gaps.
    wear_mode : {"local", "rotating", "spread", "uniform"}
        See `procmodel.wear.zmap.simulate`.
    spread_width : float, optional [um]
        For mode ``spread``.
    nodes : int
        Wear ratios that stand for an uncertain one, odd.
    stay : float [um]
        Root mean square error it is worth to leave the feeds at their start, against changing
        every one by all of itself: without it thin rings, of which the error hardly speaks, are
        paid with wild feeds.
    evaluations : int
        Most evaluations of the search.

    Raises
    ------
    InputError
        If one of them is out of its range.
    """

    cell: float
    plan_cell: float | None = None
    step: float | None = None
    side_gap: float = 0.0
    bottom_gap: float = 0.0
    wear_mode: WearMode = "local"
    spread_width: float | None = None
    nodes: int = 3
    stay: float = 1.0
    evaluations: int = 40

    def __post_init__(self) -> None:
        for name in ("cell", "plan_cell", "step"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"{name.replace('_', ' ')} {value:g} um must be above 0.")
        if not (math.isfinite(self.side_gap) and self.side_gap >= 0):
            raise InputError(f"side gap {self.side_gap:g} um must not be below 0.")
        if self.nodes < 1 or self.nodes % 2 == 0:
            raise InputError(f"nodes is {self.nodes}, but must be odd: 1, 3, 5 ...")
        if not (math.isfinite(self.stay) and self.stay >= 0):
            raise InputError(f"stay {self.stay:g} um must not be below 0.")
        if self.evaluations < 1:
            raise InputError(f"evaluations is {self.evaluations}, but must be at least 1.")

    @property
    def more(self) -> dict[str, Any]:
        """Gaps and spread width, as `CavityModel.cut` takes them."""
        return {
            "side_gap": self.side_gap,
            "bottom_gap": self.bottom_gap,
            "spread_width": self.spread_width,
        }

    def model(
        self, paths: Sequence[LayerPath], section: ElectrodeSection, cell: float
    ) -> CavityModel:
        """The model with cells of a size [um]."""
        return CavityModel.of(
            paths, section, cell, step=self.step, reach=self.side_gap, wear_mode=self.wear_mode
        )

    def coarse_cell(self, section: ElectrodeSection) -> float:
        """Side of the cells of the search [um]."""
        if self.plan_cell is not None:
            return self.plan_cell
        return max(self.cell, min(2.0 * self.cell, section.size / 5.0))


@dataclass(frozen=True)
class SimulatedSchedule:
    """A planned cavity, foreseen by simulation.

    Attributes
    ----------
    feeds : ndarray, shape (n,) [um]
        Planned feed of every layer, not rounded.
    cumulative_feed : ndarray, shape (n,) [um]
        Feed from the surface after every layer, in steps of the machine: what it is told.
    before, after : Outlook
        What to expect of the feeds at the start, and of these, both as the machine rounds them.
    target : ndarray, shape (nx, ny) [um]
        Wanted depth of every cell.
    wear_ratios : ndarray, shape (k,)
        Equally likely wear ratios that were planned for.
    touch_off_after : tuple of int
        Layers after which to measure, so that the depth spread stays within tolerance.
    new_electrode_before : tuple of int
        Layers before which the electrode is dressed or changed, by the greatest loss of its tip.
    evaluations : int
        How often the search evaluated error and derivative.
    status : str
        What was done, as a sentence.
    warnings : tuple of str
        What to know before cutting.
    """

    feeds: np.ndarray
    cumulative_feed: np.ndarray
    before: Outlook
    after: Outlook
    target: np.ndarray
    wear_ratios: np.ndarray
    touch_off_after: tuple[int, ...]
    new_electrode_before: tuple[int, ...]
    evaluations: int
    status: str
    warnings: tuple[str, ...] = ()

    @property
    def electrodes(self) -> int:
        """Number of electrodes, or of dressings and one."""
        return 1 + len(self.new_electrode_before)

    def as_schedule(self, start: Schedule, machine: Machine) -> Schedule:
        """The plan in the form of a schedule, to be written like one.

        Parameters
        ----------
        start : Schedule
            Where the search started: its layers are what is wanted.
        machine : Machine
            What was planned for.

        Returns
        -------
        Schedule
            Depths, spread, wear and errors as simulated; the wear is the tip's greatest loss.
        """
        wear = np.diff(self.after.tip_loss, prepend=0.0)
        usable = machine.usable_length
        left = np.sum(wear) - np.cumsum(wear)
        if usable is not None:
            begun = np.array([0, *(layer - 1 for layer in self.new_electrode_before)])
            since = begun[np.searchsorted(begun, np.arange(len(wear)), side="right") - 1]
            used = np.concatenate([[0.0], self.after.tip_loss])
            left = usable - (used[1:] - used[since])
        return replace(
            start,
            feeds=self.feeds,
            cumulative_feed=self.cumulative_feed,
            depths=self.after.depths,
            depth_spread=self.after.depth_spread,
            wear=wear,
            electrode_left=left,
            new_electrode_before=self.new_electrode_before,
            touch_off_after=self.touch_off_after,
            expected_wall_error=self.after.expected_rms,
            electrode_length_limit=float(self.after.tip_loss_limit[-1]),
            status=self.status,
            warnings=self.warnings,
        )

    def as_dict(self) -> dict[str, Any]:
        """The figures as plain JSON types."""
        outlooks = {"before": self.before, "after": self.after}
        return {
            "layers": len(self.feeds),
            "total_feed": float(self.cumulative_feed[-1]),
            "wear_ratios": self.wear_ratios.tolist(),
            **{
                name: {
                    "error_rms": o.expected_rms,
                    "error_rms_limit": o.rms_limit,
                    "error_max": o.expected_max,
                    "error_max_limit": o.max_limit,
                    "depth": float(o.depths[-1]),
                    "depth_spread": float(o.depth_spread[-1]),
                    "tip_loss": float(o.tip_loss[-1]),
                    "tip_loss_limit": float(o.tip_loss_limit[-1]),
                }
                for name, o in outlooks.items()
            },
            "touch_off_after": list(self.touch_off_after),
            "new_electrode_before": list(self.new_electrode_before),
            "electrodes": self.electrodes,
            "evaluations": self.evaluations,
            "status": self.status,
            "warnings": list(self.warnings),
        }


def simulated_schedule(
    paths: Sequence[LayerPath],
    target: Target,
    section: ElectrodeSection,
    wear_ratio: Any,
    start: Schedule | np.ndarray,
    settings: SimulationSettings,
    machine: Machine = _MACHINE,
    *,
    target_depth: float | None = None,
    feed_bounds: tuple[float, float] = (0.0, math.inf),
    spared: shapely.Geometry | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> SimulatedSchedule:
    """Feeds that bring the simulated surface nearest to the wanted one.

    Parameters
    ----------
    paths : sequence of LayerPath
        The way through every layer; see `procmodel.wear.scanning.scan_layers`.
    target : Solid, Mesh, Slices or DepthGrid
        The wanted cavity, as `target_map` takes it.
    section : ElectrodeSection
        The electrode.
    wear_ratio : float, FitResult or xarray.DataTree
        Number, fit or posterior with parameter ``wear_ratio``. The square of the error is
        averaged over it.
    start : Schedule or ndarray, shape (n,) [um]
        Schedule or feeds to start from, such as `exact_schedule` gives.
    settings : SimulationSettings
        Cells, gaps, wear mode.
    machine : Machine
        Resolution, usable length, tolerance.
    target_depth : float, optional [um]
        Depth at which the wanted cavity ends. When left out, the bottom of the schedule's last
        layer, and without a schedule the target's own depth.
    feed_bounds : (float, float) [um]
        Least and greatest feed of a layer, taken inwards to whole steps of the resolution.
    spared : shapely geometry, optional [um]
        Places whose error does not count, such as corners that the electrode does not reach
        (`Slices.out_of_reach`).
    progress : callable, optional
        Called with the number of evaluations and the root mean square error [um] of each. An
        interrupt from the keyboard ends the search with the best feeds so far.

    Returns
    -------
    SimulatedSchedule
        The plan; the start's feeds where the search found none that are better. Dressings and
        changes of the electrode are counted, not simulated: one electrode goes all the way.

    Raises
    ------
    InputError
        If feeds and paths differ in number, wear ratio, bounds or settings are out of range, or a
        layer alone uses up the electrode.
    """
    require_float64("A schedule through the simulator")
    begin = _start_feeds(start, len(paths))
    believed, cautions = believed_wear_ratio(wear_ratio, section.area)
    if believed[0] < 0:
        raise InputError(f"wear ratio {believed[0]:g} is below 0: check it.")
    bounds = _whole_steps(feed_bounds, machine.resolution)
    belief = Belief.of(believed, settings.nodes)
    if target_depth is None:
        layers = start.layers.bottom if isinstance(start, Schedule) else [math.inf]
        target_depth = float(layers[-1])
    check = settings.model(paths, section, settings.cell)
    wanted = _sparing(target_map(target, check.workpiece, target_depth), check.workpiece, spared)
    # Refuses settings that do not go together, before any long work.
    foresight = Foresight(check, settings.more, wanted, belief)
    told, stepped = _rounded(begin, machine.resolution)
    before = foresight.of(stepped)
    cell = settings.coarse_cell(section)
    coarse = check if cell == settings.cell else settings.model(paths, section, cell)
    found = search_feeds(
        coarse,
        settings.more,
        _sparing(target_map(target, coarse.workpiece, target_depth), coarse.workpiece, spared),
        belief.nodes,
        begin,
        bounds,
        settings.stay,
        settings.evaluations,
        progress,
    )
    new_told, stepped = _rounded(found.feeds, machine.resolution)
    after = foresight.of(stepped)
    feeds = found.feeds
    within = bool(np.all((begin >= bounds[0] - 1e-9) & (begin <= bounds[1] + 1e-9)))
    cells = f"cells of {cell:g} um, judged with {settings.cell:g} um"
    if after.expected_rms < before.expected_rms or not within:
        status = f"feeds of {len(feeds)} layers searched by simulation with {cells}: {found.why}"
        told = new_told
    else:
        feeds, after = begin, before
        status = (
            f"the start's feeds of {len(feeds)} layers are kept: the search with {cells}, found "
            "none that are better"
        )
    warnings = list(cautions)
    if not found.converged:
        warnings.append(f"the search was {found.why}: allow more evaluations for the rest")
    held = np.flatnonzero(feeds >= bounds[1] * (1 - 1e-9))
    if len(held):
        warnings.append(
            f"the greatest feed of {bounds[1]:g} um holds back {len(held)} layers (the first is "
            f"{held[0] + 1})"
        )
    return SimulatedSchedule(
        feeds=feeds,
        cumulative_feed=told,
        before=before,
        after=after,
        target=wanted,
        wear_ratios=belief.nodes,
        touch_off_after=touch_offs(
            after.depth_ends, machine.tolerance or _half_thickest(after.depths)
        ),
        new_electrode_before=electrode_changes(after.tip_loss_limit, machine.usable_length),
        evaluations=found.evaluations,
        status=status,
        warnings=tuple(warnings),
    )


def _sparing(
    target: np.ndarray, workpiece: WorkpieceMap, spared: shapely.Geometry | None
) -> np.ndarray:
    """The target with NaN where the error does not count."""
    if spared is None or spared.is_empty:
        return target
    return np.where(cells_inside(spared, workpiece), np.nan, target)


def _start_feeds(start: Schedule | np.ndarray, layers: int) -> np.ndarray:
    feeds = np.asarray(start.feeds if isinstance(start, Schedule) else start, float)
    if feeds.shape != (layers,):
        raise InputError(
            f"the start has feeds of shape {feeds.shape} for {layers} paths: give one for each."
        )
    if not (np.all(np.isfinite(feeds)) and np.all(feeds > 0)):
        worst = int(np.argmin(np.isfinite(feeds) & (feeds > 0))) + 1
        raise InputError(f"the start's feed of layer {worst} must be a number above 0.")
    return feeds


def _whole_steps(bounds: tuple[float, float], step: float) -> tuple[float, float]:
    least = step * math.ceil(max(bounds[0], step) / step - 1e-9)
    most = step * math.floor(bounds[1] / step + 1e-9) if math.isfinite(bounds[1]) else math.inf
    if not least < most:
        raise InputError(
            f"feed bounds ({bounds[0]:g}, {bounds[1]:g}) um must be increasing and above the "
            f"machine's resolution of {step:g} um."
        )
    return least, most


def _rounded(feeds: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Cumulative feed in whole steps, and the feeds it makes."""
    told = step * np.round(np.cumsum(feeds) / step)
    return told, np.diff(told, prepend=0.0)


def _half_thickest(depths: np.ndarray) -> float:
    return 0.5 * float(np.max(np.diff(depths, prepend=0.0)))
