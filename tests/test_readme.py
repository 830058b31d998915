"""Every Python block of the README runs, and its job file is accepted."""

import re
import subprocess
import sys
from pathlib import Path

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


def test_there_are_three_scripts():
    assert len(blocks("python")) == 3


@pytest.mark.parametrize("script", blocks("python"), ids=("plan", "own model", "derivative"))
def test_script(script, measured):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], cwd=measured, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_job_file(measured, capsys):
    (job,) = blocks("toml")
    (measured / "job.toml").write_text(job, encoding="utf-8")
    with pytest.raises(SystemExit) as stop:
        main(["run", str(measured / "job.toml")])
    assert stop.value.code == 0
    assert "wear_ratio" in capsys.readouterr().out
