"""Options of `wear plan`."""

from pathlib import Path
from typing import Annotated

import typer

Shape = Annotated[
    str | None,
    typer.Option(
        "--shape",
        help="pyramid, cone, hemisphere, slot, or table and map with --table; or give --solid.",
    ),
]
LayerDepth = Annotated[
    list[float],
    typer.Option(
        "--layer-depth",
        help="Depth of a layer [um], the greatest with --scallop; repeat it to compare several.",
    ),
]
Radius = Annotated[
    float | None, typer.Option("--radius", help="Of hemisphere or cone at the surface [um].")
]
HalfWidth = Annotated[
    float | None, typer.Option("--half-width", help="Of the pyramid at the surface [um].")
]
WallAngle = Annotated[
    float | None,
    typer.Option("--wall-angle", help="Between wall and surface [deg]; 90 is vertical."),
]
Length = Annotated[float | None, typer.Option("--length", help="Of the slot, along x [um].")]
Width = Annotated[float | None, typer.Option("--width", help="Of the slot [um].")]
TableFile = Annotated[
    Path | None,
    typer.Option(
        "--table",
        help="CSV with 'z [um]' and 'area [um^2]' (table), or with 'x [um]', 'y [um]' and the "
        "depth 'z [um]' on a grid (map).",
    ),
]
SolidFile = Annotated[
    Path | None,
    typer.Option("--solid", help="Volume to be removed, z upwards: STL, OBJ, PLY or OFF."),
]
SolidUnit = Annotated[
    str, typer.Option("--solid-unit", help="Unit of the solid's numbers, which no file says.")
]
Undercut = Annotated[
    str, typer.Option("--undercut", help="refuse or clip what lies under the solid's own wall.")
]
Travel = Annotated[
    tuple[float, float, float] | None,
    typer.Option("--travel", help="Travel of the machine along X, Y and Z [um]."),
]
Depth = Annotated[
    float | None, typer.Option("--depth", help="Of the cavity [um]; full depth if left out.")
]
Level = Annotated[
    str,
    typer.Option(
        "--level",
        help="Where a layer takes its section: top, middle, bottom, or as the paper (of a solid or "
        "map the middle).",
    ),
]
Scallop = Annotated[
    float | None,
    typer.Option("--scallop", help="Greatest height of the stairs, square to the wall [um]."),
]
Narrow = Annotated[
    str | None,
    typer.Option(
        "--narrow",
        help="Layers narrower than the electrode: refuse (solid, slot, map), plunge (the other "
        "shapes) or stop above them.",
    ),
]
WearRatio = Annotated[
    float | None, typer.Option("--wear-ratio", help="Volumetric wear ratio R, taken as exact.")
]
Fit = Annotated[
    Path | None, typer.Option("--fit", help="Instead: JSON that 'wear fit --out' wrote.")
]
Posterior = Annotated[
    Path | None, typer.Option("--posterior", help="Instead: netCDF of 'wear fit --posterior'.")
]
ElectrodeSide = Annotated[
    float | None, typer.Option("--electrode-side", help="Side of a square electrode [um].")
]
Gap = Annotated[
    float, typer.Option("--gap", help="Side gap: program the half width less this [um].")
]
UsableLength = Annotated[
    float | None, typer.Option("--usable-length", help="Usable length of an electrode [um].")
]
Tolerance = Annotated[
    float | None, typer.Option("--tolerance", help="Depth spread that calls a touch-off [um].")
]
RemovalRate = Annotated[
    float | None, typer.Option("--removal-rate", help="Volume removed in a second [um^3/s].")
]
LayerOverhead = Annotated[float, typer.Option("--layer-overhead", help="Time lost per layer [s].")]
Optimise = Annotated[
    bool, typer.Option("--optimise", help="Bounded feeds, least expected wall error.")
]
LeastFeed = Annotated[
    float, typer.Option("--least-feed", help="Least feed of a layer, with --optimise [um].")
]
GreatestFeed = Annotated[
    float, typer.Option("--greatest-feed", help="Greatest feed, with --optimise [um].")
]
PerMinute = Annotated[
    float, typer.Option("--per-minute", help="Mean square wall error a minute is worth [um^2].")
]
PerLength = Annotated[
    float, typer.Option("--per-length", help="And a micrometre of electrode [um^2].")
]
FinishThickness = Annotated[
    float | None,
    typer.Option("--finish-thickness", help="Ring left for a finishing stage [um]."),
]
FinishWearRatio = Annotated[
    float | None, typer.Option("--finish-wear-ratio", help="Wear ratio when finishing.")
]
FinishDiameter = Annotated[
    float | None, typer.Option("--finish-electrode-diameter", help="Of its electrode [um].")
]
FinishArea = Annotated[
    float | None, typer.Option("--finish-electrode-area", help="Of its electrode [um^2].")
]
Out = Annotated[Path | None, typer.Option("--out", help="Write the schedule here (CSV).")]
Gcode = Annotated[Path | None, typer.Option("--gcode", help="Write a generic ISO program here.")]
Template = Annotated[Path | None, typer.Option("--template", help="TOML template of the program.")]
Paths = Annotated[
    Path | None, typer.Option("--paths", help="Write the scanning path of every layer here (CSV).")
]
Preview = Annotated[
    Path | None,
    typer.Option("--preview", help="Write a picture of paths and layers here (PNG, SVG, PDF)."),
]
ScanFeed = Annotated[
    float, typer.Option("--scan-feed", help="Feed rate along the passes [mm/min].")
]
PlungeFeed = Annotated[float, typer.Option("--plunge-feed", help="Feed rate downwards [mm/min].")]
Overlap = Annotated[
    float, typer.Option("--overlap", help="Overlap of passes, share of the electrode width.")
]
PatternName = Annotated[
    str | None,
    typer.Option(
        "--pattern", help="raster, contour (the usual one) or alternate: how a layer is scanned."
    ),
]
NoToAndFro = Annotated[
    bool, typer.Option("--no-to-and-fro", help="Follow every layer's path from the same end.")
]
NoAlternate = Annotated[
    bool, typer.Option("--no-alternate", help="Do not change the main direction of the paths.")
]
NoInsideAndPeriphery = Annotated[
    bool,
    typer.Option("--no-inside-and-periphery", help="Do not cut inside and periphery in turn."),
]
Levelling = Annotated[
    int,
    typer.Option(
        "--levelling",
        help="Passes with falling feeds after the last layer, which level its bottom; 0 for none.",
    ),
]
Refine = Annotated[
    float | None,
    typer.Option(
        "--refine",
        help="Search the feeds through the simulation, on cells of this size [um]; see 'wear "
        "simulate'.",
    ),
]
WearModeName = Annotated[
    str,
    typer.Option(
        "--wear-mode",
        help="local (the electrode does not turn), rotating, spread with --spread-width, or "
        "uniform: where on its bottom the electrode wears.",
    ),
]
SpreadWidth = Annotated[
    float | None,
    typer.Option("--spread-width", help="How far wear is spread, standard deviation [um]."),
]
BottomGap = Annotated[
    float, typer.Option("--bottom-gap", help="How far the bottom goes down before it cuts [um].")
]
