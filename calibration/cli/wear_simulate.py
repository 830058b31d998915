"""`procmodel wear simulate`: the cavity and the electrode's tip that a plan will leave."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from calibration.cli import wear_plan_options as choices
from calibration.cli.wear_given import require_spread, section_of, ways_of
from calibration.cli.wear_plan_belief import believed_of
from calibration.cli.wear_plan_cavity import Cavity, cavity_of_shape, cavity_of_solid
from procmodel.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from calibration.wear_simulation import CutCavity
    from procmodel.io import WrittenPlan
    from procmodel.wear.layer_path import ElectrodeSection, LayerPath
    from procmodel.wear.slicing import Reach, Slices
    from procmodel.wear.surface_error import SurfaceError
    from procmodel.wear.zmap_maps import WorkpieceMap

# What a map may cost: more cells than this do not fit into memory with all that goes with them.
_MOST_CELLS = 2e7
_STOPPED = 130
# Median difference of the areas beyond which plan and cavity do not belong together.
_OTHER_PART = 0.25
# Cells at the wall are no bottom: the side gap and the corner of the tip are seen there.
_RIM = 1.5


@dataclass(frozen=True)
class _Job:
    """What was planned."""

    plan: "WrittenPlan"
    slices: "Slices"
    paths: "list[LayerPath]"
    reach: "Reach"
    notes: list[str]


def simulate_command(
    plan: Annotated[
        Path,
        typer.Option(
            "--plan", help="CSV of 'wear plan --out': 'target z [um]', 'cumulative feed [um]'."
        ),
    ],
    cell: Annotated[float, typer.Option("--cell", help="Side of the maps' cells [um].")],
    shape: choices.Shape = None,
    radius: choices.Radius = None,
    half_width: choices.HalfWidth = None,
    wall_angle: choices.WallAngle = None,
    length: choices.Length = None,
    width: choices.Width = None,
    table: choices.TableFile = None,
    solid: choices.SolidFile = None,
    solid_unit: choices.SolidUnit = "mm",
    undercut: choices.Undercut = "refuse",
    level: choices.Level = "paper",
    narrow: choices.Narrow = None,
    wear_ratio: choices.WearRatio = None,
    fit: choices.Fit = None,
    posterior: choices.Posterior = None,
    electrode_diameter: options.ElectrodeDiameter = None,
    electrode_area: options.ElectrodeArea = None,
    electrode_side: choices.ElectrodeSide = None,
    usable_length: choices.UsableLength = None,
    wear_mode: choices.WearModeName = "local",
    spread_width: choices.SpreadWidth = None,
    gap: Annotated[float, typer.Option("--gap", help="Side gap [um].")] = 0.0,
    bottom_gap: choices.BottomGap = 0.0,
    paths: Annotated[
        Path | None,
        typer.Option("--paths", help="Follow these paths: CSV of 'wear plan --paths'."),
    ] = None,
    pattern: choices.PatternName = None,
    overlap: choices.Overlap = 0.2,
    no_to_and_fro: choices.NoToAndFro = False,
    no_alternate: choices.NoAlternate = False,
    no_inside_and_periphery: choices.NoInsideAndPeriphery = False,
    step: Annotated[
        float | None, typer.Option("--step", help="Step along the path [um]; a cell if left out.")
    ] = None,
    feed_law: Annotated[
        str,
        typer.Option(
            "--feed-law",
            help="layer (all where a layer begins), linear (along the way) or fixed-length (after "
            "each --feed-length): how a layer's feed is given.",
        ),
    ] = "layer",
    feed_length: Annotated[
        float | None, typer.Option("--feed-length", help="Way between two feeds [um].")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the maps here (netCDF).")] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", help="Keep the state of the run here (.h5).")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the checkpoint if it is there.")
    ] = False,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Cut a plan in simulation: surface, error, volume ratio and the tip that is left."""
    if (shape is None) == (solid is None):
        raise InputError("give either --shape or --solid, the cavity that was planned.")
    if not (math.isfinite(cell) and cell > 0):
        raise InputError(f"--cell is {cell:g}, but must be above 0.")
    if not 0 <= gap < math.inf:
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    if resume and checkpoint is None:
        raise InputError("--resume is given without --checkpoint, the file to go on from.")
    scanned = no_to_and_fro or no_alternate or no_inside_and_periphery or pattern is not None
    if paths is not None and scanned:
        raise InputError("--paths brings the scanning with it: leave out the options of scanning.")
    if out is not None and out.suffix.lower() != ".nc":
        raise InputError(f"{out.name}: the maps are written as netCDF: let the name end in .nc.")
    require_spread(wear_mode, spread_width)
    read = (plan, paths, table, solid, fit, posterior)
    options.check_outputs(out, checkpoint, plot=plot, inputs=read)

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.wear_simulation import CavityTask, cut_cavity, planned_feeds, save_cavity
    from procmodel.io import read_plan
    from procmodel.wear.path_steps import path_steps
    from procmodel.wear.scanning import ScanningRules
    from procmodel.wear.surface_error import cleared_cells, surface_error
    from procmodel.wear.target_map import target_map
    from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap

    section = section_of(electrode_diameter, electrode_area, electrode_side)
    if solid is not None:
        cavity = cavity_of_solid(solid, solid_unit, undercut, None)
    else:
        assert shape is not None
        cavity = cavity_of_shape(shape, radius, half_width, wall_angle, table, length, width)
    rules = ScanningRules(not no_to_and_fro, not no_alternate, overlap, not no_inside_and_periphery)
    job = _job(read_plan(plan), cavity, level, section, gap, narrow, paths, rules, pattern)
    believed, notes = believed_of(wear_ratio, fit, posterior, section.area)
    job.notes.extend(notes)

    _require_affordable(job.paths, section, cell)
    steps = path_steps(job.paths, cell if step is None else step)
    electrode = ElectrodeMap(
        section, cell, reach=gap, usable_length=math.inf if usable_length is None else usable_length
    )
    workpiece = WorkpieceMap.around(steps, electrode, margin=2.0 * cell)
    feeds = planned_feeds(steps, job.plan.feed, feed_law, feed_length)  # type: ignore[arg-type]
    task = CavityTask(
        steps, feeds, electrode, workpiece, gap, bottom_gap, wear_mode, spread_width  # type: ignore[arg-type]
    )  # fmt: skip
    # The surface that is wanted is the part itself, or the staircase where only that is known.
    wanted = job.slices if cavity.target is None else cavity.target
    target = target_map(wanted, workpiece, float(job.plan.bottom[-1]))
    go_on = "" if checkpoint is None else "; run again with --resume"
    try:
        cut = cut_cavity(task, believed, checkpoint=checkpoint, resume=resume, progress=not as_json)
    except KeyboardInterrupt:
        console.say(f"procmodel: stopped; nothing more was written{go_on}.")
        raise typer.Exit(_STOPPED) from None
    if len(cut.simulated.removed) == 0:
        console.say(f"procmodel: {cut.simulated.status}")
        raise typer.Exit(_STOPPED)
    bottom = _bottom(job, workpiece)
    error = surface_error(cut.depth, target, bottom=bottom)
    reached = surface_error(
        cut.depth, target, cleared_cells(cut.depth, target) & ~_spared(job, workpiece), bottom
    )
    if out is not None:
        save_cavity(out, cut, target)
    if plot is not None:
        import numpy as np

        from calibration.plots.cavity import draw_cavity
        from calibration.plots.figures import save

        save(draw_cavity(cut, target, np.isfinite(error.map)), plot)
    result = _as_dict(cut, error, reached, bottom, job)
    console.show(result, _as_text(result), as_json)
    if len(cut.simulated.removed) < len(job.paths):
        raise typer.Exit(console.NOT_CONVERGED)


def _job(
    plan: "WrittenPlan",
    cavity: Cavity,
    level: str,
    section: "ElectrodeSection",
    gap: float,
    narrow: str | None,
    paths: Path | None,
    rules: Any,
    pattern: str | None,
) -> _Job:
    """Layers of the plan, cut from the cavity, and the way through them."""
    from procmodel.io import read_paths
    from procmodel.wear.scanning import scan_layers

    slices = cavity.planned(plan.bottom, level, plan.path.name)
    _require_same_part(plan, slices, cavity.name)
    notes = []
    if paths is None:
        choice = narrow or ("refuse" if cavity.solid is None else "plunge")
        if choice == "stop":
            raise InputError("--narrow stop belongs to 'wear plan': a plan is simulated whole.")
        reach = slices.reach(section, gap, choice)  # type: ignore[arg-type]
        ways = scan_layers(slices, section, gap, rules, pattern or "contour", reach)  # type: ignore[arg-type]
        if reach.narrow:
            notes.append(
                f"{len(reach.narrow)} layers from layer {reach.narrow[0]} on are narrower than the "
                "electrode, which plunges there and cuts more than they ask for"
            )
        return _Job(plan, slices, ways, reach, notes)
    written = read_paths(paths)
    if len(written) != len(plan.bottom):
        raise InputError(
            f"{paths.name} has {len(written)} layers, {plan.path.name} {len(plan.bottom)}: give "
            "the two files of one plan."
        )
    reach = slices.reach(section, gap, "plunge")
    return _Job(plan, slices, ways_of(written), reach, notes)


def _require_affordable(paths: "list[LayerPath]", section: "ElectrodeSection", cell: float) -> None:
    import numpy as np

    corners = np.concatenate([path.points for path in paths])
    wide, high = np.ptp(corners, axis=0) + section.size
    cells = wide * high / cell**2
    if cells > _MOST_CELLS:
        raise InputError(
            f"--cell {cell:g} um makes {cells:.3g} cells of {wide:.4g} x {high:.4g} um, more than "
            f"{_MOST_CELLS:.3g}: take cells of {cell * math.sqrt(cells / _MOST_CELLS):.2g} um or "
            "more."
        )


def _spared(job: _Job, workpiece: "WorkpieceMap") -> "np.ndarray":
    """Cells that the electrode does not reach in some layer."""
    from procmodel.wear.target_map import cells_inside

    return cells_inside(job.slices.out_of_reach(job.reach), workpiece)


def _require_same_part(plan: "WrittenPlan", slices: "Slices", name: str) -> None:
    import numpy as np

    if plan.area is None:
        return
    areas = slices.areas
    known = areas > 0
    off = float(np.median(np.abs(plan.area[known] / areas[known] - 1.0))) if np.any(known) else 0.0
    if off > _OTHER_PART:
        raise InputError(
            f"{plan.path.name} has layers whose areas differ from those of the {name} by "
            f"{100 * off:.3g} % in the middle: give the cavity that was planned."
        )


def _bottom(job: _Job, workpiece: "WorkpieceMap") -> "np.ndarray":
    """Cells of the last layer that its wall does not reach."""
    from procmodel.wear.target_map import cells_inside

    inside = cells_inside(job.reach.cleared[-1].buffer(-_RIM * workpiece.cell), workpiece)
    if not inside.any():
        raise InputError(
            f"the bottom is narrower than {2 * _RIM:g} cells of {workpiece.cell:g} um: take "
            "smaller cells."
        )
    return inside


def _as_dict(
    cut: "CutCavity",
    error: "SurfaceError",
    reached: "SurfaceError",
    bottom: "np.ndarray",
    job: _Job,
) -> dict[str, Any]:
    import numpy as np

    at = cut.simulated
    loss = np.asarray(at.electrode_loss)[cut.task.electrode.bottom]
    spread = None
    if cut.low is not None and cut.high is not None:
        spread = float(np.mean(0.5 * (cut.high - cut.low)[bottom]))
    return {
        "volume_ratio": float(at.volume_ratio),
        "depth_mean": float(np.mean(cut.depth[bottom])),
        "depth_spread": spread,
        "bottom_peak_to_valley": error.peak_to_valley,
        "error_rms": error.rms,
        "error_mean": error.mean,
        "error_max": error.max,
        "reachable_error_rms": reached.rms,
        "reachable_error_mean": reached.mean,
        "reachable_error_max": reached.max,
        "tip_peak_to_valley": float(np.ptp(loss)),
        "electrode_length": float(at.greatest_loss[-1]) if len(at.greatest_loss) else 0.0,
        "removed_volume": float(np.sum(at.removed)),
        "wear_ratios": list(cut.wear_ratios),
        "layers": len(at.removed),
        "layers_planned": len(job.paths),
        "path_length_um": sum(path.length for path in job.paths),
        "steps": int(cut.task.steps.counts.sum()),
        "cells": list(cut.depth.shape),
        "cell_updates_per_second": cut.cell_updates_per_second,
        "status": at.status,
        "warnings": [*job.notes, *cut.notes],
    }


def _as_text(result: dict[str, Any]) -> str:
    band = result["depth_spread"]
    speed = result["cell_updates_per_second"]
    lines = [
        result["status"],
        f"volume ratio      {result['volume_ratio']:.12g}",
        f"depth             {result['depth_mean']:.4f} um in the mean of the bottom"
        + ("" if band is None else f" +- {band:.2g} (95 %)"),
        f"flatness          {result['bottom_peak_to_valley']:.4f} um from peak to valley",
        f"error             {result['reachable_error_rms']:.4f} um rms, "
        f"{result['reachable_error_mean']:+.4f} mean, {result['reachable_error_max']:.4f} at most, "
        "of what the electrode reaches",
        f"with the corners  {result['error_rms']:.4f} um rms, {result['error_max']:.4f} at most",
        f"electrode         {result['electrode_length']:.4f} um shorter, its tip uneven by "
        f"{result['tip_peak_to_valley']:.4f} um",
        f"run               {result['steps']} steps, {result['cells'][0]} x {result['cells'][1]} "
        "cells" + ("" if speed is None else f", {speed / 1e6:.3g} million cell updates a second"),
    ]
    return "\n".join([*lines, *(f"note  {warning}." for warning in result["warnings"])])
