import json

import numpy as np
import pytest
import xarray

from procmodel.io import write_table

from .conftest import CAVITY, wall


def test_json_has_what_others_rely_on(profile, run_json):
    result = run_json("wear", "fit", profile, *CAVITY)
    ratio = result["parameters"]["wear_ratio"]
    assert set(ratio) >= {"value", "std", "interval95", "unit", "verdict"}
    assert ratio["value"] == pytest.approx(0.3, abs=4 * ratio["std"])
    assert ratio["std"] / ratio["value"] == pytest.approx(0.0057, rel=0.2)
    assert ratio["verdict"] == "identified"
    assert result["converged"] is True
    assert result["status"].startswith("converged")
    assert result["residual_rms"] == pytest.approx(1.0, rel=0.25)
    assert result["wear_per_area"] == pytest.approx(ratio["value"] / (np.pi * 2500))
    assert isinstance(result["warnings"], list)


def test_exact_profile_gives_the_exact_ratio(tmp_path, run_json):
    x, z = wall(wear_ratio=0.27)
    path = tmp_path / "exact.csv"
    write_table(path, {"x [mm]": x / 1000, "z [mm]": -z / 1000}, decimals=12)
    result = run_json("wear", "fit", path, *CAVITY)
    assert result["parameters"]["wear_ratio"]["value"] == pytest.approx(0.27, rel=1e-7)
    assert result["z_counts_upwards"] is True


def test_fitted_gap_and_its_trade_off(tmp_path, run_json):
    x, z = wall()
    depths = z + np.random.default_rng(8).normal(0.0, 1.0, len(x))
    path = tmp_path / "depths.csv"
    write_table(path, {"x [um]": x, "z [um]": depths})
    free = run_json("wear", "fit", path, *CAVITY, "--fit-gap", "--gap", 3, "--readings", "depths")
    correlation = free["correlations"].get("wear_ratio,gap")
    if free["parameters"]["gap"]["std"] is not None:
        assert correlation == pytest.approx(-0.987, abs=0.004)
        assert any("wear_ratio and gap trade off" in text for text in free["warnings"])
    else:  # noise may push the gap onto its bound at 0, which has to be said
        assert free["parameters"]["gap"]["verdict"] == "one-sided"


def test_free_electrode_area_is_flat_by_name(profile, run):
    code, out, _ = run("wear", "fit", profile, *CAVITY, "--fit-electrode-area", "--json")
    result = json.loads(out)
    assert code == 0
    verdicts = {name: p["verdict"] for name, p in result["parameters"].items()}
    assert verdicts["wear_ratio"] == verdicts["electrode_area"] == "flat"
    assert verdicts["wear_per_area"] == "identified"
    assert "wear_ratio and electrode_area cannot be told apart" in result["cannot_tell"][0]


def test_report_is_for_people(profile, run):
    code, out, err = run("wear", "fit", profile, *CAVITY)
    assert code == 0
    assert err == ""
    for word in ("data", "solver", "status", "wear_ratio", "identified", "bounds hit", "condition"):
        assert word in out


def test_solvers_agree(profile, run_json):
    ours, theirs = (
        run_json("wear", "fit", profile, *CAVITY, "--solver", solver)["parameters"]["wear_ratio"]
        for solver in ("box_lm", "scipy")
    )
    assert ours["value"] == pytest.approx(theirs["value"], rel=1e-7)
    assert ours["std"] == pytest.approx(theirs["std"], rel=1e-5)


def test_picture_result_and_posterior_are_written(profile, tmp_path, run_json):
    picture, result, draws = tmp_path / "fit.png", tmp_path / "fit.json", tmp_path / "post.nc"
    printed = run_json(
        "wear", "fit", profile, *CAVITY, "--plot", picture, "--out", result,
        "--posterior", draws, "--draws", 1600,
    )  # fmt: skip
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads(result.read_text())["data_hash"] == printed["data_hash"]
    tree = xarray.load_datatree(draws, engine="h5netcdf")
    assert tree.attrs["data_hash"] == printed["data_hash"]
    ratio = printed["parameters"]["wear_ratio"]
    mean = float(tree["posterior"]["wear_ratio"].mean())
    assert mean == pytest.approx(ratio["value"], abs=0.5 * ratio["std"])


def test_sigma_column_is_used(tmp_path, run_json):
    x, z = wall()
    rng = np.random.default_rng(2)
    sigma = np.where(x > 150, 0.2, 5.0)
    path = tmp_path / "sigma.csv"
    write_table(path, {"x [um]": x, "z [um]": z + rng.normal(0, sigma), "sigma [um]": sigma})
    result = run_json("wear", "fit", path, *CAVITY)
    assert result["reduced_chi2"] == pytest.approx(1.0, abs=0.4)
    ratio = result["parameters"]["wear_ratio"]
    assert ratio["value"] == pytest.approx(0.3, abs=4 * ratio["std"])
