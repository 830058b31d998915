"""What all pictures share: colours, panels, and how a figure is saved."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from procmodel.io import writing

# Okabe and Ito's colours, told apart by everyone.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#7A7A7A"


def save(figure: Figure, path: Path) -> None:
    """Write a figure, completely or not at all.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    path : Path
        Where; the ending chooses the format.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=150)


def plain(axes: Axes) -> None:
    """A light grid, and no frame on the upper and right sides."""
    axes.grid(color="0.92", lw=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def two_panels() -> tuple[Figure, tuple[Axes, Axes]]:
    """A figure with a tall panel above a flat one."""
    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, height_ratios=(2.2, 1))
    plain(upper)
    plain(lower)
    return figure, (upper, lower)
