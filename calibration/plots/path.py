"""Pictures of a corrected path: the path coloured by engagement, and engagement along it."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calibration.plans.path import Survey
from calibration.plans.path_load import PathLoad
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain
from procmodel.engagement.contour import Contour

# Places drawn of each contour: more cannot be told apart.
_DRAWN = 6000


def draw_path(
    surveys: Sequence[tuple[str, Survey]],
    walls: Sequence[Contour],
    loads: Sequence[PathLoad] = (),
    floor: float | None = None,
) -> Figure:
    """Paths coloured by engagement, and engagement, force and form error against the way.

    Parameters
    ----------
    surveys : sequence of (str, Survey)
        What to call each pass, such as before and after, and its engagement.
    walls : sequence of Contour
        Finished walls.
    loads : sequence of PathLoad
        Of each survey, where coefficients are known.
    floor : float, optional [rad]
        Greatest angle that cannot be avoided.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    errors = bool(loads) and all(load.form_error is not None for load in loads)
    rows = 1 + bool(loads) + errors
    figure = Figure(figsize=(5.0 * max(len(surveys), 2), 4.2 + 2.3 * rows), layout="constrained")
    grid = figure.add_gridspec(1 + rows, len(surveys), height_ratios=[2.0] + [1.0] * rows)
    degrees = [np.degrees(s.angle) for _, s in surveys]
    scale = Normalize(min(d.min() for d in degrees), max(d.max() for d in degrees) + 1e-9)
    maps = []
    for i, (name, survey) in enumerate(surveys):
        axes = figure.add_subplot(grid[0, i])
        drawn = _coloured(axes, survey, walls, scale)
        axes.set_title(f"{name}: at most {degrees[i].max():.3f}°", fontsize=10, loc="left")
        maps.append(axes)
    figure.colorbar(drawn, ax=maps, label="engagement [°]", shrink=0.85)
    colours = (ORANGE, BLUE, GREEN)
    lower = figure.add_subplot(grid[1, :])
    _along(lower, surveys, degrees, colours, "engagement [°]")
    lower.axhline(np.degrees(surveys[0][1].target), color=GREY, lw=0.9, ls="--", label="target")
    if floor is not None:
        lower.axhline(np.degrees(floor), color=GREY, lw=0.9, ls=":", label="unavoidable")
    lower.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
    panels = [lower]
    if loads:
        force = figure.add_subplot(grid[2, :], sharex=lower)
        _along(force, surveys, [load.peak for load in loads], colours, "peak force [N]")
        panels.append(force)
    if errors:
        wall = figure.add_subplot(grid[3, :], sharex=lower)
        microns = [1e3 * load.form_error for load in loads if load.form_error is not None]
        _along(wall, surveys, microns, colours, "wall error [µm]")
        panels.append(wall)
    panels[-1].set_xlabel("way along the path [mm]")
    return figure


def _coloured(
    axes: Axes, survey: Survey, walls: Sequence[Contour], scale: Normalize
) -> LineCollection:
    for wall in walls:
        points = wall.flattened(1e-3)
        closed = np.concatenate([points, points[:1]]) if wall.closed else points
        axes.plot(*closed.T, color=GREY, lw=1.0)
    begin = 0
    for at in survey.places:
        angle = np.degrees(survey.angle[begin : begin + len(at)])
        begin += len(at)
        chosen = _thinned(angle)
        points = at.point[chosen]
        lines = LineCollection(
            np.stack([points[:-1], points[1:]], axis=1).tolist(),
            cmap="viridis",
            norm=scale,
            lw=2.5,
            capstyle="round",
        )
        lines.set_array(angle[chosen][:-1])
        axes.add_collection(lines)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return lines


def _along(
    axes: Axes,
    surveys: Sequence[tuple[str, Survey]],
    values: Sequence[np.ndarray],
    colours: Sequence[str],
    label: str,
) -> None:
    plain(axes)
    for (name, survey), value, colour in zip(surveys, values, colours, strict=False):
        begin, way = 0, 0.0
        for i, at in enumerate(survey.places):
            part = value[begin : begin + len(at)]
            begin += len(at)
            chosen = _thinned(part)
            title = name if i == 0 else None
            axes.plot(way + at.way[chosen], part[chosen], color=colour, lw=1.4, label=title)
            way += float(at.way[-1])
    axes.set_ylabel(label)


def _thinned(values: np.ndarray) -> np.ndarray:
    """Numbers of the places to draw: evenly, and the extremes between them."""
    count = len(values)
    if count <= _DRAWN:
        return np.arange(count)
    blocks = np.array_split(np.arange(count), _DRAWN // 3)
    chosen = [[b[0], b[np.argmin(values[b])], b[np.argmax(values[b])]] for b in blocks]
    return np.unique(np.concatenate([*chosen, [count - 1]]))
