"""Drawing of the results; nothing is computed here."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plots.electrode_gap import draw_gap
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain
from experiments.guo_wedg_electrodes.run import Results
from procmodel.electrode.profile import radius_at
from procmodel.io import writing

_STYLE = {"dpi": 100, "layout": "constrained"}


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write every picture into the folder; returns their paths."""
    pictures: dict[str, Callable[[Results], Figure]] = {
        "gap.png": lambda found: draw_gap(found.readings, found.posterior),
        "budget.png": budget,
        "overview.png": overview,
    }
    paths = []
    for name, draw in pictures.items():
        with writing(folder / name) as draft:
            draw(results).savefig(draft, dpi=100)
        paths.append(folder / name)
    return paths


def overview(results: Results) -> Figure:
    """Gaps, shapes with their bands, budget, and what the area does to the next cavity."""
    figure = Figure(figsize=(12.5, 8.4), **_STYLE)
    (first, second), (third, fourth) = figure.subplots(2, 2)
    _gaps(first, results)
    _shapes(second, results)
    _budget(third, results)
    _cavity(fourth, results)
    return figure


def budget(results: Results) -> Figure:
    """The causes of error alone, and what measuring and correcting gains."""
    figure = Figure(figsize=(12.0, 4.2), **_STYLE)
    left, right = figure.subplots(1, 2)
    _budget(left, results)
    _learning(right, results)
    return figure


def _gaps(axes: Axes, results: Results) -> None:
    plain(axes)
    gap = np.linspace(5.0, 25.0, 121)
    ahead = results.posterior.next_gap()
    axes.plot(gap, ahead.density(gap), color=BLUE, lw=2, label="next gap, from ten simulated gaps")
    below = [results.from_range.next_below(g) for g in gap]
    axes.plot(
        gap, np.gradient(below, gap), "--", color=ORANGE, label="next gap, from the range alone"
    )
    mean = results.posterior.mean.density(gap)
    axes.fill_between(
        gap, 0.2 * mean, color=BLUE, alpha=0.15, lw=0, label="mean gap (height times 0.2)"
    )
    axes.plot(
        results.readings.gap, np.full(len(results.readings), -0.008), "|", ms=12, color=GREY,
        label="simulated gaps: extremes of the paper",
    )  # fmt: skip
    axes.set_xlabel("discharge gap [µm]")
    axes.set_ylabel("density [1/µm]")
    axes.set_ylim(-0.02, 0.24)
    axes.set_title("What ten holes tell of the next gap", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=8.5, loc="upper left")


def _shapes(axes: Axes, results: Results) -> None:
    """Half sections side by side; the band is 90 % of electrodes, to scale."""
    height = np.linspace(0.0, results.conditions.length, 60)
    for number, made in enumerate(results.ground):
        middle = 170.0 * number
        radius = np.asarray(radius_at(made.shape.profile, height))
        found = made.plan.prediction
        half = 0.5 * np.diff(found.interval, axis=1)[:, 0]
        band = 0.5 * np.interp(height, made.shape.heights, half)
        for side in (-1.0, 1.0):
            axes.fill_betweenx(
                height, middle + side * (radius - band), middle + side * (radius + band),
                color=BLUE, alpha=0.35, lw=0,
                label="90 % of electrodes" if number == 0 and side > 0 else None,
            )  # fmt: skip
            axes.plot(
                middle + side * radius, height, color="k", lw=1.0,
                label="drawing" if number == 0 and side > 0 else None,
            )  # fmt: skip
        chance = found.all_within
        assert chance is not None
        axes.text(
            middle, -12.0, f"{made.shape.name}\nwithin 2 %: {100 * chance:.0f} %",
            ha="center", va="top", fontsize=9,
        )  # fmt: skip
    axes.set_aspect("equal")
    axes.set_ylim(-48.0, results.conditions.length + 45.0)
    axes.set_ylabel("height above the tip [µm]")
    axes.set_xticks([])
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_title(
        f"Three electrodes, path corrected; all three within 2 %: {100 * results.all_within:.1f} %",
        loc="left",
        fontsize=11,
    )
    axes.legend(frameon=False, fontsize=8.5, loc="upper right", ncols=2)


def _budget(axes: Axes, results: Results) -> None:
    plain(axes)
    names = [cause.name for cause in results.budget]
    values = [cause.std for cause in results.budget]
    place = np.arange(len(names))[::-1]
    colours = [BLUE, BLUE, ORANGE, GREEN, GREEN]
    axes.hlines(place, 5e-5, values, color=colours, lw=2, alpha=0.5)
    axes.scatter(values, place, color=colours, s=45, zorder=3)
    for at, value in zip(place, values, strict=True):
        axes.text(1.4 * value, at, f"{value:.2g} µm", va="center", fontsize=9)
    axes.set_xscale("log")
    axes.set_xlim(5e-5, 60.0)
    axes.set_yticks(place, names)
    axes.set_xlabel("standard deviation in a diameter [µm]")
    axes.set_title("What spoils a diameter", loc="left", fontsize=11)


def _learning(axes: Axes, results: Results) -> None:
    plain(axes)
    found = results.learning
    axes.plot(
        found.electrodes, found.error, "o-", color=BLUE, ms=4, label="path corrected each time"
    )
    axes.axhline(found.least, color=GREY, lw=1, label="mean gap known: scatter alone")
    axes.set_xticks(found.electrodes[::5])
    axes.set_xlabel("electrodes measured so far")
    axes.set_ylabel("expected error of the next diameter [µm]")
    axes.set_ylim(0.0, None)
    axes.legend(frameon=False, fontsize=9)


def _cavity(axes: Axes, results: Results) -> None:
    plain(axes)
    colours = (GREEN, ORANGE, BLUE)
    for (name, plan), colour in zip(results.linked.plans.items(), colours, strict=True):
        layers = np.asarray(plan.layers.bottom)
        axes.plot(
            layers, plan.depth_spread, color=colour, lw=2,
            label=f"{name}: ±{plan.depth_spread[-1]:.1f} µm at the bottom",
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xlabel("wanted depth of a 60° cone [µm]")
    axes.set_ylabel("half of the 95 % range of depth [µm]")
    share = results.linked.blind.relative
    axes.set_title(
        f"The next cavity; area of a blind electrode: ±{100 * share:.0f} %",
        loc="left",
        fontsize=11,
    )
    axes.legend(frameon=False, fontsize=8.5, loc="lower right")
