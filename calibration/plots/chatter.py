"""Pictures of a detection: score and states, spectrogram with its masks, loudness by state."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch

from calibration.chatter_detection import RecordDetection
from calibration.chatter_tally import NOT_SCORED
from calibration.chatter_trace import Trace
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain
from procmodel.chatter import AIR, CHATTER, CUTTING, ENTRY, EXIT, MARGINAL, STABLE, Detector

_YELLOW = "#E69F00"
# Colour and strength of the shade behind each state.
_SHADES = {
    ENTRY: (GREY, 0.18),
    CUTTING: (GREY, 0.18),
    EXIT: (GREY, 0.18),
    STABLE: (GREEN, 0.18),
    MARGINAL: (_YELLOW, 0.3),
    CHATTER: (ORANGE, 0.3),
    NOT_SCORED: ("black", 0.25),
}
_LOWEST_SCORE = 0.1
_MOST_EVENTS, _MOST_SHADED = 200, 40
# From here on the loudest state leaves nothing to be seen of the others.
_MOST_APART = 30.0


def draw_detection(
    found: RecordDetection,
    trace: Trace,
    units: Sequence[str],
    interval: tuple[float, float] | None = None,
) -> Figure:
    """Score over time, spectrogram, and how loud each state is.

    Parameters
    ----------
    found : RecordDetection
        From `calibration.chatter_detection.detect_record`.
    trace : Trace
        That it filled.
    units : sequence of str
        Unit of each channel.
    interval : tuple of float, optional
        Of the threshold.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = Figure(figsize=(9.0, 8.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(1.5, 1.6, 0.9), width_ratios=(60, 1))
    score = figure.add_subplot(grid[0, 0])
    spectrum = figure.add_subplot(grid[1, 0], sharex=score)
    loud = figure.add_subplot(grid[2, 0])
    _draw_score(score, found, trace, interval)
    image = _draw_spectrogram(spectrum, found, trace)
    figure.colorbar(image, cax=figure.add_subplot(grid[1, 1]), label="over air cutting [dB]")
    channel = found.tally.channel
    _draw_loudness(loud, trace, channel, found.detector.channels[channel], units[channel])
    return figure


def _draw_score(
    axes: Axes, found: RecordDetection, trace: Trace, interval: tuple[float, float] | None
) -> None:
    plain(axes)
    ends, threshold = trace.ends, found.detector.settings.threshold
    score = np.maximum(trace.score, _LOWEST_SCORE)
    row = 0
    for state, same in groupby(trace.state):
        begin, row = row, row + len(list(same))
        if state in _SHADES:
            colour, strength = _SHADES[state]
            axes.axvspan(ends[begin], ends[row], color=colour, alpha=strength, lw=0, zorder=0)
    axes.step(ends, np.append(score, score[-1:]), where="post", color=BLUE, lw=1.0)
    axes.axhline(threshold, color=GREY, lw=1.0, ls="--")
    if interval is not None:
        axes.axhspan(*interval, color=GREY, alpha=0.25, lw=0, zorder=0.5)
    for event in found.events[:_MOST_EVENTS]:
        colour = ORANGE if event.state == CHATTER else _YELLOW
        axes.plot(
            [event.time_s], [1.0], "v", color=colour, ms=7, clip_on=False, mec="white", mew=0.6,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xlim(ends[0], ends[-1])
    axes.set_ylabel("score")
    axes.tick_params(labelbottom=False)
    axes.set_title(found.tally.status, fontsize=10, loc="left", pad=24)
    handles = [
        axes.lines[0],
        axes.lines[1],
        *(
            Patch(facecolor=_SHADES[s][0], alpha=_SHADES[s][1], label=s)
            for s in (STABLE, MARGINAL, CHATTER, NOT_SCORED)
            if s in set(trace.state)
        ),
    ]
    handles[0].set_label("score")
    also = "" if interval is None else f", 90 %: {interval[0]:.4g} to {interval[1]:.4g}"
    handles[1].set_label(f"threshold {threshold:g}{also}")
    axes.legend(
        handles=handles, frameon=False, fontsize=8, ncols=6, loc="lower left",
        bbox_to_anchor=(-0.01, 1.02), borderaxespad=0.0,
    )  # fmt: skip


def _draw_spectrogram(axes: Axes, found: RecordDetection, trace: Trace) -> AxesImage:
    detector, lines = found.detector, trace.frequencies
    over = 10.0 * np.log10(np.maximum(trace.over_air, 1e-3))
    half = 0.5 * (lines[1] - lines[0]) if len(lines) > 1 else 0.5
    ends = trace.ends
    # The last row may be of fewer windows than the picture gives it.
    last = ends[0] + len(over) * (ends[1] - ends[0])
    top = max(20.0, float(np.percentile(over, 99.8)))
    image = axes.imshow(
        over.T, origin="lower", aspect="auto", cmap="viridis", vmin=0.0, vmax=top,
        extent=(ends[0], last, lines[0] - half, lines[-1] + half), interpolation="nearest",
    )  # fmt: skip
    left_out = _left_out(detector)
    for low, high in left_out:
        # Beside the picture, as so many lines would hide it.
        axes.axhspan(low, high, 1.004, 1.018, color="black", lw=0, clip_on=False)
        if len(left_out) <= _MOST_SHADED:
            axes.axhspan(low, high, color="white", alpha=0.25, lw=0)
    for event in found.events[:_MOST_EVENTS]:
        axes.plot([event.time_s], [event.frequency_hz], "o", mfc="none", mec=ORANGE, ms=7, mew=1.4)
    axes.set_xlim(ends[0], ends[-1])
    axes.set_ylim(lines[0] - half, lines[-1] + half)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("frequency [Hz]")
    turning = detector.rotation.frequency
    said = f"black, at the side: left out (multiples of {turning:.2f} Hz and listed lines)"
    axes.set_title(f"{said}; rings: events", fontsize=8, loc="left")
    return image


def _left_out(detector: Detector) -> list[tuple[float, float]]:
    """Stretches of frequency inside the band that are not searched [Hz]."""
    windowing, scorer = detector.settings.windowing, detector.scorer
    free = detector.free[scorer.low : scorer.low + scorer.bins]
    stretches, bin = [], scorer.low
    for searched, same in groupby(free.tolist()):
        begin, bin = bin, bin + len(list(same))
        if not searched:
            low, high = (begin - 0.5), (bin - 0.5)
            stretches.append((low * windowing.resolution, high * windowing.resolution))
    return stretches


def _draw_loudness(axes: Axes, trace: Trace, channel: int, name: str, unit: str) -> None:
    plain(axes)
    loudness = trace.loudness()
    shown = [s for s in (AIR, ENTRY, STABLE, MARGINAL, CHATTER, EXIT, NOT_SCORED) if s in loudness]
    rows = np.arange(len(shown))
    heights = [float(loudness[s][2][channel]) for s in shown]
    squares = [float(loudness[s][1][channel]) for s in shown]
    colours = [_SHADES.get(s, (BLUE, 0.5)) for s in shown]
    for row, height, (colour, _) in zip(rows, heights, colours, strict=True):
        axes.barh(row, height, color=colour, alpha=0.55, height=0.66)
    axes.plot(squares, rows, "|", color="black", ms=13, mew=1.6, label="root mean square (as Rq)")
    for row, state, height in zip(rows, shown, heights, strict=True):
        count = loudness[state][0]
        text = f" {height:.4g}, {count} window{'' if count == 1 else 's'}"
        axes.text(height, float(row), text, va="center", fontsize=8)
    axes.set_yticks(rows, shown)
    axes.invert_yaxis()
    if min(squares) > 0.0 and max(heights) > _MOST_APART * min(heights):
        axes.set_xscale("log")
        axes.set_xlim(0.5 * min(squares), 8.0 * max(heights))
    else:
        axes.set_xlim(0.0, 1.25 * max([*heights, 1e-300]))
    said = "" if unit == "1" else f" [{unit}]"
    axes.set_xlabel(f"{name}{said}: from peak to valley, mean over windows (as Rz)")
    axes.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.96))
    axes.grid(visible=False, axis="y")
