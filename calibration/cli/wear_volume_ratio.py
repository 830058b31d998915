"""`procmodel wear volume-ratio`: the wear ratio from outlines of electrode and workpiece."""

from pathlib import Path
from typing import Annotated

import typer

from calibration.cli import console, options


def volume_ratio_command(
    tool: Annotated[
        Path, typer.Option("--tool", help="Worn electrode: CSV with x and y, tip at y = 0.")
    ],
    work: Annotated[
        Path, typer.Option("--work", help="Workpiece: CSV with x and y, top at y = 0.")
    ],
    unworn: Annotated[
        Path | None,
        typer.Option("--unworn", help="Unworn electrode; the rectangle around TOOL if left out."),
    ] = None,
    digitising_error: Annotated[
        float,
        typer.Option(
            "--digitising-error", help="Standard deviation of every outline coordinate [um]."
        ),
    ] = 10.0,
    as_json: options.AsJson = False,
) -> None:
    """Estimate the wear ratio as eroded electrode area over removed workpiece area."""
    from procmodel.io import read_outline
    from procmodel.wear.volume_ratio import volume_ratio

    found = volume_ratio(
        read_outline(tool).points,
        read_outline(work).points,
        None if unworn is None else read_outline(unworn).points,
        digitising_error=digitising_error,
    )
    caution = (
        "the standard deviation covers independent errors of the points; a shift of the whole "
        "outline, such as a tip that is not at y = 0, comes on top"
    )
    result = {
        "wear_ratio": {"value": found.ratio, "std": found.std, "unit": ""},
        "eroded_area": {"value": found.eroded_area, "std": found.eroded_area_std, "unit": "um^2"},
        "removed_area": {
            "value": found.removed_area,
            "std": found.removed_area_std,
            "unit": "um^2",
        },
        "digitising_error": found.digitising_error,
        "warnings": [caution],
    }
    text = (
        f"eroded electrode area   {found.eroded_area:.6g} +- {found.eroded_area_std:.2g} um^2\n"
        f"removed workpiece area  {found.removed_area:.6g} +- {found.removed_area_std:.2g} um^2\n"
        f"wear ratio              {found.ratio:.5f} +- {found.std:.5f}\n"
        f"note  {caution}."
    )
    console.show(result, text, as_json)
