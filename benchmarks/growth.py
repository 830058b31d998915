"""How the time of a fit grows with readings and with layers."""

import itertools
from collections.abc import Sequence

import numpy as np

from benchmarks import measure
from benchmarks.cases import Case, wall_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes

# Room for the scatter of the clock on a growth that is exactly linear.
SLACK = 1.1
CAVITY_DEPTH = 200.0


def run(section: Section, sizes: Sizes) -> None:
    section.text("Wear ratio and gap from one wall. Growth is the time over that of the row above.")
    cases = {count: wall_case(readings=count) for count in sizes.readings}
    _grow(section, "readings", cases, sizes.growth_repeats, "100 layers")
    readings = sizes.readings[1]
    cases = {
        count: wall_case(readings, layers=count, step=CAVITY_DEPTH / count) for count in sizes.layers
    }
    _grow(section, "layers", cases, sizes.growth_repeats, f"{readings} readings")


def _grow(
    section: Section, what: str, cases: dict[int, Case], repeats: int, beside: str
) -> None:
    rows: list[list[str]] = []
    seconds: dict[int, dict[str, np.ndarray]] = {}
    for count, case in cases.items():
        case.require_same_model()
        y, fitters = case.readings(1), case.fitters()
        first = measure.first_call(lambda fitters=fitters, y=y: fitters["ours"](y))
        calls = {name: (lambda f=fitter, y=y: f(y)) for name, fitter in fitters.items()}
        seconds[count] = measure.interleaved(calls, repeats)
        before = _before(list(cases), count)
        for name, times in seconds[count].items():
            rows.append(
                [
                    f"{count}",
                    name,
                    measure.time_spread(times),
                    measure.spread(times / seconds[count]["ours"]),
                    "" if before is None else measure.spread(times / seconds[before][name]),
                    f"{first:.2f} s" if name == "ours" else "",
                ]
            )
    section.heading(f"{what.capitalize()}, {beside}")
    section.table([what, "contestant", "time", "time / ours", "growth", "first call"], rows)
    for small, large in itertools.pairwise(cases):
        growth = float(np.median(seconds[large]["ours"]) / np.median(seconds[small]["ours"]))
        section.target(
            f"time of one fit, {small} to {large} {what}",
            f"at most {large / small:g} times, linear",
            f"{growth:.2g} times",
            growth <= SLACK * large / small,
        )


def _before(counts: Sequence[int], count: int) -> int | None:
    index = counts.index(count)
    return counts[index - 1] if index else None
