"""How often the 95 % interval of the wear ratio holds the true one."""

import math

import numpy as np

from benchmarks.cases import Case, depths_case, wall_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes

WANTED, ALLOWED = 0.95, 0.02


def run(section: Section, sizes: Sizes) -> None:
    section.text(
        f"{sizes.cavities} simulated cavities with a fixed seed, noise of 1 µm unknown to the fit. "
        "curve_fit's interval is the value ± 1.96 of its standard deviations."
    )
    for case in (depths_case(), wall_case()):
        _cover(section, case, sizes.cavities)


def _cover(section: Section, case: Case, cavities: int) -> None:
    fitters = case.fitters()
    ours, theirs = [], []
    for i in range(cavities):
        y = case.readings(100_000 + i)
        estimate = fitters["ours"](y).parameters["wear_ratio"]
        low, high = estimate.interval95 or (math.nan, math.nan)
        ours.append((estimate.value, estimate.std or math.nan, low, high))
        found = fitters["curve_fit"](y)
        value, std = found.values[0], found.stds[0]
        theirs.append((value, std, value - 1.96 * std, value + 1.96 * std))
    rows = []
    true = case.true[0]
    for name, results in (("ours", ours), ("curve_fit", theirs)):
        value, std, low, high = np.array(results).T
        covered = float(np.mean((low <= true) & (true <= high)))
        error = math.sqrt(covered * (1.0 - covered) / cavities)
        scatter = float(np.std(value, ddof=1))
        shift = (float(np.mean(value)) - true) / (scatter / math.sqrt(cavities))
        rows.append(
            [
                name,
                f"{100 * covered:.1f} % ± {100 * error:.1f} %",
                f"{float(np.mean(std)) / scatter:.3f} ± {1 / math.sqrt(2 * cavities):.3f}",
                f"{shift:+.1f}",
                f"{int(np.sum(~np.isfinite(std)))}",
            ]
        )
        if name == "ours":
            section.target(
                f"coverage of the 95 % interval, {case.title}",
                f"{100 * WANTED:.0f} ± {100 * ALLOWED:.0f} %",
                f"{100 * covered:.1f} %",
                abs(covered - WANTED) <= ALLOWED,
            )
    section.heading(case.title[0].upper() + case.title[1:])
    section.table(
        [
            "contestant",
            "covered",
            "mean std / true scatter",
            "mean error / its standard error",
            "without std",
        ],
        rows,
    )
