"""Drawing of the results; nothing is computed here."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.chatter_cuts import CutScores
from calibration.plots.figures import BLUE, GREY, ORANGE, plain, save
from experiments.chatter_thresholds.run import PAPERS_THRESHOLD, Results
from procmodel.chatter import CHATTER, STABLE


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write the picture into the folder; returns its path."""
    save(overview(results), folder / "overview.png")
    return [folder / "overview.png"]


def overview(results: Results) -> Figure:
    """Scores of every tool's new cuts with the thresholds, and the rates they lead to."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
    names = list(results.held_out)
    for row, name in enumerate(names):
        for label, colour, lift in ((STABLE, BLUE, 0.13), (CHATTER, ORANGE, -0.13)):
            for cut in results.held_out[name]:
                if cut.label == label:
                    _span(left, cut, row + lift, colour)
    styles = ("-", ":")
    for (rate, plan), style in zip(results.plans.items(), styles, strict=True):
        left.axvline(
            plan.threshold.value, color="k", ls=style, lw=1.2,
            label=f"learnt, {rate:g} false alarms an hour",
        )  # fmt: skip
    left.axvline(PAPERS_THRESHOLD, color=GREY, ls="--", lw=1.2, label="100, the paper's")
    left.plot([], [], color=BLUE, lw=4, alpha=0.6, label="stable cuts, 5 to 95 % of windows")
    left.plot([], [], color=ORANGE, lw=4, alpha=0.6, label="chattering cuts")
    left.set_xscale("log")
    left.set_yticks(range(len(names)), names)
    left.invert_yaxis()
    left.set_xlabel("score D")
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncol=2, frameon=False, fontsize=8)
    for (rate, plan), colour, lift in zip(
        results.plans.items(), (BLUE, ORANGE), (0.12, -0.12), strict=True
    ):
        stated = plan.false_alarms_per_hour.value
        for row, name in enumerate(names):
            found = results.tallies[name, rate].false_alarms_per_hour
            if found is not None:
                low, high = found.interval90
                right.plot([low / stated, high / stated], [row + lift] * 2, color=colour, lw=2)
                right.plot(max(found.value, low) / stated, row + lift, "o", color=colour, ms=5)
        right.plot([], [], color=colour, marker="o", label=f"{rate:g} an hour asked for")
    right.axvspan(0.5, 2.0, color="0.9", zorder=0, label="within a factor of two")
    right.set_xscale("log")
    right.set_yticks(range(len(names)), [""] * len(names))
    right.set_ylim(left.get_ylim())
    right.set_xlabel("false alarms seen over stated, 90 % interval")
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncol=2, frameon=False, fontsize=8)
    for axes in (left, right):
        plain(axes)
    return figure


def _span(axes: Axes, cut: CutScores, row: float, colour: str) -> None:
    low, high = np.quantile(np.maximum(cut.scores, 1.0), [0.05, 0.95])
    axes.plot([low, high], [row] * 2, color=colour, lw=4, alpha=0.25, solid_capstyle="butt")
