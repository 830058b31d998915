"""Drawing of the results; nothing is computed here. Depth and length of the electrode down."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain
from experiments.yu_1997_path_rules.cutting import Cut
from experiments.yu_1997_path_rules.rules import ALL
from experiments.yu_1997_path_rules.run import DRAWN, Results
from procmodel.io import writing

_STYLE = {"dpi": 100, "layout": "constrained"}
PURPLE = "#AA4499"
# Nearer to eq. (3) than this is not drawn.
_ROUNDING = 1e-7


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write every picture into the folder; returns their paths."""
    pictures: dict[str, Callable[[Results], Figure]] = {
        "floors.png": floors,
        "overview.png": overview,
    }
    paths = []
    for name, draw in pictures.items():
        with writing(folder / name) as draft:
            draw(results).savefig(draft, dpi=100)
        paths.append(folder / name)
    return paths


def overview(results: Results) -> Figure:
    """Tilt, overlap, slot, start-up, feed laws and hemisphere."""
    figure = Figure(figsize=(14.0, 8.4), **_STYLE)
    axes = figure.subplots(2, 3)
    for panel, draw in zip(
        axes.ravel(), (_tilt, _overlap, _slot, _start_up, _laws, _hemisphere), strict=True
    ):
        plain(panel)
        draw(panel, results)
    return figure


def floors(results: Results) -> Figure:
    """Floor of the pocket for some variants, fixed above and rotating below."""
    figure = Figure(figsize=(14.0, 5.9), **_STYLE)
    panels = figure.subplots(2, len(DRAWN))
    for line, electrode in zip(panels, ("fixed", "rotating"), strict=True):
        for axes, name in zip(line, DRAWN, strict=True):
            row = results.row(name, electrode)
            made = row.made
            half = 0.5 * results.conditions.pocket
            values = (made.depth - np.median(made.depth[_inside(made)])) / results.conditions.feed
            image = axes.imshow(
                values.T, origin="lower", cmap="RdBu_r", vmin=-1, vmax=1,
                extent=(made.x[0], made.x[-1], made.y[0], made.y[-1]),
            )  # fmt: skip
            axes.set_xlim(-half, half)
            axes.set_ylim(-half, half)
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_title(f"{name}, {electrode}:\n{row.floor.inside:.2f} feeds", fontsize=9.5)
    figure.colorbar(image, ax=panels, label="depth less the floor's, in feeds", shrink=0.8)
    return figure


def _inside(made: Cut) -> np.ndarray:
    left, low, right, high = made.job.outline.bounds
    x, y = np.meshgrid(made.x, made.y, indexing="ij")
    return (x > left) & (x < right) & (y > low) & (y < high)


def _tilt(axes: Axes, results: Results) -> None:
    tilt, groove = results.tilts[0], results.grooves[0]
    share = np.linspace(0.0, 1.0, len(tilt.x))
    after = groove.ends[1] / results.conditions.feed
    for values, colour, style, text in (
        (tilt.profile[0], ORANGE, "-", f"one way: {tilt.one_way[-1]:.2f} feeds (law: 0.50)"),
        (tilt.profile[1], BLUE, "-", f"to and fro: {-tilt.to_and_fro[-1]:.2f}, the other way"),
        (after - after.mean(), GREEN, "-", f"four falling passes more: {groove.after:.3f}"),
    ):
        axes.plot(share, values, color=colour, ls=style, lw=2, label=text)
    axes.set_ylim(0.62, -0.32)
    axes.set_xlabel("share of the groove")
    axes.set_ylabel("depth about the mean, in feeds")
    axes.set_title("Tilt: turned by to and fro, levelled (u = 1)", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=9, loc="lower right")


def _overlap(axes: Axes, results: Results) -> None:
    feed = results.conditions.feed
    for name, colour in (("no overlap, one direction", ORANGE), (ALL, BLUE)):
        row = results.row(name, "rotating")
        made = row.made
        strip = np.abs(made.x) < 20.0
        line = made.depth[strip].mean(axis=0) / feed
        level = np.median(line[np.abs(made.y) < 80.0])
        label = f"{name}: {row.floor.inside:.2f} feeds"
        axes.plot(made.y, line - level, color=colour, lw=2, label=label)
    half = 0.5 * results.conditions.pocket
    axes.set_xlim(-half, half)
    axes.set_ylim(1.0, -1.4)
    axes.set_xlabel("across the lines [µm]")
    axes.set_ylabel("depth about the floor, in feeds")
    axes.set_title("Overlap and alternation, rotating electrode", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=9, loc="upper center")


def _slot(axes: Axes, results: Results) -> None:
    feed = results.conditions.feed
    for name, colour in (("slot, not turned", ORANGE), ("slot, turned", BLUE)):
        row = results.row(name, "fixed")
        loss = np.asarray(row.made.last.electrode_loss)
        place = row.made.job.electrode.centres[1][0]
        values = loss.mean(axis=0) / feed
        label = f"{name}: {row.floor.tip:.1f} feeds in all"
        axes.plot(place, values - values.min(), color=colour, lw=2, label=label)
    axes.set_xlabel("across the slot, on the electrode [µm]")
    axes.set_ylabel("shorter than its longest place, in feeds")
    axes.set_title("The slot rounds the edges along it (figs 9, 10)", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=9, loc="upper center")


def _start_up(axes: Axes, results: Results) -> None:
    colours = {"flat": GREY, "fixed": BLUE, "rotating": ORANGE}
    for (electrode, ratio), depth in results.start_up.items():
        strong = ratio == results.conditions.wear_ratio
        off = np.abs(depth - 1.0)
        off[off < _ROUNDING] = np.nan
        axes.semilogy(
            np.arange(1, len(off) + 1), off, color=colours[electrode], lw=2,
            ls="-" if strong else "--",
            label=f"{electrode}, R = {ratio:g}",
        )  # fmt: skip
    axes.set_ylim(1e-9, 1.5)
    axes.set_xlabel("layer")
    axes.set_ylabel("mean depth off eq. (3), relative")
    axes.set_title("Start-up: eq. (3) holds once it is over", loc="left", fontsize=11)
    axes.legend(fontsize=8.5, ncols=2, loc="lower left", framealpha=1.0, edgecolor="white")


def _laws(axes: Axes, results: Results) -> None:
    right = results.conditions.wear_ratio
    wrong = results.conditions.wrong * right
    place = np.arange(3)
    bars = (
        ("fixed", right, BLUE, 1.0), ("fixed", wrong, BLUE, 0.4),
        ("rotating", right, ORANGE, 1.0), ("rotating", wrong, ORANGE, 0.4),
    )  # fmt: skip
    for number, (electrode, ratio, colour, alpha) in enumerate(bars):
        rms = [
            results.pocket(law, electrode, ratio).rms for law in ("layer", "linear", "fixed-length")
        ]
        text = "R right" if ratio == right else "R + 10 %"
        axes.bar(
            place + 0.2 * (number - 1.5), rms, 0.19, color=colour, alpha=alpha,
            label=f"{electrode}, {text}",
        )  # fmt: skip
    axes.set_xticks(place, ["feed per layer\n(uniform wear)", "linear", "fixed length"])
    depth = results.conditions.depth_per_layer * results.conditions.layers
    axes.set_ylabel("rms error of the floor [µm]")
    axes.set_title(f"A pocket of {depth:g} µm by three feed laws", loc="left", fontsize=11)
    axes.set_ylim(0.0, 1.35 * max(made.rms for made in results.compensated))
    axes.legend(frameon=False, fontsize=8.5, ncols=2, loc="upper center")


def _hemisphere(axes: Axes, results: Results) -> None:
    bowl = results.bowl
    x, y = np.meshgrid(bowl.workpiece.x, bowl.workpiece.y, indexing="ij")
    radius = np.hypot(x, y)
    edges = np.arange(0.0, results.conditions.radius + 2.5, 2.5)
    middle = 0.5 * (edges[1:] + edges[:-1])
    colours = {"eq. (3)": ORANGE, "simulator": BLUE, "simulator, for the belief": PURPLE}

    def around(depth: np.ndarray) -> np.ndarray:
        off = depth - bowl.target
        rings = [bowl.region & (radius >= a) & (radius < b) for a, b in pairwise(edges)]
        return np.array([off[ring].mean() if np.any(ring) else np.nan for ring in rings])

    axes.plot(
        middle, around(bowl.staircase), color=GREY, ls=":", lw=2, label="the layers themselves"
    )
    for plan in results.planned:
        if plan.name in colours:
            colour = colours[plan.name]
            text = f"{plan.name}: rms {plan.right[0]:.1f}, R + 10 %: {plan.wrong[0]:.1f}"
            axes.plot(middle, around(plan.depth), color=colour, lw=2, label=text)
            axes.plot(middle, around(plan.worse), color=colour, lw=1.3, ls="--")
    axes.set_ylim(11.0, -9.0)
    axes.set_xlabel("from the axis [µm]")
    axes.set_ylabel("depth less the hemisphere's [µm]")
    axes.set_title("Hemisphere (dashed: R 10 % greater)", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=8.5, loc="lower left")
