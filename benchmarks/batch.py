"""A thousand fits of different noise, one after the other."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks import measure
from benchmarks.cases import depths_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes


def run(section: Section, sizes: Sizes) -> None:
    case = depths_case()
    readings = [case.readings(1000 + i) for i in range(sizes.batch)]
    fitters = case.fitters()

    def loop(fitter: Callable[[np.ndarray], Any]) -> list[Any]:
        return [fitter(y) for y in readings]

    calls = {name: partial(loop, fitter) for name, fitter in fitters.items()}
    turns = measure.interleaved(calls, sizes.batch_repeats)
    seconds, outcomes = turns.seconds, turns.outcomes
    values = {name: np.array([case.estimate(o).values for o in outcomes[name]]) for name in calls}
    failed = sum(not outcome.converged for outcome in outcomes["ours"])
    section.text(
        f"{sizes.batch} data sets of the first problem above ({case.title}), a plain loop over "
        "the single fit for everyone, compiled before the loop. "
        f"{failed} of ours did not converge."
    )
    section.table(
        ["contestant", "time of all", "fits per second", "time / ours", "greatest difference"],
        [
            [
                name,
                measure.time_spread(seconds[name]),
                f"{sizes.batch / float(np.median(seconds[name])):.0f}",
                measure.ratio(seconds[name], seconds["ours"]),
                "" if name == "ours" else f"{_worst(values[name], values['ours']):.1e}",
            ]
            for name in fitters
        ],
    )
    section.target("fits of the thousand that converge", "all", f"all but {failed}", failed == 0)


def _worst(theirs: np.ndarray, ours: np.ndarray) -> float:
    return float(np.max(np.abs(theirs / ours - 1.0)))
