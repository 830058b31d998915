"""Drawing of the results; nothing is computed here."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plans.avoidance import Run
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain, save
from experiments.nishikawa_chatter_avoidance.conditions import (
    BAND,
    LENGTH,
    RATE,
    SENSORS,
    Paper,
)
from experiments.nishikawa_chatter_avoidance.recording import THRESHOLD, Recording
from experiments.nishikawa_chatter_avoidance.run import Results
from experiments.nishikawa_chatter_avoidance.slopes import Slopes
from experiments.nishikawa_chatter_avoidance.study import HOLD, Study
from experiments.nishikawa_chatter_avoidance.sweep import Sweep
from procmodel.chatter import CHATTER

_PAPER = Paper()
_NAMES = {"displacement": "holder displacement", "acceleration": "head acceleration"}
_UNITS = {"displacement": "µm²", "acceleration": "(m/s²)²"}


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write every picture into the folder; returns their paths."""
    pictures: dict[str, Callable[[Results], Figure]] = {
        "distance_by_speed.png": distance_by_speed,
        "spectra.png": spectra,
        "slopes.png": slopes,
        "policies.png": policies,
        "overview.png": overview,
    }
    if results.recording is not None:
        pictures["measured_cut.png"] = measured_cut
    for name, draw in pictures.items():
        save(draw(results), folder / name)
    return [folder / name for name in pictures]


def distance_by_speed(results: Results) -> Figure:
    """Distance of both sensors at all speeds, with the paper's extremes."""
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for i, each in enumerate(axes):
        _distance_panel(each, results.sweep, i)
    axes[0].legend(frameon=False, fontsize=9, loc="upper left")
    axes[1].set_ylabel("")
    return figure


def _distance_panel(axes: Axes, sweep: Sweep, sensor: int) -> None:
    plain(axes)
    bad = sweep.chatters
    for of, colour, name in ((~bad, BLUE, "no chatter"), (bad, ORANGE, "chatter")):
        axes.errorbar(
            sweep.speeds[of] / 1000.0, sweep.distance[of, sensor],
            _bars(sweep, of, sensor), fmt="o", color=colour, ms=6, lw=1.2, capsize=2,
            label=f"simulated, {name}",
        )  # fmt: skip
    marks = (
        (_PAPER.worst_good_at, _PAPER.worst_good, BLUE, "paper, largest without chatter"),
        (_PAPER.least_bad_at, _PAPER.least_bad, ORANGE, "paper, least under chatter"),
    )
    for speed, value, colour, name in marks:
        axes.plot(
            speed[sensor] / 1000.0, value[sensor], "s", mfc="none", mec=colour, mew=1.8, ms=9,
            label=name,
        )  # fmt: skip
    name = _NAMES[SENSORS[sensor]]
    axes.set_title(
        f"{name}: ratio {sweep.ratio[sensor]:.2f}, paper {_PAPER.ratio[sensor]:.2f}",
        fontsize=10, loc="left",
    )  # fmt: skip
    axes.set(
        yscale="log",
        xlabel="spindle speed [1000/min]",
        ylabel="mean of the windows' largest distance",
        xticks=range(6, 29, 2),
    )


def _bars(sweep: Sweep, of: np.ndarray, sensor: int) -> np.ndarray:
    """Standard deviation over repetitions, kept above the axis."""
    spread, at = sweep.spread[of, sensor], sweep.distance[of, sensor]
    return np.stack([np.minimum(spread, 0.6 * at), spread])


def spectra(results: Results) -> Figure:
    """Spectra in air and in the cut at 18000 1/min, and their distance."""
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    sweep = results.sweep
    frequencies = np.arange(LENGTH // 2 + 1) * RATE / LENGTH
    band = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    rotation = 18000.0 / 60.0
    order = np.round(frequencies / rotation)
    forced = np.abs(frequencies - order * rotation) <= 2.0 * RATE / LENGTH
    for i, sensor in enumerate(SENSORS):
        upper, lower = axes[:, i]
        plain(upper)
        plain(lower)
        air, cut = sweep.spectra[i]
        khz = frequencies / 1000.0
        upper.semilogy(khz[band], cut[band], color=ORANGE, lw=0.9, label="cutting")
        upper.semilogy(khz[band], air[band], color=GREY, lw=0.9, label="air")
        upper.set(ylabel=f"power [{_UNITS[sensor]}]")
        upper.set_title(f"{_NAMES[sensor]}, 18000 1/min", fontsize=10, loc="left")
        # Of noise the deviation of a power is as large as its mean.
        over = np.where(cut > 1.1 * air, cut / air - 1.0, np.nan)
        free = band & ~forced
        on = band & forced
        lower.semilogy(khz[free], over[free], ".", color=BLUE, ms=3, label="searched")
        lower.semilogy(khz[on], over[on], ".", color="0.75", ms=3, label="forced, left out")
        at = int(np.nanargmax(np.where(free, over, np.nan)))
        lower.annotate(
            f"{frequencies[at]:.0f} Hz", (khz[at], over[at]), (8, -3),
            textcoords="offset points", fontsize=9,
        )  # fmt: skip
        lower.set(xlabel="frequency [kHz]", ylabel="power over air less 1")
    axes[0, 0].legend(frameon=False, fontsize=9)
    axes[1, 0].legend(frameon=False, fontsize=9)
    return figure


def slopes(results: Results) -> Figure:
    """Speed and distance over time on both slopes, with and without the loop."""
    found = results.slopes
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    axes = figure.subplots(2, len(found.on), sharex="col", squeeze=False)
    for column, slope in enumerate(found.on):
        _speed_panel(axes[0, column], found, slope)
        _score_panel(axes[1, column], found, slope)
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].legend(frameon=False, fontsize=9)
    axes[1, 0].legend(frameon=False, fontsize=9, loc="upper right")
    return figure


def _speed_panel(axes: Axes, found: Slopes, slope: int) -> None:
    plain(axes)
    for run, colour, name in _pair(found, slope):
        axes.plot(run.time, 0.06 * run.rotation, color=colour, lw=1.8, label=name)
    wanted = dict(_PAPER.reached)[slope]
    axes.axhline(wanted / 1000.0, color=GREY, lw=1.0, ls="--", label="paper, settled")
    axes.set(ylabel="spindle speed [1000/min]", ylim=(6.5, 16.0))
    axes.set_title(f"slope of {slope}°", fontsize=10, loc="left")


def _score_panel(axes: Axes, found: Slopes, slope: int) -> None:
    plain(axes)
    for run, colour, name in _pair(found, slope):
        rows = [r for r in run.log if np.isfinite(r.score)]
        axes.plot([r.time for r in rows], [r.score for r in rows], ".-", color=colour, label=name)
    axes.axhline(100.0, color="black", lw=0.9, ls=":", label="threshold")
    axes.set(yscale="log", ylabel="distance")


def _pair(found: Slopes, slope: int) -> tuple[tuple[Run, str, str], ...]:
    return (
        (found.off[slope], ORANGE, "without the loop"),
        (found.on[slope], BLUE, "with the loop"),
    )


def policies(results: Results) -> Figure:
    """Energy and time of every cut that chatters, against no loop; and the means."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.subplots()
    _policies_panel(axes, results.study)
    axes.legend(frameon=False, fontsize=9)
    return figure


def _policies_panel(axes: Axes, study: Study) -> None:
    plain(axes)
    colours = (ORANGE, BLUE, GREEN)
    bad = study.chattering
    names = [name for name in study.runs if name != HOLD]
    for name, colour in zip(names, colours, strict=True):
        less = np.log10(study.energy(name)[bad] / study.energy(HOLD)[bad])
        lost = study.lost(name)[bad]
        axes.plot(lost, less, "o", color=colour, ms=4, alpha=0.45)
        energy, time = study.against(name, HOLD, chattering=True)
        axes.errorbar(
            time.mean, energy.mean,
            [[energy.mean - energy.interval90[0]], [energy.interval90[1] - energy.mean]],
            [[time.mean - time.interval90[0]], [time.interval90[1] - time.mean]],
            fmt="D", color=colour, mec="white", ms=10, lw=2.0, capsize=3, label=name,
        )  # fmt: skip
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.axvline(0.0, color=GREY, lw=0.8)
    axes.set(
        xlabel="time lost in a cut of 2 s [s]",
        ylabel="log10 of chatter energy over that without a loop",
    )
    axes.set_title(
        f"{int(bad.sum())} simulated cuts that chatter: each, and means with 90 % intervals",
        fontsize=10, loc="left",
    )  # fmt: skip


def measured_cut(results: Results) -> Figure:
    """Score of the measured cut over time."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    if results.recording is not None:
        _recording_panel(figure.subplots(), results.recording)
    return figure


def _recording_panel(axes: Axes, found: Recording) -> None:
    plain(axes)
    time = [o.time for o in found.observations]
    axes.semilogy(time, [max(o.score, 0.1) for o in found.observations], ".-", color=BLUE)
    axes.axhline(THRESHOLD, color="black", lw=0.9, ls=":")
    chatter = [e for e in found.events if e.state == CHATTER]
    for event in chatter[:1]:
        axes.axvline(event.time_s, color=ORANGE, lw=1.4)
        axes.annotate(
            f"chatter, {event.time_s:.2f} s\n{event.frequency_hz:.0f} Hz",
            (event.time_s, 1.0), (-6, -6), xycoords=("data", "axes fraction"),
            textcoords="offset points", fontsize=9, va="top", ha="right", color=ORANGE,
        )  # fmt: skip
    axes.set(xlabel="time [s]", ylabel="distance")
    axes.set_title("measured slot cut, 5000 1/min", fontsize=10, loc="left")


def overview(results: Results) -> Figure:
    """Distance by speed, the loop on the steep slope, policies, the measured cut."""
    figure = Figure(figsize=(12.0, 8.6), layout="constrained")
    axes = figure.subplots(2, 3, width_ratios=(1.15, 1.0, 1.0))
    for i in range(2):
        _distance_panel(axes[i, 0], results.sweep, i)
    axes[0, 0].legend(frameon=False, fontsize=8, loc="upper left")
    slope = next(iter(results.slopes.on))
    _speed_panel(axes[0, 1], results.slopes, slope)
    axes[0, 1].legend(frameon=False, fontsize=8)
    _score_panel(axes[1, 1], results.slopes, slope)
    axes[1, 1].set_xlabel("time [s]")
    axes[0, 1].set_xlim(axes[1, 1].get_xlim())
    _policies_panel(axes[0, 2], results.study)
    axes[0, 2].set_title("cuts that chatter: each, and means", fontsize=10, loc="left")
    axes[0, 2].legend(frameon=False, fontsize=8)
    if results.recording is None:
        axes[1, 2].set_axis_off()
        axes[1, 2].text(0.5, 0.5, "no measured cut here", ha="center", color=GREY)
    else:
        _recording_panel(axes[1, 2], results.recording)
    return figure
