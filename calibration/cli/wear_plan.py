"""`procmodel wear plan`: layers, feeds and scanning paths of the next cavity."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from calibration.cli import console, options
from calibration.cli import wear_plan_options as choices
from calibration.cli.wear_plan_belief import believed_of
from calibration.cli.wear_plan_cavity import Cavity, cavity_of_shape, cavity_of_solid
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.plans.schedule import Schedule
    from procmodel.wear import Solid, TargetLayers

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
    preview: choices.Preview = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan layers, feeds and scanning paths of a shape, a depth map or a solid (STL)."""
    area = _electrode_area(electrode_diameter, electrode_area, electrode_side)
    if not 0 <= gap < math.inf:
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    if not optimise and (least_feed > 0 or greatest_feed < math.inf):
        raise InputError("--least-feed and --greatest-feed need --optimise: exact feeds obey none.")
    if gcode is not None and (shape == "table" or finish_thickness is not None):
        raise InputError("--gcode is written for one stage of a cavity that has an outline only.")
    if template is not None and gcode is None:
        raise InputError("--template is given without --gcode, the program it is for: give both.")
    if (shape is None) == (solid is None):
        raise InputError("give either --shape or --solid, one of the two.")
    options.check_outputs(out, paths, gcode, plot=plot)
    options.check_outputs(out, paths, gcode, plot, plot=preview)

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.cli import wear_plan_output, wear_plan_paths, wear_plan_stages
    from calibration.plans.layer_depth import compare_layer_depths
    from calibration.plans.schedule import Machine, Trade, exact_schedule, optimised_schedule
    from procmodel.wear.layer_path import ElectrodeSection
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
    asked = changed or paths is not None or preview is not None or cavity.solid is None
    by_shape = not asked and scallop is None and electrode_side is None
    scanning = asked or (gcode is not None and not by_shape)
    round_or_square = ElectrodeSection("round", 2.0 * math.sqrt(area / math.pi))
    if electrode_side is not None:
        round_or_square = ElectrodeSection("square", electrode_side)

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
    compared, stages = [], []
    if cavity.solid is None or scallop is not None or (scanning and finish is not None):
        if len(layer_depth) > 1:
            raise InputError(
                "several --layer-depth are compared for shapes and tables without --scallop, and "
                "not for two stages with paths: give one."
            )
        slices = cavity.slices(layer_depth[0], depth, level, scallop, resolution)
        choice = narrow or ("refuse" if cavity.solid is None else "plunge")
        stages = wear_plan_stages.of_slices(slices, round_or_square, gap, choice, finish)
        schedules = [
            plan(stages[0].layers),
            *(plan(s.layers, s.wear_ratio, s.electrode.area) for s in stages[1:]),
        ]
    else:
        compared = compare_layer_depths(cavity.solid, layer_depth, plan, trade, depth, level)
        schedules = [compared[0].schedule]
        if finish is not None:
            schedules = _two_stages(cavity.solid, compared[0].layers, finish, plan)
        if scanning:
            stages = [
                wear_plan_stages.of_shape(
                    cavity, compared[0].layers, level, round_or_square, gap, narrow or "plunge"
                )
            ]
    found: dict[str, Any] = dict(NO_PATHS)
    notes += [note for stage in stages for note in stage.notes]
    if scanning:
        scans = [stage.scanned(gap, rules, pattern or "contour") for stage in stages]
        found = wear_plan_paths.summed_up(scans, schedules, scan_feed, plunge_feed)
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
    result |= {"layer_depth": compared[0].layer_depth if compared else layer_depth[0], **found}
    console.show(result, wear_plan_output.as_text(result), as_json)


def _electrode_area(diameter: float | None, area: float | None, side: float | None) -> float:
    if side is None:
        return console.electrode_area(diameter, area)
    if diameter is not None or area is not None:
        raise InputError("--electrode-side is given with another size of the electrode: give one.")
    if not (math.isfinite(side) and side > 0):
        raise InputError(f"--electrode-side is {side:g}, but must be above 0.")
    return side**2


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
