"""Run the experiment: learn a threshold, use it on cuts of the same and of other tools, compare.

What is compared with ``expected.json`` is the logarithm to base 2 of the rate of false alarms that
is seen over the one that was stated: within 1 is within a factor of two, below it the threshold
kept more than it promised.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.chatter_cuts import CutScores
from calibration.chatter_scores import fit_scores
from calibration.plans.threshold import Figure, ThresholdPlan, plan_threshold
from calibration.plans.threshold_check import Tally, tallied
from calibration.plans.threshold_cost import Costs
from experiments.chatter_thresholds import cuts
from experiments.chatter_thresholds.cuts import LEARNT, OTHERS, Generator
from experiments.comparison import Numbers, command, read_expected, table, written

HERE = Path(__file__).parent
# False alarms that are allowed, per hour of stable cutting.
ASKED = (400.0, 1600.0)
# A miss is dear, so that the rate asked for, not the cost, sets the threshold.
COSTS = Costs(miss=100.0, false_alarm=1.0, chatter_share=0.2)
PAPERS_THRESHOLD = 100.0


@dataclass(frozen=True)
class Sizes:
    """How many cuts are made, and how long they are [s]."""

    learnt: tuple[int, int, int] = (18, 4, 12)
    learnt_seconds: float = 2.0
    same: tuple[int, int, int] = (60, 0, 20)
    other: tuple[int, int, int] = (30, 0, 12)
    seconds: float = 4.0


@dataclass(frozen=True)
class Results:
    """Everything computed.

    Attributes
    ----------
    learnt : list of CutScores
        Cuts that were learnt from.
    plans : dict of float to ThresholdPlan
        By the rate asked for.
    held_out : dict of str to list of CutScores
        New cuts of every tool.
    tallies : dict of (str, float) to Tally
        What each threshold did with them.
    papers : dict of str to Tally
        What the threshold 100 did with them.
    """

    learnt: list[CutScores]
    plans: dict[float, ThresholdPlan]
    held_out: dict[str, list[CutScores]]
    tallies: dict[tuple[str, float], Tally]
    papers: dict[str, Tally]


def compute(sizes: Sizes = Sizes(), others: tuple[Generator, ...] = OTHERS) -> Results:
    """Compute everything."""
    learnt = cuts.campaign(LEARNT, cuts.shares(*sizes.learnt, seed=0), sizes.learnt_seconds, 0)
    posterior = fit_scores(learnt)
    plans = {
        rate: plan_threshold(posterior, COSTS, tool=LEARNT.name, false_alarms_per_hour=rate)
        for rate in ASKED
    }
    held_out = {}
    for number, generator in enumerate((LEARNT, *others), start=1):
        many = sizes.same if generator is LEARNT else sizes.other
        depths = cuts.shares(*many, seed=number)
        held_out[generator.name] = cuts.campaign(generator, depths, sizes.seconds, 100 * number)
    some = next(iter(plans.values()))
    tallies = {
        (name, rate): tallied([(cut, plan.choice) for cut in new], plan.rule)
        for name, new in held_out.items()
        for rate, plan in plans.items()
    }
    papers_choice = replace(some.choice, threshold=PAPERS_THRESHOLD, raised=False)
    papers = {
        name: tallied([(cut, papers_choice) for cut in new], some.rule)
        for name, new in held_out.items()
    }
    return Results(learnt, plans, held_out, tallies, papers)


def key_numbers(results: Results) -> Numbers:
    """The numbers that are compared with ``expected.json``."""
    numbers: Numbers = {}
    for (name, rate), tally in results.tallies.items():
        seen, stated = tally.false_alarms_per_hour, results.plans[rate].false_alarms_per_hour
        if seen is None:
            continue
        # Without a single alarm the rate is that of half an alarm.
        least = 0.5 / tally.hours
        numbers[f"{name}: false alarms at {rate:g} an hour"] = float(
            np.log2(max(seen.value, least) / stated.value)
        )
        found = tally.detection_probability
        if found is not None:
            numbers[f"{name}: chatter found at {rate:g} an hour"] = found.value
    return numbers


def report(results: Results) -> str:
    """Rates and detections of every threshold and tool, as text."""
    rows = [("threshold", "cuts of", "false alarms an hour", "chatter found", "delay")]
    for rate, plan in results.plans.items():
        low, high = plan.threshold.interval90
        rows.append(
            (
                f"{plan.threshold.value:.4g} ({low:.0f} to {high:.0f})", "stated",
                _rate(plan.false_alarms_per_hour), f"{plan.detection_probability.value:.3f}",
                f"{plan.delay.value:.2f} s",
            )
        )  # fmt: skip
        rows += [_row(name, results.tallies[name, rate]) for name in results.held_out]
    rows.append((f"{PAPERS_THRESHOLD:g} (the paper's)", "", "", "", ""))
    rows += [_row(name, tally) for name, tally in results.papers.items()]
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def _rate(rate: Figure) -> str:
    return f"{rate.value:.0f} ({rate.interval90[0]:.0f} to {rate.interval90[1]:.0f})"


def _row(name: str, tally: Tally) -> tuple[str, ...]:
    rate, found = tally.false_alarms_per_hour, tally.detection_probability
    return (
        "",
        name,
        "-" if rate is None else f"{_rate(rate)}, {tally.false_alarms} in {tally.hours:.3f} h",
        "-" if found is None else f"{found.value:.3f}",
        f"{np.median(tally.delays):.2f} s" if tally.delays else "-",
    )


def main(arguments: list[str] | None = None) -> int:
    """The command; returns 1 when a promise is broken, see `broken`."""
    parser = command(HERE, "Use a threshold on cuts of the tool it was learnt from, and of others.")
    chosen = parser.parse_args(arguments)
    # Here, because drawing knows `Results`.
    from experiments.chatter_thresholds.figures import draw_all

    chosen.out.mkdir(parents=True, exist_ok=True)
    results = compute()
    numbers, expected = key_numbers(results), read_expected(HERE)
    print(table(numbers, expected))
    print()
    print(report(results))
    for warning in dict.fromkeys(w for plan in results.plans.values() for w in plan.warnings):
        print(f"warning: {warning}")
    written(
        chosen.out,
        json.dumps(numbers, indent=1) + "\n",
        lambda: draw_all(results, chosen.out),
    )
    return int(broken(numbers))


def broken(numbers: Numbers) -> bool:
    """Whether more than twice the stated false alarms were seen, or a tenth of chatter missed."""
    return any(
        np.max(value) > 1.0 if "false alarms" in name else np.min(value) < 0.9
        for name, value in numbers.items()
    )
