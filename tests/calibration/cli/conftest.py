import json
import math

import numpy as np
import pytest

from calibration.cli import main
from procmodel.io import write_table

ELECTRODE = ["--electrode-diameter", "100"]
CAVITY = ["--section", "square", "--half-width", "250", "--feed", "2", "--step", "2", *ELECTRODE]


def wall(wear_ratio=0.3, layers=100, gap=0.0, x=None):
    """Independent of the library: eq. (4) by hand, drawn through the corners with np.interp."""
    positions = 250.0 - 2.0 * np.arange(layers)
    areas = 4.0 * (positions + gap) ** 2
    depths = np.cumsum(2.0 / (1.0 + wear_ratio * areas / (math.pi * 50.0**2)))
    x = positions[::-1] if x is None else x
    return x, np.interp(x, positions[::-1] + gap, depths[::-1])


@pytest.fixture
def profile(tmp_path):
    x, z = wall()
    path = tmp_path / "cavity.csv"
    noise = np.random.default_rng(5).normal(0.0, 1.0, len(x))
    write_table(path, {"x [um]": x, "z [um]": z + noise})
    return path


@pytest.fixture
def run(capsys):
    """Run the command in this process: exit code, stdout, stderr."""

    def run(*arguments):
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return stop.value.code, captured.out, captured.err

    return run


@pytest.fixture
def run_json(run):
    """Run with --json; the one object on stdout."""

    def run_json(*arguments):
        code, out, err = run(*arguments, "--json")
        assert code == 0, err
        assert out.count("\n") == 1
        return json.loads(out)

    return run_json
