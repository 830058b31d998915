"""Run the experiment: compute, compare with ``expected.json``, print a table, draw.

The numbers that are compared are in `key_numbers`; what each should be, how close, and why is in
``expected.json``.
"""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.wear import CavityFit
from experiments.comparison import (
    Expected,
    command,
    deviations,
    read_expected,
    table,
    verdict,
    written,
)
from experiments.yu_1997_cavities import cavities, loop
from experiments.yu_1997_cavities.cavities import (
    CompensatedCavity,
    ConstantFeedWall,
    FinishedCavity,
)
from experiments.yu_1997_cavities.conditions import (
    ASSUMED,
    Conditions,
    cone_frustum,
    hemisphere,
    pyramid_frustum,
)
from experiments.yu_1997_cavities.loop import PlannedCut

HERE = Path(__file__).parent
REPEATS = 200


@dataclass(frozen=True)
class Results:
    """Everything computed; `loop` holds the pyramid and the hemisphere planned on the fit."""

    conditions: Conditions
    paper_wall: ConstantFeedWall
    known_wall: ConstantFeedWall
    compensated: tuple[CompensatedCavity, ...]
    finished: tuple[FinishedCavity, ...]
    fit: CavityFit
    loop: tuple[PlannedCut, ...]
    staircase_bias: float
    coverage: float | None


def compute(conditions: Conditions = ASSUMED, repeats: int = 0) -> Results:
    """Compute everything; the loop is repeated for its coverage as often as asked."""
    roughing, finishing = conditions.roughing, conditions.finishing
    frustum, cone = pyramid_frustum(conditions), cone_frustum(conditions)
    roughed_sphere = hemisphere(conditions, roughing)
    fit = loop.fitted_profile(conditions)
    return Results(
        conditions=conditions,
        paper_wall=cavities.paper_wall(conditions),
        known_wall=cavities.known_wall(conditions.known_square, 10),
        compensated=tuple(
            cavities.compensated(wanted, conditions) for wanted in (frustum, cone, roughed_sphere)
        ),
        finished=tuple(
            cavities.finished(wanted, conditions)
            for wanted in (cone, hemisphere(conditions, finishing))
        ),
        fit=fit,
        loop=tuple(
            loop.planned_cut(wanted, fit, roughing, conditions)
            for wanted in (frustum, roughed_sphere)
        ),
        staircase_bias=loop.staircase_bias(conditions),
        coverage=loop.coverage(frustum, conditions, repeats) if repeats else None,
    )


def key_numbers(results: Results) -> dict[str, float | list[float]]:
    """The numbers that are compared with ``expected.json``, lengths in um."""
    wall = results.paper_wall
    estimate = results.fit.result.parameters["wear_ratio"]
    numbers: dict[str, float | list[float]] = {
        **_known_numbers(results),
        "constant feed: depth": float(wall.depths[-1]),
        "constant feed: depth, limit": float(wall.limit(np.array(wall.innermost))),
    }
    for cavity in results.compensated:
        numbers |= {
            f"{cavity.wanted.name}: error, planned": cavity.max_error(cavity.planned),
            f"{cavity.wanted.name}: error, plain": cavity.max_error(cavity.plain),
            f"{cavity.wanted.name}: error, even": cavity.max_error(cavity.even),
            f"{cavity.wanted.name}: electrode": cavity.schedule.electrode_length,
        }
    for finished in results.finished:
        name = f"{finished.wanted.name}, finished"
        numbers |= {
            f"{name}: error": finished.max_error,
            f"{name}: error, roughing R": finished.with_roughing_ratio,
            f"{name}: electrodes": list(finished.electrode_lengths),
        }
    numbers |= {
        "loop: R": estimate.value,
        "loop: half of the 95 % interval": 0.5 * float(np.diff(estimate.interval95)[0]),
    }
    for cut in results.loop:
        numbers |= {
            f"loop: {cut.wanted.name}, error": cut.max_wall_error,
            f"loop: {cut.wanted.name}, share of band": cut.share_of_band,
        }
    numbers["loop: bias of R by sharp steps"] = results.staircase_bias
    if results.coverage is not None:
        numbers["loop: share inside band"] = results.coverage
    return numbers


def _known_numbers(results: Results) -> dict[str, float | list[float]]:
    """What section 1 of the wear notes gives the answers of."""
    square = results.conditions.known_square
    round_electrode = results.conditions.known_round_electrode
    wall = results.known_wall
    feeds = cavities.known_schedule(square, 10.0).feeds
    long_plan = cavities.known_schedule(round_electrode, 2.0)
    walls = [cavities.known_wall(round_electrode, n) for n in (25, 50, 100, 200)]
    return {
        "known: layer depths": np.diff(wall.depths, prepend=0.0).tolist(),
        "known: depth": float(wall.depths[-1]),
        "known: depth less limit": float(wall.depths[-1] - wall.limit(np.array(0.0))),
        "known: compensated feeds": feeds.tolist(),
        "known: compensated total": float(feeds.sum()),
        "known: depth of 25, 50, 100, 200 layers": [float(w.depths[-1]) for w in walls],
        "known: their limit": float(walls[0].limit(np.array(0.0))),
        "known: first and last of 125 feeds": long_plan.feeds[[0, -1]].tolist(),
        "known: total of 125 feeds": long_plan.total_feed,
    }


def expected_numbers() -> Expected:
    """What ``expected.json`` says of every key number."""
    return read_expected(HERE)


def as_json(results: Results, numbers: dict[str, Any], expected: dict[str, Any]) -> str:
    """Conditions, key numbers, fit and walls as JSON text."""
    off = deviations(numbers, expected)
    content = {
        "lengths": "um",
        "conditions": dataclasses.asdict(results.conditions),
        "key_numbers": {
            name: {"value": value, "as_expected": off[name] <= 1} for name, value in numbers.items()
        },
        "fit": results.fit.result.as_dict(),
        "notes": list(results.fit.notes),
        "startup_decay_of_first_layer": cavities.startup_decay(_first_relative_wear(results)),
        "walls": {
            cavity.wanted.name: {
                "half_width": np.round(cavity.layers.half_width, 6).tolist(),
                "wanted_depth": np.round(cavity.layers.bottom, 6).tolist(),
                "cumulative_feed": np.round(cavity.schedule.cumulative_feed, 6).tolist(),
                "depth": np.round(cavity.planned, 6).tolist(),
                "depth_plain": np.round(cavity.plain, 6).tolist(),
            }
            for cavity in results.compensated
        },
    }
    return json.dumps(content, indent=1) + "\n"


def _first_relative_wear(results: Results) -> float:
    electrode = results.conditions.roughing
    area = float(results.compensated[0].layers.area[0])
    return electrode.wear_ratio * area / electrode.area


def main(arguments: list[str] | None = None) -> int:
    """The command; returns 1 when a number is not as expected."""
    parser = command(HERE, "Recompute the cavities of Yu and Masuzawa (1997).")
    parser.add_argument(
        "--repeats",
        type=int,
        default=REPEATS,
        help="how often to repeat the loop for its coverage; 0 to leave it out",
    )
    chosen = parser.parse_args(arguments)
    # Here, because drawing knows `Results`.
    from experiments.yu_1997_cavities.figures import draw_all

    chosen.out.mkdir(parents=True, exist_ok=True)
    results = compute(repeats=chosen.repeats)
    numbers, expected = key_numbers(results), expected_numbers()
    print(table(numbers, expected))
    content = as_json(results, numbers, expected)
    written(chosen.out, content, lambda: draw_all(results, chosen.out))
    return verdict(numbers, expected)
