"""`procmodel path correct`: passes that hold the engagement angle along a finished wall."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options, path_options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.plans.path import PathPlan
    from procmodel.engagement.contour import Contour
    from procmodel.io import BulgePolyline, PathSettings

PROGRAMS = (".nc", ".ngc", ".gcode", ".tap", ".cnc", ".iso")


def correct_command(
    contour: path_options.Wall,
    tool_diameter: path_options.ToolDiameter,
    radial_depth: path_options.RadialDepth,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="backward (keeps the last pass, changes those before it) or forward (moves every "
            "pass, ends beside the wall).",
        ),
    ] = "backward",
    target_angle: path_options.TargetAngle = None,
    passes: Annotated[
        int, typer.Option("--passes", help="Passes to correct: before the last, or forward ones.")
    ] = 1,
    previous_diameter: path_options.PreviousDiameter = None,
    side: path_options.Side = "inside",
    layer: path_options.Layer = None,
    units: path_options.Units = None,
    spacing: path_options.Spacing = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="Of the arcs that are written [mm].")
    ] = 1e-4,
    coefficients: path_options.Coefficients = None,
    flutes: path_options.Flutes = None,
    axial_depth: path_options.AxialDepth = None,
    feed_per_tooth: path_options.FeedPerTooth = None,
    helix: path_options.Helix = 30.0,
    milling: path_options.Milling = "down",
    stiffness: path_options.Stiffness = None,
    overhang: path_options.Overhang = None,
    youngs_modulus: path_options.YoungsModulus = 6e5,
    feed: Annotated[
        float | None, typer.Option("--feed", help="Feed rate of the program [mm/min].")
    ] = None,
    spindle_speed: Annotated[
        float | None, typer.Option("--spindle-speed", help="Spindle speed of the program [1/min].")
    ] = None,
    z: Annotated[
        float | None, typer.Option("--z", help="Z of the cut [mm]; minus axial depth.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Tool paths, in the order of cutting: .nc ..., .csv or .dxf."),
    ] = None,
    dxf: Annotated[
        Path | None, typer.Option("--dxf", help="Drawing of wall and passes, a layer for each.")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Correct the passes along a finished wall so that the engagement angle is constant."""
    options.check_outputs(out, dxf, plot=plot)
    _check(out, dxf, tolerance)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.plans.path import correct_path
    from calibration.plans.path_load import load_along
    from calibration.plans.path_written import as_written

    radius = 0.5 * tool_diameter
    loading = path_options.cut_of(
        coefficients, flutes, axial_depth, feed_per_tooth, radius, helix, milling, stiffness,
        overhang, youngs_modulus,
    )  # fmt: skip
    if feed is None and feed_per_tooth and flutes and spindle_speed:
        feed = feed_per_tooth * flutes * spindle_speed
    # Before the work, so that a wrong feed is refused at once.
    settings = _settings(feed, spindle_speed, z if z is not None else -(axial_depth or 0.0))
    walls = path_options.walls_of(contour, side, layer, units)
    plan = correct_path(
        walls,
        radius,
        radial_depth,
        target=None if target_angle is None else math.radians(target_angle),
        method=method,
        previous_radius=None if previous_diameter is None else 0.5 * previous_diameter,
        passes=passes,
        spacing=spacing,
    )
    result = plan.as_dict()
    notes = result["notes"]
    loads = []
    if loading is not None:
        cut, materials, tool = loading
        loads = [load_along(s, cut, materials, tool) for s in (plan.before, plan.after)]
        result["force"] = {
            name: load.as_dict() for name, load in zip(("before", "after"), loads, strict=True)
        }
    if out is not None or dxf is not None:
        written, engagement = as_written(plan, tolerance)
        result["written"] = engagement.as_dict() | {
            "tolerance_mm": tolerance,
            "moves": sum(len(c.bulges) for one in written for c in one),
        }
        if out is not None and out.suffix.lower() in PROGRAMS and None in (feed, spindle_speed):
            notes.append(
                "feed rate and spindle speed of the program are placeholders (100 mm/min, "
                "1000 1/min): give --feed and --spindle-speed"
            )
        if out is not None:
            _write(out, written, settings)
        if dxf is not None:
            _draw(dxf, walls, written)
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.path import draw_path

        surveys = [("parallel passes", plan.before), (f"corrected, {method}", plan.after)]
        save(draw_path(surveys, walls, loads, plan.floor), plot)
    console.show(result, _as_text(plan, result), as_json)


def _check(out: Path | None, dxf: Path | None, tolerance: float) -> None:
    known = (*PROGRAMS, ".csv", ".dxf")
    if out is not None and out.suffix.lower() not in known:
        raise InputError(f"{out.name}: paths end in {', '.join(known)}: rename it.")
    if dxf is not None and dxf.suffix.lower() != ".dxf":
        raise InputError(f"{dxf.name}: a drawing ends in .dxf: rename it.")
    if not 0 < tolerance < math.inf:
        raise InputError(f"--tolerance is {tolerance:g}, but must be above 0.")


def _settings(feed: float | None, spindle_speed: float | None, z: float) -> "PathSettings":
    from procmodel.io import PathSettings

    feed = 100.0 if feed is None else feed
    spindle_speed = 1000.0 if spindle_speed is None else spindle_speed
    return PathSettings(z, feed, feed, spindle_speed, max(5.0, z + 5.0))


def _write(out: Path, passes: "list[list[Contour]]", settings: "PathSettings") -> None:
    from procmodel.io import write_contours_csv, write_dxf, write_path_program

    lines = _lines(passes)
    if out.suffix.lower() == ".csv":
        write_contours_csv(out, lines)
    elif out.suffix.lower() == ".dxf":
        write_dxf(out, lines, [line.name for line in lines])
    else:
        write_path_program(out, lines, settings)


def _draw(dxf: Path, walls: "list[Contour]", passes: "list[list[Contour]]") -> None:
    from procmodel.io import write_dxf

    lines = [*(_polyline(wall, "WALL") for wall in walls), *_lines(passes)]
    write_dxf(dxf, lines, [line.name for line in lines])


def _lines(passes: "list[list[Contour]]") -> "list[BulgePolyline]":
    return [_polyline(c, f"PASS {i + 1}") for i, one in enumerate(passes) for c in one]


def _polyline(path: "Contour", name: str) -> "BulgePolyline":
    from procmodel.io import BulgePolyline

    return BulgePolyline(path.points, path.bulges, path.closed, name)


def _as_text(plan: "PathPlan", result: dict[str, Any]) -> str:
    lines = [
        f"method            {plan.method}, {len(plan.passes)} passes in the order of cutting",
        f"target            {result['target_deg']:.4f} deg",
    ]
    for name in ("before", "after"):
        part = result[name]
        lines.append(
            f"{name:<18}{part['min_deg']:.4f} to {part['max_deg']:.4f} deg, mean "
            f"{part['mean_deg']:.4f}, overshoot {part['overshoot_percent']:.2f} %"
        )
        said = ", ".join(f"{count} {status}" for status, count in part["statuses"].items())
        lines.append(f"{'':<18}{part['points']} places: {said}")
    lines.append(
        f"unavoidable       {result['floor_percent']:.2f} % (junctions that no previous pass can "
        "relieve without cutting deeper)"
    )
    left = result["left_on_wall_mm"]
    lines.append(f"left on the wall  {left['min']:.6f} to {left['max']:.6f} mm")
    for name, load in result.get("force", {}).items():
        error = load.get("form_error_um")
        tail = f", wall error {error['min']:.2f} to {error['max']:.2f} um" if error else ""
        peak = load["peak_n"]
        lines.append(f"force {name:<12}{peak['min']:.1f} to {peak['max']:.1f} N at its peak{tail}")
    if "written" in result:
        part = result["written"]
        lines.append(
            f"as written        {part['moves']} lines and arcs, at most {part['max_deg']:.4f} deg"
        )
    return "\n".join([*lines, *(f"note  {note}." for note in result["notes"])])
