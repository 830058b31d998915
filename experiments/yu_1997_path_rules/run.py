"""Run the experiment: compute, compare with ``expected.json``, print tables, draw.

The numbers that are compared are in `key_numbers`; what each should be, how close, and why is in
``expected.json``. Those of the kind "known answer" hold for other cells, too.
"""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

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
from experiments.yu_1997_path_rules import compensation, hemisphere, known, rules
from experiments.yu_1997_path_rules.compensation import LAWS, Compensated
from experiments.yu_1997_path_rules.conditions import CHOSEN, Conditions
from experiments.yu_1997_path_rules.hemisphere import Bowl, Planned
from experiments.yu_1997_path_rules.known import Levelled, Shape, Tilt
from experiments.yu_1997_path_rules.rules import ALL, Row

HERE = Path(__file__).parent
STRETCHES = (1.0, 2.0, 4.0)
WORN = ("fixed", "rotating")
STARTED = ("flat", *WORN)
# Variants that are drawn.
DRAWN = (ALL, "no overlap, one direction", "lines alone", "no rule", "feed along the path")


@dataclass(frozen=True)
class Results:
    """Everything computed.

    `rows` are the variants of the rules and the slots, `start_up` depths over eq. (3) of every
    layer by electrode and wear ratio; `levelled_pockets` has the pocket by wear ratio
    and number of passes.
    """

    conditions: Conditions
    tilts: tuple[Tilt, ...]
    wedge: Shape
    cones: tuple[Shape, Shape]
    grooves: tuple[Levelled, ...]
    rows: tuple[Row, ...]
    start_up: dict[tuple[str, float], np.ndarray]
    levelled_pockets: dict[tuple[float, int], Levelled]
    compensated: tuple[Compensated, ...]
    bowl: Bowl
    staircase: tuple[float, float]
    planned: tuple[Planned, ...]

    def row(self, variant: str, electrode: str) -> Row:
        """The row of a variant and an electrode."""
        return next(r for r in self.rows if (r.variant, r.electrode) == (variant, electrode))

    def pocket(self, law: str, electrode: str, assumed: float) -> Compensated:
        """The pocket cut by a feed law that was planned for a wear ratio."""
        return next(
            p
            for p in self.compensated
            if (p.law, p.electrode, p.assumed) == (law, electrode, assumed)
        )


def compute(
    conditions: Conditions = CHOSEN, names: Sequence[str] | None = None, searched: bool = True
) -> Results:
    """Compute everything, or some variants of the rules; `searched` as of `hemisphere.plans`."""
    cell = conditions.cell
    gentle = dataclasses.replace(conditions, wear_ratio=conditions.gentle_wear_ratio)
    more_passes = dataclasses.replace(conditions, passes=conditions.many_passes)
    rows = [
        rules.slot(conditions, turning, electrode)
        for electrode in ("fixed", "local")
        for turning in (True, False)
    ]
    rows += [
        rules.cut_variant(conditions, name, electrode)
        for name in (names or rules.variants(conditions))
        for electrode in WORN
    ]
    rows += [rules.cut_variant(conditions, ALL, electrode) for electrode in ("local", "flat")]
    ratios = (conditions.wear_ratio, conditions.wrong * conditions.wear_ratio)
    bowl = hemisphere.bowl(conditions)
    return Results(
        conditions=conditions,
        tilts=tuple(known.tilt(conditions, stretch) for stretch in STRETCHES),
        wedge=known.linear_tip(conditions, False, cell),
        cones=(
            known.linear_tip(conditions, True, 2.0 * conditions.fine_cell),
            known.linear_tip(conditions, True, conditions.fine_cell),
        ),
        grooves=tuple(known.levelled_groove(conditions, stretch) for stretch in STRETCHES),
        rows=tuple(rows),
        start_up={
            (electrode, at.wear_ratio): compensation.start_up(at, electrode)
            for at in (gentle, conditions)
            for electrode in STARTED
        },
        levelled_pockets={
            (at.wear_ratio, at.passes): compensation.levelled_pocket(at)
            for at in (gentle, conditions, more_passes)
        },
        compensated=tuple(
            compensation.compensated(conditions, law, electrode, ratio)
            for electrode in WORN
            for law in LAWS
            for ratio in ratios
        ),
        bowl=bowl,
        staircase=hemisphere.error(bowl, bowl.staircase),
        planned=tuple(
            hemisphere.cut_plan(bowl, name, feeds, conditions)
            for name, feeds in hemisphere.plans(bowl, conditions, searched).items()
        ),
    )


def key_numbers(results: Results) -> Numbers:
    """The numbers that are compared with ``expected.json``, lengths in um."""
    conditions = results.conditions
    one_way = [tilt.one_way[-1] for tilt in results.tilts]
    cone = [shape.slope / shape.wanted for shape in results.cones]
    gentle = conditions.gentle_wear_ratio
    numbers: Numbers = {
        "known: volume ratio less R, worst": max(abs(row.volume) for row in results.rows),
        "known: tilt one way, of a long path": 2.0 * one_way[-1] - one_way[-2],
        "known: tilt to and fro, both layers' sum": sum(results.tilts[-1].to_and_fro),
        "known: wedge slope over k / R": results.wedge.slope / results.wedge.wanted,
        "known: cone slope over pi k / R, of small cells": 2.0 * cone[1] - cone[0],
        "known: order of the cone's slope in the cell": float(
            np.log2((1.0 - cone[0]) / (1.0 - cone[1]))
        ),
        "known: groove area over k S_e / R": [
            shape.area / shape.wanted_area for shape in (results.wedge, results.cones[1])
        ],
        "known: last layer over eq. (3), u = 1.04": [
            float(results.start_up[electrode, gentle][-1]) for electrode in STARTED
        ],
        "known: last layer over eq. (3), u = 5.2, flat": float(
            results.start_up["flat", conditions.wear_ratio][-1]
        ),
        "known: layers of a cycle over eq. (3), u = 5.2": [
            1.0 + results.row(ALL, electrode).law for electrode in STARTED
        ],
        "levelling: feeds, u = 1": (results.grooves[0].plan.feeds / conditions.feed).tolist(),
        "law: tilt after levelling, u = 1": results.grooves[0].by_law[1],
        "simulated: tilt after levelling, u = 1": max(g.after for g in results.grooves),
        "simulated: pocket after levelling, u = 1.04 and 5.2": [
            results.levelled_pockets[gentle, conditions.passes].after,
            results.levelled_pockets[conditions.wear_ratio, conditions.many_passes].after,
        ],
        "no rule, rotating: share uncut": results.row("no rule", "rotating").uncovered,
        "path of a layer: all rules, no rule": [
            results.row(name, "fixed").length for name in (ALL, "no rule")
        ],
        "slot: tip, turned and not": [
            results.row(f"slot, {way}", "fixed").floor.tip for way in ("turned", "not turned")
        ],
    }
    for electrode in STARTED:
        numbers[f"flatness in feeds, {electrode}"] = results.row(ALL, electrode).floor.inside
    numbers["known: depth by an R 10 % too large, over eq. (3)"] = [
        _by_wrong_ratio(results, law, electrode) for electrode in WORN for law in LAWS
    ]
    for law in LAWS:
        numbers[f"pocket: rms of the floor, {law}, rotating"] = results.pocket(
            law, "rotating", conditions.wear_ratio
        ).rms
    for plan in results.planned:
        numbers[f"hemisphere: rms, {plan.name}"] = plan.right[0]
    return numbers


def _by_wrong_ratio(results: Results, law: str, electrode: str) -> float:
    """What a wear ratio taken too large adds to the mean depth, over what eq. (3) says."""
    conditions = results.conditions
    right, wrong = (
        results.pocket(law, electrode, factor * conditions.wear_ratio)
        for factor in (1.0, conditions.wrong)
    )
    u = right.made.job.relative_wear
    depth = conditions.depth_per_layer * len(right.made.job.paths)
    return (wrong.mean - right.mean) / (depth * (conditions.wrong - 1.0) * u / (1.0 + u))


def expected_numbers() -> Expected:
    """What ``expected.json`` says of every key number."""
    return read_expected(HERE)


def rules_table(results: Results) -> str:
    """The rules as text, peaks to valleys in feeds and radii in um."""
    lines = [
        f"{'rules':<26} {'electrode':<9} {'floor':>6} {'whole':>6} {'tip':>6} {'foot':>6} "
        f"{'rim':>6} {'corner':>6} {'uncut':>7} {'path':>6} {'turns':>5}"
    ]
    for row in results.rows:
        floor = row.floor
        lines.append(
            f"{row.variant:<26} {row.electrode:<9} {floor.inside:>6.2f} {floor.whole:>6.2f} "
            f"{floor.tip:>6.2f} {floor.foot:>6.1f} {floor.rim:>6.1f} {floor.corner:>6.1f} "
            f"{row.uncovered:>7.4f} {row.length:>6.0f} {row.turns:>5}"
        )
    return "\n".join(lines)


def levelling_table(results: Results) -> str:
    """Tilts before and after levelling as text, in feeds, beside the law of the path."""
    lines = [f"{'levelling':<28} {'u':>5} {'before':>7} {'law':>7} {'after':>7} {'law':>7}"]
    named = [
        (f"groove, {tilt.length:g} um", groove)
        for tilt, groove in zip(results.tilts, results.grooves, strict=True)
    ] + [
        (f"pocket, R = {ratio:g}, {passes} passes", made)
        for (ratio, passes), made in results.levelled_pockets.items()
    ]
    for name, made in named:
        lines.append(
            f"{name:<28} {made.relative_wear:>5.2f} {made.before:>7.3f} {made.by_law[0]:>7.3f} "
            f"{made.after:>7.4f} {made.by_law[1]:>7.4f}"
        )
    return "\n".join(lines)


def compensation_table(results: Results) -> str:
    """The pocket by feed law as text, in um and s."""
    lines = [
        f"{'feed law':<13} {'electrode':<9} {'R by':>5} {'mean':>6} {'rms':>6} {'max':>6} "
        f"{'time':>6} {'electrode':>9}"
    ]
    for made in results.compensated:
        off = made.assumed / results.conditions.wear_ratio
        lines.append(
            f"{made.law:<13} {made.electrode:<9} {off:>5.2f} {made.mean:>6.2f} {made.rms:>6.2f} "
            f"{made.greatest:>6.2f} {made.time:>6.0f} {made.length:>9.1f}"
        )
    return "\n".join(lines)


def hemisphere_table(results: Results) -> str:
    """Rms and greatest error of the hemisphere as text, in um."""
    lines = [
        f"{'hemisphere':<27} {'R right':>14} {'R 10 % greater':>15} {'R known to 5 %':>15} "
        f"{'electrode':>9}",
        f"{'its layers themselves':<27} {results.staircase[0]:>7.2f} {results.staircase[1]:>6.2f}",
    ]
    for plan in results.planned:
        pairs = [f"{rms:>8.2f} {most:>6.2f}" for rms, most in (plan.wrong, plan.believed)]
        lines.append(
            f"{plan.name:<27} {plan.right[0]:>7.2f} {plan.right[1]:>6.2f} {pairs[0]} {pairs[1]} "
            f"{plan.length:>9.1f}"
        )
    return "\n".join(lines)


def as_json(results: Results, numbers: Numbers, expected: Expected) -> str:
    """Conditions, key numbers and tables as JSON text."""
    off = deviations(numbers, expected)
    content: dict[str, Any] = {
        "lengths": "um",
        "conditions": dataclasses.asdict(results.conditions),
        "key_numbers": {
            name: {"value": value, "as_expected": off[name] <= 1} for name, value in numbers.items()
        },
        "rules": [
            {**_plain(row, "floor", "made"), **dataclasses.asdict(row.floor)}
            for row in results.rows
        ],
        "start_up": {
            f"{electrode}, R = {ratio:g}": np.round(depth, 7).tolist()
            for (electrode, ratio), depth in results.start_up.items()
        },
        "compensation": [_plain(made, "made") for made in results.compensated],
        "hemisphere": {
            "staircase": results.staircase,
            **{
                plan.name: {
                    "feeds": np.round(plan.feeds, 5).tolist(),
                    **_plain(plan, "name", "feeds", "depth", "worse"),
                }
                for plan in results.planned
            },
        },
    }
    # A slot has no floor away from its walls: NaN, which JSON has not.
    return json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n"


def _plain(record: Any, *left_out: str) -> dict[str, Any]:
    names = (f.name for f in dataclasses.fields(record) if f.name not in left_out)
    return {name: getattr(record, name) for name in names}


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_nan(inner) for name, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(inner) for inner in value]
    return None if isinstance(value, float) and np.isnan(value) else value


def main(arguments: list[str] | None = None) -> int:
    """The command; returns 1 when a number is not as expected."""
    parser = command(HERE, "Yu and Masuzawa's path rules (1997), one by one, in simulation.")
    parser.add_argument(
        "--no-search",
        action="store_true",
        help="leave out the plans through the simulator, which take the longest",
    )
    chosen = parser.parse_args(arguments)
    # Here, because drawing knows `Results`.
    from experiments.yu_1997_path_rules.figures import draw_all

    chosen.out.mkdir(parents=True, exist_ok=True)
    results = compute(searched=not chosen.no_search)
    numbers, expected = key_numbers(results), expected_numbers()
    print(table(numbers, expected))
    for text in (rules_table, levelling_table, compensation_table, hemisphere_table):
        print(f"\n{text(results)}")
    print()
    content = as_json(results, numbers, expected)
    written(chosen.out, content, lambda: draw_all(results, chosen.out))
    return verdict(numbers, expected)
