"""`procmodel force fit`: the force coefficients from measured cutting forces."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.milling import ForceFit


def fit_command(
    forces: Annotated[
        Path,
        typer.Argument(
            help="CSV with columns 'feed per tooth [mm]', 'axial depth [mm]', 'start [deg]' and "
            "'exit [deg]' or 'engagement angle [deg]', 'Fx [N]', 'Fy [N]', optional 'Fz [N]'; "
            "with 'rotation [deg]' the forces are instantaneous."
        ),
    ],
    flutes: Annotated[int, typer.Option("--flutes", help="Number of flutes.")],
    milling: Annotated[
        str | None,
        typer.Option("--milling", help="down or up; needed for a column 'engagement angle'."),
    ] = None,
    diameter: Annotated[
        float | None,
        typer.Option("--diameter", help="Of the tool [mm]; needed for instantaneous forces."),
    ] = None,
    helix: Annotated[
        float | None,
        typer.Option("--helix", help="Helix angle [deg]; needed for instantaneous forces."),
    ] = None,
    rotation_offset: Annotated[
        float,
        typer.Option(
            "--rotation-offset",
            help="Angle of a flute's end from +y when the rotation reads 0 [deg].",
        ),
    ] = 0.0,
    fit_rotation_offset: Annotated[
        bool, typer.Option("--fit-rotation-offset", help="Fit that angle too.")
    ] = False,
    noise: Annotated[
        float | None,
        typer.Option(
            "--noise",
            help="Standard deviation of every force, if known [N]; else one for each axis.",
        ),
    ] = None,
    solver: Annotated[
        str, typer.Option("--solver", help="box_lm, optimistix, scipy or jaxopt.")
    ] = "box_lm",
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the JSON here too, as coefficients to read.")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Fit shearing and edge coefficients to measured cutting forces, means or instantaneous."""
    if flutes < 1:
        raise InputError(f"--flutes is {flutes}, but must be 1 or more.")
    if milling not in (None, "down", "up"):
        raise InputError(f"--milling is {milling!r}, but must be down or up.")
    for name, value, highest in (("--diameter", diameter, math.inf), ("--helix", helix, 90.0)):
        if value is not None and not 0.0 < value < highest:
            limit = "" if math.isinf(highest) else f" and below {highest:g}"
            raise InputError(f"{name} is {value:g}, but must be above 0{limit}.")
    if not math.isfinite(rotation_offset):
        raise InputError(f"--rotation-offset is {rotation_offset}, but must be a finite angle.")
    if noise is not None and not 0.0 < noise < math.inf:
        raise InputError(f"--noise is {noise:g}, but must be above 0.")
    options.check_outputs(out, plot=plot)
    from procmodel.io import read_forces, write_text

    measured = read_forces(forces, milling)
    if measured.rotation is not None:
        reason = "a table of instantaneous forces"
        console.required(diameter, "--diameter", reason)
        console.required(helix, "--helix", reason)
    elif fit_rotation_offset:
        raise InputError(
            f"--fit-rotation-offset needs a column 'rotation [deg]', which {forces.name} has not."
        )

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.milling import fit_force_coefficients

    found = fit_force_coefficients(
        measured,
        flutes,
        radius=None if diameter is None else 0.5 * diameter,
        helix=None if helix is None else math.radians(helix),
        sigma=noise,
        rotation_offset=math.radians(rotation_offset),
        fit_rotation_offset=fit_rotation_offset,
        solver=solver,
    )
    result = result_as_dict(found)
    text = found.result.report() + "".join(f"\nnote  {note}." for note in found.notes)
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.force import draw_forces

        save(draw_forces(found), plot)
    if out is not None:
        write_text(out, console.json_text(result) + "\n")
    console.show(result, text, as_json)
    if not found.result.converged:
        raise typer.Exit(console.NOT_CONVERGED)


def result_as_dict(found: "ForceFit") -> dict[str, Any]:
    """The fit as the JSON that the command prints and `read_coefficients` reads."""
    result = found.as_dict()
    offset = result["parameters"].get("rotation_offset")
    if offset is not None:
        result["rotation_offset_deg"] = math.degrees(offset["value"])
    return result
