"""One fit: time and result of ours beside curve_fit and lmfit."""

from functools import partial

import numpy as np

from benchmarks import measure
from benchmarks.cases import Case, depths_case, full_case, wall_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes

AGREEMENT = 1e-6
SEED = 1


def run(section: Section, sizes: Sizes) -> None:
    section.text(
        "Square cavity with a half width of 250 µm, 100 layers fed and stepped by 2 µm, wear ratio "
        "0.3, round electrode of 100 µm diameter, noise of 1 µm that no contestant is told. "
        "The same start and bounds for all; scipy and lmfit get a NumPy model and no Jacobian. "
        "Ours includes making the Problem. A difference is relative to ours, in units of the value."
    )
    for case in (depths_case(), wall_case(), full_case()):
        _compare(section, case, sizes.fit_repeats)


def _compare(section: Section, case: Case, repeats: int) -> None:
    case.require_same_model()
    y = case.readings(SEED)
    fitters = case.fitters()
    first, _ = measure.first_call(lambda: fitters["ours"](y))
    turns = measure.interleaved({name: partial(f, y) for name, f in fitters.items()}, repeats)
    seconds = turns.seconds
    outcomes = {name: case.estimate(outcome) for name, outcome in turns.outcomes.items()}
    ours = outcomes["ours"]
    best = min(case.misfit(e.values, y) for e in outcomes.values())

    section.heading(case.title[0].upper() + case.title[1:])
    rows = []
    for name, estimate in outcomes.items():
        difference = float(np.max(np.abs(estimate.values / ours.values - 1.0)))
        rows.append(
            [
                name,
                measure.time_spread(seconds[name]),
                measure.ratio(seconds[name], seconds["ours"]),
                f"{estimate.values[0]:.9f} ± {estimate.stds[0]:.6f}",
                "" if name == "ours" else f"{difference:.1e}",
                f"{case.misfit(estimate.values, y) / best - 1.0:.1e}",
            ]
        )
        if name != "ours":
            section.target(
                f"{case.title}: values beside {name}",
                f"relative difference of at most {AGREEMENT:g}",
                _difference(case, difference, estimate.values, ours.values, y),
                difference <= AGREEMENT,
            )
    section.table(
        [
            "contestant",
            "time of one fit",
            "time / ours",
            "wear ratio",
            "greatest difference of any value",
            "squared misfit above the best",
        ],
        rows,
    )
    section.text(f"First call of ours, nothing compiled: {first:.2f} s.")


def _difference(
    case: Case, difference: float, theirs: np.ndarray, ours: np.ndarray, y: np.ndarray
) -> str:
    """The difference; where it is too great, whose optimum is the better one."""
    if difference <= AGREEMENT:
        return f"{difference:.1e}"
    excess = case.misfit(theirs, y) / case.misfit(ours, y) - 1.0
    nearer = "ours" if excess > 0 else "theirs"
    return f"{difference:.1e}, the misfit of {nearer} is lower by a share of {abs(excess):.1e}"
