"""From a new process to a posterior: ours with and without a warm cache, beside emcee."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import measure
from benchmarks.report import Section
from benchmarks.sizes import Sizes

_OURS = """
from calibration.cli.runtime import prepare_jax
prepare_jax()
from benchmarks.posteriors import posteriors
from calibration import sample
tree = sample(posteriors()[0].problem)
print(float(tree["posterior"]["wear_ratio"].mean()))
"""
# The same posterior in the few lines that a user of emcee writes.
_EMCEE = """
import numpy as np, emcee
walls = 250.0 - 2.0 * np.arange(100)
def depths(ratio, gap, zero):
    return zero + np.cumsum(2.0 / (1.0 + ratio * 4.0 * (walls + gap) ** 2 / (np.pi * 50.0**2)))
y = depths(0.3, 3.0, 0.5) + np.random.default_rng(11).normal(0.0, 1.0, 100)
def density(v):
    if v[0] < 0 or v[1] < 0:
        return -np.inf
    return -0.5 * (np.sum((depths(*v) - y) ** 2) + (v[1] - 3.0) ** 2)
from scipy.optimize import least_squares
def residuals(v):
    return np.append(depths(*v) - y, v[1] - 3.0)
best = least_squares(residuals, [0.2, 3.0, 0.0], x_scale="jac")
spread = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
start = best.x + spread * np.random.default_rng(0).normal(size=(16, 3))
sampler = emcee.EnsembleSampler(16, 3, density)
sampler.run_mcmc(sampler.run_mcmc(start, 2000), 4000)
print(sampler.get_chain(discard=2000, flat=True)[:, 0].mean())
"""


def run(section: Section, sizes: Sizes) -> None:
    root = Path(__file__).parents[1]
    seconds: dict[str, list[float]] = {"ours, cold": [], "ours, warm cache": [], "emcee": []}
    means: dict[str, float] = {}
    for _ in range(sizes.process_repeats // 2 + 1):
        with tempfile.TemporaryDirectory(prefix="procmodel-bench-") as folder:
            for name, script in (
                ("ours, cold", _OURS),
                ("ours, warm cache", _OURS),
                ("emcee", _EMCEE),
            ):
                environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
                environment["XDG_CACHE_HOME"] = folder
                begin = time.perf_counter()
                done = subprocess.run(
                    [sys.executable, "-c", script],
                    env=environment,
                    cwd=root,
                    capture_output=True,
                    text=True,
                )
                seconds[name].append(time.perf_counter() - begin)
                if done.returncode:
                    raise RuntimeError(f"{name} failed: {done.stderr.strip()[-300:]}")
                means[name] = float(done.stdout.split()[-1])
    section.text(
        "Wear ratio, gap and zero of a wear curve: a new process imports, fits and samples, and "
        "exits. Ours makes 4 ensembles of 16 walkers with diagnostics, emcee one ensemble of 16 "
        "walkers, 4000 steps after 2000 each. Cold has nothing compiled before."
    )
    rows = [
        [
            name,
            measure.time_spread(np.array(taken)),
            measure.ratio(np.array(taken), np.array(seconds["emcee"])),
            f"{means[name]:.5f}",
        ]
        for name, taken in seconds.items()
    ]
    section.table(["contestant", "time of the process", "time / emcee's", "mean wear ratio"], rows)
