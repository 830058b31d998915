"""What `path check` and `path correct` share: options, contours, cut and coefficients."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procmodel.errors import InputError

if TYPE_CHECKING:
    from procmodel.engagement import Cut, ForceCoefficients, ToolStiffness
    from procmodel.engagement.contour import Contour

Wall = Annotated[
    Path,
    typer.Argument(
        help="Finished wall: DXF, G-code (.nc ...) or CSV with 'x [mm]', 'y [mm]', optional "
        "'bulge [-]', 'contour [-]', 'closed [-]'."
    ),
]
ToolDiameter = Annotated[float, typer.Option("--tool-diameter", help="Diameter of the tool [mm].")]
RadialDepth = Annotated[
    float, typer.Option("--radial-depth", help="Radial depth of cut on a straight wall [mm].")
]
TargetAngle = Annotated[
    float | None,
    typer.Option(
        "--target-angle", help="Engagement angle to hold [deg]; that of a straight wall otherwise."
    ),
]
PreviousDiameter = Annotated[
    float | None,
    typer.Option("--previous-diameter", help="Diameter of the previous pass' tool [mm]."),
]
Side = Annotated[
    str,
    typer.Option(
        "--side",
        help="inside (pocket) or outside (boss) of closed walls; left or right of open ones.",
    ),
]
Layer = Annotated[str | None, typer.Option("--layer", help="Layer of the drawing.")]
Units = Annotated[
    str | None, typer.Option("--units", help="mm or inch, for a file that does not say.")
]
Spacing = Annotated[
    float | None,
    typer.Option("--spacing", help="Distance of the places looked at [mm]; radius/1000 otherwise."),
]
Coefficients = Annotated[
    Path | None,
    typer.Option("--coefficients", help="Force coefficients: TOML, or JSON of 'force fit --out'."),
]
Flutes = Annotated[int | None, typer.Option("--flutes", help="Number of flutes, for forces.")]
AxialDepth = Annotated[
    float | None, typer.Option("--axial-depth", help="Axial depth of cut [mm], for forces.")
]
FeedPerTooth = Annotated[
    float | None, typer.Option("--feed-per-tooth", help="Feed per tooth [mm], for forces.")
]
Helix = Annotated[float, typer.Option("--helix", help="Helix angle [deg], for forces.")]
Milling = Annotated[str, typer.Option("--milling", help="down or up, for forces.")]
Stiffness = Annotated[
    float | None,
    typer.Option("--stiffness", help="Measured stiffness of the tool [N/mm], for the wall error."),
]
Overhang = Annotated[
    float | None,
    typer.Option("--overhang", help="Length from the clamp [mm], instead of a stiffness."),
]
YoungsModulus = Annotated[
    float, typer.Option("--youngs-modulus", help="Of the tool [N/mm^2], with --overhang.")
]


def walls_of(path: Path, side: str, layer: str | None, units: str | None) -> list["Contour"]:
    """Walls from a file, the tool's side to the left of each.

    Raises
    ------
    InputError
        As the readers, or if side and walls do not go together.
    """
    from procmodel.engagement.contour import contour, oriented
    from procmodel.io import read_contours

    drawn = read_contours(path, layer=layer, units=units)
    return oriented([contour(p.points, p.bulges, p.closed, p.name) for p in drawn], side)


def cut_of(
    coefficients: Path | None,
    flutes: int | None,
    axial_depth: float | None,
    feed_per_tooth: float | None,
    radius: float,
    helix: float,
    milling: str,
    stiffness: float | None,
    overhang: float | None,
    youngs_modulus: float,
) -> "tuple[Cut, ForceCoefficients, ToolStiffness | None] | None":
    """Cut, coefficients and stiffness from the options; None where no force was asked for.

    Raises
    ------
    InputError
        If options for forces are incomplete or out of range.
    """
    given = {
        "--coefficients": coefficients,
        "--flutes": flutes,
        "--axial-depth": axial_depth,
        "--feed-per-tooth": feed_per_tooth,
    }
    if all(value is None for value in given.values()):
        if stiffness is not None or overhang is not None:
            raise InputError("a wall error needs forces: give --coefficients too.")
        return None
    for option, value in given.items():
        if value is None:
            raise InputError(f"{option} is missing: forces need {', '.join(given)}.")
    for option, number in (
        ("--flutes", flutes), ("--axial-depth", axial_depth), ("--feed-per-tooth", feed_per_tooth),
        ("--stiffness", stiffness), ("--overhang", overhang), ("--youngs-modulus", youngs_modulus),
    ):  # fmt: skip
        if number is not None and not 0 < number < math.inf:
            raise InputError(f"{option} is {number:g}, but must be above 0.")
    if not 0 < helix < 90:
        raise InputError(f"--helix is {helix:g}, but must be between 0 and 90 degrees.")
    if stiffness is not None and overhang is not None:
        raise InputError("--stiffness and --overhang both say how the tool bends: give one.")

    from procmodel.engagement import Cantilever, Cut, ForceCoefficients, MeasuredStiffness
    from procmodel.io import read_coefficients

    assert coefficients is not None and flutes is not None
    assert axial_depth is not None and feed_per_tooth is not None
    cut = Cut(flutes, axial_depth, feed_per_tooth, radius, math.radians(helix), milling)
    tool: ToolStiffness | None = None
    if stiffness is not None:
        tool = MeasuredStiffness(stiffness)
    elif overhang is not None:
        tool = Cantilever(2.0 * radius, overhang, youngs_modulus)
    return cut, ForceCoefficients(**read_coefficients(coefficients)), tool
