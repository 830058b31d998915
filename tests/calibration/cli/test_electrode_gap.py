"""`procmodel electrode gap`: tables of diameters in, mean, spread and next gap out."""

import math

import numpy as np
import pytest

from calibration.electrode import GapData
from calibration.electrode_gap import fit_gap
from procmodel.io import write_table

GAPS = np.random.default_rng(7).normal(14.75, 2.3, 10)
HEADINGS = ("hole diameter [um]", "electrode diameter [um]")


def write(path, holes, electrodes, headings=HEADINGS):
    write_table(path, dict(zip(headings, (holes, electrodes), strict=True)), decimals=9)
    return path


@pytest.fixture
def holes(tmp_path):
    return write(tmp_path / "holes.csv", 100.0 + 2.0 * GAPS, np.full(10, 100.0))


def test_json_holds_what_the_library_finds(run_json, holes):
    found = run_json("electrode", "gap", holes)
    # +-1 um, every error alike likely: sqrt(1/3), and half the difference of two.
    known = fit_gap(GapData(GAPS, 1 / math.sqrt(6)))
    assert found["readings"] == 10
    assert found["gap_mean"]["value"] == pytest.approx(known.mean.mean, abs=1e-6)
    assert found["gap_spread"]["value"] == pytest.approx(float(known.spread_quantile(0.5)))
    assert found["next_gap"]["interval"] == pytest.approx(known.next_gap().interval(0.9), abs=1e-6)
    assert found["measuring_std"] == pytest.approx(1 / math.sqrt(6))
    assert found["lowest"] == pytest.approx(GAPS.min(), abs=1e-6)


def test_options_change_error_repeats_and_level(run_json, holes):
    found = run_json(
        "electrode", "gap", holes, "--diameter-error", 2, "--repeats", 4, "--level", 0.5
    )
    known = fit_gap(GapData(GAPS, 1 / math.sqrt(6)))
    assert found["measuring_std"] == pytest.approx(1 / math.sqrt(6))
    assert found["next_gap"]["interval"] == pytest.approx(known.next_gap().interval(0.5), abs=1e-6)


def test_electrodes_join_the_holes(run_json, holes, tmp_path):
    paths = np.array([165.0, 166.0])
    headings = ("path radius [um]", "electrode diameter [um]")
    table = write(tmp_path / "electrodes.csv", paths, 2 * (paths - 100 - 14), headings)
    both = run_json("electrode", "gap", holes, "--electrodes", table, "--wire-diameter", 200)
    assert both["readings"] == 12
    alone = run_json("electrode", "gap", "--electrodes", table, "--wire-diameter", 200)
    assert alone["readings"] == 2 and alone["lowest"] == pytest.approx(14.0)
    assert any("2 readings say little" in note for note in alone["notes"])


def test_gaps_that_agree_better_than_they_can_be_measured_are_noted(run_json, tmp_path):
    table = write(tmp_path / "alike.csv", np.full(10, 130.0), np.full(10, 100.0))
    found = run_json("electrode", "gap", table)
    assert any("scatters less than measuring" in note for note in found["notes"])
    assert not any("say little" in note for note in found["notes"])


def test_the_text_names_all_three(run, holes):
    code, out, _ = run("electrode", "gap", holes)
    assert code == 0
    for word in ("mean gap", "spread", "next gap", "note"):
        assert f"\n{word}" in out


def test_a_picture_is_written(run, holes, tmp_path):
    code, _, _ = run("electrode", "gap", holes, "--plot", tmp_path / "gap.png")
    assert code == 0
    assert (tmp_path / "gap.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "nothing was measured"),
        (["--level", "1"], "--level is 1"),
        (["HOLES", "--diameter-error", "0"], "--diameter-error is 0"),
        (["HOLES", "--repeats", "0"], "--repeats is 0"),
        (["--electrodes", "HOLES"], "--wire-diameter is missing"),
        (["--electrodes", "HOLES", "--wire-diameter", "-1"], "--wire-diameter is -1"),
        (["HOLES", "--plot", "gap.bmp"], "a picture ends in"),
        (["none.csv"], "none.csv"),
    ],
)
def test_bad_input_is_one_sentence(run, holes, arguments, said):
    code, out, err = run(
        "electrode", "gap", *[holes if given == "HOLES" else given for given in arguments]
    )
    assert code == 2 and out == ""
    assert said in err and err.count("\n") == 1 and "Traceback" not in err


def test_faulty_rows_are_named_with_their_file(run, tmp_path):
    path = tmp_path / "holes.csv"
    for holes, electrodes, said in (
        ([130.0, 95.0], [100.0, 100.0], "holes.csv, row 3: the hole of 95 um is smaller"),
        ([130.0], [100.0], "holes.csv, row 2: a single gap of 15 um"),
        ([130.0, -1.0], [100.0, 100.0], "holes.csv, row 3: negative hole diameter"),
    ):
        write(path, holes, electrodes)
        code, _, err = run("electrode", "gap", path)
        assert code == 2 and said in err and err.count("\n") == 1
    path.write_text("hole diameter [um]\n130\n")
    code, _, err = run("electrode", "gap", path)
    assert code == 2 and "no column 'electrode diameter'" in err
