"""`procmodel force fit`: a table in, coefficients with intervals out."""

import json
import math

import numpy as np
import pytest

from procmodel.engagement import ForceCoefficients, instantaneous_force, mean_force
from procmodel.io import read_coefficients, write_table

TRUTH = ForceCoefficients(796.0, 168.8, 222.0, 27.7, 30.8, 1.4)
NAMES = ("tangential_shear", "radial_shear", "axial_shear", "tangential_edge", "radial_edge")


def conditions(feed):
    return {"feed per tooth [mm]": feed, "axial depth [mm]": np.full(len(feed), 5.0)}


def columns(forces):
    return {
        f"{axis} [N]": values for axis, values in zip(("Fx", "Fy", "Fz"), forces.T, strict=True)
    }


@pytest.fixture
def means(tmp_path):
    """Mean forces in down milling, by engagement angle."""
    feed, angle = (g.ravel() for g in np.meshgrid([0.02, 0.04, 0.08], [20.0, 60.0, 120.0]))
    start = np.pi - np.radians(angle)
    exact = np.asarray(mean_force(TRUTH, start, np.full(9, np.pi), 4, np.full(9, 5.0), feed))
    forces = exact + np.random.default_rng(1).normal(0.0, 1.0, exact.shape)
    path = tmp_path / "forces.csv"
    write_table(path, {**conditions(feed), "engagement angle [deg]": angle, **columns(forces)})
    return path


@pytest.fixture
def record(tmp_path):
    """Forces along two turns, the rotation counted from 25 deg."""
    rotation = np.arange(0.0, 720.0, 3.0)
    feed = np.where(rotation < 360.0, 0.04, 0.08)
    start, exit = np.full(240, 140.0), np.full(240, 180.0)
    exact = np.asarray(
        instantaneous_force(
            TRUTH, np.radians((rotation + 25.0) % 360.0), np.radians(start), np.radians(exit), 4,
            np.full(240, 5.0), feed, 5.0, math.radians(30.0),
        )
    )  # fmt: skip
    forces = exact + np.random.default_rng(2).normal(0.0, 1.0, exact.shape)
    arc = {"start [deg]": start, "exit [deg]": exit}
    path = tmp_path / "record.csv"
    write_table(
        path, {"rotation [deg]": rotation, **conditions(feed), **arc, **columns(forces)}, decimals=6
    )
    return path


def test_mean_forces_to_coefficients(means, tmp_path, run_json):
    out, picture = tmp_path / "fit.json", tmp_path / "fit.png"
    result = run_json(
        "force", "fit", means, "--flutes", 4, "--milling", "down", "--noise", 1,
        "--out", out, "--plot", picture,
    )  # fmt: skip
    assert result["converged"] is True
    assert result["flutes"] == 4
    for name in NAMES:
        estimate = result["parameters"][name]
        assert estimate["value"] == pytest.approx(getattr(TRUTH, name), abs=4 * estimate["std"])
        assert estimate["verdict"] == "identified"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads(out.read_text()) == result
    read = read_coefficients(out)
    assert read["radial_edge"] == result["parameters"]["radial_edge"]["value"]


def test_up_milling_is_another_arc(means, run_json):
    up = run_json("force", "fit", means, "--flutes", 4, "--milling", "up")
    down = run_json("force", "fit", means, "--flutes", 4, "--milling", "down")
    assert up["residual_rms"] > 10.0 * down["residual_rms"]


def test_instantaneous_forces_and_the_offset(record, run_json):
    tool = ("--diameter", 10, "--helix", 30)
    result = run_json("force", "fit", record, "--flutes", 4, *tool, "--fit-rotation-offset")
    std = math.degrees(result["parameters"]["rotation_offset"]["std"])
    found = (result["rotation_offset_deg"] - 25.0 + 45.0) % 90.0 - 45.0
    assert abs(found) < max(4.0 * std, 1e-3)
    given = run_json("force", "fit", record, "--flutes", 4, *tool, "--rotation-offset", 25)
    for fitted in (result, given):
        for name in NAMES:
            estimate = fitted["parameters"][name]
            assert estimate["value"] == pytest.approx(
                getattr(TRUTH, name), abs=4.5 * estimate["std"]
            )


def test_report_names_what_one_condition_leaves_open(tmp_path, run):
    feed = np.full(6, 0.04)
    exact = np.asarray(
        mean_force(TRUTH, np.full(6, 2.8), np.full(6, np.pi), 4, np.full(6, 5.0), feed)
    )
    forces = exact + np.random.default_rng(3).normal(0.0, 1.0, exact.shape)
    path = tmp_path / "one.csv"
    arc = {"start [rad]": np.full(6, 2.8), "exit [rad]": np.full(6, math.pi)}
    write_table(path, {**conditions(feed), **arc, **columns(forces)}, decimals=9)
    out = tmp_path / "fit.json"
    code, text, err = run("force", "fit", path, "--flutes", 4, "--out", out)
    assert (code, err) == (0, "")
    assert "axial_shear and axial_edge cannot be told apart" in text
    assert "tangential_shear" in text
    with pytest.raises(ValueError, match="measure at another feed or engagement"):
        read_coefficients(out)


def test_report_is_for_people(means, run):
    code, text, err = run("force", "fit", means, "--flutes", 4, "--milling", "down")
    assert (code, err) == (0, "")
    for word in ("mean cutting force of 4 flutes", "radial_edge", "identified", "N/mm^2"):
        assert word in text


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--flutes", 0), ("--flutes is 0", "1 or more")),
        (("--flutes", 4), ("forces.csv", "engagement angle", "down or up")),
        (("--flutes", 4, "--milling", "climb"), ("--milling is 'climb'", "down or up")),
        (("--flutes", 4, "--milling", "down", "--noise", 0), ("--noise is 0", "above 0")),
        (("--flutes", 4, "--milling", "down", "--helix", 90), ("--helix is 90", "below 90")),
        (("--flutes", 4, "--milling", "down", "--diameter", -1), ("--diameter is -1", "above 0")),
        (
            ("--flutes", 4, "--milling", "down", "--fit-rotation-offset"),
            ("--fit-rotation-offset", "'rotation [deg]'", "forces.csv"),
        ),
        (
            ("--flutes", 4, "--milling", "down", "--rotation-offset", "inf"),
            ("--rotation-offset is inf", "finite"),
        ),
        (("--flutes", 4, "--milling", "down", "--plot", "fit.txt"), ("fit.txt", ".png")),
        (("--flutes", 4, "--milling", "down", "--solver", "newton"), ("solver 'newton'", "known")),
    ],
)
def test_bad_input_is_one_sentence(means, run, options, parts):
    code, out, err = run("force", "fit", means, *options)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


@pytest.mark.parametrize(
    ("given", "missing"), [("--diameter", "--helix"), ("--helix", "--diameter")]
)
def test_instantaneous_forces_need_the_tool(record, run, given, missing):
    code, _, err = run("force", "fit", record, "--flutes", 4, given, 10)
    assert code == 2
    assert f"{missing} is missing: a table of instantaneous forces needs it." in err
