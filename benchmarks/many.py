"""Ten thousand small fits: ours beside scipy, lmfit, optimistix and our own single fit."""

import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.optimize import curve_fit, leastsq

from benchmarks import measure, peers
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from calibration import Parameter, Problem, fit
from calibration.many import fit_many, fit_stream

X = np.linspace(0.0, 5.0, 30)
NAMES = ("a", "b", "c")
START = np.array([1.0, 1.0, 0.3])
UPPER = 10.0
NOISE = 0.02
AGREEMENT = 1e-6
# A stream's block, few enough that the smaller run has several, too.
BLOCK = 2500
# Room for the scatter of the clock on a growth that is exactly linear.
SLACK = 1.1

# Fits out of the same data for those that would take minutes for all; their time is per fit.
SAMPLES = {
    "scipy leastsq": 1000,
    "scipy curve_fit, bounded": 200,
    "lmfit, bounded": 300,
    "optimistix, vmap": 2000,
    "calibration.fit": 200,
}


def decay(params: dict[str, Any], x: Any) -> Any:
    return params["a"] * jnp.exp(-params["b"] * x) + params["c"]


def numpy_decay(x: np.ndarray, a: float, b: float, c: float) -> np.ndarray:
    return a * np.exp(-b * x) + c


def parameters() -> dict[str, Parameter]:
    pairs = zip(NAMES, START, strict=True)
    return {name: Parameter(float(start), bounds=(0.0, UPPER)) for name, start in pairs}


def readings(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    true = rng.uniform((1.0, 0.5, 0.2), (3.0, 1.5, 0.8), (n, 3))
    return numpy_decay(X, *true.T[..., None]) + rng.normal(0.0, NOISE, (n, len(X)))


def run(section: Section, sizes: Sizes) -> None:
    n = 10 * sizes.batch
    y = readings(n)
    cold, ours = measure.first_call(lambda: fit_many(decay, parameters(), X, y))
    calls = {"ours": lambda: fit_many(decay, parameters(), X, y).value} | _others(y)
    counts = {name: min(n, SAMPLES.get(name, n)) for name in calls}
    turns = measure.interleaved(calls, sizes.batch_repeats)
    seconds = {name: times / counts[name] for name, times in turns.seconds.items()}
    section.text(
        f"{n} data sets of a exp(-b x) + c, 30 readings each, bounds, covariance, noise level "
        "from the residuals. leastsq and optimistix are without bounds and covariance here. All "
        "start at the same values; everyone's tolerances are the default, optimistix' 1e-8. Some "
        "work on the first of the fits alone, the time is "
        "per fit."
    )
    section.table(
        ["contestant", "fits", "time per fit", "fits per second", "time / ours", "difference"],
        [
            [
                name,
                f"{counts[name]}",
                measure.time_spread(seconds[name]),
                f"{1.0 / float(np.median(seconds[name])):.0f}",
                measure.ratio(seconds[name], seconds["ours"]),
                "" if name == "ours" else f"{_difference(turns.outcomes[name], ours.value):.1e}",
            ]
            for name in calls
        ],
    )
    warm = float(np.median(turns.seconds["ours"]))
    section.text(
        f"First call of ours, nothing compiled: {cold:.2f} s, then {warm:.3f} s. "
        f"{int(ours.refitted.sum())} fits were made again one by one."
    )
    for name, wanted in (("scipy leastsq", 10.0), ("scipy curve_fit, bounded", 80.0)):
        found = float(np.median(seconds[name] / seconds["ours"]))
        section.target(
            f"{n} fits: {name}, time / ours",
            f"at least {wanted:g}",
            f"{found:.3g}",
            found >= wanted,
        )
    failed = int(np.count_nonzero(~ours.converged))
    section.target(f"of {n} fits converge", "all", f"all but {failed}", failed == 0)
    _agree(section, y, ours)
    _grow(section, y, sizes.batch_repeats)
    _memory(section, n)


def _others(y: np.ndarray) -> dict[str, Callable[[], np.ndarray]]:
    """Every other contestant as a function that returns values, shape (fits, 3)."""
    lower, upper = np.zeros(3), np.full(3, UPPER)
    lmfit_fit = peers.LmfitFit(numpy_decay, NAMES)
    solver = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)

    def residuals(vector: Any, reading: Any) -> Any:
        return decay(dict(zip(NAMES, vector, strict=True)), X) - reading

    @jax.jit
    @jax.vmap
    def optimistix_fit(reading: Any) -> Any:
        start = jnp.asarray(START)
        end = optimistix.least_squares(residuals, solver, start, reading, throw=False)
        return end.value

    def numpy_residuals(vector: np.ndarray, reading: np.ndarray) -> np.ndarray:
        return numpy_decay(X, *vector) - reading

    def ours(reading: np.ndarray) -> list[float]:
        found = fit(Problem.from_function(decay, parameters(), X, reading)).parameters
        return [found[name].value for name in NAMES]

    def looped(one: Callable[[np.ndarray], Any], name: str) -> Callable[[], np.ndarray]:
        return lambda: np.array([one(reading) for reading in y[: SAMPLES[name]]])

    singles = {
        "scipy leastsq": lambda r: leastsq(numpy_residuals, START, args=(r,))[0],
        "scipy curve_fit, bounded": lambda r: (
            peers.scipy_fit(numpy_decay, X, r, START, lower, upper).values
        ),
        "lmfit, bounded": lambda r: lmfit_fit(X, r, START, lower, upper).values,
        "calibration.fit": ours,
    }
    calls = {name: looped(one, name) for name, one in singles.items()}
    batch = y[: SAMPLES["optimistix, vmap"]]
    return calls | {"optimistix, vmap": lambda: np.asarray(optimistix_fit(batch))}


def _difference(theirs: np.ndarray, ours: np.ndarray) -> float:
    return float(np.max(np.abs(theirs / ours[: len(theirs)] - 1.0)))


def _agree(section: Section, y: np.ndarray, ours: Any) -> None:
    """Against scipy with its tolerances as tight as they go."""
    tight = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
    ends = [
        curve_fit(numpy_decay, X, reading, START, bounds=(0.0, UPPER), **tight)
        for reading in y[: SAMPLES["scipy curve_fit, bounded"]]
    ]
    values = _difference(np.array([value for value, _ in ends]), ours.value)
    stds = _difference(np.array([np.sqrt(np.diag(c)) for _, c in ends]), ours.std)
    section.target(
        "values beside curve_fit at its tightest",
        f"relative difference of at most {AGREEMENT:g}",
        f"{values:.1e} (standard deviations {stds:.1e})",
        values <= AGREEMENT,
    )


def _grow(section: Section, y: np.ndarray, repeats: int) -> None:
    more = np.concatenate([y] * 10)
    calls = {len(ys): partial(fit_many, decay, parameters(), X, ys) for ys in (y, more)}
    seconds = measure.interleaved(calls, repeats).seconds
    small, large = calls
    growth = float(np.median(seconds[large] / seconds[small]))
    section.text(
        f"{large} fits: {measure.time_spread(seconds[large])}, "
        f"{large / float(np.median(seconds[large])):.0f} per second."
    )
    section.target(
        f"time of {large} fits over {small}", "at most 10 times, linear", f"{growth:.3g} times",
        growth <= SLACK * 10.0,
    )  # fmt: skip


def _memory(section: Section, n: int) -> None:
    peaks = {}
    for fits in (n, 100 * n):
        line = [sys.executable, "-m", "benchmarks.many", str(fits)]
        done = subprocess.run(
            line, cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=600
        )
        if done.returncode:
            raise RuntimeError(f"the stream of {fits} fits failed: {done.stderr.strip()[-300:]}")
        peaks[fits] = json.loads(done.stdout)
    section.heading("Memory of a stream")
    section.text(f"A fresh process each; blocks of {BLOCK} fits, made as they are asked for.")
    section.table(
        ["fits", "peak memory", "fits per second, making the readings included"],
        [
            [f"{fits}", f"{found['peak']:.0f} MiB", f"{found['rate']:.0f}"]
            for fits, found in peaks.items()
        ],
    )
    growth = peaks[100 * n]["peak"] / peaks[n]["peak"]
    section.target(
        f"peak memory of {100 * n} fits over {n}", "at most 1.1", f"{growth:.3g}", growth <= 1.1
    )


def _stream(fits: int) -> dict[str, float]:
    """Peak memory [MiB] and speed of a stream of fits."""
    blocks = ((X, readings(min(BLOCK, fits - i), seed=i)) for i in range(0, fits, BLOCK))
    total = 0

    def count() -> None:
        nonlocal total
        total = sum(int(part.converged.sum()) for part in fit_stream(decay, parameters(), blocks))

    seconds, _ = measure.first_call(count)
    if total != fits:
        raise RuntimeError(f"{fits - total} of {fits} fits did not converge")
    return {"peak": measure.peak_memory(), "rate": fits / seconds}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    print(json.dumps(_stream(int(sys.argv[1]))))
