"""`procmodel electrode predict`: gaps in, the best path and its sizes out."""

import math

import numpy as np
import pytest

from calibration.electrode import GapData
from calibration.electrode_gap import fit_gap
from calibration.plans.electrode import corrected_path, predict_sizes
from procmodel.io import write_table

GAPS = np.random.default_rng(7).normal(14.75, 2.3, 10)
WIRE = ["--wire-diameter", "200"]


@pytest.fixture
def holes(tmp_path):
    path = tmp_path / "holes.csv"
    columns = {"hole diameter [um]": 100.0 + 2.0 * GAPS, "electrode diameter [um]": [100.0] * 10}
    write_table(path, columns, decimals=9)
    return path


@pytest.fixture(scope="module")
def known():
    return fit_gap(GapData(GAPS, 1 / math.sqrt(6)))


@pytest.mark.parametrize("loss", ["absolute", "outside"])
def test_the_best_path_is_the_librarys(run_json, holes, known, loss):
    found = run_json(
        "electrode", "predict", holes, *WIRE, "--diameter", 60, "--diameter", 120, "--loss", loss
    )
    best = corrected_path([60.0, 120.0], known, 100.0, loss=loss)
    assert found["path_radius"] == pytest.approx(best.path_radius.tolist(), abs=1e-6)
    assert found["counted_gap"] == pytest.approx(best.counted_gap, abs=1e-6)
    assert found["expected_error"] == pytest.approx(best.expected_error, abs=1e-6)
    assert found["within"] == pytest.approx(best.prediction.within.tolist(), abs=1e-6)
    assert found["all_within"] == pytest.approx(best.prediction.all_within, abs=1e-6)
    assert found["gap"]["readings"] == 10
    # d = 2 (r_p - r_w - g): the area's share is twice the diameter's.
    assert found["area_relative_std"][1] == pytest.approx(2 * found["std"][1] / 120, rel=0.1)


def test_a_given_path_is_predicted_as_it_is(run_json, holes, known):
    found = run_json("electrode", "predict", holes, *WIRE, "--path-radius", 165)
    expected = predict_sizes([165.0], known, 100.0)
    assert found["size"] == pytest.approx(expected.size.tolist(), abs=1e-6)
    assert found["interval"][0] == pytest.approx(expected.interval[0].tolist(), abs=1e-6)
    assert found["wanted"] is None and found["within"] is None


def test_a_slope_is_taken_in_degrees(run_json, holes, known):
    found = run_json(
        "electrode", "predict", holes, *WIRE, "--diameter", 60, "--diameter", 120,
        "--slope", 0, "--slope", 30,
    )  # fmt: skip
    best = corrected_path([60.0, 120.0], known, 100.0, slope=[0.0, math.radians(30)])
    assert found["path_radius"] == pytest.approx(best.path_radius.tolist(), abs=1e-6)
    assert found["std"][1] == pytest.approx(found["std"][0] / math.cos(math.radians(30)))


def test_flats_average_two_gaps(run_json, holes, known):
    found = run_json(
        "electrode", "predict", holes, *WIRE, "--diameter", 100, "--section", "flats",
        "--tolerance", 5, "--level", 0.5,
    )  # fmt: skip
    best = corrected_path(100.0, known, 100.0, passes=2, tolerance=0.05, level=0.5)
    assert found["all_within"] == pytest.approx(best.prediction.all_within, abs=1e-6)
    assert found["interval"][0] == pytest.approx(best.prediction.interval[0].tolist(), abs=1e-6)


def test_text_and_picture(run, holes, tmp_path):
    code, out, _ = run(
        "electrode", "predict", holes, *WIRE, "--diameter", 60, "--plot", tmp_path / "sizes.svg"
    )
    assert code == 0
    for said in (
        "--gap of 'electrode path'",
        "least expected absolute error",
        "wanted 60 um, wire at",
        "within 2 %",
        "area",
    ):
        assert said in out
    assert "<svg" in (tmp_path / "sizes.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "give the wanted --diameter"),
        (["--diameter", "0"], "--diameter is 0"),
        (["--diameter", "60", "--path-radius", "150", "--path-radius", "160"], "equally often"),
        (["--path-radius", "90"], "the wire would cut through the axis"),
        (["--diameter", "60", "--section", "oval"], "must be round or flats"),
        (["--diameter", "60", "--loss", "worst"], "must be absolute, squared or outside"),
        (["--diameter", "60", "--tolerance", "100"], "--tolerance is 100"),
        (["--diameter", "60", "--resolution", "0"], "--resolution is 0"),
        (["--diameter", "60", "--slope", "1", "--slope", "2"], "--slope is given 2 times"),
        (["--diameter", "60", "--slope", "85"], "80 deg"),
        (["--diameter", "60", "--level", "0"], "--level is 0"),
        (["--diameter", "1"], "leaves nothing of the electrode"),
    ],
)
def test_bad_input_is_one_sentence(run, holes, arguments, said):
    code, out, err = run("electrode", "predict", holes, *WIRE, *arguments)
    assert code == 2 and out == ""
    assert said in err and err.count("\n") == 1 and "Traceback" not in err


def test_the_wire_must_be_given_and_thick(run, holes):
    code, _, err = run("electrode", "predict", holes, "--diameter", 60)
    assert code == 2 and "--wire-diameter" in err
    code, _, err = run("electrode", "predict", holes, "--wire-diameter", 0, "--diameter", 60)
    assert code == 2 and "wire" in err and err.count("\n") == 1
