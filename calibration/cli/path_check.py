"""`procmodel path check`: the engagement of an existing program along a finished wall."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options, path_options

if TYPE_CHECKING:
    from procmodel.engagement import Cut, ForceCoefficients, ToolStiffness


def check_command(
    contour: path_options.Wall,
    tool_diameter: path_options.ToolDiameter,
    radial_depth: path_options.RadialDepth,
    program: Annotated[
        Path | None,
        typer.Option(
            "--program",
            help="Paths of the tool centre in the order of cutting (G-code, DXF, CSV); the path "
            "parallel to the wall otherwise.",
        ),
    ] = None,
    target_angle: path_options.TargetAngle = None,
    previous_diameter: path_options.PreviousDiameter = None,
    side: path_options.Side = "inside",
    layer: path_options.Layer = None,
    units: path_options.Units = None,
    spacing: path_options.Spacing = None,
    coefficients: path_options.Coefficients = None,
    flutes: path_options.Flutes = None,
    axial_depth: path_options.AxialDepth = None,
    feed_per_tooth: path_options.FeedPerTooth = None,
    helix: path_options.Helix = 30.0,
    stiffness: path_options.Stiffness = None,
    overhang: path_options.Overhang = None,
    youngs_modulus: path_options.YoungsModulus = 6e5,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Report the engagement of a program, or of the parallel path, along a finished wall."""
    options.check_outputs(plot=plot)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.plans.path_check import check_path
    from calibration.plans.path_load import load_along
    from procmodel.engagement.contour import contour as checked
    from procmodel.io import read_contours

    radius = 0.5 * tool_diameter

    def loading_in(milling: str) -> "tuple[Cut, ForceCoefficients, ToolStiffness | None] | None":
        return path_options.cut_of(
            coefficients, flutes, axial_depth, feed_per_tooth, radius, helix, milling, stiffness,
            overhang, youngs_modulus,
        )  # fmt: skip

    loading_in("down")  # so that faulty options are refused before the work
    walls = path_options.walls_of(contour, side, layer, units)
    moves = None
    if program is not None:
        moves = [
            checked(p.points, p.bulges, p.closed, p.name)
            for p in read_contours(program, units=units)
        ]
    found = check_path(
        walls,
        radius,
        radial_depth,
        moves,
        target=None if target_angle is None else math.radians(target_angle),
        previous_radius=None if previous_diameter is None else 0.5 * previous_diameter,
        spacing=spacing,
    )
    result = found.as_dict()
    loads = []
    loading = loading_in(found.milling)
    if loading is not None:
        cut, materials, tool = loading
        loads = [load_along(found.surveys[-1], cut, materials, tool)]
        result["force"] = loads[0].as_dict()
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.path import draw_path

        named = "parallel path" if program is None else "last pass"
        save(draw_path([(named, found.surveys[-1])], found.walls, loads, found.floor), plot)
    console.show(result, _as_text(result), as_json)


def _as_text(result: dict[str, Any]) -> str:
    lines = [f"target       {result['target_deg']:.4f} deg, {result['milling']} milling"]
    for i, part in enumerate(result["passes"]):
        said = ", ".join(f"{count} {status}" for status, count in part["statuses"].items())
        figures = "in air"
        if part["max_deg"] is not None:
            figures = (
                f"{part['min_deg']:.4f} to {part['max_deg']:.4f} deg, mean {part['mean_deg']:.4f}, "
                f"overshoot {part['overshoot_percent']:.2f} %"
            )
        lines += [f"pass {i + 1:<8}{figures}", f"{'':<13}{part['points']} places: {said}"]
    lines.append(f"unavoidable  {result['floor_percent']:.2f} %")
    if "force" in result:
        peak = result["force"]["peak_n"]
        lines.append(f"force        {peak['min']:.1f} to {peak['max']:.1f} N at its peak")
        error = result["force"].get("form_error_um")
        if error:
            lines.append(f"wall error   {error['min']:.2f} to {error['max']:.2f} um")
    return "\n".join(lines)
