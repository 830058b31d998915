"""Drawing of the results; nothing is computed here.

Depth counts downwards. Where a wall is judged by eye, both axes have one scale.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.yu_1997_cavities.cavities import (
    CompensatedCavity,
    ConstantFeedWall,
    FinishedCavity,
    told_feeds,
)
from experiments.yu_1997_cavities.conditions import Conditions
from experiments.yu_1997_cavities.loop import PlannedCut
from experiments.yu_1997_cavities.run import Results
from procmodel.io import writing

# Okabe and Ito's colours, told apart by colour-blind readers too.
WANTED = "#000000"
PLANNED = "#0072B2"
PLAIN = "#D55E00"
EVEN = "#CC79A7"
FINISHED = "#009E73"
READINGS = "#8A8A8A"
WORKPIECE = "#ECE7DC"

_STYLE = {"dpi": 130, "layout": "constrained"}


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write every picture into the folder; returns their paths."""
    pictures: dict[str, Callable[[Results], Figure]] = {
        "fig_12_16_constant_feed.png": constant_feed,
        "fig_17_19_20_compensated.png": compensated,
        "fig_21_22_finished.png": finished,
        "closed_loop.png": closed_loop,
        "overview.png": overview,
    }
    paths = []
    for name, draw in pictures.items():
        with writing(folder / name) as draft:
            draw(results).savefig(draft)
        paths.append(folder / name)
    return paths


def constant_feed(results: Results) -> Figure:
    """Figs 12 and 16: the curved wall, and the case with known answers beside it."""
    figure = Figure(figsize=(11, 4.6), **_STYLE)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1))
    paper, known = results.paper_wall, results.known_wall
    _constant_feed_panel(left, paper)
    left.set_title(
        f"Figs 12 and 16: electrode 50 × 50 µm, R = {paper.wear_ratio:.2f} (assumed),\n"
        f"{len(paper.depths)} layers of {paper.feed:g} µm feed and {paper.step:g} µm step"
    )
    _constant_feed_panel(right, known, mark_layers=True)
    right.set_title(
        f"Known answers: S$_e$ = 10$^4$ µm², R = {known.wear_ratio:g},\n"
        f"{len(known.depths)} layers of {known.feed:g} µm feed and {known.step:g} µm step"
    )
    return figure


def _constant_feed_panel(axes: Axes, wall: ConstantFeedWall, mark_layers: bool = False) -> None:
    fine = np.linspace(wall.innermost, wall.half_widths[0], 400)
    floor = np.array([0.0, fine[0]])
    axes.plot(
        np.concatenate([floor, fine]),
        np.concatenate([np.full(2, wall.intended(fine)[0]), wall.intended(fine)]),
        "--",
        color=WANTED,
        lw=1.5,
        label="intended wall, no wear",
    )
    axes.plot(
        np.concatenate([floor, fine]),
        np.concatenate([np.full(2, wall.limit(fine)[0]), wall.limit(fine)]),
        color=PLANNED,
        lw=2,
        label="limit of thin layers, arctangent",
    )
    x, z = staircase(wall.half_widths, wall.depths)
    axes.plot(x, z, color=PLAIN, lw=1, label="layers, eq. (4)")
    axes.plot(
        wall.half_widths,
        wall.depths,
        "o",
        ms=6 if mark_layers else 2.5,
        color=PLAIN,
        label="their outer corners ($X_n$, $Z_n$)",
    )
    _cross_section_axes(axes, "distance from the centre [µm]")
    axes.set_xlim(0, 1.08 * wall.half_widths[0])
    axes.legend(loc="lower right", frameon=False, fontsize=9)


def compensated(results: Results) -> Figure:
    """Figs 17, 19, 20: walls above, the feeds that made them below."""
    figure = Figure(figsize=(13, 6.2), **_STYLE)
    rows = figure.subplots(2, 3, height_ratios=(1.15, 1))
    for column, cavity in enumerate(results.compensated):
        _compensated_wall(rows[0, column], cavity)
        _feeds(rows[1, column], cavity)
    handles, labels = rows[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _compensated_wall(axes: Axes, cavity: CompensatedCavity) -> None:
    half_widths = np.asarray(cavity.layers.half_width)
    lines = (
        (np.asarray(cavity.layers.bottom), WANTED, 5, "wanted", 0.25),
        (cavity.plain, PLAIN, 1.8, "every layer fed by its wanted depth", 1),
        (cavity.even, EVEN, 1.8, "the plan's total feed in equal parts", 1),
        (cavity.planned, PLANNED, 1.8, "planned feeds, rounded to 0.1 µm", 1),
    )
    for depths, colour, width, label, alpha in lines:
        x, z = _both_sides(*staircase(half_widths, depths))
        axes.plot(x, z, color=colour, lw=width, alpha=alpha, label=label)
    _cross_section_axes(axes, "across [µm]")
    axes.set(xlim=(-165, 165), ylim=(185, -12))
    axes.set_title(
        f"Fig. {cavity.wanted.figure}: {cavity.wanted.name}\n"
        f"wall error {cavity.max_error(cavity.planned):.2f} µm; constant feed "
        f"{cavity.max_error(cavity.plain):.0f} or {cavity.max_error(cavity.even):.0f} µm",
        fontsize=10,
    )


def _feeds(axes: Axes, cavity: CompensatedCavity) -> None:
    number = np.arange(1, len(cavity.planned) + 1)
    axes.plot(number, np.asarray(cavity.layers.thickness), color=PLAIN, lw=1.8)
    axes.plot(number, np.full(number.shape, cavity.schedule.feeds.mean()), color=EVEN, lw=1.8)
    axes.step(number, told_feeds(cavity.schedule), color=PLANNED, lw=1.2, where="mid")
    axes.set(xlabel="layer", ylabel="feed of the layer [µm]", xlim=(0, number[-1] + 1))
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)


def finished(results: Results) -> Figure:
    """Figs 21 and 22: walls after both stages, and the electrode that each consumed."""
    figure = Figure(figsize=(11, 6.6), **_STYLE)
    rows = figure.subplots(2, 2, height_ratios=(1.35, 1))
    for column, cavity in enumerate(results.finished):
        _finished_wall(rows[0, column], cavity)
        rows[0, column].set_title(
            f"Fig. {('21', '22')[column]}: {cavity.wanted.name}, "
            f"ring of {results.conditions.ring:g} µm off the wall\n"
            f"greatest wall error after finishing {cavity.max_error:.2f} µm",
            fontsize=10.5,
        )
        _electrode_used(rows[1, column], cavity, results.conditions)
    return figure


def _finished_wall(axes: Axes, cavity: FinishedCavity) -> None:
    rough, finish = cavity.staged.roughing, cavity.staged.finishing
    outer = np.asarray(finish.half_widths)
    deep = np.asarray(finish.depths)
    ring_x, ring_z = _both_sides(*staircase(outer, deep))
    rough_x, rough_z = _both_sides(*staircase(np.asarray(rough.half_widths), rough.depths))
    axes.fill(ring_x, ring_z, color=FINISHED, alpha=0.25, lw=0)
    axes.fill(rough_x, rough_z, color="white", lw=0)
    wanted = np.asarray(cavity.finish_plan.layers.bottom)
    axes.plot(
        *_both_sides(*staircase(outer, wanted)), color=WANTED, lw=5, alpha=0.25, label="wanted"
    )
    axes.plot(rough_x, rough_z, "--", color=PLAIN, lw=1.8, label="after roughing")
    axes.plot(ring_x, ring_z, color=FINISHED, lw=1.8, label="after finishing")
    _cross_section_axes(axes, "across [µm]")
    axes.set(xlim=(-165, 165), ylim=(160, -10))
    axes.legend(loc="upper center", frameon=False, fontsize=9, bbox_to_anchor=(0.5, 0.9))


def _electrode_used(axes: Axes, cavity: FinishedCavity, conditions: Conditions) -> None:
    rough, finish = conditions.roughing, conditions.finishing
    size = f"{rough.size:g} × {rough.size:g} µm"
    stages = (
        (cavity.staged.roughing, PLAIN, f"roughing, {size}, R = {rough.wear_ratio:g}", "--"),
        (
            cavity.staged.finishing,
            FINISHED,
            f"finishing, Ø {finish.size:g} µm, R = {finish.wear_ratio:g}",
            "-",
        ),
    )
    for stage, colour, label, dashes in stages:
        used = np.cumsum(np.asarray(stage.electrode_wear))
        depths = np.asarray(stage.depths)
        axes.plot(depths, used, dashes, color=colour, lw=1.8, label=label)
        axes.annotate(
            f"{used[-1]:.0f} µm",
            (depths[-1], used[-1]),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            color=colour,
        )
    axes.set(xlabel="depth reached by the stage [µm]", ylabel="electrode consumed [µm]")
    axes.set_xlim(0, 1.15 * float(cavity.staged.finishing.depths[-1]))
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)
    axes.legend(loc="upper left", frameon=False, fontsize=9)


def closed_loop(results: Results) -> Figure:
    """Readings and fit, the feeds planned on the fit, and the wall error they leave."""
    figure = Figure(figsize=(13, 4.6), **_STYLE)
    grid = figure.add_gridspec(2, 3, width_ratios=(1.55, 1, 1.1), height_ratios=(1.5, 1))
    profile, residual = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    feeds, error = figure.add_subplot(grid[:, 1]), figure.add_subplot(grid[:, 2])
    _readings_and_fit(profile, results)
    profile.set(xlim=(-190, 190), ylim=(148, -12), xlabel=None)
    profile.legend(loc="lower center", ncols=3, frameon=False, fontsize=8.5, columnspacing=1.2)
    profile.set_title("1  measure the test cavity, fit R\n" + _fitted_ratio(results))
    _residuals(residual, results)
    cut = results.loop[0]
    number = np.arange(1, len(cut.depths) + 1)
    feeds.step(number, told_feeds(cut.schedule), color=PLANNED, lw=1.2, where="mid")
    feeds.set(xlabel="layer", ylabel="feed of the layer [µm]", xlim=(0, number[-1] + 1))
    feeds.set_ylim(bottom=0)
    feeds.grid(alpha=0.25)
    feeds.set_title(f"2  plan the {cut.wanted.name}\ntotal feed {cut.schedule.total_feed:.1f} µm")
    _wall_error(error, cut)
    error.set_title(
        f"3  cut with the true R = {results.conditions.roughing.wear_ratio:g}\n"
        f"greatest wall error {cut.max_wall_error:.2f} µm"
    )
    return figure


def _residuals(axes: Axes, results: Results) -> None:
    fit = results.fit
    centre = fit.result.parameters["centre"].value
    axes.axhline(0.0, color=PLAIN, lw=1.5)
    axes.plot(fit.position - centre, fit.result.residuals["data"], "o", ms=3, color=READINGS)
    axes.set(xlabel="across [µm]", ylabel="reading\nless fit [µm]", xlim=(-190, 190))
    axes.grid(alpha=0.25)


def _wall_error(axes: Axes, cut: PlannedCut) -> None:
    depth = np.asarray(cut.schedule.layers.bottom)
    expected, spread = cut.schedule.wall_error, cut.schedule.depth_spread
    axes.fill_betweenx(
        depth,
        expected - spread,
        expected + spread,
        color=PLANNED,
        alpha=0.2,
        lw=0,
        label="95 % band",
    )
    axes.plot(expected, depth, color=PLANNED, lw=1, label="expected")
    axes.plot(cut.wall_error, depth, color=PLAIN, lw=1.8, label="cut")
    limit = 1.9 * float(np.max(spread))
    axes.set(xlabel="wall error, positive is too deep [µm]", ylabel="depth [µm]")
    axes.set_xlim(-limit, limit)
    axes.set_ylim(depth[-1], 0)
    axes.grid(alpha=0.25)
    axes.legend(loc="upper left", frameon=False, fontsize=8.5)


def overview(results: Results) -> Figure:
    """Left the uncompensated wall with its fit, right the hemisphere planned on that fit."""
    figure = Figure(figsize=(10.4, 3.5), dpi=125, layout="constrained")
    left, right = figure.subplots(1, 2)
    _readings_and_fit(left, results, filled=True)
    truth = results.conditions.roughing.wear_ratio
    left.set_title(
        f"Constant feed curves the wall: fit it\n{_fitted_ratio(results)} (true {truth:g})",
        fontsize=11.5,
    )
    left.legend(loc="lower left", frameon=False, fontsize=9.5)
    cut = results.loop[1]
    half_widths = np.asarray(cut.schedule.layers.half_width)
    for depths, colour, width, label, dashes, alpha in (
        (np.asarray(cut.schedule.layers.bottom), WANTED, 6, "wanted hemisphere", "-", 0.25),
        (cut.plain, PLAIN, 2, "cut with constant feed", "--", 1),
        (cut.depths, PLANNED, 2, "cut with planned feeds", "-", 1),
    ):
        x, z = _both_sides(*staircase(half_widths, depths))
        if colour == PLANNED:
            _workpiece(right, x, z)
        right.plot(x, z, dashes, color=colour, lw=width, alpha=alpha, label=label)
    _cross_section_axes(right, "across [µm]")
    right.set_title(
        "Feeds planned on that fit: the wall is right\n"
        f"error at most {cut.max_wall_error:.1f} µm, not {cut.max_plain_error:.0f} µm",
        fontsize=11.5,
    )
    right.legend(loc="center", frameon=False, fontsize=9.5, bbox_to_anchor=(0.5, 0.47))
    for axes in (left, right):
        axes.set(xlim=(-190, 190), ylim=(170, -12))
    return figure


def _readings_and_fit(axes: Axes, results: Results, filled: bool = False) -> None:
    """The simulated profile, moved to the centre and surface found by the fit."""
    fit, wall = results.fit, results.paper_wall
    values = {name: p.value for name, p in fit.result.parameters.items()}
    centre = values["centre"]
    fine = np.linspace(fit.position[0] - 5.0, fit.position[-1] + 5.0, 1500)

    def surface(position: np.ndarray) -> np.ndarray:
        return values["zero"] + values["tilt"] * (position - centre)

    fitted = fit.predict(fine) - surface(fine)
    if filled:
        _workpiece(axes, fine - centre, fitted)
    edges = np.array([wall.half_widths[0], wall.innermost])
    across, depth = _both_sides(edges, wall.intended(edges))
    noise = results.conditions.instrument.noise
    axes.plot(across, depth, "--", color=WANTED, lw=1.5, label="intended wall")
    axes.plot(
        fit.position - centre,
        fit.depth - surface(fit.position),
        "o",
        ms=4,
        color=READINGS,
        label=f"simulated readings, noise {noise:g} µm",
    )
    axes.plot(fine - centre, fitted, color=PLAIN, lw=2, label="fitted wall")
    _cross_section_axes(axes, "across [µm]")


def _fitted_ratio(results: Results) -> str:
    estimate = results.fit.result.parameters["wear_ratio"]
    low, high = estimate.interval95
    return f"R = {estimate.value:.4f}, 95 % {low:.4f} to {high:.4f}"


def staircase(half_widths: np.ndarray, depths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wall of the layers from the surface at the outermost wall in to the centre of the floor."""
    x = np.append(np.repeat(half_widths, 2), 0.0)
    z = np.concatenate([[0.0], np.repeat(depths, 2)])
    return x, z


def _both_sides(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([-x, x[::-1]]), np.concatenate([z, z[::-1]])


def _workpiece(axes: Axes, x: np.ndarray, z: np.ndarray) -> None:
    """Fill what is left of the workpiece under a wall."""
    across = np.concatenate([[-400.0], x, [400.0]])
    depth = np.concatenate([[0.0], z, [0.0]])
    axes.fill_between(across, depth, 400.0, color=WORKPIECE, lw=0, zorder=0)


def _cross_section_axes(axes: Axes, across: str) -> None:
    axes.set(xlabel=across, ylabel="depth [µm]")
    axes.set_aspect("equal")
    if not axes.yaxis_inverted():
        axes.invert_yaxis()
    axes.grid(alpha=0.25)
