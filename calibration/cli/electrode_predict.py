"""`procmodel electrode predict`: the path for wanted sizes, and the sizes to expect of it."""

import math
from typing import Annotated, Any

import typer

from calibration.cli import console, electrode_gap, options
from procmodel.errors import InputError

SIDES = {"round": 1, "flats": 2}


def predict_command(
    wire_diameter: Annotated[float, typer.Option("--wire-diameter", help="Of the wire [um].")],
    holes: electrode_gap.Holes = None,
    electrodes: electrode_gap.Electrodes = None,
    diameter: Annotated[
        list[float] | None,
        typer.Option(
            "--diameter",
            help="Wanted diameter, or width across flats [um]; repeat it for every one of an "
            "electrode.",
        ),
    ] = None,
    path_radius: Annotated[
        list[float] | None,
        typer.Option(
            "--path-radius",
            help="Distance of the wire's centre from the axis [um], one for each diameter: predict "
            "this path instead of the best one.",
        ),
    ] = None,
    section: Annotated[
        str,
        typer.Option("--section", help="round, or flats: each side ground in a pass of its own."),
    ] = "round",
    slope: Annotated[
        list[float] | None,
        typer.Option(
            "--slope",
            help="Angle between surface and axis [deg], one for all sizes or one for each.",
        ),
    ] = None,
    loss: Annotated[
        str,
        typer.Option(
            "--loss",
            help="What the path keeps small: absolute or squared error, or the probability to be "
            "outside the tolerance.",
        ),
    ] = "absolute",
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="How far a size may be off the drawing [%].")
    ] = 2.0,
    resolution: Annotated[
        float, typer.Option("--resolution", help="Step of the machine's axes [um].")
    ] = 0.1,
    diameter_error: electrode_gap.DiameterError = 1.0,
    repeats: electrode_gap.Repeats = 1,
    level: Annotated[
        float, typer.Option("--level", help="Probability inside the intervals.")
    ] = 0.9,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Correct the path by the known gaps; predict sizes, cross-section and their intervals."""
    electrode_gap.require_level(level)
    if section not in SIDES:
        raise InputError(f"--section is {section!r}, but must be round or flats.")
    if loss not in ("absolute", "squared", "outside"):
        raise InputError(f"--loss is {loss!r}, but must be absolute, squared or outside.")
    if not 0 < tolerance < 100:
        raise InputError(f"--tolerance is {tolerance:g}, but must be above 0 and below 100.")
    if not 0 < resolution < float("inf"):
        raise InputError(f"--resolution is {resolution:g}, but must be above 0.")
    for name, values in (("--diameter", diameter), ("--path-radius", path_radius)):
        for value in values or ():
            if not 0 < value < float("inf"):
                raise InputError(f"{name} is {value:g}, but must be above 0.")
    if not diameter and not path_radius:
        raise InputError("give the wanted --diameter, or the --path-radius to predict.")
    if diameter and path_radius and len(diameter) != len(path_radius):
        raise InputError(
            f"--diameter is given {len(diameter)} times and --path-radius {len(path_radius)} "
            "times: give both equally often."
        )
    angles = [math.radians(angle) for angle in slope or (0.0,)]
    count = len(diameter or path_radius or ())
    if len(angles) not in (1, count):
        raise InputError(
            f"--slope is given {len(angles)} times for {count} sizes: give one, or one for each."
        )
    slopes = angles[0] if len(angles) == 1 else angles
    options.check_outputs(plot=plot)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.electrode_area import electrode_area
    from calibration.plans.electrode import corrected_path, predict_sizes

    data, posterior = electrode_gap.known_gap(
        holes, electrodes, wire_diameter, diameter_error, repeats
    )
    wire_radius, passes, share = 0.5 * wire_diameter, SIDES[section], tolerance / 100.0
    result: dict[str, Any] = {"gap": electrode_gap.as_dict(data, posterior, level)}
    if path_radius:
        result["status"] = "the given path"
        prediction = predict_sizes(
            path_radius,
            posterior,
            wire_radius,
            wanted=diameter or None,
            tolerance=share,
            passes=passes,
            slope=slopes,
            level=level,
        )
    else:
        found = corrected_path(
            diameter,
            posterior,
            wire_radius,
            loss=loss,
            tolerance=share,
            passes=passes,
            slope=slopes,
            resolution=resolution,
            level=level,
        )
        prediction = found.prediction
        result |= {
            "status": found.status,
            "counted_gap": found.counted_gap,
            "loss": loss,
            "expected_error": found.expected_error,
        }
    result |= prediction.as_dict()
    shape = "round" if section == "round" else "square"
    areas = [
        electrode_area(posterior, float(path), wire_radius, shape=shape, slope=angle)
        for path, angle in zip(prediction.path_radius, angles * (count // len(angles)), strict=True)
    ]
    result["area"] = [area.mean for area in areas]
    result["area_relative_std"] = [area.relative for area in areas]
    if plot is not None:
        from calibration.plots.electrode_gap import draw_sizes
        from calibration.plots.figures import save

        save(draw_sizes(prediction), plot)
    console.show(result, _as_text(result), as_json)


def _as_text(result: dict[str, Any]) -> str:
    lines = [f"path       {result['status']}"]
    if "counted_gap" in result:
        lines.append(
            f"gap        count on {result['counted_gap']:.2f} um: --gap of 'electrode path'"
        )
    for i, path in enumerate(result["path_radius"]):
        low, high = result["interval"][i]
        wanted = "" if result["wanted"] is None else f"wanted {result['wanted'][i]:.4g} um, "
        chance = (
            ""
            if result["within"] is None
            else f", within {100 * result['tolerance']:.3g} %: {100 * result['within'][i]:.0f} %"
        )
        lines.append(
            f"size       {wanted}wire at {path:.1f} um: {result['size'][i]:.2f} um "
            f"[{100 * result['level']:.3g} %: {low:.2f} to {high:.2f}]{chance}"
        )
    if result["all_within"] is not None:
        lines.append(
            f"all        within {100 * result['tolerance']:.3g} %, on all sides: "
            f"{100 * result['all_within']:.0f} %"
        )
    for mean, relative in zip(result["area"], result["area_relative_std"], strict=True):
        lines.append(f"area       {mean:.0f} um^2 +- {100 * relative:.1f} %")
    lines += [f"note       {note}." for note in result["gap"]["notes"]]
    return "\n".join(lines)
