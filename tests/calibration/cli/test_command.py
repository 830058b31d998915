import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.measured import OUTLINES, needs

from .conftest import CAVITY


def test_help_loads_no_jax():
    code = (
        "import sys\nfrom calibration.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "heavy = {'jax', 'numpy', 'scipy', 'matplotlib', 'xarray', 'pint'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_importing_calibration_loads_no_jax_and_sets_nothing():
    code = (
        "import sys, calibration, procmodel\nassert 'jax' not in sys.modules\n"
        "from calibration import Parameter, Problem, fit, sample\nimport calibration.fitting\n"
        "import jax\nassert not jax.config.jax_enable_x64\n"
        "from calibration import fit as again\nassert again is fit and callable(fit)\n"
        "try:\n    fit(Problem.from_function(lambda p, x: p['a'] * x,"
        " {'a': Parameter(1.0)}, [1.0, 2.0], [1.0, 2.0]))\n"
        "except RuntimeError as error:\n    assert 'jax_enable_x64' in str(error)\n"
        "else:\n    raise AssertionError\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_installed_command_prints_its_version():
    command = Path(sys.executable).parent / "procmodel"
    done = subprocess.run([command, "--version"], check=True, capture_output=True, text=True)
    assert done.stdout.startswith("procmodel ")


@needs(OUTLINES)
def test_volume_ratio_of_the_measured_outlines(run_json):
    result = run_json("wear", "volume-ratio", "--tool", OUTLINES / "flat1_tool_um.csv",
                      "--work", OUTLINES / "flat1_work_um.csv")  # fmt: skip
    assert result["wear_ratio"]["value"] == pytest.approx(0.16837, abs=5e-5)
    assert 0.0005 < result["wear_ratio"]["std"] < 0.005


def test_volume_ratio_of_rectangles(tmp_path, run_json):
    tool, work = tmp_path / "tool.csv", tmp_path / "work.csv"
    tool.write_text("x [um],y [um]\n0,5000\n0,100\n2000,100\n2000,5000\n")
    work.write_text("x [mm],y [mm]\n0,0.1\n0,-0.5\n2,-0.5\n2,0.1\n")
    result = run_json("wear", "volume-ratio", "--tool", tool, "--work", work)
    assert result["wear_ratio"]["value"] == pytest.approx(0.2, rel=1e-9)


def test_predict_known_answer(run_json):
    result = run_json("wear", "predict", "--half-width", 100, "--step", 10, "--feed", 10,
                      "--wear-ratio", 0.2, "--electrode-area", 1e4)  # fmt: skip
    assert result["layers"] == 10
    assert result["depth"] == pytest.approx(79.322654, abs=1e-6)
    assert result["electrode_length"] == pytest.approx(100 - 79.322654, abs=1e-6)
    assert result["corners"]["z"][0] == pytest.approx(5.555556, abs=1e-6)


def test_job_file_does_what_the_options_do(profile, run, run_json):
    job = profile.parent / "job.toml"
    job.write_text(
        'command = "wear fit"\nprofile = "cavity.csv"\nsection = "square"\nhalf-width = 250\n'
        "feed = 2\nstep = 2\nelectrode_diameter = 100\nfit-gap = false\njson = true\n"
        'out = "from_job.json"\n'
    )
    code, out, err = run("run", job)
    assert code == 0, err
    direct = run_json("wear", "fit", profile, *CAVITY)
    assert json.loads(out)["parameters"] == direct["parameters"]
    assert (profile.parent / "from_job.json").is_file()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('command = "wear fix"\n', ("wear fix", "fit")),
        ('command = "wear fit"\nhalfwidth = 250\n', ("halfwidth", "half-width")),
        ("half-width = 250\n", ("command",)),
        ("command = \n", ("TOML",)),
        ('command = "run"\n', ("command",)),
        ('command = "wear fit"\nfeed = true\n', ("feed",)),
    ],
)
def test_faulty_job(text, words, tmp_path, run):
    job = tmp_path / "job.toml"
    job.write_text(text)
    code, out, err = run("run", job)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "job.toml" in err
    assert all(word in err for word in words), err


def test_demo_makes_its_files(tmp_path, run):
    folder = tmp_path / "a folder"
    code, out, _ = run("demo", "--folder", folder)
    assert code == 0
    assert "wear_ratio" in out
    for name in ("cavity.csv", "fit.json", "fit.png", "plan.csv", "plan.nc", "plan.png"):
        assert (folder / name).stat().st_size > 0
    fitted = json.loads((folder / "fit.json").read_text())["parameters"]["wear_ratio"]
    low, high = fitted["interval95"]
    assert low < 0.3 < high
