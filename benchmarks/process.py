"""The command from start to exit, beside a scipy script that makes the same fit."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import measure, peers
from benchmarks.report import Section
from benchmarks.sizes import Sizes

LAYERS = 100
OPTIONS = "--section square --half-width 250 --feed 2 --step 2 --electrode-diameter 100 --json"
AGREEMENT = 1e-6
# Names in the environment that would let the first run find something compiled, or that change
# where the command keeps it.
_CACHE_SETTINGS = ("JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")


def run(section: Section, sizes: Sizes) -> None:
    command = _command()
    if command is None:
        section.text("Left out: the command `procmodel` is not installed beside this Python.")
        return
    with tempfile.TemporaryDirectory(prefix="procmodel-bench-") as folder:
        bench = _Bench(Path(folder), command)
        missing = bench.what_is_missing()
        if missing:
            section.text(f"Left out: `procmodel wear fit --help` does not work yet ({missing}).")
            return
        _fits(section, bench, sizes.process_repeats)
        _help(section, bench, sizes.process_repeats)


class _Bench:
    """The files and the environment of the runs, all in one temporary folder."""

    def __init__(self, folder: Path, command: str):
        self.folder = folder
        self.environment = {k: v for k, v in os.environ.items() if k not in _CACHE_SETTINGS}
        self.environment["XDG_CACHE_HOME"] = str(folder / "cache")
        self.command = command
        self.profile = folder / "wall.csv"
        self.script = folder / "fit_with_scipy.py"
        _write_profile(self.profile)
        self.script.write_text(peers.FIT_SCRIPT.format(layers=LAYERS))
        fit = [command, "wear", "fit", str(self.profile), *OPTIONS.split()]
        self.ours = {
            "procmodel wear fit": fit,
            f"procmodel wear fit --layers {LAYERS}": [*fit, "--layers", str(LAYERS)],
        }
        self.theirs = [sys.executable, str(self.script), str(self.profile)]

    def what_is_missing(self) -> str:
        """Last line of the error when the command does not exist yet; empty when it does."""
        done = self.finished([self.command, "wear", "fit", "--help"])
        lines = done.stderr.strip().splitlines()
        return "" if done.returncode == 0 else (lines[-1] if lines else "no message")

    def finished(self, line: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            line, env=self.environment, cwd=self.folder, capture_output=True, text=True
        )

    def seconds(self, line: list[str]) -> tuple[float, str]:
        """Time from start to exit, and what was printed."""
        begin = time.perf_counter()
        done = self.finished(line)
        taken = time.perf_counter() - begin
        if done.returncode:
            raise RuntimeError(f"{Path(line[0]).name} failed: {done.stderr.strip()[-300:]}")
        return taken, done.stdout

    def cache(self) -> tuple[int, float]:
        """Files in the compilation cache, and their size [kB]."""
        files = [f for f in (self.folder / "cache").rglob("*-cache") if f.is_file()]
        return len(files), sum(f.stat().st_size for f in files) / 1e3


def _fits(section: Section, bench: _Bench, repeats: int) -> None:
    contestants = {**bench.ours, "scipy script": bench.theirs}
    cold, printed = bench.seconds(next(iter(bench.ours.values())))
    files, size = bench.cache()
    # Second runs: everything compiled, every file read before.
    printed = {name: bench.seconds(line)[1] for name, line in contestants.items()}
    values = {name: _wear_ratio(text) for name, text in printed.items()}
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for repeat in range(repeats):
        names = list(contestants)
        shift = repeat % len(names)
        for name in names[shift:] + names[:shift]:
            times[name].append(bench.seconds(contestants[name])[0])
    seconds = {name: np.array(value) for name, value in times.items()}

    section.text(
        f"`procmodel wear fit wall.csv {OPTIONS}` from start to exit, on 251 readings of one wall, "
        f"{LAYERS} layers. Without `--layers` the command counts them on the floor, which takes "
        "several fits; the script is told. The script reads the CSV with NumPy, fits with "
        f"curve_fit and prints JSON. {repeats} runs of each in turns, compilation cache warm."
    )
    section.table(
        ["contestant", "time of the process", "time / scipy script", "wear ratio", "std"],
        [
            [
                f"`{name}`" if name in bench.ours else name,
                measure.time_spread(seconds[name]),
                measure.ratio(seconds[name], seconds["scipy script"]),
                f"{values[name][0]:.9f}",
                f"{values[name][1]:.6f}",
            ]
            for name in contestants
        ],
    )
    section.text(f"First run of all, nothing compiled (once): {cold:.2f} s.")
    if files:
        section.text(f"It left {files} programs, {size:.0f} kB, in the compilation cache.")
    section.target(
        "the command keeps what it compiled under XDG_CACHE_HOME",
        "at least one file",
        f"{files} files",
        files > 0,
    )
    worst = max(abs(values[name][0] / values["scipy script"][0] - 1.0) for name in bench.ours)
    section.target(
        "wear ratio of the command beside the scipy script",
        f"relative difference of at most {AGREEMENT:g}",
        f"{worst:.1e}",
        worst <= AGREEMENT,
    )


def _help(section: Section, bench: _Bench, repeats: int) -> None:
    line = [bench.command, "--help"]
    bare = [sys.executable, "-c", "pass"]
    pairs = np.array([(bench.seconds(line)[0], bench.seconds(bare)[0]) for _ in range(repeats)])
    listed = bench.finished([sys.executable, "-X", "importtime", *line]).stderr
    modules = re.findall(r"\|\s*([\w.]+)$", listed, flags=re.MULTILINE)
    loaded = sorted({m.split(".")[0] for m in modules} & {"jax", "jaxlib", "scipy", "numpy"})
    section.heading("Help")
    section.text(
        f"`procmodel --help` takes {measure.time_spread(pairs[:, 0])}, an empty Python process "
        f"{measure.time_spread(pairs[:, 1])}. It imports {len(modules)} modules."
    )
    section.target(
        "`procmodel --help` imports no JAX",
        "neither jax nor jaxlib",
        f"{', '.join(loaded) or 'none'} of jax, jaxlib, scipy, numpy",
        bool(modules) and not {"jax", "jaxlib"} & set(loaded),
    )


def _command() -> str | None:
    # The folder of this Python first: it is the one that the package is installed for.
    return shutil.which("procmodel", path=str(Path(sys.executable).parent))


def _write_profile(path: Path) -> None:
    walls = 250.0 - 2.0 * np.arange(LAYERS)
    x = np.arange(251.0)
    z = peers.wall_model(walls, 2.0, 1.0)(x, 0.3) + np.random.default_rng(7).normal(size=len(x))
    rows = [f"{a:.1f},{b:.4f}" for a, b in zip(x, z, strict=True)]
    path.write_text("\n".join(["x [um],z [um]", *rows]) + "\n")


def _wear_ratio(printed: str) -> tuple[float, float]:
    found = json.loads(printed)
    estimate = found.get("parameters", found)["wear_ratio"]
    return estimate["value"], estimate["std"]
