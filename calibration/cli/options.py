"""Options that several wear commands share."""

from pathlib import Path
from typing import Annotated

import typer

from procmodel.errors import InputError

PICTURES = (".png", ".svg", ".pdf")

Section = Annotated[str, typer.Option("--section", help="square or circle.")]
Feed = Annotated[float, typer.Option("--feed", help="Feed of every layer [um].")]
Step = Annotated[
    float, typer.Option("--step", help="How much narrower every layer is than the last [um].")
]
Layers = Annotated[
    int | None, typer.Option("--layers", help="Number of layers, if fewer than fit the half width.")
]
ElectrodeDiameter = Annotated[
    float | None, typer.Option("--electrode-diameter", help="Diameter of a round electrode [um].")
]
ElectrodeArea = Annotated[
    float | None, typer.Option("--electrode-area", help="Cross-section of the electrode [um^2].")
]
Resolution = Annotated[
    float, typer.Option("--resolution", help="Step of the machine's feed axis [um].")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Plot = Annotated[Path | None, typer.Option("--plot", help="Write a picture here (PNG, SVG, PDF).")]


def check_outputs(
    *files: Path | None, plot: Path | None = None, inputs: tuple[Path | None, ...] = ()
) -> None:
    """Refuse outputs that cannot be written before any work is done.

    Parameters
    ----------
    *files : Path, optional
        Files to write.
    plot : Path, optional
        Picture to write.
    inputs : tuple of Path, optional
        Files that are read, and must not be written over.

    Raises
    ------
    InputError
        If one of them cannot be written, two are the same, one is read as well, or the picture has
        no known ending.
    """
    from procmodel.io import check_target  # loads NumPy

    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise InputError(f"{plot.name}: a picture ends in {', '.join(PICTURES)}: rename it.")
    targets = [check_target(file) for file in (*files, plot) if file is not None]
    read = [file.resolve() for file in inputs if file is not None]
    for target in targets:
        if target.resolve() in read:
            raise InputError(f"{target.name} is read and would be written over: name another.")
    for i, target in enumerate(targets):
        if target in targets[:i]:
            raise InputError(f"{target.name} is named for two outputs: give each its own file.")


def require_feed_above(feed: float, resolution: float) -> None:
    """Refuse a feed that the machine cannot make.

    Parameters
    ----------
    feed, resolution : float [um]
        Feed of a layer, and step of the feed axis.

    Raises
    ------
    InputError
        If the feed is below the resolution.
    """
    if not feed >= resolution:
        raise InputError(
            f"--feed {feed:g} um is below the machine's resolution of {resolution:g} um: feed more "
            "per layer, or state the finer --resolution of your machine."
        )
