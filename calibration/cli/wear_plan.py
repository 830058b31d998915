"""`procmodel wear plan`: the feed of every layer for the next cavity."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.plans.schedule import Schedule
    from procmodel.wear import Solid, TargetLayers


def plan_command(
    shape: Annotated[
        str, typer.Option("--shape", help="pyramid, cone, hemisphere, or table with --table.")
    ],
    layer_depth: Annotated[
        list[float],
        typer.Option("--layer-depth", help="Depth of a layer [um]; repeat it to compare several."),
    ],
    radius: Annotated[
        float | None, typer.Option("--radius", help="Of hemisphere or cone at the surface [um].")
    ] = None,
    half_width: Annotated[
        float | None, typer.Option("--half-width", help="Of the pyramid at the surface [um].")
    ] = None,
    wall_angle: Annotated[
        float | None,
        typer.Option("--wall-angle", help="Between wall and surface [deg]; 90 is vertical."),
    ] = None,
    table: Annotated[
        Path | None, typer.Option("--table", help="CSV with 'z [um]' and 'area [um^2]'.")
    ] = None,
    depth: Annotated[
        float | None, typer.Option("--depth", help="Of the cavity [um]; full depth if left out.")
    ] = None,
    level: Annotated[
        str, typer.Option("--level", help="Where a layer takes its section: see the README.")
    ] = "paper",
    wear_ratio: Annotated[
        float | None, typer.Option("--wear-ratio", help="Volumetric wear ratio R, taken as exact.")
    ] = None,
    fit: Annotated[
        Path | None, typer.Option("--fit", help="Instead: JSON that 'wear fit --out' wrote.")
    ] = None,
    posterior: Annotated[
        Path | None, typer.Option("--posterior", help="Instead: netCDF of 'wear fit --posterior'.")
    ] = None,
    electrode_diameter: options.ElectrodeDiameter = None,
    electrode_area: options.ElectrodeArea = None,
    gap: Annotated[
        float, typer.Option("--gap", help="Side gap: program the half width less this [um].")
    ] = 0.0,
    resolution: options.Resolution = 0.1,
    usable_length: Annotated[
        float | None, typer.Option("--usable-length", help="Usable length of an electrode [um].")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance", help="Depth spread that calls a touch-off [um].")
    ] = None,
    removal_rate: Annotated[
        float | None, typer.Option("--removal-rate", help="Volume removed in a second [um^3/s].")
    ] = None,
    layer_overhead: Annotated[
        float, typer.Option("--layer-overhead", help="Time lost per layer [s].")
    ] = 0.0,
    optimise: Annotated[
        bool, typer.Option("--optimise", help="Bounded feeds, least expected wall error.")
    ] = False,
    least_feed: Annotated[
        float, typer.Option("--least-feed", help="Least feed of a layer, with --optimise [um].")
    ] = 0.0,
    greatest_feed: Annotated[
        float, typer.Option("--greatest-feed", help="Greatest feed, with --optimise [um].")
    ] = math.inf,
    per_minute: Annotated[
        float, typer.Option("--per-minute", help="Mean square wall error a minute is worth [um^2].")
    ] = 0.0,
    per_length: Annotated[
        float, typer.Option("--per-length", help="And a micrometre of electrode [um^2].")
    ] = 0.0,
    finish_thickness: Annotated[
        float | None,
        typer.Option("--finish-thickness", help="Ring left for a finishing stage [um]."),
    ] = None,
    finish_wear_ratio: Annotated[
        float | None, typer.Option("--finish-wear-ratio", help="Wear ratio when finishing.")
    ] = None,
    finish_electrode_diameter: Annotated[
        float | None, typer.Option("--finish-electrode-diameter", help="Of its electrode [um].")
    ] = None,
    finish_electrode_area: Annotated[
        float | None, typer.Option("--finish-electrode-area", help="Of its electrode [um^2].")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the schedule here (CSV).")
    ] = None,
    gcode: Annotated[
        Path | None, typer.Option("--gcode", help="Write a generic ISO program here.")
    ] = None,
    template: Annotated[
        Path | None, typer.Option("--template", help="TOML template of the program.")
    ] = None,
    scan_feed: Annotated[
        float, typer.Option("--scan-feed", help="Feed rate along the passes [mm/min].")
    ] = 10.0,
    plunge_feed: Annotated[
        float, typer.Option("--plunge-feed", help="Feed rate downwards [mm/min].")
    ] = 1.0,
    overlap: Annotated[
        float, typer.Option("--overlap", help="Overlap of passes, share of the electrode width.")
    ] = 0.2,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan the feed of every layer for a pyramid, cone, hemisphere or any table of areas."""
    area = console.electrode_area(electrode_diameter, electrode_area)
    if not 0 <= gap < math.inf:
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    if not optimise and (least_feed > 0 or greatest_feed < math.inf):
        raise InputError("--least-feed and --greatest-feed need --optimise: exact feeds obey none.")
    if gcode is not None and (shape == "table" or finish_thickness is not None):
        raise InputError("--gcode is written for one stage of a pyramid, cone or hemisphere only.")

    if template is not None and gcode is None:
        raise InputError("--template is given without --gcode, the program it is for: give both.")
    options.check_outputs(out, gcode, plot=plot)

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.plans.layer_depth import compare_layer_depths
    from calibration.plans.schedule import (
        Machine,
        Trade,
        exact_schedule,
        optimised_schedule,
    )

    believed, notes = _believed(wear_ratio, fit, posterior, area)
    machine = Machine(resolution, removal_rate, layer_overhead, usable_length, tolerance)
    trade = Trade(per_minute, per_length)
    solid = _solid(shape, radius, half_width, wall_angle, table)

    def plan(layers: "TargetLayers", ratio: Any = believed, electrode: float = area) -> "Schedule":
        if not optimise:
            return exact_schedule(layers, ratio, electrode, machine)
        bounds = (least_feed, greatest_feed)
        return optimised_schedule(
            layers, ratio, electrode, machine, feed_bounds=bounds, trade=trade
        )

    compared = compare_layer_depths(solid, layer_depth, plan, trade, depth, level)
    stages = [compared[0].schedule]
    if finish_thickness is not None:
        finish_area = console.electrode_area(
            finish_electrode_diameter, finish_electrode_area, "finish-electrode"
        )
        ratio = console.required(finish_wear_ratio, "--finish-wear-ratio", "--finish-thickness")
        stages = _two_stages(solid, compared[0].layers, finish_thickness, plan, ratio, finish_area)
        if finish_thickness <= math.sqrt(finish_area / math.pi):
            notes.append(
                "the ring left for finishing is not thicker than half the finishing electrode, "
                "which then cuts with its side and loses its shape: leave more or go thinner"
            )
    if out is not None:
        _write_schedule(out, stages, gap)
    if gcode is not None:
        scanning = (scan_feed, plunge_feed, overlap)
        _write_program(gcode, template, stages[0], shape, area, gap, scanning)
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.wear import draw_plan

        save(draw_plan(stages), plot)
    result = _as_dict(stages, notes)
    result["layer_depth"] = compared[0].layer_depth
    if len(compared) > 1:
        result["compared"] = [
            {
                "layer_depth": option.layer_depth,
                "layers": len(option.schedule.feeds),
                "stair_error": option.stair_error,
                "expected_wall_error": option.schedule.expected_wall_error,
                "electrode_length": option.schedule.electrode_length,
                "time": option.schedule.time,
                "cost": option.cost,
            }
            for option in compared
        ]
    console.show(result, _as_text(result), as_json)


def _believed(
    wear_ratio: float | None, fit: Path | None, posterior: Path | None, area: float
) -> tuple[Any, list[str]]:
    """Wear ratio as the plans take it, and what to note about where it came from."""
    given = [value is not None for value in (wear_ratio, fit, posterior)]
    if sum(given) != 1:
        raise InputError("give one of --wear-ratio, --fit and --posterior.")
    if wear_ratio is not None:
        return wear_ratio, []
    if posterior is not None:
        return _read_posterior(posterior), []
    assert fit is not None
    return _read_fit(fit, area)


def _read_posterior(path: Path) -> Any:
    import xarray

    if not path.is_file():
        raise InputError(f"{path.name} is not a file: give the netCDF of 'wear fit --posterior'.")
    try:
        tree = xarray.load_datatree(path, engine="h5netcdf")
    except (OSError, ValueError):
        raise InputError(
            f"{path.name} cannot be read as netCDF: give the file of 'wear fit --posterior'."
        ) from None
    return tree


def _read_fit(path: Path, area: float) -> tuple[Any, list[str]]:
    """Equally likely wear ratios from the JSON of a fit."""
    import numpy as np

    from calibration.plans.belief import NODES, different_area
    from calibration.result import student_quantile
    from procmodel.io.textfile import read_utf8

    try:
        result = json.loads(read_utf8(path))
        estimate = result["parameters"]["wear_ratio"]
        fitted_area = result["parameters"]["electrode_area"]["value"]
        value, std = estimate["value"], estimate["std"]
        freedom = estimate["degrees_of_freedom"] or math.inf
    except (json.JSONDecodeError, KeyError, TypeError):
        raise InputError(
            f"{path.name} is not a result of a fit: give the JSON of 'wear fit --out'."
        ) from None
    if not result.get("converged") or std is None:
        raise InputError(
            f"{path.name} has no usable wear_ratio ({estimate['reason'] or result['status']}): "
            "fit again, or give --wear-ratio."
        )
    differs = abs(fitted_area / area - 1) > 1e-6
    notes = [different_area(fitted_area, area)] if differs else []
    levels = (np.arange(NODES) + 0.5) / NODES
    return np.maximum(value + std * student_quantile(levels, freedom), 0.0), notes


def _solid(
    shape: str,
    radius: float | None,
    half_width: float | None,
    wall_angle: float | None,
    table: Path | None,
) -> "Solid":
    from procmodel.io import read_area_table
    from procmodel.wear import Hemisphere, TabulatedSolid, cone, pyramid

    def angle(reason: str) -> float:
        return math.radians(console.required(wall_angle, "--wall-angle", reason))

    if shape == "pyramid":
        width = console.required(half_width, "--half-width", "a pyramid")
        return pyramid(width, angle("a pyramid"))
    if shape == "cone":
        return cone(console.required(radius, "--radius", "a cone"), angle("a cone"))
    if shape == "hemisphere":
        return Hemisphere(console.required(radius, "--radius", "a hemisphere"))
    if shape == "table":
        areas = read_area_table(console.required(table, "--table", "the shape 'table'"))
        return TabulatedSolid(areas.z, areas.area)
    raise InputError(f"--shape is {shape!r}, but must be pyramid, cone, hemisphere or table.")


def _two_stages(
    solid: "Solid",
    layers: "TargetLayers",
    thickness: float,
    plan: Callable[..., "Schedule"],
    wear_ratio: float,
    electrode_area: float,
) -> list["Schedule"]:
    from procmodel.wear import CircleSection, Hemisphere, TaperedSolid, split_for_finishing

    if isinstance(solid, TaperedSolid):
        section = solid.section
    elif isinstance(solid, Hemisphere):
        section = CircleSection()
    else:
        raise InputError("--finish-thickness needs a pyramid, cone or hemisphere, not a table.")
    roughing, finishing = split_for_finishing(layers, section, thickness)
    return [plan(roughing), plan(finishing, wear_ratio, electrode_area)]


def _write_schedule(path: Path, stages: list["Schedule"], gap: float) -> None:
    import numpy as np

    from procmodel.io import write_table

    columns: dict[str, list[Any]] = {}
    for stage, schedule in enumerate(stages, start=1):
        count = len(schedule.feeds)
        for header, values in {
            "layer": np.arange(1, count + 1),
            "stage [1]": np.full(count, stage),
            "target z [um]": schedule.layers.bottom,
            "half width [um]": schedule.layers.half_width,
            "programmed half width [um]": np.maximum(schedule.layers.half_width - gap, 0.0),
            "area [um^2]": schedule.layers.area,
            "feed [um]": schedule.feeds,
            "cumulative feed [um]": schedule.cumulative_feed,
            "depth [um]": schedule.depths,
            "depth spread [um]": schedule.depth_spread,
            "wear [um]": schedule.wear,
            "electrode left [um]": schedule.electrode_left,
        }.items():
            columns.setdefault(header, []).append(np.asarray(values))
    write_table(path, {header: np.concatenate(parts) for header, parts in columns.items()})


def _write_program(
    path: Path,
    template: Path | None,
    schedule: "Schedule",
    shape: str,
    area: float,
    gap: float,
    scanning: tuple[float, float, float],
) -> None:
    from procmodel.io import ProgramLayer, Scanning, read_template, write_program

    scan_feed, plunge_feed, overlap = scanning
    layers = [
        ProgramLayer(n + 1, float(feed), max(float(width) - gap, 0.0))
        for n, (feed, width) in enumerate(
            zip(schedule.cumulative_feed, schedule.layers.half_width, strict=True)
        )
    ]
    write_program(
        path,
        read_template(template),
        layers,
        Scanning(
            shape="square" if shape == "pyramid" else "circle",
            electrode_radius=math.sqrt(area / math.pi),
            scan_feed=scan_feed,
            plunge_feed=plunge_feed,
            side_gap=gap,
            overlap=overlap,
        ),
    )


def _as_dict(stages: list["Schedule"], notes: list[str]) -> dict[str, Any]:
    last = stages[-1]
    per_stage = [
        {
            "layers": len(s.feeds),
            "total_feed": s.total_feed,
            "commanded_feed": float(s.cumulative_feed[-1]),
            "electrode_length": s.electrode_length,
            "electrode_length_limit": s.electrode_length_limit,
            "electrodes": s.electrodes,
            "new_electrode_before": list(s.new_electrode_before),
            "touch_off_after": list(s.touch_off_after),
            "depth": float(s.depths[-1]),
            "depth_spread": float(s.depth_spread[-1]),
            "max_wall_error": s.max_wall_error,
            "expected_wall_error": s.expected_wall_error,
            "time": s.time,
            "status": s.status,
        }
        for s in stages
    ]
    times = [s.time for s in stages]
    return {
        "layers": sum(len(s.feeds) for s in stages),
        "total_feed": sum(s.total_feed for s in stages),
        "electrode_length": sum(s.electrode_length for s in stages),
        "electrodes": sum(s.electrodes for s in stages),
        "max_wall_error": last.max_wall_error,
        "expected_wall_error": last.expected_wall_error,
        "time": None if None in times else sum(t for t in times if t is not None),
        "stages": per_stage,
        "warnings": [*notes, *(w for s in stages for w in s.warnings)],
    }


def _as_text(result: dict[str, Any]) -> str:
    lines = []
    names = ("roughing", "finishing") if len(result["stages"]) > 1 else ("",)
    for name, stage in zip(names, result["stages"], strict=True):
        lines += [f"{name:<17} {stage['status']}".strip()]
        lines += [
            f"layers            {stage['layers']}",
            f"total feed        {stage['total_feed']:.4f} um "
            f"(commanded {stage['commanded_feed']:.4f})",
            f"electrode length  {stage['electrode_length']:.2f} um, at most "
            f"{stage['electrode_length_limit']:.2f} (97.5 %)",
            f"electrodes        {stage['electrodes']}"
            + _listed(", a fresh one before layer", stage["new_electrode_before"]),
            f"depth             {stage['depth']:.4f} um +- {stage['depth_spread']:.2g} (95 %)",
            f"wall error        {stage['max_wall_error']:.4f} um at most, "
            f"{stage['expected_wall_error']:.4f} um rms expected",
        ]
        if stage["touch_off_after"]:
            lines.append("touch-off pays" + _listed("    after layer", stage["touch_off_after"]))
        if stage["time"] is not None:
            lines.append(f"time              {stage['time'] / 60.0:.1f} min")
    for option in result.get("compared", ()):
        lines.append(
            f"layer depth {option['layer_depth']:g} um: {option['layers']} layers, stairs "
            f"{option['stair_error']:.3g} um, wall {option['expected_wall_error']:.3g} um, "
            f"cost {option['cost']:.4g} um^2"
        )
    return "\n".join([*lines, *(f"note  {warning}." for warning in result["warnings"])])


def _listed(words: str, layers: list[int]) -> str:
    if not layers:
        return ""
    shown = ", ".join(str(n) for n in layers[:8])
    return f"{words} {shown}" + (f" and {len(layers) - 8} more" if len(layers) > 8 else "")
