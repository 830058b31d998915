"""Entry points that need double precision say so in a script that forgot it."""

import os
import subprocess
import sys

import pytest

SCRIPTS = {
    "fit": (
        "from calibration import Parameter, Problem, fit\n"
        "fit(Problem.from_function(lambda p, x: p['a'] * x, {'a': Parameter(1.0)}, [1.0], [2.0]))"
    ),
    "sample": (
        "from calibration import Parameter, Problem, sample\n"
        "sample(Problem.from_function(lambda p, x: p['a'] * x, {'a': Parameter(1.0)}, [1.0], [2.]))"
    ),
    "schedule": (
        "from calibration.plans.schedule import exact_schedule\n"
        "from procmodel.wear import pyramid, slice_solid\n"
        "exact_schedule(slice_solid(pyramid(50.0, 0.8), 5.0), 0.1, 100.0)"
    ),
}


def run(script, x64):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment["JAX_ENABLE_X64"] = "1" if x64 else "0"
    return subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment
    )


@pytest.mark.parametrize("entry", SCRIPTS)
def test_single_precision_is_refused_with_the_remedy(entry):
    done = run(SCRIPTS[entry], x64=False)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("RuntimeError: ")
    assert "needs 64-bit floats: call jax.config.update('jax_enable_x64', True)" in last


def test_double_precision_is_let_through():
    done = run(SCRIPTS["schedule"], x64=True)
    assert done.returncode == 0, done.stderr


def test_importing_sets_no_global_flag():
    script = "import calibration, procmodel.wear, calibration.fitting, calibration.sampling, jax\n"
    done = run(script + "raise SystemExit(3 if jax.config.jax_enable_x64 else 0)", x64=False)
    assert done.returncode == 0, done.stderr
