"""Run the experiment: compute, compare with ``expected.json``, print tables, draw.

The numbers that are compared with the paper are in `key_numbers`; what each should be, how close,
and why is in ``expected.json``.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.plans.avoidance_comparison import Paired, summary
from calibration.plans.avoidance_log import write_log
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
from experiments.nishikawa_chatter_avoidance import recording
from experiments.nishikawa_chatter_avoidance.conditions import SENSORS, Paper
from experiments.nishikawa_chatter_avoidance.recording import Recording, detected
from experiments.nishikawa_chatter_avoidance.slopes import Slopes, both_slopes
from experiments.nishikawa_chatter_avoidance.study import FIXED, HOLD, Study, studied
from experiments.nishikawa_chatter_avoidance.sweep import Sweep, swept

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Results:
    """Everything computed; the last is None where the measured cut is not there."""

    sweep: Sweep
    slopes: Slopes
    study: Study
    recording: Recording | None


def compute() -> Results:
    """Compute everything."""
    return Results(swept(), both_slopes(), studied(), detected())


def key_numbers(results: Results) -> Numbers:
    """The numbers that are compared with ``expected.json``."""
    return {
        **sweep_numbers(results.sweep),
        **slope_numbers(results.slopes),
        **recording_numbers(results.recording),
    }


def sweep_numbers(sweep: Sweep) -> Numbers:
    """Those of the cuts at all speeds."""
    shown = int(np.argmin(np.abs(sweep.speeds - 18000.0)))
    numbers: Numbers = {
        "chatter from": float(sweep.speeds[sweep.chatters].min()),
        "no chatter up to": float(sweep.speeds[~sweep.chatters].max()),
        "chatter frequency at 18000": float(sweep.frequency[shown, 0]),
    }
    for i, sensor in enumerate(SENSORS):
        numbers |= {
            f"{sensor}: power at 18000": float(sweep.power[shown, i]),
            f"{sensor}: largest distance, good": float(sweep.worst_good[i]),
            f"{sensor}: least distance, chatter": float(sweep.least_bad[i]),
            f"{sensor}: their ratio": float(sweep.ratio[i]),
        }
    return numbers


def slope_numbers(slopes: Slopes) -> Numbers:
    """Those of the two slopes."""
    return {f"{slope} deg: speed reached": slopes.reached(slope) for slope in slopes.on}


def recording_numbers(found: Recording | None) -> Numbers:
    """Those of the measured cut, if it is there."""
    if found is None:
        return {}
    return {
        "measured cut: first alarm": found.first_alarm,
        "measured cut: frequency": found.frequency,
        "measured cut: windows in air judged": float(found.windows_in_air_judged),
    }


def expected_numbers() -> Expected:
    """What ``expected.json`` says of every key number."""
    return read_expected(HERE)


def beside_the_paper(results: Results) -> str:
    """What else the paper says, beside ours; these are not judged."""
    paper, sweep, slopes = Paper(), results.sweep, results.slopes
    good, bad = ~sweep.chatters, sweep.chatters
    rows = []
    for i, sensor in enumerate(SENSORS):
        at_good = sweep.speeds[good][np.argmax(sweep.distance[good, i])]
        at_bad = sweep.speeds[bad][np.argmin(sweep.distance[bad, i])]
        rows += [
            (f"{sensor}, largest good at", f"{paper.worst_good_at[i]:.0f}", f"{at_good:.0f} 1/min"),
            (f"{sensor}, least bad at", f"{paper.least_bad_at[i]:.0f}", f"{at_bad:.0f} 1/min"),
        ]
    for slope in slopes.on:
        without, with_loop = (1e6 * slopes.vibration(slope, on) for on in (False, True))
        rows.append(
            (
                f"{slope} deg, vibration beyond the forced",
                "lower with the system",
                f"{without:.1f} um without, {with_loop:.1f} um with the loop",
            )
        )
        rows.append(
            (
                f"{slope} deg, first alarm",
                "at the start of the cut",
                f"{slopes.first_alarm(slope):.2f} s after it began",
            )
        )
    return "\n".join(f"{name:<42}paper {theirs:<26}ours {ours}" for name, theirs, ours in rows)


def about_policies(study: Study) -> str:
    """The closed loop on many cuts, in words and numbers."""
    count, bad = len(study.chattering), int(study.chattering.sum())
    lines = [f"{count} simulated cuts, {bad} of which chatter without a loop"]
    lines.append(summary(study.runs, FIXED))
    lines.append(f"the {bad} that chatter, against no loop: log10 energy, time lost [s]")
    for name in study.runs:
        if name != HOLD:
            energy, lost = study.against(name, HOLD, chattering=True)
            lines.append(f"  {name:<14} {_told(energy)}   {_told(lost)}")
    return "\n".join(lines)


def about_recording(found: Recording | None) -> str:
    """Whether the measured cut was there, in one line."""
    if found is None:
        return (
            f"measured cut: {recording.FILE} is not there, so that it is left out; "
            "set PROCMODEL_DATA."
        )
    return f"measured cut: {found.events[0].sentence}"


def _told(figure: Paired) -> str:
    low, high = figure.interval90
    return f"{figure.mean:+.3f} ({low:+.3f} to {high:+.3f})"


def as_json(results: Results, numbers: Numbers, expected: Expected) -> str:
    """Key numbers and curves as JSON text."""
    off = deviations(numbers, expected)
    sweep, study = results.sweep, results.study
    content: dict[str, Any] = {
        "units": "1/min, Hz, um^2, (m/s^2)^2, s, m^2 s",
        "key_numbers": {
            name: {"value": value, "as_expected": off[name] <= 1} for name, value in numbers.items()
        },
        "sweep": {
            "speed": sweep.speeds.tolist(),
            "growth": np.round(sweep.growth, 3).tolist(),
            **{s: np.round(sweep.distance[:, i], 3).tolist() for i, s in enumerate(SENSORS)},
        },
        "slopes": {
            str(slope): {
                "time": np.round(run.time, 4).tolist(),
                "speed": np.round(60.0 * run.rotation, 1).tolist(),
            }
            for slope, run in results.slopes.on.items()
        },
        "policies": {
            name: {"energy": study.energy(name).tolist(), "time_lost": study.lost(name).tolist()}
            for name in study.runs
        },
    }
    return json.dumps(content, indent=1) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """The command; returns 1 when a number is not as expected."""
    parser = command(HERE, "The detector and the avoidance system of Nishikawa et al., simulated.")
    chosen = parser.parse_args(arguments)
    # Here, because drawing knows `Results`.
    from experiments.nishikawa_chatter_avoidance.figures import draw_all

    chosen.out.mkdir(parents=True, exist_ok=True)
    results = compute()
    numbers, expected = key_numbers(results), expected_numbers()
    for text in (
        table(numbers, expected),
        beside_the_paper(results),
        about_policies(results.study),
        about_recording(results.recording),
    ):
        print(text + "\n")
    content = as_json(results, numbers, expected)
    written(
        chosen.out,
        content,
        lambda: [*write_logs(results, chosen.out), *draw_all(results, chosen.out)],
    )
    return verdict(numbers, expected)


def write_logs(results: Results, folder: Path) -> list[Path]:
    """Write what the loop did on every slope; returns the paths."""
    paths = []
    for slope, run in results.slopes.on.items():
        paths.append(folder / f"slope_{slope}.csv")
        write_log(paths[-1], run.log)
    return paths
