"""`procmodel wear predict`: the wall that given feeds will leave."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.cli import console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from procmodel.io import Table


def predict_command(
    wear_ratio: Annotated[float, typer.Option("--wear-ratio", help="Volumetric wear ratio R.")],
    section: options.Section = "square",
    half_width: Annotated[
        float | None,
        typer.Option("--half-width", help="Programmed half width of the first layer [um]."),
    ] = None,
    feed: Annotated[float | None, typer.Option("--feed", help="Feed of every layer [um].")] = None,
    step: Annotated[
        float | None,
        typer.Option("--step", help="How much narrower every layer is than the last [um]."),
    ] = None,
    layers: options.Layers = None,
    schedule: Annotated[
        Path | None,
        typer.Option(
            "--schedule",
            help="Instead of feed and step: CSV with 'half width [um]' (cleared), 'feed [um]' and, "
            "for other sections than --section, 'area [um^2]', as 'wear plan' writes.",
        ),
    ] = None,
    electrode_diameter: options.ElectrodeDiameter = None,
    electrode_area: options.ElectrodeArea = None,
    stage: Annotated[
        int | None, typer.Option("--stage", help="Which stage of a schedule with two.")
    ] = None,
    gap: Annotated[float, typer.Option("--gap", help="Side gap [um].")] = 0.0,
    points: Annotated[int, typer.Option("--points", help="Points of the wall curve.")] = 201,
    resolution: options.Resolution = 0.1,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the wall curve here (CSV).")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Predict the wall, the depth and the electrode used for constant feeds or a schedule."""
    import numpy as np

    from procmodel.io import Column, read_table, write_table

    area = console.electrode_area(electrode_diameter, electrode_area)
    if not 0 <= wear_ratio < float("inf"):
        raise InputError(f"--wear-ratio is {wear_ratio:g}, but must be 0 or more.")
    if not 0 <= gap < float("inf"):
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    if section not in ("square", "circle"):
        raise InputError(f"--section is {section!r}, but must be square or circle.")
    options.check_outputs(out, plot=plot)
    if points < 2:
        raise InputError(f"--points is {points}, but a curve needs 2 or more.")
    areas = None
    if schedule is not None:
        if any(value is not None for value in (half_width, feed, step, layers)):
            raise InputError("--schedule stands instead of --half-width, --feed, --step, --layers.")
        if gap > 0:
            raise InputError("--gap is given with --schedule, whose half widths hold it: drop it.")
        columns = [
            Column("half width", "um"),
            Column("feed", "um", positive=True),
            Column("area", "um^2", required=False),
            Column("stage", "1", required=False),
        ]
        table = read_table(schedule, columns)
        rows = _rows_of_stage(table, stage, schedule.name)
        half_widths, feeds = table.values["half width"][rows], table.values["feed"][rows]
        areas = table.values["area"][rows] if "area" in table.values else None
        if np.any(np.diff(half_widths) > 0):
            row = table.rows[rows][int(np.argmax(np.diff(half_widths) > 0)) + 1]
            raise InputError(
                f"{schedule.name}, row {row}: the half width grows again, but a layer must not be "
                "wider than the one above: sort the rows from the surface down."
            )

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.wear import TestCavity
    from procmodel.wear import CircleSection, SquareSection, cavity_depths, wall_depth

    if schedule is None:
        reason = "a cavity without --schedule"
        x0 = console.required(half_width, "--half-width", reason)
        dz = console.required(feed, "--feed", reason)
        options.require_feed_above(dz, resolution)
        dx = console.required(step, "--step", reason)
        test = TestCavity(section, x0, dx, dz, area, layers)
        count = layers or test.most_layers
        half_widths, feeds = test.half_widths[:count], test.feeds[:count]
    if areas is None:
        shape = SquareSection() if section == "square" else CircleSection()
        areas = np.asarray(shape.area(half_widths, gap))
    walls = half_widths + gap
    depths = np.asarray(cavity_depths(feeds, areas, wear_ratio, area))
    x = np.linspace(0.0, float(walls[0]), points)
    z = np.asarray(wall_depth(x, walls, depths))
    result = {
        "layers": len(half_widths),
        "depth": float(depths[-1]),
        "total_feed": float(np.sum(feeds)),
        "electrode_length": float(np.sum(feeds) - depths[-1]),
        "corners": {"x": walls, "z": depths},
    }
    if out is not None:
        write_table(out, {"x [um]": x, "z [um]": z})
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.wear import draw_prediction

        save(draw_prediction(walls, depths, feeds), plot)
    text = (
        f"layers            {result['layers']}\n"
        f"depth             {result['depth']:.4f} um\n"
        f"total feed        {result['total_feed']:.4f} um\n"
        f"electrode length  {result['electrode_length']:.4f} um"
    )
    console.show(result, text, as_json)


def _rows_of_stage(table: "Table", stage: int | None, name: str) -> "np.ndarray":
    """Which rows of a schedule belong to the stage asked for."""
    import numpy as np

    numbers = table.values.get("stage", np.ones(len(table.rows)))
    held = sorted({int(n) for n in numbers})
    if stage is None and len(held) > 1:
        raise InputError(f"{name} holds stages {held[0]} to {held[-1]}: choose one with --stage.")
    if stage is not None and stage not in held:
        raise InputError(f"{name} has no stage {stage}; it has {', '.join(map(str, held))}.")
    return numbers == (held[0] if stage is None else stage)
