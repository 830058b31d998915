"""Every Python block of the README runs, and its job file is accepted."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calibration.cli import main
from calibration.cli.demo import simulated_profile
from procmodel.io import write_table

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.fixture
def measured(tmp_path):
    folder = tmp_path / "demo-output"
    folder.mkdir()
    x, z = simulated_profile()
    write_table(folder / "cavity.csv", {"x [um]": x, "z [um]": z})
    write_table(tmp_path / "cavity.csv", {"x [um]": x, "z [um]": z})
    return tmp_path


SCRIPTS = (
    "plan", "own model", "many fits", "derivative", "cavity", "tool path", "chatter", "electrode",
)  # fmt: skip


def test_every_script_is_known():
    assert len(blocks("python")) == len(SCRIPTS)


@pytest.mark.parametrize("script", blocks("python"), ids=SCRIPTS)
def test_script(script, measured):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], cwd=measured, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_job_file_of_a_command(measured, capsys):
    job, _ = blocks("toml")
    (measured / "job.toml").write_text(job, encoding="utf-8")
    with pytest.raises(SystemExit) as stop:
        main(["run", str(measured / "job.toml")])
    assert stop.value.code == 0
    assert "wear_ratio" in capsys.readouterr().out


def test_job_file_of_a_model(tmp_path, capsys):
    _, job = blocks("toml")
    (tmp_path / "job.toml").write_text(job, encoding="utf-8")
    model = "import jax.numpy as jnp\n\n\ndef decay(params, t):\n"
    model += "    return params['offset'] + params['height'] * jnp.exp(-t / params['length'])\n"
    (tmp_path / "decay.py").write_text(model, encoding="utf-8")
    t = np.linspace(0.0, 5.0, 60)
    noise = np.random.default_rng(0).standard_t(4, 60)
    write_table(
        tmp_path / "decay.csv", {"t [s]": t, "v [V]": 3.0 * np.exp(-t / 1.5) + 0.05 * noise}
    )
    with pytest.raises(SystemExit) as stop:
        main(["fit", str(tmp_path / "job.toml"), "--json"])
    assert stop.value.code == 0
    found = json.loads(capsys.readouterr().out)["parameters"]
    for name, true in (("height", 3.0), ("length", 1.5), ("scatter", 0.05)):
        assert abs(found[name]["value"] - true) < 4.0 * found[name]["std"]
