"""Timing: contestants take turns in one run, and a ratio is taken within each turn."""

import gc
import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

LIBRARIES = (
    "jax",
    "jaxlib",
    "numpy",
    "scipy",
    "lmfit",
    "emcee",
    "blackjax",
    "equinox",
    "procmodel",
)
_UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"))


@dataclass(frozen=True)
class Turns[Name]:
    """Contestants that took turns.

    Attributes
    ----------
    seconds : dict of ndarray, shape (repeats,)
        Seconds per call of every contestant.
    outcomes : dict
        What the last call of every contestant returned.
    """

    seconds: dict[Name, np.ndarray]
    outcomes: dict[Name, Any]


def interleaved[Name](
    contestants: Mapping[Name, Callable[[], Any]], repeats: int, least_seconds: float = 0.05
) -> Turns[Name]:
    """Time all contestants in turns.

    One repeat gives every contestant a block of calls, long enough for the clock; the order
    rotates, so that a slow spell of the machine does not always hit the same one. Every call
    is made once or twice before the first block.
    """
    names = list(contestants)
    calls = {name: _calls_of(contestants[name], least_seconds) for name in names}
    seconds: dict[Name, list[float]] = {name: [] for name in names}
    outcomes: dict[Name, Any] = {}
    for repeat in range(repeats):
        shift = repeat % len(names)
        for name in names[shift:] + names[:shift]:
            taken, outcomes[name] = _block(contestants[name], calls[name])
            seconds[name].append(taken)
    return Turns({name: np.array(values) for name, values in seconds.items()}, outcomes)


def _calls_of(call: Callable[[], Any], least_seconds: float) -> int:
    once, _ = _block(call, 1)
    if once < 20.0 * least_seconds:  # it may have compiled or imported: judge by the second
        once, _ = _block(call, 1)
    return max(1, round(least_seconds / once))


def _block(call: Callable[[], Any], calls: int) -> tuple[float, Any]:
    """Mean seconds of a number of calls, without garbage collection, and the last outcome."""
    gc.collect()
    gc.disable()
    try:
        begin = time.perf_counter()
        for _ in range(calls):
            outcome = call()
        return (time.perf_counter() - begin) / calls, outcome
    finally:
        gc.enable()


def timed[Outcome](call: Callable[[], Outcome]) -> tuple[float, Outcome]:
    """Seconds of a call, and what it returned."""
    begin = time.perf_counter()
    outcome = call()
    return time.perf_counter() - begin, outcome


def first_call[Outcome](call: Callable[[], Outcome]) -> tuple[float, Outcome]:
    """Seconds of a call with nothing compiled yet, and what it returned."""
    import jax

    jax.clear_caches()
    return timed(call)


def spread(values: np.ndarray, digits: int = 3) -> str:
    """Median and quartiles of dimensionless numbers, as text."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return f"{middle:.{digits}g} ({low:.{digits}g}–{high:.{digits}g})"


def ratio(of: np.ndarray, to: np.ndarray) -> str:
    """Ratio of times taken in the same repeats, as text."""
    return "1" if of is to else spread(of / to)


def time_spread(seconds: np.ndarray) -> str:
    """Median and quartiles of times in the unit that suits the median."""
    middle = float(np.median(seconds))
    scale, unit = next((u for u in _UNITS if middle >= u[0]), _UNITS[-1])
    return f"{spread(seconds / scale)} {unit}"


def resident_memory() -> float:
    """Memory that this process holds now [MiB]; on Linux only."""
    return _status_of_process("VmRSS")


def _status_of_process(entry: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) / 2**10 for line in lines if line.startswith(entry))


def peak_memory() -> float:
    """Greatest memory that this process has held so far [MiB]."""
    # Not getrusage on Linux: there a process starts with the peak of the one that started it.
    try:
        return _status_of_process("VmHWM")
    except OSError:
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (2**20 if platform.system() == "Darwin" else 2**10)


def machine() -> list[str]:
    """The machine in lines: processor, Python, libraries, load."""
    load = os.getloadavg()[0]
    versions = ", ".join(f"{name} {_version(name)}" for name in LIBRARIES)
    return [
        f"{_usable_cores()} cores, {_processor()}, {platform.system()} {platform.machine()}",
        f"Python {platform.python_version()}; {versions}",
        f"load average of the machine at the start: {load:.2f}",
    ]


def _usable_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or "unknown processor"


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
