"""Pictures of the discharge gap: what is known of it, and the sizes that it lets expect."""

import numpy as np
from matplotlib.figure import Figure

from calibration.electrode import GapData
from calibration.electrode_gap import GapPosterior
from calibration.plans.electrode import SizePrediction
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain

_LEVELS = (0.5, 0.9)


def draw_gap(data: GapData, posterior: GapPosterior, level: float = 0.9) -> Figure:
    """Readings with the next gap to expect, and the posterior of mean and spread.

    Parameters
    ----------
    data : GapData
        The readings.
    posterior : GapPosterior
        What they tell.
    level : float
        Probability inside the band of the next gap.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    plain(left)
    plain(right)
    number = np.arange(1, len(data) + 1)
    ahead = posterior.next_gap()
    low, high = ahead.interval(level)
    left.axhspan(low, high, color=BLUE, alpha=0.15, lw=0, label=f"next gap, {100 * level:.3g} %")
    mean_low, mean_high = posterior.mean.interval(level)
    left.axhspan(
        mean_low, mean_high, color=BLUE, alpha=0.35, lw=0, label=f"mean gap, {100 * level:.3g} %"
    )
    left.errorbar(
        number, data.gap, 2.0 * data.sigma, fmt="o", color=ORANGE, ms=4, lw=1, label="read, ±2σ"
    )
    left.set_xlabel("reading")
    left.set_ylabel("gap [µm]")
    left.legend(frameon=False, fontsize=9)
    spread_low, spread_high = posterior.spread_quantile([0.0005, 0.9995])
    near, far = posterior.mean.interval(0.999)
    chosen = (posterior.spread >= spread_low) & (posterior.spread <= spread_high)
    mean = np.linspace(near, far, 160)
    z = (mean[:, None] - posterior.centre[chosen]) / posterior.std[chosen]
    # The row is even in the log of the spread; per um of spread it thins out.
    density = posterior.weight[chosen] / posterior.spread[chosen]
    density = density * np.exp(-0.5 * z**2) / posterior.std[chosen]
    levels = np.linspace(0.05, 1.0, 12) * np.max(density)
    right.contourf(mean, posterior.spread[chosen], density.T, levels, cmap="Blues", vmin=0.0)
    right.set_xlabel("mean of the gap [µm]")
    right.set_ylabel("spread of the gap [µm]")
    right.set_title(f"posterior of {posterior.readings} readings", fontsize=10, loc="left")
    return figure


def draw_sizes(prediction: SizePrediction) -> Figure:
    """Sizes to expect beside those of the drawing, as differences.

    Parameters
    ----------
    prediction : SizePrediction
        From `calibration.plans.electrode`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    axes = figure.subplots()
    plain(axes)
    reference = prediction.size if prediction.wanted is None else prediction.wanted
    place = np.arange(len(reference))
    spread = prediction.interval - reference[:, None]
    axes.vlines(
        place,
        spread[:, 0],
        spread[:, 1],
        color=BLUE,
        lw=6,
        alpha=0.5,
        label=f"{100 * prediction.level:.3g} % of electrodes",
    )
    axes.plot(place, prediction.size - reference, "o", color=BLUE, label="expected")
    if prediction.wanted is not None and prediction.tolerance is not None:
        allowed = prediction.tolerance * prediction.wanted
        half = 0.25
        for sign in (-1.0, 1.0):
            axes.hlines(
                sign * allowed,
                place - half,
                place + half,
                color=GREEN,
                lw=1.5,
                label=f"±{100 * prediction.tolerance:.3g} %" if sign > 0 else "_",
            )
    axes.axhline(0.0, color=GREY, lw=0.8, zorder=0)
    axes.set_xticks(place, [f"{size:.4g}" for size in reference])
    axes.set_xlim(-0.6, len(reference) - 0.4)
    named = "expected" if prediction.wanted is None else "wanted"
    axes.set_xlabel(f"{named} size [µm]")
    axes.set_ylabel(f"size − {named} [µm]")
    axes.legend(frameon=False, fontsize=9)
    return figure
