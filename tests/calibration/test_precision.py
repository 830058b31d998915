"""Entry points that need double precision say so in a script that forgot it."""

import os
import subprocess
import sys

SCRIPT = """
import jax
import calibration.sampling, calibration.plans.schedule, procmodel.wear
assert not jax.config.jax_enable_x64, "an import switched double precision on"
from calibration import Parameter, Problem, fit, sample
from calibration.plans.schedule import exact_schedule, optimised_schedule
from procmodel.wear import pyramid, slice_solid

layers = slice_solid(pyramid(50.0, 0.8), 5.0)
problem = Problem.from_function(lambda p, x: p["a"] * x, {"a": Parameter(1.0)}, [1.0], [2.0], 1.0)
for call in (
    lambda: fit(problem),
    lambda: sample(problem),
    lambda: exact_schedule(layers, 0.1, 100.0),
    lambda: optimised_schedule(layers, 0.1, 100.0),
):
    try:
        call()
    except RuntimeError as refusal:
        print(refusal)
jax.config.update("jax_enable_x64", True)
layers = slice_solid(pyramid(50.0, 0.8), 5.0)
print(exact_schedule(layers, 0.1, 100.0).status)
"""


def test_single_precision_is_refused_with_the_remedy_and_imports_set_no_flag():
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    *refusals, status = done.stdout.strip().splitlines()
    assert len(refusals) == 4
    for refusal in refusals:
        assert "needs 64-bit floats: call jax.config.update('jax_enable_x64', True)" in refusal
    assert status.startswith("exact feeds for")
