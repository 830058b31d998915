"""Run the experiment: compute, compare with ``expected.json``, print tables, draw.

The numbers that are compared are in `key_numbers`; what each should be, how close, and why is in
``expected.json``.
"""

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.electrode import GapData
from calibration.electrode_gap import GapPosterior
from experiments.comparison import (
    Expected,
    Numbers,
    command,
    deviations,
    read_expected,
    table,
    verdict,
    written,
)
from experiments.guo_wedg_electrodes import gaps, link, sizes
from experiments.guo_wedg_electrodes.conditions import PAPER, Conditions
from experiments.guo_wedg_electrodes.gaps import Learning, RangePosterior
from experiments.guo_wedg_electrodes.link import Linked
from experiments.guo_wedg_electrodes.sizes import Cause, GroundShape

HERE = Path(__file__).parent
SURE = 0.9


@dataclass(frozen=True)
class Results:
    """Everything computed."""

    conditions: Conditions
    readings: GapData
    posterior: GapPosterior
    from_range: RangePosterior
    ground: list[GroundShape]
    all_within: float
    even_odds_spread: float
    sure_diameter: float
    budget: tuple[Cause, ...]
    rounding: tuple[float, float]
    learning: Learning
    linked: Linked


def compute(conditions: Conditions = PAPER) -> Results:
    """Compute everything."""
    known = gaps.posterior(conditions)
    ground = [sizes.ground(shape, known, conditions) for shape in conditions.shapes]
    return Results(
        conditions=conditions,
        readings=gaps.readings(conditions),
        posterior=known,
        from_range=gaps.from_range(conditions),
        ground=ground,
        all_within=sizes.chance_of_all(ground, known, conditions),
        even_odds_spread=sizes.spread_for_even_odds(conditions),
        sure_diameter=sizes.diameter_for(SURE, known, conditions),
        budget=sizes.budget(known, conditions),
        rounding=sizes.rounding_on_the_arc(conditions),
        learning=gaps.learning(conditions),
        linked=link.linked(known, conditions),
    )


def key_numbers(results: Results) -> Numbers:
    """The numbers that are compared with ``expected.json``, lengths in um."""
    conditions, known = results.conditions, results.posterior
    spread = (conditions.highest_gap - conditions.lowest_gap) / conditions.range_constant
    numbers: Numbers = {
        "known: mean range of ten": conditions.range_constant,
        "known: spread from the range": spread,
        "known: area of a 100 um electrode, share": 4.0 * spread / conditions.blind_diameter,
        "known: chord error on the arc": results.budget[-1].std / 2.0,
        "simulated gaps: lowest and highest": [
            float(np.min(results.readings.gap)),
            float(np.max(results.readings.gap)),
        ],
        "simulated gaps: mean": known.mean.mean,
        "simulated gaps: spread": float(known.spread_quantile(0.5)),
        "simulated gaps: next, 90 %": list(known.next_gap().interval(0.9)),
        "range alone: mean": results.from_range.mean_mean,
        "range alone: spread": results.from_range.spread_median,
        "range alone: next, 90 %": [
            results.from_range.next_quantile(level) for level in (0.05, 0.95)
        ],
    }
    for made in results.ground:
        chance = made.plan.prediction.all_within
        assert chance is not None
        numbers[f"2 %: {made.shape.name}"] = chance
        numbers[f"2 %: {made.shape.name}, by the wire's law"] = made.share_within
    numbers |= {
        "2 %: all three": results.all_within,
        "2 %: spread for even odds": results.even_odds_spread,
        "2 %: diameter for nine in ten": results.sure_diameter,
        "budget": [cause.std for cause in results.budget],
        "rounding on the arc: rms and greatest": list(results.rounding),
        "learning: error after 0, 2, 10 electrodes": results.learning.error[[0, 2, 10]].tolist(),
        "learning: least error": results.learning.least,
    }
    linked = results.linked
    numbers |= {
        "link: area, blind and measured": [linked.blind.relative, linked.measured.relative],
        "link: wear ratio": float(np.std(linked.wear_ratio) / np.mean(linked.wear_ratio)),
        "link: depth of the cone, half of 95 %": [
            float(plan.depth_spread[-1]) for plan in linked.plans.values()
        ],
    }
    return numbers


def expected_numbers() -> Expected:
    """What ``expected.json`` says of every key number."""
    return read_expected(HERE)


def budget_table(results: Results) -> str:
    """The causes of error as text: standard deviation in a diameter, share of the variance."""
    total = sum(cause.std**2 for cause in results.budget)
    lines = [f"{'cause of error':<30}  {'std of a diameter [um]':>22}  {'share of variance':>17}"]
    lines += [
        f"{cause.name:<30}  {cause.std:>22.5f}  {cause.std**2 / total:>17.2e}"
        for cause in results.budget
    ]
    return "\n".join([*lines, f"{'together':<30}  {math.sqrt(total):>22.5f}"])


def sizes_table(results: Results) -> str:
    """Sizes to expect of the three electrodes, as text."""
    lines = [f"{'electrode':<15}  {'drawing':>7}  {'expected':>8}  {'90 %':>16}  within 2 %"]
    for made in results.ground:
        found = made.plan.prediction
        assert found.wanted is not None and found.within is not None
        for i, wanted in enumerate(found.wanted):
            low, high = found.interval[i]
            lines.append(
                f"{made.shape.name:<15}  {wanted:>7.0f}  {found.size[i]:>8.2f}  "
                f"{low:>7.2f}, {high:>7.2f}  {100 * found.within[i]:>8.0f} %"
            )
    return "\n".join(lines)


def as_json(results: Results, numbers: Numbers, expected: Expected) -> str:
    """Conditions, key numbers, gaps and sizes as JSON text."""
    off = deviations(numbers, expected)
    content: dict[str, Any] = {
        "lengths": "um",
        "conditions": dataclasses.asdict(results.conditions),
        "key_numbers": {
            name: {"value": value, "as_expected": off[name] <= 1} for name, value in numbers.items()
        },
        "simulated_gaps": results.readings.gap.tolist(),
        "gap": results.posterior.as_dict(),
        "sizes": {made.shape.name: made.plan.prediction.as_dict() for made in results.ground},
        "budget": {cause.name: cause.std for cause in results.budget},
        "plans": {
            name: {"depth_spread": plan.depth_spread.tolist()}
            for name, plan in results.linked.plans.items()
        },
    }
    return json.dumps(content, indent=1) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """The command; returns 1 when a number is not as expected."""
    parser = command(HERE, "What the sizes of Guo, Pei, Yu and Li's micro-electrodes depend on.")
    chosen = parser.parse_args(arguments)
    # Here, because drawing knows `Results`.
    from experiments.guo_wedg_electrodes.figures import draw_all

    chosen.out.mkdir(parents=True, exist_ok=True)
    results = compute()
    numbers, expected = key_numbers(results), expected_numbers()
    print(table(numbers, expected))
    print(f"\n{budget_table(results)}\n\n{sizes_table(results)}\n")
    content = as_json(results, numbers, expected)
    written(chosen.out, content, lambda: draw_all(results, chosen.out))
    return verdict(numbers, expected)
