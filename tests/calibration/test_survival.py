"""Long runs: however they are cut, killed and resumed, the draws are the same to the bit."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from calibration import Normal, Parameter, Problem, fit, sample
from calibration.checkpoint import Checkpoint
from calibration.samplers import driver
from procmodel.errors import InputError

X = np.linspace(0.0, 4.0, 12)
Y = 1.0 + 0.5 * X + 0.3 * np.random.default_rng(0).normal(size=12)
LENGTHS = {"stretch": 32_000, "emcee": 1_600, "nuts": 400}


def line(params, x):
    return params["a"] + params["b"] * x


def bent_line(params, x):
    return params["a"] + params["b"] * x**2


def problem(model=line, y=Y, **changed):
    parameters = {"a": Parameter(0.0, prior=Normal(0.0, 5.0)), "b": Parameter(0.1, bounds=(-3, 3))}
    return Problem.from_function(model, parameters | changed, X, y, 0.3)


@pytest.fixture(scope="module")
def start():
    return fit(problem())


def run(start, sampler, **options):
    return sample(problem(), 7, LENGTHS[sampler], sampler, ensembles=2, start=start, **options)


def assert_same_bits(one, other):
    for name in ("a", "b"):
        np.testing.assert_array_equal(one["posterior"][name], other["posterior"][name])
    np.testing.assert_array_equal(one["sample_stats"]["lp"], other["sample_stats"]["lp"])
    assert one.attrs == other.attrs


@pytest.fixture(scope="module")
def whole(start):
    """Uninterrupted runs, made when first asked for."""
    made = {}

    def of(sampler):
        if sampler not in made:
            made[sampler] = run(start, sampler)
        return made[sampler]

    return of


class Stopped:
    """Progress that stops the run, as Ctrl-C does, once so much of a stage is done."""

    def __init__(self, stage, share):
        self.stage, self.share, self.seen = stage, share, set()

    def __call__(self, stage, done, total):
        self.seen.add((stage, done is None))
        if stage == self.stage and done is not None and self.share * total <= done < total:
            raise KeyboardInterrupt


@pytest.mark.parametrize("sampler", LENGTHS)
@pytest.mark.parametrize("stage", ["warm-up", "sampling"])
def test_a_run_that_was_stopped_goes_on_to_the_same_draws(
    tmp_path, start, whole, sampler, stage, monkeypatch
):
    # Small pieces, so that there is something to stop between.
    monkeypatch.setattr(driver, "_PIECE_SECONDS", 0.002)
    path = tmp_path / "run.h5"
    stopped = Stopped(stage, 0.3)
    with pytest.raises(KeyboardInterrupt):
        run(start, sampler, checkpoint=path, progress=stopped)
    assert ("warm-up", True) in stopped.seen  # compiling is told apart from running
    monkeypatch.setattr(driver, "_PIECE_SECONDS", 0.05)
    assert_same_bits(run(start, sampler, checkpoint=path, resume=True), whole(sampler))


def test_a_finished_run_is_read_back_without_running(tmp_path, start, whole):
    path = tmp_path / "run.h5"
    run(start, "stretch", checkpoint=path)
    told = []
    again = run(
        start, "stretch", checkpoint=path, resume=True, progress=lambda *seen: told.append(seen)
    )
    assert_same_bits(again, whole("stretch"))
    assert all(stage == "fit" for stage, _, _ in told)


def test_another_seed_gives_other_draws(start, whole):
    other = sample(problem(), 8, LENGTHS["stretch"], "stretch", ensembles=2, start=start)
    assert not np.array_equal(other["posterior"]["a"], whole("stretch")["posterior"]["a"])


KILLED = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
from pathlib import Path
from tests.calibration.test_survival import KILLED_DRAWS, line, problem
from calibration import sample

def slowly(stage, done, total):
    print(stage, done, flush=True)

sample(problem(), 3, KILLED_DRAWS, "stretch", ensembles=2, checkpoint=sys.argv[1], resume=True,
       progress=slowly)
"""
KILLED_DRAWS = 800_000


@pytest.mark.slow
def test_kill_minus_nine(tmp_path):
    path, root = tmp_path / "run.h5", Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], cwd=root, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    for told in process.stdout:
        if told.startswith("sampling") and path.exists():
            break
    time.sleep(0.3)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    with h5py.File(path) as file:
        kept = len(file["log_density"]) if "log_density" in file else 0
        assert int(file["warmed"][()]) > 0
    assert kept < KILLED_DRAWS / 16
    resumed = sample(
        problem(), 3, KILLED_DRAWS, "stretch", ensembles=2, checkpoint=path, resume=True
    )
    assert_same_bits(resumed, sample(problem(), 3, KILLED_DRAWS, "stretch", ensembles=2))
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5"]


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("seed 7, this one has 8", {"seed": 8}),
        ("draws 32000, this one has 64000", {"draws": 64_000}),
        ("ensembles 2, this one has 3", {"ensembles": 3}),
        ("walkers 16, this one has 20", {"walkers": 20}),
        ("warm-up 1000, this one has 5", {"warmup": 5}),
        ("sampler stretch, this one has emcee", {"sampler": "emcee", "draws": 32_000}),
        ("data ", {"problem": problem(y=Y + 0.001)}),
        ("model line, this one has bent_line", {"problem": problem(bent_line)}),
        ("parameters ", {"problem": problem(b=Parameter(0.1, bounds=(-2, 3)))}),
    ],
)
def test_a_changed_configuration_is_refused_by_name(tmp_path, start, what, change):
    path = tmp_path / "run.h5"
    run(start, "stretch", checkpoint=path)
    before = path.read_bytes()
    options = {"problem": problem(), "seed": 7, "draws": 32_000, "sampler": "stretch"}
    options |= {"ensembles": 2, "start": None} | change
    with pytest.raises(InputError, match="belongs to a run with") as refused:
        sample(**options, checkpoint=path, resume=True)
    assert what in str(refused.value) or "start" in str(refused.value)
    assert path.read_bytes() == before


def test_code_of_the_model_is_part_of_the_configuration(tmp_path, start):
    def changed(params, x):
        return params["a"] + params["b"] * x + 0.0 * x**3

    changed.__name__ = "line"
    path = tmp_path / "run.h5"
    run(start, "stretch", checkpoint=path)
    with pytest.raises(InputError, match="model code"):
        sample(problem(changed), 7, 32_000, "stretch", ensembles=2, checkpoint=path, resume=True)


def test_existing_checkpoints_are_not_overwritten_by_accident(tmp_path, start):
    path = tmp_path / "run.h5"
    path.write_text("something else")
    with pytest.raises(InputError, match=r"run.h5 exists: resume the run"):
        run(start, "stretch", checkpoint=path)
    with pytest.raises(InputError, match="is not a checkpoint of this library"):
        run(start, "stretch", checkpoint=path, resume=True)
    assert path.read_text() == "something else"
    with pytest.raises(InputError, match=r"ends in \.h5"):
        run(start, "stretch", checkpoint=tmp_path / "run.txt")
    with pytest.raises(InputError, match="resume needs the checkpoint"):
        run(start, "stretch", resume=True)


def test_a_write_that_fails_leaves_the_last_checkpoint(tmp_path):
    checkpoint = Checkpoint(tmp_path / "run.h5", {"seed": 1}, resume=False)
    checkpoint.save({"a": np.arange(3)})
    with pytest.raises(TypeError):
        checkpoint.save({"a": np.array([object()])})
    again = Checkpoint(tmp_path / "run.h5", {"seed": 1}, resume=True)
    np.testing.assert_array_equal(again.load()["a"], np.arange(3))
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5"]
