"""How the time of a fit grows with readings and with layers."""

import itertools
from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks import measure
from benchmarks.cases import Case, wall_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes

# Room for the scatter of the clock on a growth that is exactly linear.
SLACK = 1.1
CAVITY_DEPTH = 200.0


def run(section: Section, sizes: Sizes) -> None:
    section.text(
        "Wear ratio and gap from one wall. Growth is the time over that of "
        "the same contestant with fewer."
    )
    cases = {count: wall_case(readings=count) for count in sizes.readings}
    _grow(section, "readings", cases, sizes.growth_repeats, "100 layers")
    readings = sizes.readings[1]
    cases = {
        count: wall_case(readings, layers=count, step=CAVITY_DEPTH / count)
        for count in sizes.layers
    }
    _grow(section, "layers", cases, sizes.growth_repeats, f"{readings} readings")


def _grow(section: Section, what: str, cases: dict[int, Case], repeats: int, beside: str) -> None:
    calls = {}
    for count, case in cases.items():
        case.require_same_model()
        y = case.readings(1)
        for name, fitter in case.fitters().items():
            calls[count, name] = partial(fitter, y)
    seconds = measure.interleaved(calls, repeats).seconds
    rows = []
    for count, name in calls:
        before = _before(list(cases), count)
        times = seconds[count, name]
        rows.append(
            [
                f"{count}",
                name,
                measure.time_spread(times),
                measure.ratio(times, seconds[count, "ours"]),
                "" if before is None else measure.ratio(times, seconds[before, name]),
            ]
        )
    section.heading(f"{what.capitalize()}, {beside}")
    section.table([what, "contestant", "time", "time / ours", "growth"], rows)
    for small, large in itertools.pairwise(cases):
        growth = float(np.median(seconds[large, "ours"] / seconds[small, "ours"]))
        section.target(
            f"time of one fit, {small} to {large} {what}",
            f"at most {large / small:g} times, linear",
            f"{growth:.2g} times",
            growth <= SLACK * large / small,
        )


def _before(counts: Sequence[int], count: int) -> int | None:
    index = counts.index(count)
    return counts[index - 1] if index else None
