"""Run the experiment: compute, compare with ``expected.json``, print a table, draw.

The numbers that are compared are in `key_numbers`; what each should be, how close, and why is in
``expected.json``.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from calibration.plans.path import PathPlan
from experiments.comparison import (
    Expected,
    command,
    deviations,
    read_expected,
    table,
    verdict,
    written,
)
from experiments.ibaraki_constant_engagement import loads as force
from experiments.ibaraki_constant_engagement import passes
from experiments.ibaraki_constant_engagement.conditions import PAPERS_CUT, Conditions
from experiments.ibaraki_constant_engagement.loads import Loads
from experiments.ibaraki_constant_engagement.passes import (
    ForwardPasses,
    NewtonSteps,
    OpenWall,
)
from procmodel.engagement import engagement_angle_constant_curvature, radial_depth_for_angle

HERE = Path(__file__).parent
TRANSITION = (0.8, 0.5, 0.25, 0.0)


@dataclass(frozen=True)
class Results:
    """Everything computed."""

    conditions: Conditions
    wall: OpenWall
    pocket: PathPlan
    forward: ForwardPasses
    newton: NewtonSteps
    loads: Loads


def compute(conditions: Conditions = PAPERS_CUT) -> Results:
    """Compute everything."""
    wall = passes.on_open_wall(conditions)
    return Results(
        conditions=conditions,
        wall=wall,
        pocket=passes.on_pocket(conditions),
        forward=passes.forward_on_open_wall(conditions, wall.target),
        newton=passes.newton_on_plain_path(wall, conditions),
        loads=force.loads(wall, conditions),
    )


def key_numbers(results: Results) -> dict[str, float | list[float]]:
    """The numbers that are compared with ``expected.json``."""
    newton, forward = results.newton, results.forward
    target = results.wall.target
    arc = (newton.way > 0.0) & (newton.way < results.conditions.path_turn)
    moved_surface = passes.one_step_of_surface(results.conditions, target)
    reached = {
        "path, one step in the angle": newton.one_step[newton.middle],
        "path, one step in the cosine": newton.one_ratio[newton.middle],
        "surface, one step in the angle": moved_surface[0],
        "surface, one step in the cosine": moved_surface[1],
    }
    return {
        **geometry_numbers(results.wall, results.conditions),
        "pocket: overshoot before": 100.0 * results.pocket.before.overshoot,
        "pocket: overshoot after": 100.0 * results.pocket.after.overshoot,
        "pocket: left on the wall after": results.pocket.miss[1],
        **{
            f"newton: {name}, off": 100.0 * (float(angle) / target - 1.0)
            for name, angle in reached.items()
        },
        "newton: path, steps from place to place, off": 100.0
        * float(np.max(np.abs(newton.continued[arc] / target - 1.0))),
        "newton: converged, moved in the arc": float(newton.moved[newton.middle]),
        "algorithm I: angle off": float(np.degrees(max(forward.off))),
        "algorithm I: left after each pass": [float(m.max()) for m in forward.miss],
        **_forces(results),
    }


def geometry_numbers(wall: OpenWall, conditions: Conditions) -> dict[str, float | list[float]]:
    """Those of the open wall that have closed forms; mm, degrees and per cent."""
    r, ae, curvature = conditions.radius, conditions.radial_depth, 1.0 / conditions.corner
    surface = wall.before.surface
    angles = passes.at_ways(wall, surface, np.array([-15.0, 0.5 * conditions.path_turn]), r)
    transition = passes.at_ways(wall, surface, -np.array(TRANSITION), r)
    rises, falls = passes.transition_ways(wall, conditions)
    sensitivity = jax.grad(engagement_angle_constant_curvature)(ae, r, 0.0)
    off = np.abs(wall.before.angle - passes.closed_form(wall.way, conditions))
    return {
        "angle on the line": float(np.degrees(angles[0])),
        "angle in the arc": float(np.degrees(angles[1])),
        "angle per radial depth on the line": float(np.degrees(sensitivity)),
        "radial depth that holds the angle in the arc": float(
            radial_depth_for_angle(wall.target, r, curvature)
        ),
        "transition: .8, .5, .25, 0 mm before the arc": np.degrees(transition).tolist(),
        "transition: begins before the arc": rises,
        "transition: ends before the arc's end": falls,
        "transition: greatest distance from the closed form": float(np.degrees(off.max())),
        "algorithm II: kinks of the wanted surface": np.degrees(wall.kinks).tolist(),
        "algorithm II: overshoot before": 100.0 * wall.before.overshoot,
        "algorithm II: overshoot after": 100.0 * wall.after.overshoot,
        "algorithm II: floor of the overshoot": 100.0 * (wall.floor / wall.target - 1.0),
        "algorithm II: greatest angle after": float(np.degrees(wall.after.angle.max())),
        "algorithm II: least angle after": float(np.degrees(wall.after.angle.min())),
    }


def _forces(results: Results) -> dict[str, float | list[float]]:
    found = results.loads
    line, arc, _ = found.wall_force
    before, after = found.absolute.before, found.absolute.after
    numbers: dict[str, float | list[float]] = {
        "force: wall, arc over line": arc / line,
        "force: mean, line and arc": [float(before.mean.min()), float(before.mean.max())],
        "force: peak, line and arc": [float(before.peak.min()), float(before.peak.max())],
        "force: greatest mean and peak after": [float(after.mean.max()), float(after.peak.max())],
        "force: variation of the peak, before": found.variation("peak", corrected=False),
        "force: variation of the peak, after": found.variation("peak", corrected=True),
    }
    for name, reading in (("absolute", found.absolute), ("arc less line", found.relative)):
        numbers |= {
            f"14 um {name}: fitted stiffness": reading.stiffness,
            f"14 um {name}: left in the arc, before": 1e3 * reading.left_in_arc,
            f"14 um {name}: on the lines": 1e3 * reading.on_line,
            f"14 um {name}: junction more than line, after": 1e3 * reading.left_at_junction,
        }
    return numbers


def expected_numbers() -> Expected:
    """What ``expected.json`` says of every key number."""
    return read_expected(HERE)


def against_the_paper(results: Results) -> str:
    """What the paper measured beside what is computed; these are not judged."""
    paper, found = results.conditions.paper, results.loads
    wall = results.wall
    degrees = np.degrees([paper.angle_on_line, paper.angle_in_arc, wall.target])
    rows = [
        ("engagement on lines [deg]", f"{degrees[0]:.1f}", f"{degrees[2]:.3f}"),
        ("engagement in the arc [deg]", f"{degrees[1]:.0f}", _deg(wall.before.angle.max())),
        ("left in the arc, plain [um]", f"{1e3 * paper.left_in_arc:.0f}", "fitted to it"),
        (
            "left at the junction, corrected [um]",
            f"{1e3 * paper.left_at_junction:.1f}",
            f"{1e3 * found.absolute.left_at_junction:.2f} or "
            f"{1e3 * found.relative.left_at_junction:.2f}",
        ),
        (
            "variation of force, corrected [N]",
            f"< {paper.steady_variation:.0f} (steel)",
            f"{found.variation('peak', corrected=True):.2f} (aluminium)",
        ),
    ]
    return "\n".join(f"{name:<38}paper {theirs:<14}ours {ours}" for name, theirs, ours in rows)


def _deg(angle: Any) -> str:
    return f"{float(np.degrees(angle)):.3f}"


def as_json(results: Results, numbers: dict[str, Any], expected: dict[str, Any]) -> str:
    """Key numbers, fits and curves along the open wall as JSON text."""
    off = deviations(numbers, expected)
    wall, found = results.wall, results.loads
    thin = slice(None, None, 10)
    content = {
        "units": "mm, N, degrees, wall errors in um",
        "key_numbers": {
            name: {"value": value, "as_expected": off[name] <= 1} for name, value in numbers.items()
        },
        "fits": {r.name: r.fit.as_dict() for r in (found.absolute, found.relative)},
        "along_the_open_wall": {
            "way": np.round(wall.way[thin], 6).tolist(),
            "before": np.round(np.degrees(wall.before.angle[thin]), 6).tolist(),
            "after": np.round(np.degrees(wall.after.angle[thin]), 6).tolist(),
        },
    }
    return json.dumps(content, indent=1) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """The command; returns 1 when a number is not as expected."""
    parser = command(HERE, "Recompute the cut of Ibaraki et al.")
    chosen = parser.parse_args(arguments)
    # Here, because drawing knows `Results`.
    from experiments.ibaraki_constant_engagement.figures import draw_all

    chosen.out.mkdir(parents=True, exist_ok=True)
    results = compute()
    numbers, expected = key_numbers(results), expected_numbers()
    print(table(numbers, expected))
    print()
    print(against_the_paper(results))
    content = as_json(results, numbers, expected)
    written(chosen.out, content, lambda: draw_all(results, chosen.out))
    return verdict(numbers, expected)
