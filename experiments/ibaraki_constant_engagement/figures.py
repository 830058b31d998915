"""Drawing of the results; nothing is computed here."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calibration.plans.path import Survey
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain, save
from experiments.ibaraki_constant_engagement import passes
from experiments.ibaraki_constant_engagement.conditions import open_wall
from experiments.ibaraki_constant_engagement.run import Results
from procmodel.engagement import Contour

PURPLE = "#CC79A7"


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write every picture into the folder; returns their paths."""
    pictures: dict[str, Callable[[Results], Figure]] = {
        "part_by_engagement.png": part_by_engagement,
        "engagement.png": engagement,
        "corrected_surface.png": corrected_surface,
        "force_and_wall_error.png": force_and_wall_error,
        "algorithm_one.png": algorithm_one,
        "overview.png": overview,
    }
    for name, draw in pictures.items():
        save(draw(results), folder / name)
    return [folder / name for name in pictures]


def part_by_engagement(results: Results) -> Figure:
    """The pocket's last pass, coloured by engagement, before and after."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    axes = figure.subplots(1, 2)
    drawn = _maps(axes[0], axes[1], results)
    figure.colorbar(drawn, ax=axes.tolist(), label="engagement [°]", shrink=0.8)
    return figure


def _maps(left: Axes, right: Axes, results: Results) -> LineCollection:
    plan = results.pocket
    scale = Normalize(np.degrees(plan.target), np.degrees(plan.before.angle.max()))
    for axes, survey, name in (
        (left, plan.before, "parallel path before"),
        (right, plan.after, "previous pass corrected"),
    ):
        drawn = _coloured(axes, survey, scale)
        greatest = np.degrees(survey.angle.max())
        axes.set_title(f"{name}: at most {greatest:.2f}°", fontsize=10, loc="left")
    return drawn


def _coloured(axes: Axes, survey: Survey, scale: Normalize) -> LineCollection:
    walls = [c for c in survey.surface.contours if c.closed]
    for wall in walls:
        _outline(axes, wall, color=GREY, lw=1.0)
    (at,) = survey.places
    lines = LineCollection(
        np.stack([at.point[:-1], at.point[1:]], axis=1).tolist(),
        cmap="viridis",
        norm=scale,
        lw=3.0,
        capstyle="round",
    )
    lines.set_array(np.degrees(survey.angle[:-1]))
    axes.add_collection(lines)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return lines


def _outline(axes: Axes, line: Contour, **style: Any) -> None:
    points = line.flattened(1e-6)
    closed = np.concatenate([points, points[:1]]) if line.closed else points
    axes.plot(*closed.T, **style)


def engagement(results: Results) -> Figure:
    """Engagement along the open wall, before and after, with the closed form."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.subplots()
    _engagement_panel(axes, results)
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _engagement_panel(axes: Axes, results: Results) -> None:
    wall, conditions = results.wall, results.conditions
    plain(axes)
    _mark_arc(axes, results)
    axes.plot(wall.way, np.degrees(wall.before.angle), color=ORANGE, lw=2.6, label="before")
    form = np.degrees(passes.closed_form(wall.way, conditions))
    axes.plot(wall.way, form, ":", color="black", lw=1.4, label="before, closed form")
    axes.plot(wall.way, np.degrees(wall.after.angle), color=BLUE, lw=2.0, label="after")
    axes.axhline(np.degrees(wall.floor), color=GREY, lw=0.9, ls="--", label="unavoidable")
    axes.set(
        xlabel="way of the tool's centre from the beginning of the arc [mm]",
        ylabel="engagement [°]",
        xlim=(-2.5, conditions.path_turn + 2.0),
        ylim=(10.5, 19.9),
    )


def _mark_arc(axes: Axes, results: Results) -> None:
    axes.axvspan(0.0, results.conditions.path_turn, color="0.95", zorder=0)
    axes.annotate(
        "arc", (0.5 * results.conditions.path_turn, 1.0), (0, -3), fontsize=9, color=GREY,
        xycoords=("data", "axes fraction"), textcoords="offset points", ha="center", va="top",
    )  # fmt: skip


def corrected_surface(results: Results) -> Figure:
    """The surface at the arc's beginning, and the previous tool's path that makes it."""
    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _surface_panel(left, results)
    left.legend(frameon=False, fontsize=9, loc="upper left")
    left.set_title("Surface that the previous pass leaves", fontsize=10, loc="left")
    conditions = results.conditions
    plain(right)
    depth = conditions.radial_depth + conditions.radius
    _outline(right, open_wall(conditions, depth), color=ORANGE, lw=2.0, label="parallel path")
    for path in results.wall.corrected.path:
        _outline(right, path, color=BLUE, lw=2.0, label="corrected path")
    right.set(xlabel="x [mm]", ylabel="y [mm]", xlim=(-0.6, 3.4), ylim=(5.0, 8.0))
    right.set_aspect("equal")
    right.legend(frameon=False, fontsize=9, loc="upper left")
    right.set_title("Path of the previous tool, with its corner", fontsize=10, loc="left")
    return figure


def _surface_panel(axes: Axes, results: Results) -> None:
    wall, conditions = results.wall, results.conditions
    plain(axes)
    _outline(axes, open_wall(conditions), color="black", lw=1.6, label="finished wall")
    _outline(
        axes, open_wall(conditions, conditions.radial_depth), color=ORANGE, lw=1.8,
        label="parallel surface",
    )  # fmt: skip
    for line in wall.corrected.wanted:
        _outline(axes, line, color=GREEN, lw=1.8, ls="--", label="wanted, with its kink")
    for line in wall.corrected.surface.contours:
        _outline(axes, line, color=BLUE, lw=1.8, label="corrected, as a disc can leave it")
    kink = (conditions.radius * float(np.sin(wall.target)), conditions.radial_depth)
    axes.annotate(
        f"kink of {np.degrees(wall.kinks[0]):.2f}°", kink, (-70, -34), fontsize=9, color=GREEN,
        textcoords="offset points", ha="center",
        arrowprops={"arrowstyle": "-", "color": GREEN, "lw": 0.9},
    )  # fmt: skip
    axes.set(xlabel="x [mm]", ylabel="y [mm], six times magnified", xlim=(-0.4, 2.4))
    axes.set_aspect(6.0)
    axes.set_ylim(-0.03, 0.36)


def force_and_wall_error(results: Results) -> Figure:
    """Force above, wall error below with both readings of the 14 um."""
    figure = Figure(figsize=(9.0, 8.4), layout="constrained")
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(1, 1, 1.35))
    wall, found = results.wall, results.loads
    for axes, law, label in ((upper, "peak", "peak force [N]"), (middle, "mean", "mean force [N]")):
        plain(axes)
        _mark_arc(axes, results)
        axes.plot(wall.way, getattr(found.absolute.before, law), color=ORANGE, lw=2, label="before")
        axes.plot(wall.way, getattr(found.absolute.after, law), color=BLUE, lw=2, label="after")
        axes.set_ylabel(label)
        axes.set_ylim(0.0, 1.15 * float(getattr(found.absolute.before, law).max()))
    upper.set_title(
        f"Coefficients of {results.conditions.material} (published) and a helix of 30°, both "
        "assumed: the paper cut steel, HRC53",
        fontsize=10, loc="left",
    )  # fmt: skip
    upper.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    _error_panel(lower, results)
    lower.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    lower.set_title(
        "Wall error: the stiffness is fitted to the 14 µm; it is confounded with the coefficients",
        fontsize=10, loc="left",
    )  # fmt: skip
    lower.set_xlabel("way of the tool's centre from the beginning of the arc [mm]")
    lower.set_xlim(-2.5, results.conditions.path_turn + 2.0)
    return figure


def _error_panel(axes: Axes, results: Results) -> None:
    wall, found, paper = results.wall, results.loads, results.conditions.paper
    plain(axes)
    _mark_arc(axes, results)
    for reading, style, name in (
        (found.absolute, "-", "14 µm left"),
        (found.relative, "--", "14 µm arc less line"),
    ):
        for load, colour, when in (
            (reading.before, ORANGE, "before"),
            (reading.after, BLUE, "after"),
        ):
            axes.plot(
                wall.way, 1e3 * reading.read(load), style, color=colour, lw=2,
                label=f"{when}, {name}",
            )  # fmt: skip
    middle = 0.5 * results.conditions.path_turn
    points = ((middle, paper.left_in_arc), (0.0, paper.left_at_junction))
    axes.plot(
        *np.array([(x, 1e3 * y) for x, y in points]).T, "D", color="black", ms=6, zorder=5,
        label="paper: 14 µm (fitted),\n4.5 µm at the junction",
    )  # fmt: skip
    axes.set(ylabel="wall error [µm]", ylim=(-0.8, 16.5))


def algorithm_one(results: Results) -> Figure:
    """What algorithm I leaves, pass by pass; and the paper's Newton step."""
    figure = Figure(figsize=(9.0, 6.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    forward, newton = results.forward, results.newton
    for axes in (upper, lower):
        plain(axes)
        _mark_arc(axes, results)
    for number, (way, miss) in enumerate(zip(forward.way, forward.miss, strict=True), start=1):
        colour = (PURPLE, GREEN, BLUE)[(number - 1) % 3]
        upper.plot(way, 1e3 * miss, color=colour, lw=2, label=f"pass {number}")
    upper.set_ylabel("left on the wanted surface [µm]")
    upper.set_ylim(-10.0, 225.0)
    upper.set_title("Algorithm I: constant engagement, and the contour is missed", fontsize=10)
    lower.plot(
        newton.way, np.degrees(newton.one_step), color=ORANGE, lw=2,
        label="one step, from the\ngiven path (baseline)",
    )  # fmt: skip
    lower.plot(
        newton.way, np.degrees(newton.continued), color=GREEN, lw=2,
        label="one step, from the\nplace before",
    )  # fmt: skip
    lower.plot(newton.way, np.degrees(newton.converged), ":", color="black", label="converged")
    lower.set(
        xlabel="way of the tool's centre from the beginning of the arc [mm]",
        ylabel="engagement reached [°]",
        ylim=(4.8, 12.8),
        xlim=(-2.0, results.conditions.path_turn + 2.0),
    )
    lower.set_title("Algorithm I place by place: the paper's finite-difference step", fontsize=10)
    for axes in (upper, lower):
        axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def overview(results: Results) -> Figure:
    """The experiment on one page."""
    figure = Figure(figsize=(12.0, 8.4), layout="constrained")
    (left, right), (lower, last) = figure.subplots(2, 2, height_ratios=(1, 1.05))
    drawn = _maps(left, right, results)
    figure.colorbar(drawn, ax=[left, right], label="engagement [°]", shrink=0.8)
    _engagement_panel(lower, results)
    lower.set_xlim(-2.5, results.conditions.path_turn + 6.5)
    lower.legend(frameon=False, fontsize=8, loc="upper right")
    lower.set_title("Engagement along one corner", fontsize=10, loc="left")
    _error_panel(last, results)
    last.set(
        xlabel="way of the tool's centre from the beginning of the arc [mm]",
        xlim=(-2.5, results.conditions.path_turn + 6.5),
    )
    last.legend(frameon=False, fontsize=8, loc="upper right")
    last.set_title(
        "Wall error, stiffness fitted to the 14 µm (confounded with force)",
        fontsize=10, loc="left",
    )  # fmt: skip
    return figure
