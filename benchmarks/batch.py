"""A thousand fits of different noise, one after the other."""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import measure
from benchmarks.cases import Case, depths_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes


def run(section: Section, sizes: Sizes) -> None:
    case = depths_case()
    readings = [case.readings(1000 + i) for i in range(sizes.batch)]
    fitters = case.fitters()
    values = {name: _values(case, fitter, readings) for name, fitter in fitters.items()}
    calls = {name: _loop(fitter, readings) for name, fitter in fitters.items()}
    seconds = measure.interleaved(calls, sizes.batch_repeats)
    section.text(
        f"{sizes.batch} data sets of the first problem above ({case.title}), a plain loop over "
        "the single fit for everyone. Compiled once, before the loop."
    )
    section.table(
        ["contestant", "time of all", "fits per second", "time / ours", "greatest difference"],
        [
            [
                name,
                measure.time_spread(seconds[name]),
                f"{sizes.batch / float(np.median(seconds[name])):.0f}",
                measure.spread(seconds[name] / seconds["ours"]),
                "" if name == "ours" else f"{_worst(values[name], values['ours']):.1e}",
            ]
            for name in fitters
        ],
    )


def _values(case: Case, fitter: Callable[[np.ndarray], Any], readings: list) -> np.ndarray:
    return np.array([case.estimate(fitter(y)).values for y in readings])


def _loop(fitter: Callable[[np.ndarray], Any], readings: list) -> Callable[[], None]:
    def loop() -> None:
        for y in readings:
            fitter(y)

    return loop


def _worst(theirs: np.ndarray, ours: np.ndarray) -> float:
    return float(np.max(np.abs(theirs / ours - 1.0)))
