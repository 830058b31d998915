"""Interpolated paths: ours beside plain NumPy and a loop over the points, and their memory."""

import math
import tracemalloc
from collections.abc import Callable

import numpy as np

from benchmarks import measure
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from procmodel.electrode import interpolate_arc, interpolate_line

STEP, RESOLUTION = 0.3, 0.1
START = (1.0, 2.0, 3.0)
DIRECTION = (2.0 / 3.0, 2.0 / 3.0, 1.0 / 3.0)
CENTRE, SWEEP = (1.0, 2.0), 5.0
# A position next to the middle of two grid lines may be rounded to either.
AGREEMENT = 1e-9
NUMPY_WANTED, LOOP_WANTED = 3.0, 300.0


def run(section: Section, sizes: Sizes) -> None:
    count = sizes.electrode_steps
    section.text(
        f"Positions of {count:,} steps of {STEP} µm, rounded to {RESOLUTION} µm. Plain NumPy is "
        "what a user writes: all the numbers at once, broadcast, `np.round`. The loop computes "
        "and rounds one point after the other with `math`. The plain versions do not guard whole "
        "multiples and do not check what they are given."
    )
    length = (count - 0.25) * STEP
    end = tuple(s + length * d for s, d in zip(START, DIRECTION, strict=True))
    radius = length / SWEEP
    _case(
        section, sizes, "line in space",
        lambda: interpolate_line(START, end, STEP, RESOLUTION),
        lambda: numpy_line(START, end, STEP, RESOLUTION),
        lambda: loop_line(START, end, STEP, RESOLUTION),
    )  # fmt: skip
    _case(
        section, sizes, "arc",
        lambda: interpolate_arc(CENTRE, radius, 0.1, SWEEP, STEP, RESOLUTION),
        lambda: numpy_arc(CENTRE, radius, 0.1, SWEEP, STEP, RESOLUTION),
        lambda: loop_arc(CENTRE, radius, 0.1, SWEEP, STEP, RESOLUTION),
    )  # fmt: skip


def numpy_line(
    start: tuple[float, ...], end: tuple[float, ...], step: float, resolution: float
) -> np.ndarray:
    first, last = np.array(start), np.array(end)
    length = np.linalg.norm(last - first)
    way = np.minimum(np.arange(math.ceil(length / step) + 1) * step, length)
    return np.round((first + way[:, None] * (last - first) / length) / resolution) * resolution


def loop_line(
    start: tuple[float, ...], end: tuple[float, ...], step: float, resolution: float
) -> np.ndarray:
    length = math.dist(start, end)
    along = [(b - a) / length for a, b in zip(start, end, strict=True)]
    points = []
    for i in range(math.ceil(length / step) + 1):
        way = min(i * step, length)
        points.append(
            [round((a + way * u) / resolution) * resolution
             for a, u in zip(start, along, strict=True)]
        )  # fmt: skip
    return np.array(points)


def numpy_arc(
    centre: tuple[float, ...], radius: float, start: float, sweep: float, step: float,
    resolution: float,
) -> np.ndarray:  # fmt: skip
    theta = 2.0 * np.arcsin(step / (2.0 * radius))
    angle = start + np.minimum(np.arange(math.ceil(sweep / theta) + 1) * theta, sweep)
    points = np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.round(points / resolution) * resolution


def loop_arc(
    centre: tuple[float, ...], radius: float, start: float, sweep: float, step: float,
    resolution: float,
) -> np.ndarray:  # fmt: skip
    theta = 2.0 * math.asin(step / (2.0 * radius))
    points = []
    for i in range(math.ceil(sweep / theta) + 1):
        angle = start + min(i * theta, sweep)
        x, y = centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle)
        points.append((round(x / resolution) * resolution, round(y / resolution) * resolution))
    return np.array(points)


def _case(
    section: Section,
    sizes: Sizes,
    title: str,
    ours: Callable[[], np.ndarray],
    plain: Callable[[], np.ndarray],
    loop: Callable[[], np.ndarray],
) -> None:
    calls = {"ours": ours, "plain NumPy": plain, "loop over points": loop}
    memory = {name: _peak(call) for name, call in calls.items() if name != "loop over points"}
    turns = measure.interleaved(calls, sizes.electrode_repeats)
    seconds, points = turns.seconds, turns.outcomes
    section.heading(f"{title}, {len(points['ours']) - 1:,} steps")
    section.table(
        ["contestant", "time", "time / ours", "most memory", "greatest difference [µm]"],
        [
            [
                name,
                measure.time_spread(seconds[name]),
                measure.ratio(seconds[name], seconds["ours"]),
                f"{memory[name] / 2**20:.0f} MiB" if name in memory else "not traced",
                f"{_difference(points[name], points['ours']):.1e}",
            ]
            for name in calls
        ],
    )
    section.text(f"The positions themselves take {points['ours'].nbytes / 2**20:.0f} MiB.")
    for name, wanted in (("plain NumPy", NUMPY_WANTED), ("loop over points", LOOP_WANTED)):
        ratio = float(np.median(seconds[name] / seconds["ours"]))
        section.target(f"{title}, {name}", f"{wanted:g} × ours", f"{ratio:.3g} ×", ratio >= wanted)
    worst = max(_difference(points[name], points["ours"]) for name in calls)
    section.target(
        f"{title}: same positions", f"within {AGREEMENT:g} µm", f"{worst:.1e} µm",
        worst <= AGREEMENT,
    )  # fmt: skip


def _difference(these: np.ndarray, those: np.ndarray) -> float:
    """Greatest difference; of positions near the middle of two grid lines, the lesser of both."""
    if these.shape != those.shape:
        return math.inf
    off = np.abs(these - those)
    # One grid line apart is the same position before rounding, to its last digits.
    return float(np.max(np.minimum(off, np.abs(off - RESOLUTION))))


def _peak(call: Callable[[], np.ndarray]) -> int:
    """Most memory in arrays that a call holds at once [bytes]."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
