import csv
import math
import re

import numpy as np
import pytest

from procmodel.io import Column, read_table, write_table

from .conftest import CAVITY, ELECTRODE

PYRAMID = ["--shape", "pyramid", "--half-width", "250", "--wall-angle", "45", "--layer-depth", "2"]
HEMISPHERE = ["--shape", "hemisphere", "--radius", "150", "--layer-depth", "2"]
AREA = math.pi * 50.0**2


def read(path):
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_known_pyramid(tmp_path, run_json):
    out = tmp_path / "plan.csv"
    result = run_json("wear", "plan", *PYRAMID, "--wear-ratio", 0.3, *ELECTRODE, "--out", out)
    plan = read(out)
    assert result["layers"] == 125
    assert result["total_feed"] == pytest.approx(1055.349477, abs=1e-6)
    assert plan["feed [um]"][0] == pytest.approx(21.098593, abs=1e-6)
    assert plan["feed [um]"][-1] == pytest.approx(2.001222, abs=1e-6)
    assert result["electrode_length"] == pytest.approx(1055.349477 - 250, abs=0.1)
    assert result["max_wall_error"] <= 0.05 + 1e-9
    np.testing.assert_array_equal(plan["layer"], np.arange(1, 126))
    commanded = plan["cumulative feed [um]"]
    np.testing.assert_allclose(commanded, np.round(commanded, 1), atol=1e-9)
    np.testing.assert_allclose(commanded, np.cumsum(plan["feed [um]"]), atol=0.05 + 1e-6)


def test_hemisphere_follows_equation_6(tmp_path, run_json):
    out = tmp_path / "plan.csv"
    run_json("wear", "plan", *HEMISPHERE, "--depth", 140, "--wear-ratio", 0.2, *ELECTRODE,
             "--out", out)  # fmt: skip
    plan = read(out)
    z, x = plan["target z [um]"], plan["half width [um]"]
    np.testing.assert_allclose(x**2 + z**2, 150.0**2, rtol=1e-6)
    np.testing.assert_allclose(plan["area [um^2]"], math.pi * x**2, rtol=1e-6)
    np.testing.assert_allclose(
        plan["feed [um]"], 2.0 * (1.0 + 0.2 * plan["area [um^2]"] / AREA), rtol=1e-6
    )


def test_cone_and_table_of_the_same_cone_agree(tmp_path, run_json):
    z = np.linspace(0.0, 200.0, 2001)
    table = tmp_path / "areas.csv"
    write_table(table, {"z [um]": z, "area [um^2]": math.pi * (200.0 - z) ** 2})
    common = ["--layer-depth", 4, "--depth", 150, "--wear-ratio", 0.3, *ELECTRODE]
    cone = run_json("wear", "plan", "--shape", "cone", "--radius", 200, "--wall-angle", 45, *common)
    tabulated = run_json("wear", "plan", "--shape", "table", "--table", table, *common)
    assert tabulated["total_feed"] == pytest.approx(cone["total_feed"], rel=1e-5)


def test_plan_on_a_fit_and_on_a_posterior(profile, tmp_path, run_json):
    fit, draws = tmp_path / "fit.json", tmp_path / "posterior.nc"
    found = run_json("wear", "fit", profile, *CAVITY, "--out", fit, "--posterior", draws,
                     "--draws", 3200)  # fmt: skip
    number = found["parameters"]["wear_ratio"]["value"]
    shape = [*HEMISPHERE, "--depth", 100, *ELECTRODE]
    exact = run_json("wear", "plan", *shape, "--wear-ratio", number)
    on_fit = run_json("wear", "plan", *shape, "--fit", fit)
    on_draws = run_json("wear", "plan", *shape, "--posterior", draws)
    assert on_fit["total_feed"] == pytest.approx(exact["total_feed"], rel=1e-9)
    assert on_draws["total_feed"] == pytest.approx(exact["total_feed"], rel=1e-3)
    spread = on_fit["stages"][0]["depth_spread"]
    assert spread > 0.1
    assert on_draws["stages"][0]["depth_spread"] == pytest.approx(spread, rel=0.2)
    assert exact["stages"][0]["depth_spread"] == 0.0


def test_optimised_plan_keeps_its_bounds(tmp_path, run_json):
    out = tmp_path / "plan.csv"
    result = run_json("wear", "plan", *PYRAMID, "--wear-ratio", 0.3, *ELECTRODE, "--optimise",
                      "--greatest-feed", 15, "--out", out)  # fmt: skip
    assert np.max(read(out)["feed [um]"]) <= 15.0 + 1e-9
    assert any("holds back" in warning for warning in result["warnings"])


def test_layer_depths_compared(run_json):
    common = ["--shape", "cone", "--radius", 200, "--wall-angle", 45, "--depth", 120, *ELECTRODE]
    common += ["--wear-ratio", 0.3, "--layer-depth", 1, "--layer-depth", 4]
    common += ["--removal-rate", 2000, "--layer-overhead", 60]
    accurate = run_json("wear", "plan", *common)
    fast = run_json("wear", "plan", *common, "--per-minute", 10)
    assert accurate["layer_depth"] == 1
    assert fast["layer_depth"] == 4
    assert len(accurate["compared"]) == 2


def test_finishing_stage(tmp_path, run_json):
    out = tmp_path / "plan.csv"
    common = [*HEMISPHERE, "--depth", 100, *ELECTRODE, "--wear-ratio", 0.2]
    one = run_json("wear", "plan", *common)
    two = run_json("wear", "plan", *common, "--finish-thickness", 30, "--finish-wear-ratio", 0.3,
                   "--finish-electrode-diameter", 50, "--out", out)  # fmt: skip
    roughing, finishing = two["stages"]
    assert finishing["layers"] == one["layers"]
    # Volume: roughing wear / R + finishing wear / R' is what one stage removes.
    removed = roughing["electrode_length"] * AREA / 0.2
    removed += finishing["electrode_length"] * math.pi * 25.0**2 / 0.3
    assert removed == pytest.approx(one["electrode_length"] * AREA / 0.2, rel=2e-3)
    assert set(read(out)["stage [1]"]) == {1.0, 2.0}
    thin = run_json("wear", "plan", *common, "--finish-thickness", 20, "--finish-wear-ratio", 0.3,
                    "--finish-electrode-diameter", 50)  # fmt: skip
    assert any("half the finishing electrode" in w for w in thin["warnings"])
    assert not any("half the finishing electrode" in w for w in two["warnings"])


def test_program_commands_the_cumulative_feed(tmp_path, run_json):
    plan, program, picture = tmp_path / "p.csv", tmp_path / "p.nc", tmp_path / "p.png"
    run_json("wear", "plan", *PYRAMID, "--depth", 150, "--wear-ratio", 0.3, *ELECTRODE,
             "--out", plan, "--gcode", program, "--plot", picture)  # fmt: skip
    depths = [float(z) for z in re.findall(r"G1 Z(-[\d.]+)", program.read_text())]
    np.testing.assert_allclose(np.array(depths) * -1000, read(plan)["cumulative feed [um]"])
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_schedule_fed_back_gives_the_wanted_wall(tmp_path, run_json):
    plan, curve = tmp_path / "plan.csv", tmp_path / "wall.csv"
    run_json("wear", "plan", *PYRAMID, "--depth", 150, "--wear-ratio", 0.3, *ELECTRODE,
             "--out", plan)  # fmt: skip
    result = run_json("wear", "predict", "--schedule", plan, "--wear-ratio", 0.3, *ELECTRODE,
                      "--out", curve)  # fmt: skip
    assert result["depth"] == pytest.approx(150.0, abs=1e-4)
    wall = read_table(curve, [Column("x", "um"), Column("z", "um")])
    x, z = wall.values["x"], wall.values["z"]
    inside = (x >= 102) & (x <= 250)
    np.testing.assert_allclose(z[inside], 252.0 - x[inside], atol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--shape", "sphere", "--layer-depth", "2"], ("sphere", "hemisphere")),
        (["--shape", "cone", "--layer-depth", "2", "--radius", "90"], ("--wall-angle",)),
        (["--shape", "hemisphere", "--layer-depth", "2"], ("--radius",)),
        ([*HEMISPHERE, "--depth", "200"], ("depth", "150")),
        ([*HEMISPHERE, "--layer-depth", "0.01"], ("resolution",)),
        ([*HEMISPHERE, "--greatest-feed", "3"], ("--optimise",)),
        ([*HEMISPHERE, "--wear-ratio", "-1"], ("--wear-ratio is -1",)),
        ([*HEMISPHERE, "--fit", "fit.json"], ("--wear-ratio", "--fit")),
        ([*HEMISPHERE, "--usable-length", "1"], ("usable length",)),
        (["--shape", "table", "--layer-depth", "2"], ("--table",)),
    ],
)
def test_faulty_plan(arguments, words, tmp_path, run):
    out = tmp_path / "plan.csv"
    code, printed, err = run(
        "wear", "plan", "--wear-ratio", 0.3, *ELECTRODE, *arguments, "--out", out, "--json"
    )
    assert code == 2, (printed, err)
    assert printed == ""
    assert err.count("\n") == 1
    assert all(word in err for word in words), err
    assert not out.exists()


def test_negative_area_names_the_row(tmp_path, run):
    table = tmp_path / "areas.csv"
    table.write_text("z [um],area [um^2]\n0,100\n10,-5\n20,0\n")
    code, _, err = run("wear", "plan", "--shape", "table", "--table", table, "--layer-depth", 2,
                       "--wear-ratio", 0.3, *ELECTRODE)  # fmt: skip
    assert code == 2
    assert "areas.csv" in err
    assert "row 3" in err
