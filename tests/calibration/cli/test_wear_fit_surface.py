"""`fit-surface` on a cavity whose depth is known in closed form."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from calibration.cli.wear_fit_surface import fit_surface_command
from calibration.cli.wear_plan_belief import believed_of
from procmodel.errors import InputError
from procmodel.io import write_table

# A plunge of 8 um with a square electrode wears it evenly: depth = feed / (1 + R).
FEED, RATIO, SIDE = 8.0, 0.25, 6.0


@pytest.fixture
def files(tmp_path):
    line = np.arange(-5.5, 6.0, 1.0)
    x, y = (values.ravel() for values in np.meshgrid(line, line))
    inside = (np.abs(x) < SIDE / 2) & (np.abs(y) < SIDE / 2)
    z = np.where(inside, FEED / (1.0 + RATIO), 0.0)
    z += np.random.default_rng(1).normal(0.0, 0.02, len(z))
    write_table(tmp_path / "map.csv", {"x [um]": x, "y [um]": y, "z [um]": -z})
    write_table(
        tmp_path / "paths.csv",
        {
            "layer [1]": [1], "x [um]": [0.0], "y [um]": [0.0], "cumulative feed [um]": [FEED],
            "cutting [1]": [0], "quarter turns [1]": [0],
        },
    )  # fmt: skip
    return tmp_path


def run(files, *arguments):
    """The command alone, as the application registers it."""
    app = typer.Typer()
    app.command()(fit_surface_command)
    command = ["map.csv", "--paths", "paths.csv", "--electrode-side", SIDE, "--cell", 1, *arguments]
    paths = {name: str(files / name) for name in ("map.csv", "paths.csv", "fit.json")}
    return CliRunner().invoke(app, [paths.get(str(a), str(a)) for a in command])


@pytest.mark.slow
def test_wear_ratio_of_a_plunge_and_a_plan_on_it(files):
    done = run(
        files, "--wear-mode", "uniform", "--unknown", "wear_ratio", "--out", "fit.json", "--json"
    )
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    ratio = result["parameters"]["wear_ratio"]
    assert ratio["value"] == pytest.approx(RATIO, abs=4.0 * ratio["std"])
    assert ratio["std"] < 0.002
    assert result["told"] == result["unknown"] == ["wear_ratio"]
    assert result["z_counts_upwards"] is True
    assert result["wear_per_area"] == pytest.approx(ratio["value"] / SIDE**2)
    assert result["readings"] + result["readings_left_out"] == 144
    assert json.loads((files / "fit.json").read_text()) == result
    believed, notes = believed_of(None, files / "fit.json", None, SIDE**2)
    assert np.median(believed) == pytest.approx(ratio["value"], rel=1e-9)
    assert notes == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--unknown", "wear_ration"), "--unknown wear_ration is not known"),
        (("--cell", "0"), "--cell is 0"),
        (("--feed", "-1"), "--feed is -1"),
        (("--gap", "-1"), "--gap is -1"),
        (("--noise", "0"), "--noise is 0"),
        (("--greatest-gap", "0"), "--greatest-gap is 0"),
        (("--electrode-diameter", "5"), "another size of the electrode"),
        (("--cell", "4"), "cell 4 um is larger than half"),
    ],
)
def test_bad_input_is_named(files, arguments, words):
    done = run(files, *arguments)
    assert isinstance(done.exception, InputError)
    assert words in str(done.exception)


def test_sigma_column_and_noise_are_one_too_many(files):
    table = (files / "map.csv").read_text().splitlines()
    table = [table[0] + ",sigma [um]", *(row + ",0.1" for row in table[1:])]
    (files / "map.csv").write_text("\n".join(table))
    done = run(files, "--noise", "0.1")
    assert "has a sigma column and --noise is given" in str(done.exception)
