"""`procmodel wear plan`: layers, feeds and scanning paths of the next cavity."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from calibration.cli import console, options
from calibration.cli import wear_plan_options as choices
from calibration.cli.wear_given import require_spread, section_of
from calibration.cli.wear_plan_belief import believed_of
from calibration.cli.wear_plan_cavity import Cavity, cavity_of_shape, cavity_of_solid
from procmodel.errors import InputError, nearest

if TYPE_CHECKING:
    from calibration.plans.levelling import LevellingPlan
    from calibration.plans.schedule import Machine, Schedule
    from procmodel.wear import Solid, TargetLayers

LEVELS = ("paper", "top", "middle", "bottom")
# How far a search through the simulation may raise the greatest feed of the exact schedule.
_MOST_OF_START = 1.5
Planner = Callable[..., "Schedule"]
NO_PATHS = dict.fromkeys(
    (
        "path_length_um",
        "lifted_length_um",
        "lifted_moves",
        "turning_points",
        "path_time_s",
        "uncovered_share",
        "unreachable_share",
        "islands",
    )
)


def plan_command(
    layer_depth: choices.LayerDepth,
    shape: choices.Shape = None,
    solid: choices.SolidFile = None,
    solid_unit: choices.SolidUnit = "mm",
    radius: choices.Radius = None,
    half_width: choices.HalfWidth = None,
    wall_angle: choices.WallAngle = None,
    length: choices.Length = None,
    width: choices.Width = None,
    table: choices.TableFile = None,
    depth: choices.Depth = None,
    level: choices.Level = "paper",
    scallop: choices.Scallop = None,
    undercut: choices.Undercut = "refuse",
    narrow: choices.Narrow = None,
    travel: choices.Travel = None,
    wear_ratio: choices.WearRatio = None,
    fit: choices.Fit = None,
    posterior: choices.Posterior = None,
    electrode_diameter: options.ElectrodeDiameter = None,
    electrode_area: options.ElectrodeArea = None,
    electrode_side: choices.ElectrodeSide = None,
    gap: choices.Gap = 0.0,
    resolution: options.Resolution = 0.1,
    usable_length: choices.UsableLength = None,
    tolerance: choices.Tolerance = None,
    removal_rate: choices.RemovalRate = None,
    layer_overhead: choices.LayerOverhead = 0.0,
    optimise: choices.Optimise = False,
    least_feed: choices.LeastFeed = 0.0,
    greatest_feed: choices.GreatestFeed = math.inf,
    per_minute: choices.PerMinute = 0.0,
    per_length: choices.PerLength = 0.0,
    finish_thickness: choices.FinishThickness = None,
    finish_wear_ratio: choices.FinishWearRatio = None,
    finish_electrode_diameter: choices.FinishDiameter = None,
    finish_electrode_area: choices.FinishArea = None,
    out: choices.Out = None,
    paths: choices.Paths = None,
    gcode: choices.Gcode = None,
    template: choices.Template = None,
    scan_feed: choices.ScanFeed = 10.0,
    plunge_feed: choices.PlungeFeed = 1.0,
    pattern: choices.PatternName = None,
    overlap: choices.Overlap = 0.2,
    no_to_and_fro: choices.NoToAndFro = False,
    no_alternate: choices.NoAlternate = False,
    no_inside_and_periphery: choices.NoInsideAndPeriphery = False,
    levelling: choices.Levelling = 0,
    refine: choices.Refine = None,
    wear_mode: choices.WearModeName = "local",
    spread_width: choices.SpreadWidth = None,
    bottom_gap: choices.BottomGap = 0.0,
    preview: choices.Preview = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan layers, feeds and scanning paths of a shape, a depth map or a solid (STL)."""
    section = section_of(electrode_diameter, electrode_area, electrode_side)
    area = section.area
    if not 0 <= gap < math.inf:
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    if not optimise and refine is None and (least_feed > 0 or greatest_feed < math.inf):
        raise InputError(
            "--least-feed and --greatest-feed need --optimise or --refine: exact feeds obey none."
        )
    if gcode is not None and (shape == "table" or finish_thickness is not None):
        raise InputError("--gcode is written for one stage of a cavity that has an outline only.")
    if levelling < 0 or (levelling and (finish_thickness is not None or len(layer_depth) > 1)):
        raise InputError("--levelling is a number of passes, for one stage and one --layer-depth.")
    if refine is not None and (levelling or finish_thickness is not None):
        raise InputError("--refine is for one stage without --levelling: give one of them.")
    if refine is None and (wear_mode != "local" or spread_width is not None or bottom_gap):
        raise InputError("--wear-mode, --spread-width and --bottom-gap belong to --refine.")
    if template is not None and gcode is None:
        raise InputError("--template is given without --gcode, the program it is for: give both.")
    if (shape is None) == (solid is None):
        raise InputError("give either --shape or --solid, one of the two.")
    if level not in LEVELS:
        raise InputError(f"--level is {level!r}{nearest(level, LEVELS)}.")
    if undercut not in ("refuse", "clip"):
        raise InputError(f"--undercut is {undercut!r}, but must be refuse or clip.")
    for name, value in (("--scallop", scallop), ("--refine", refine), ("--scan-feed", scan_feed),
                        ("--plunge-feed", plunge_feed)):  # fmt: skip
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value:g}, but must be above 0.")
    require_spread(wear_mode, spread_width)
    read = (table, solid, fit, posterior, template)
    options.check_outputs(out, paths, gcode, plot=plot, inputs=read)
    options.check_outputs(out, paths, gcode, plot, plot=preview, inputs=read)

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.cli import (
        wear_plan_output,
        wear_plan_paths,
        wear_plan_refine,
        wear_plan_stages,
    )
    from calibration.plans.layer_depth import compare_layer_depths
    from calibration.plans.levelling import with_levelling
    from calibration.plans.schedule import Machine, Trade, exact_schedule, optimised_schedule
    from calibration.plans.simulated_schedule import SimulationSettings
    from procmodel.wear.scanning import ScanningRules

    believed, notes = believed_of(wear_ratio, fit, posterior, area)
    machine = Machine(resolution, removal_rate, layer_overhead, usable_length, tolerance)
    trade = Trade(per_minute, per_length)
    rules = ScanningRules(not no_to_and_fro, not no_alternate, overlap, not no_inside_and_periphery)
    cavity: Cavity
    if solid is not None:
        cavity = cavity_of_solid(solid, solid_unit, undercut, travel)
    else:
        assert shape is not None
        cavity = cavity_of_shape(shape, radius, half_width, wall_angle, table, length, width)
    # A shape's own program, along arcs, unless something else was asked of the paths.
    changed = pattern is not None or no_to_and_fro or no_alternate or no_inside_and_periphery
    changed = changed or (levelling > 0 and (gcode is not None))
    asked = (
        changed
        or refine is not None
        or paths is not None
        or preview is not None
        or cavity.solid is None
    )
    by_shape = not asked and scallop is None and electrode_side is None
    scanning = asked or (gcode is not None and not by_shape)

    def plan(layers: "TargetLayers", ratio: Any = believed, electrode: float = area) -> "Schedule":
        if not optimise:
            return exact_schedule(layers, ratio, electrode, machine)
        bounds = (least_feed, greatest_feed)
        return optimised_schedule(
            layers, ratio, electrode, machine, feed_bounds=bounds, trade=trade
        )

    finish: wear_plan_stages.Finish | None = None
    if finish_thickness is not None:
        finish_area = console.electrode_area(
            finish_electrode_diameter, finish_electrode_area, "finish-electrode"
        )
        ratio = console.required(finish_wear_ratio, "--finish-wear-ratio", "--finish-thickness")
        finish = wear_plan_stages.Finish(finish_thickness, ratio, finish_area)
        notes += finish.cautions

    def planned(thickness: list[float], depth: float | None) -> tuple[list, list, list]:
        """Schedules of the stages, the stages that have an outline, and layer depths compared."""
        compared: list[Any] = []
        stages: list[Any] = []
        if cavity.solid is None or scallop is not None or (scanning and finish is not None):
            if len(thickness) > 1:
                raise InputError(
                    "several --layer-depth are compared for shapes and tables without "
                    "--scallop, and not for two stages with paths: give one."
                )
            slices = cavity.slices(thickness[0], depth, level, scallop, resolution)
            choice = narrow or ("refuse" if cavity.solid is None else "plunge")
            stages = wear_plan_stages.of_slices(slices, section, gap, choice, finish)
            schedules = [
                plan(stages[0].layers),
                *(plan(s.layers, s.wear_ratio, s.electrode.area) for s in stages[1:]),
            ]
        else:
            compared = compare_layer_depths(cavity.solid, thickness, plan, trade, depth, level)
            schedules = [compared[0].schedule]
            if finish is not None:
                schedules = _two_stages(cavity.solid, compared[0].layers, finish, plan)
            if scanning:
                stages = [
                    wear_plan_stages.of_shape(
                        cavity, compared[0].layers, level, section, gap, narrow or "plunge"
                    )
                ]
        return schedules, stages, compared

    schedules, stages, compared = planned(layer_depth, depth)
    passes = None
    if levelling:
        passes = _levelling(schedules[0], believed, area, levelling, machine)
        end = float(schedules[0].layers.bottom[-1])
        # The same layers and passes, so much thinner that they end at the depth asked for.
        share = end / (end + passes.depth_added)
        schedules, stages, compared = planned([layer_depth[0] * share], end * share)
        passes = _levelling(schedules[0], believed, area, levelling, machine)
        schedules = [with_levelling(schedules[0], passes, usable_length)]
        stages = [stages[0].levelled(schedules[0], levelling)] if stages else []
    found: dict[str, Any] = dict(NO_PATHS)
    notes += [note for stage in stages for note in stage.notes]
    notes += cavity.missed_floors([float(z) for z in schedules[-1].layers.bottom])
    if scanning:
        scans = [stage.scanned(gap, rules, pattern or "contour") for stage in stages]
        if refine is not None:
            # The bottom is to cut, not the side: no layer much deeper than those of eq. (3).
            most = min(greatest_feed, _MOST_OF_START * float(max(schedules[0].feeds)))
            bounds = (least_feed, most)
            simulated = wear_plan_refine.refined(
                scans[0], stages[0].reach, cavity, believed, schedules[0], machine, bounds,
                SimulationSettings(
                    refine, side_gap=gap, bottom_gap=bottom_gap, wear_mode=wear_mode,  # type: ignore[arg-type]
                    spread_width=spread_width,
                ),
                quiet=as_json,
            )  # fmt: skip
            schedules = [simulated.as_schedule(schedules[0], machine)]
            found["simulated"] = simulated.as_dict()
        found |= wear_plan_paths.summed_up(scans, schedules, scan_feed, plunge_feed)
    if travel is not None:
        wear_plan_stages.require_travel(schedules, stages, travel)
    if out is not None:
        wear_plan_output.write_schedule(out, schedules, gap)
    if paths is not None:
        wear_plan_paths.write_paths(paths, scans, schedules)
    if gcode is not None and by_shape:
        feeds = (scan_feed, plunge_feed, overlap)
        wear_plan_output.write_shape_program(
            gcode, template, schedules[0], cavity.name, area, gap, feeds
        )
    elif gcode is not None:
        wear_plan_paths.write_scanning_program(
            gcode, template, cavity.name, scans[0], schedules[0], gap, (scan_feed, plunge_feed)
        )
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.wear import draw_plan

        save(draw_plan(schedules), plot)
    if preview is not None:
        from calibration.plots.figures import save
        from calibration.plots.scanning import draw_scanning

        save(draw_scanning(scans[0].slices, scans[0].paths, scans[0].electrode, gap), preview)
    result = wear_plan_output.as_dict(schedules, notes, compared)
    if passes is not None:
        result["levelling"] = {
            "feeds": passes.feeds,
            "tilt_before": passes.tilt_before,
            "tilt": passes.tilt,
            "tilt_limit": passes.tilt_limit,
            "depth_added": passes.depth_added,
            "status": passes.status,
        }
    result |= {"layer_depth": compared[0].layer_depth if compared else layer_depth[0], **found}
    console.show(result, wear_plan_output.as_text(result), as_json)


def _levelling(
    schedule: "Schedule", believed: Any, area: float, passes: int, machine: "Machine"
) -> "LevellingPlan":
    """Levelling passes for the last layer of a schedule."""
    from calibration.plans.belief import believed_wear_ratio
    from calibration.plans.levelling import levelling_passes

    ratios, _ = believed_wear_ratio(believed, area)
    section = float(schedule.layers.area[-1])
    wear = ratios * section / area
    return levelling_passes(
        float(schedule.feeds[-1]),
        wear if len(wear) > 1 else float(wear[0]),
        passes,
        resolution=machine.resolution,
    )


def _two_stages(
    solid: "Solid", layers: "TargetLayers", finish: Any, plan: Planner
) -> list["Schedule"]:
    from procmodel.wear import CircleSection, Hemisphere, TaperedSolid, split_for_finishing

    if isinstance(solid, TaperedSolid):
        section = solid.section
    elif isinstance(solid, Hemisphere):
        section = CircleSection()
    else:
        raise InputError("--finish-thickness needs a cavity with an outline, not a table.")
    roughing, finishing = split_for_finishing(layers, section, finish.thickness)
    return [plan(roughing), plan(finishing, finish.wear_ratio, finish.area)]
