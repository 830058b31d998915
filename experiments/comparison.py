"""Computed key numbers beside those of an ``expected.json``: how far off, a table, the command."""

import argparse
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from procmodel.io import write_text

Numbers = dict[str, float | list[float]]
Expected = dict[str, dict[str, Any]]


def read_expected(folder: Path) -> Expected:
    """What the ``expected.json`` of an experiment says of every key number."""
    return json.loads((folder / "expected.json").read_text(encoding="utf-8"))


def deviations(numbers: Numbers, expected: Expected) -> dict[str, float]:
    """Greatest distance of every number from what is expected, over its tolerance."""
    return {
        name: float(
            np.max(np.abs(np.asarray(value) - np.asarray(expected[name]["value"])))
            / expected[name]["tolerance"]
        )
        for name, value in numbers.items()
    }


def table(numbers: Numbers, expected: Expected) -> str:
    """The comparison as text, one number a line (the worst entry of a list)."""
    off = deviations(numbers, expected)
    width = max(map(len, numbers))
    units, kinds = (
        max(len(head), *(len(expected[name][head]) for name in numbers))
        for head in ("unit", "kind")
    )
    lines = [
        f"{'key number':<{width}}  {'computed':>12}  {'expected':>12}  {'tolerance':>9}  "
        f"{'unit':<{units}}  {'kind':<{kinds}}  verdict"
    ]
    for name, value in numbers.items():
        entry = expected[name]
        got, want = np.atleast_1d(value), np.atleast_1d(entry["value"])
        worst = int(np.argmax(np.abs(got - want)))
        verdict = "as expected" if off[name] <= 1 else "OFF"
        unit, kind = entry["unit"], entry["kind"]
        lines.append(
            f"{name:<{width}}  {got[worst]:>12.6f}  {want[worst]:>12.6f}  "
            f"{entry['tolerance']:>9.2g}  {unit:<{units}}  {kind:<{kinds}}  {verdict}"
        )
    return "\n".join(lines)


def command(folder: Path, description: str) -> argparse.ArgumentParser:
    """The command of the experiment in a folder, which takes where its results go."""
    parser = argparse.ArgumentParser(
        prog=f"python -m experiments.{folder.name}", description=description
    )
    parser.add_argument("--out", type=Path, default=folder / "output", metavar="FOLDER")
    return parser


def written(out: Path, content: str, draw: Callable[[], Iterable[Path]]) -> None:
    """Write ``results.json``, then what is drawn, and name every file."""
    write_text(out / "results.json", content)
    for path in [out / "results.json", *draw()]:
        print(f"wrote {path}")


def verdict(numbers: Numbers, expected: Expected) -> int:
    """The exit code of a command: 1 when a number is not as expected."""
    return int(any(off > 1 for off in deviations(numbers, expected).values()))
