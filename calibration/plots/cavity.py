"""Pictures of a cavity cut in simulation: its surface, its error, a section, the electrode's tip.

Depth points downwards; lengths in um.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plots.figures import BLUE, GREY, ORANGE, plain
from calibration.wear_simulation import CutCavity


def draw_cavity(cut: CutCavity, target: np.ndarray, region: np.ndarray) -> Figure:
    """Surface, error map, section through the middle, tip and layers.

    Parameters
    ----------
    cut : CutCavity
        From `calibration.wear_simulation.cut_cavity`.
    target : ndarray, shape (nx, ny) [um]
        Wanted depth.
    region : ndarray of bool, shape (nx, ny)
        Cells in which the error counts; the others are left white in its map.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = Figure(figsize=(10.5, 8.6), layout="constrained")
    (surface, error), (section, tip) = figure.subplots(2, 2, height_ratios=(1.15, 1))
    x, y = cut.task.workpiece.x, cut.task.workpiece.y
    row = len(y) // 2
    _map(figure, surface, cut, cut.depth, "depth [µm]", "viridis_r", "surface")
    surface.axhline(y[row], color="white", lw=0.9, ls="--")
    off = np.where(region, cut.depth - target, np.nan)
    limit = float(np.nanpercentile(np.abs(off), 99.0)) if np.any(region) else 1.0
    title = "error: depth less target"
    _map(figure, error, cut, off, "error [µm]", "RdBu_r", title, (-limit, limit))

    plain(section)
    section.plot(x, target[:, row], color=GREY, lw=1.4, ls="--", label="target")
    section.plot(x, cut.depth[:, row], color=BLUE, lw=1.6, label="simulated")
    if cut.low is not None and cut.high is not None:
        section.fill_between(
            x, cut.low[:, row], cut.high[:, row], color=BLUE, alpha=0.3, lw=0,
            label="95 % of the wear ratio",
        )  # fmt: skip
    section.invert_yaxis()
    section.set_xlabel("x [µm]")
    section.set_ylabel("depth [µm]")
    section.set_title(f"section at y = {y[row]:.4g} µm", fontsize=10, loc="left")
    section.legend(frameon=False, fontsize=8)
    _tip(tip, cut)
    return figure


def _map(
    figure: Figure,
    axes: Axes,
    cut: CutCavity,
    values: np.ndarray,
    label: str,
    colours: str,
    title: str,
    limits: tuple[float, float] | None = None,
) -> None:
    x, y, half = cut.task.workpiece.x, cut.task.workpiece.y, 0.5 * cut.task.workpiece.cell
    image = axes.imshow(
        values.T,
        origin="lower",
        extent=(x[0] - half, x[-1] + half, y[0] - half, y[-1] + half),
        cmap=colours,
        vmin=limits[0] if limits else None,
        vmax=limits[1] if limits else None,
        interpolation="nearest",
    )
    figure.colorbar(image, ax=axes, label=label, shrink=0.85)
    axes.set_xlabel("x [µm]")
    axes.set_ylabel("y [µm]")
    axes.set_title(title, fontsize=10, loc="left")


def _tip(axes: Axes, cut: CutCavity) -> None:
    """The tip's section through the axis: what is left hangs below, its greatest length at 0."""
    plain(axes)
    electrode = cut.task.electrode
    line = np.asarray(electrode.centres[0])[:, 0]
    middle = len(line) // 2
    for values, colour, name in (
        (np.asarray(electrode.loss), GREY, "before"),
        (np.asarray(cut.simulated.electrode_loss), ORANGE, "after"),
    ):
        shown = np.where(electrode.bottom, values, np.nan)
        least = float(np.nanmin(shown))
        text = f"{name}: {least:.3g} to {np.nanmax(shown):.3g} µm shorter"
        axes.plot(line, shown[:, middle] - least, color=colour, lw=1.5, label=text)
    axes.set_xlabel("from the axis [µm]")
    axes.set_ylabel("above the lowest point [µm]")
    axes.set_title("electrode's bottom along x", fontsize=10, loc="left")
    axes.legend(frameon=False, fontsize=8)
