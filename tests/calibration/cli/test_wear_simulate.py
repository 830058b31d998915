"""`wear simulate`: plans cut in simulation, their files, and what it refuses."""

import pytest
import xarray

SHAPE = ["--shape", "hemisphere", "--radius", 40]
ELECTRODE = ["--electrode-diameter", 20]
PLAN = ("wear", "plan", *SHAPE, *ELECTRODE, "--depth", 30, "--layer-depth", 3)


@pytest.fixture
def planned(tmp_path, run_json):
    out = tmp_path / "plan.csv"
    run_json(*PLAN, "--wear-ratio", 0.2, "--out", out, "--paths", tmp_path / "paths.csv")
    return out


def simulate(plan, *more):
    return ("wear", "simulate", "--plan", plan, *SHAPE, *ELECTRODE, "--cell", 2, *more)


@pytest.mark.parametrize("mode", ["local", "rotating", "uniform"])
def test_names_that_others_rely_on(planned, run_json, mode):
    found = run_json(*simulate(planned, "--wear-ratio", 0.2, "--wear-mode", mode))
    assert found["volume_ratio"] == pytest.approx(0.2, rel=1e-12)
    assert found["depth_mean"] == pytest.approx(30.0, abs=3.0)
    assert 0.0 < found["error_rms"] < found["error_max"] < 8.0
    assert 0.0 <= found["bottom_peak_to_valley"] < 6.0
    assert found["layers"] == found["layers_planned"] == 10
    # A step is at most a cell long, and every layer begins with one of its own.
    assert found["steps"] > found["path_length_um"] / 2.0
    assert found["cell_updates_per_second"] is None or found["cell_updates_per_second"] > 0
    assert found["status"] == "all 10 layers are cut."


def test_a_plan_for_another_wear_ratio_misses(planned, run_json):
    right = run_json(*simulate(planned, "--wear-ratio", 0.2, "--wear-mode", "uniform"))
    wrong = run_json(*simulate(planned, "--wear-ratio", 0.4, "--wear-mode", "uniform"))
    assert wrong["depth_mean"] < right["depth_mean"] - 3.0
    assert wrong["error_rms"] > 3.0 * right["error_rms"]


def test_written_paths_are_followed(planned, tmp_path, run_json):
    options = ("--wear-ratio", 0.2)
    scanned = run_json(*simulate(planned, *options))
    followed = run_json(*simulate(planned, *options, "--paths", tmp_path / "paths.csv"))
    # The file has four decimals.
    assert followed["error_rms"] == pytest.approx(scanned["error_rms"], rel=1e-3)
    assert followed["path_length_um"] == pytest.approx(scanned["path_length_um"], abs=0.1)
    raster = run_json(*simulate(planned, *options, "--pattern", "raster"))
    assert abs(raster["path_length_um"] - scanned["path_length_um"]) > 10.0


def test_a_fit_brings_its_band(planned, tmp_path, run_json, run, profile):
    from .conftest import CAVITY

    fit = tmp_path / "fit.json"
    run("wear", "fit", profile, *CAVITY, "--out", fit)
    out, plot = tmp_path / "cut.nc", tmp_path / "cut.png"
    found = run_json(*simulate(planned, "--fit", fit, "--out", out, "--plot", plot))
    assert len(found["wear_ratios"]) == 3
    assert found["depth_spread"] > 0.0
    assert any("electrode" in warning for warning in found["warnings"])
    data = xarray.load_dataset(out, engine="h5netcdf")
    inside = data.target > 5.0
    assert bool((data.depth_low.where(inside) <= data.depth_high.where(inside) + 1e-9).sum())
    spread = 0.5 * (data.depth_high - data.depth_low).where(data.target > 29.99).mean()
    assert float(spread) == pytest.approx(found["depth_spread"], rel=0.1)
    assert plot.stat().st_size > 20_000


def test_what_is_read_is_not_written_over(planned, run):
    plan = planned.with_suffix(".nc")
    plan.write_bytes(planned.read_bytes())
    code, _, err = run(*simulate(plan, "--wear-ratio", 0.2, "--out", plan))
    assert code == 2 and "is read and would be written over" in err
    assert plan.read_bytes() == planned.read_bytes()


def test_a_plan_of_another_part_is_told(planned, run):
    slot = ("--shape", "slot", "--length", 60, "--width", 30, "--wear-ratio", 0.2)
    code, _, err = run(
        "wear", "simulate", "--plan", planned, *slot, *ELECTRODE, "--cell", 2
    )  # fmt: skip
    assert code == 2 and "whose areas differ from those of the slot" in err


def test_corners_out_of_reach_are_told_apart(tmp_path, run_json):
    box = ("--shape", "pyramid", "--half-width", 25, "--wall-angle", 90)
    out = tmp_path / "plan.csv"
    run_json("wear", "plan", *box, *ELECTRODE, "--depth", 10, "--layer-depth", 1,
             "--wear-ratio", 0.1, "--out", out)  # fmt: skip
    found = run_json("wear", "simulate", "--plan", out, *box, *ELECTRODE, "--cell", 1,
                     "--wear-ratio", 0.1, "--wear-mode", "uniform")  # fmt: skip
    assert found["error_max"] == pytest.approx(10.0)
    assert found["reachable_error_rms"] < 0.6 * found["error_rms"]


def test_a_used_up_electrode_ends_the_run(planned, run):
    code, out, _ = run(*simulate(planned, "--wear-ratio", 0.2, "--usable-length", 5))
    assert code == 1
    assert "the electrode is used up in layer" in out


def test_a_run_goes_on_from_its_checkpoint(planned, tmp_path, run_json, run):
    kept = ("--wear-ratio", 0.2, "--checkpoint", tmp_path / "run.h5")
    first = run_json(*simulate(planned, *kept))
    code, _, err = run(*simulate(planned, *kept))
    assert code == 2 and "run.h5 exists" in err
    again = run_json(*simulate(planned, *kept, "--resume"))
    assert again["error_rms"] == first["error_rms"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--wear-ratio", -0.1], "--wear-ratio is -0.1"),
        (["--wear-ratio", 40], "not in percent"),
        (["--wear-ratio", 0.2, "--cell", 0], "--cell is 0"),
        (["--wear-ratio", 0.2, "--cell", 11], "larger than half the electrode"),
        (["--wear-ratio", 0.2, "--wear-mode", "turning"], "turning"),
        (["--wear-ratio", 0.2, "--feed-law", "steady"], "feed law 'steady' is unknown"),
        (["--wear-ratio", 0.2, "--spread-width", 3], "spread"),
        (["--wear-ratio", 0.2, "--resume"], "--resume is given without --checkpoint"),
        (["--wear-ratio", 0.2, "--solid", "part.stl"], "give either --shape or --solid"),
        (["--wear-ratio", 0.2, "--radius", 20], "give the cavity that was planned"),
        (["--wear-ratio", 0.2, "--narrow", "stop"], "--narrow stop belongs to 'wear plan'"),
        (["--wear-ratio", 0.2, "--cell", 0.001], "more than 2e+07: take cells of"),
        (["--wear-ratio", 0.2, "--wear-mode", "spread"], "--spread-width go together"),
        (["--wear-ratio", 0.2, "--out", "map.txt"], "let the name end in .nc"),
        ([], "give one of --wear-ratio, --fit and --posterior"),
    ],
)
def test_refusals(planned, tmp_path, run, more, words):
    out = tmp_path / "never.nc"
    more = more if "--out" in more else [*more, "--out", out]
    code, _, err = run(*simulate(planned, *more))
    assert code == 2
    assert words in err and err.count("\n") == 1
    assert not out.exists()
