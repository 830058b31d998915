"""`procmodel wear fit-surface`: wear ratio, gaps and spread width from a measured height map."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from calibration.cli import wear_plan_options as choices
from calibration.cli.wear_given import section_of, ways_of
from procmodel.errors import InputError, nearest

if TYPE_CHECKING:
    from calibration.wear_surface import SurfaceFit
    from procmodel.io import WrittenPath


def fit_surface_command(
    height_map: Annotated[
        Path,
        typer.Argument(
            help="CSV with 'x [um]', 'y [um]', 'z [um]', optional 'sigma [um]', in any order."
        ),
    ],
    paths: Annotated[
        Path, typer.Option("--paths", help="The paths that were cut: CSV of 'wear plan --paths'.")
    ],
    cell: Annotated[float, typer.Option("--cell", help="Side of the maps' cells [um].")],
    feed: Annotated[
        float | None,
        typer.Option(
            "--feed", help="Feed of every layer [um], instead of the paths' cumulative feed."
        ),
    ] = None,
    electrode_diameter: options.ElectrodeDiameter = None,
    electrode_area: options.ElectrodeArea = None,
    electrode_side: choices.ElectrodeSide = None,
    wear_mode: Annotated[
        str, typer.Option("--wear-mode", help="local, rotating, spread or uniform.")
    ] = "local",
    unknown: Annotated[
        list[str] | None,
        typer.Option(
            "--unknown",
            help="What to find, repeated: wear_ratio, side_gap, bottom_gap, spread_width, and "
            "zero, tilt_x, tilt_y, shift_x, shift_y of the instrument. Left out: wear ratio, side "
            "gap and, with wear mode spread, its width.",
        ),
    ] = None,
    wear_ratio: Annotated[
        float | None, typer.Option("--wear-ratio", help="Its start, or its value if not unknown.")
    ] = None,
    gap: Annotated[float | None, typer.Option("--gap", help="Side gap likewise [um].")] = None,
    bottom_gap: Annotated[
        float | None, typer.Option("--bottom-gap", help="Bottom gap likewise [um].")
    ] = None,
    spread_width: Annotated[
        float | None, typer.Option("--spread-width", help="Spread width likewise [um].")
    ] = None,
    greatest_gap: Annotated[
        float | None,
        typer.Option("--greatest-gap", help="Largest side gap to look for [um]."),
    ] = None,
    step: Annotated[
        float | None, typer.Option("--step", help="Step along the path [um]; a cell if left out.")
    ] = None,
    noise: Annotated[
        float | None, typer.Option("--noise", help="Standard deviation of z, if known [um].")
    ] = None,
    solver: Annotated[
        str, typer.Option("--solver", help="box_lm, optimistix, scipy or jaxopt.")
    ] = "box_lm",
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the JSON here too, for 'wear plan --fit'.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Fit a simulated cavity to the measured height map of one that was cut along known paths."""
    from procmodel.io import write_text
    from procmodel.io.height_maps import read_height_map
    from procmodel.io.plans import read_paths

    for name, value in (
        ("--cell", cell), ("--feed", feed), ("--step", step), ("--noise", noise),
        ("--greatest-gap", greatest_gap),
    ):  # fmt: skip
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value:g}, but must be above 0.")
    if gap is not None and not 0 <= gap < math.inf:
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    options.check_outputs(out, inputs=(height_map, paths))
    section = section_of(electrode_diameter, electrode_area, electrode_side)
    measured = read_height_map(height_map)
    if noise is not None and measured.sigma is not None:
        raise InputError(f"{height_map.name} has a sigma column and --noise is given: drop one.")
    written = read_paths(paths)

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.wear_surface import UNKNOWN, SurfaceModel, fit_surface
    from calibration.wear_surface_model import CavityModel

    names = _names(unknown, wear_mode, UNKNOWN)
    start = {
        name: value
        for name, value in (
            ("wear_ratio", wear_ratio), ("side_gap", gap), ("bottom_gap", bottom_gap),
            ("spread_width", spread_width),
        )
        if value is not None
    }  # fmt: skip
    reach = gap or 0.0
    if "side_gap" in names:
        reach = max(2.0 * cell, 2.0 * reach) if greatest_gap is None else greatest_gap
    cavity = CavityModel.of(
        ways_of(written), section, cell, step=step, reach=reach,
        wear_mode=wear_mode, margin=2.0 * cell,  # type: ignore[arg-type]
    )  # fmt: skip
    found = fit_surface(
        measured, SurfaceModel(cavity, _feeds(written, feed)), names, start, noise, solver
    )
    result = result_as_dict(found)
    text = found.result.report() + "".join(f"\nnote  {note}." for note in found.notes)
    if out is not None:
        write_text(out, console.json_text(result) + "\n")
    console.show(result, text, as_json)
    if not found.result.converged:
        raise typer.Exit(console.NOT_CONVERGED)


def result_as_dict(found: "SurfaceFit") -> dict[str, Any]:
    """The fit as the JSON that the command prints and `wear plan --fit` reads."""
    result = found.result.as_dict()
    result["warnings"] = [*result["warnings"], *found.notes]
    result["wear_per_area"] = result["parameters"]["wear_per_area"]["value"]
    result["unknown"] = list(found.unknown)
    result["told"] = list(found.told)
    result["layers"] = found.model.cavity.layers
    result["cells"] = list(found.model.cavity.workpiece.depth.shape)
    result["readings"] = len(found.x)
    result["readings_left_out"] = found.left_out
    result["z_counts_upwards"] = found.flipped
    return result


def _names(unknown: list[str] | None, wear_mode: str, known: tuple[str, ...]) -> tuple[str, ...]:
    if not unknown:
        return ("wear_ratio", "side_gap", *(("spread_width",) if wear_mode == "spread" else ()))
    for name in unknown:
        if name not in known:
            raise InputError(f"--unknown {name} is not known{nearest(name, known)}.")
    return tuple(dict.fromkeys(unknown))


def _feeds(written: "list[WrittenPath]", feed: float | None) -> Any:
    import numpy as np

    if feed is not None:
        return np.full(len(written), feed)
    return np.diff([way.cumulative_feed for way in written], prepend=0.0)
