"""Pictures of scanning paths: some layers from above, all layers from the side. Lengths in um."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path

from calibration.plots.figures import BLUE, GREY, ORANGE, plain
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.scanning import sweep
from procmodel.wear.slicing import Slices

_COLOURS = "viridis"


def draw_scanning(
    slices: Slices, paths: Sequence[LayerPath], electrode: ElectrodeSection, gap: float = 0.0
) -> Figure:
    """Paths of three or four layers from above, coloured by order, and the layers from the side.

    Parameters
    ----------
    slices : Slices
        The layers.
    paths : sequence of LayerPath
        Path of every layer.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = Figure(figsize=(11.0, 7.2), layout="constrained")
    shown = _shown(len(slices))
    grid = figure.add_gridspec(1, 2, width_ratios=(1.25, 1.0))
    left, low, right, high = slices.bounds
    # Long parts lie better above one another.
    columns = 1 if right - left > 2.5 * (high - low) else 2
    inner = grid[0].subgridspec(-(-len(shown) // columns), columns)
    tops = [figure.add_subplot(inner[i // columns, i % columns]) for i in range(len(shown))]
    margin = 0.04 * max(right - left, high - low)
    for axes, n in zip(tops, shown, strict=True):
        _draw_layer(axes, slices.regions[n], paths[n], electrode, gap)
        axes.set_xlim(left - margin, right + margin)
        axes.set_ylim(low - margin, high + margin)
        axes.set_title(_title(n, paths[n]), fontsize=9, loc="left")
        axes.set_xlabel("x [µm]", fontsize=9)
        axes.set_ylabel("y [µm]", fontsize=9)
    colours = tops[0].collections[-1]
    bar = figure.colorbar(colours, ax=tops, orientation="horizontal", shrink=0.6, aspect=40)
    bar.set_label(
        "share of the way done; dotted: lifted; dashed: electrode at the start; orange: uncut",
        fontsize=8,
    )
    bar.ax.tick_params(labelsize=8)
    side = grid[1].subgridspec(2, 1, height_ratios=(1.4, 1.0))
    section, lengths = figure.add_subplot(side[0]), figure.add_subplot(side[1])
    _draw_side(section, slices)
    _draw_lengths(lengths, slices, paths)
    return figure


def _shown(count: int) -> list[int]:
    """The first pair, the next pair's first, and the last layer."""
    return sorted({n for n in (0, 1, 2, count - 1) if 0 <= n < count})


def _title(n: int, path: LayerPath) -> str:
    lifts = int(np.sum(~path.cutting))
    text = f"layer {n + 1}: {path.length / 1000:.2f} mm, turning points: {path.turning_points}"
    if lifts:
        text += f",\nlifted moves: {lifts}"
    if path.quarter_turns:
        text += f",\nelectrode turned by {90 * path.quarter_turns}°"
    return text


def _draw_layer(
    axes: Axes,
    region: shapely.Geometry,
    path: LayerPath,
    electrode: ElectrodeSection,
    gap: float,
) -> None:
    axes.set_aspect("equal")
    plain(axes)
    axes.tick_params(labelsize=8)
    _fill(axes, region, facecolor="0.97", edgecolor=GREY, lw=1.0)
    missed = region.difference(sweep(path, electrode, gap))
    _fill(axes, missed.buffer(0), facecolor=ORANGE, alpha=0.45, lw=0)
    points = path.points
    moves = np.stack([points[:-1], points[1:]], axis=1)
    done = np.cumsum(path.move_lengths) / max(float(np.sum(path.move_lengths)), 1e-12)
    lifted = LineCollection(list(moves[~path.cutting]), colors=GREY, lw=0.9, ls=":", zorder=3)
    axes.add_collection(lifted)
    # The electrode where it begins, to scale.
    _draw_electrode(axes, points[0], electrode)
    axes.plot(*points[0], "o", color=ORANGE, ms=4, zorder=5)
    cut = LineCollection(
        list(moves[path.cutting]), cmap=_COLOURS, array=done[path.cutting], lw=1.3, zorder=4
    )
    cut.set_clim(0.0, 1.0)
    axes.add_collection(cut)


def _draw_electrode(axes: Axes, at: np.ndarray, electrode: ElectrodeSection) -> None:
    if electrode.shape == "round":
        outline = shapely.Point(at).buffer(electrode.half, quad_segs=24)
    else:
        outline = shapely.box(*(at - electrode.half), *(at + electrode.half))
    corners = shapely.get_coordinates(outline)
    axes.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=ORANGE, lw=1.0, ls="--"))


def _fill(axes: Axes, geometry: shapely.Geometry, **style: Any) -> None:
    patches = []
    for part in shapely.get_parts(geometry):
        if part.geom_type != "Polygon" or part.is_empty:
            continue
        rings = [shapely.get_coordinates(r) for r in (part.exterior, *part.interiors)]
        patches.append(PathPatch(Path.make_compound_path(*(Path(r, closed=True) for r in rings))))
    if patches:
        axes.add_collection(PatchCollection(patches, **style))


def _draw_side(axes: Axes, slices: Slices) -> None:
    """Where every layer is cut along a line through the middle of the first."""
    plain(axes)
    left, low, right, high = slices.bounds
    y = float(shapely.get_y(shapely.point_on_surface(slices.regions[0])))
    middle = (low + high) / 2
    if shapely.intersects_xy(slices.regions[0], (left + right) / 2, middle):
        y = middle
    line = shapely.LineString([(left - 1.0, y), (right + 1.0, y)])
    cut, silhouettes = [], []
    for region, bottom, thickness in zip(
        slices.regions, slices.bottom, slices.thickness, strict=True
    ):
        top = bottom - thickness
        for piece in shapely.get_parts(shapely.intersection(region, line)):
            begin, _, end, _ = piece.bounds
            cut.append([(begin, top), (end, top), (end, bottom), (begin, bottom)])
        begin, _, end, _ = region.bounds
        silhouettes += [[(x, top), (x, bottom)] for x in (begin, end)]
    axes.add_collection(
        PatchCollection(
            [Polygon(c, closed=True) for c in cut], facecolor=BLUE, alpha=0.25, edgecolor=BLUE,
            lw=0.5 if len(slices) < 80 else 0.2,
        )
    )  # fmt: skip
    axes.add_collection(LineCollection(silhouettes, colors=GREY, lw=0.8))
    depth = float(slices.bottom[-1])
    axes.set_xlim(left - 0.03 * (right - left), right + 0.03 * (right - left))
    axes.set_ylim(depth * 1.05, -0.05 * depth)
    title = f"{len(slices)} layers cut at y = {y:.2f} µm; grey: outermost walls"
    if depth > 0.2 * (right - left):
        axes.set_aspect("equal")
    else:
        title += "; z stretched"
    axes.set_xlabel("x [µm]", fontsize=9)
    axes.set_ylabel("depth z [µm]", fontsize=9)
    axes.set_title(title, fontsize=9, loc="left")
    axes.tick_params(labelsize=8)


def _draw_lengths(axes: Axes, slices: Slices, paths: Sequence[LayerPath]) -> None:
    plain(axes)
    lengths = [path.length / 1000 for path in paths[: len(slices)]]
    axes.step([lengths[0], *lengths], [0.0, *slices.bottom], where="pre", color=BLUE, lw=1.2)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel("way in the layer [mm]", fontsize=9)
    axes.set_ylabel("depth z [µm]", fontsize=9)
    axes.tick_params(labelsize=8)
