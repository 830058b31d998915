"""Pictures of a tuned threshold."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from calibration.chatter_cuts import CutScores
from calibration.plans.threshold import ThresholdPlan, named
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, two_panels
from procmodel.chatter import CHATTER, MARGINAL, STABLE

_COLOURS = {STABLE: BLUE, MARGINAL: GREEN, CHATTER: ORANGE}
_ORDER = (STABLE, MARGINAL, CHATTER)
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
_NOTHING = NullFormatter()


def draw_threshold(plan: ThresholdPlan, cuts: list[CutScores]) -> Figure:
    """Scores of every cut with the threshold and its interval, and P(chatter | D).

    Parameters
    ----------
    plan : ThresholdPlan
        The threshold.
    cuts : list of CutScores
        Cuts to show.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure, (upper, lower) = two_panels()
    rows = sorted(cuts, key=lambda c: (_ORDER.index(c.label), float(np.median(c.scores))))
    rng = np.random.default_rng(0)
    shown = set[str]()
    for row, cut in enumerate(rows):
        scores = np.maximum(cut.scores, 0.1)
        jitter = row + 0.28 * rng.uniform(-1.0, 1.0, len(scores))
        label = None if cut.label in shown else cut.label
        shown.add(cut.label)
        colour = _COLOURS[cut.label]
        upper.plot(scores, jitter, ".", color=colour, ms=5, alpha=0.5, mew=0, label=label)
        upper.plot(np.median(scores), row, "|", color=colour, ms=9, mew=1.6)
    low, high = plan.threshold.interval90
    for axes in (upper, lower):
        axes.axvspan(max(low, 0.1), max(high, 0.1), color=GREY, alpha=0.18, lw=0)
        axes.axvline(plan.threshold.value, color=GREY, lw=1.2)
        axes.set_xscale("log")
    title = f"Threshold {plan.threshold.value:.4g}, {named(plan.tool)}"
    upper.set_title(title, fontsize=10, loc="left")
    upper.set_ylabel("cut")
    upper.set_ylim(len(rows) - 0.4, -0.6)
    upper.set_yticks([])
    upper.tick_params(which="both", labelbottom=False)
    legend = upper.legend(
        frameon=False,
        fontsize=9,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        handletextpad=0.1,
        markerscale=1.8,
        columnspacing=1.0,
    )
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)
    along = np.geomspace(*upper.get_xlim(), 400)
    lower.plot(along, plan.choice.chatter_probability(along), color=ORANGE, lw=1.6)
    lower.axhline(plan.costs.probability, color=GREY, lw=0.8, ls=":")
    lower.set_ylim(0.0, 1.0)
    lower.set_ylabel("P(chatter | score)")
    lower.set_xlabel("score D")
    lower.set_xlim(*upper.get_xlim())
    for axis in (lower.xaxis, upper.xaxis):
        axis.set_major_formatter(_PLAIN)
        axis.set_minor_formatter(_PLAIN if np.ptp(np.log10(upper.get_xlim())) < 1.5 else _NOTHING)
    return figure
