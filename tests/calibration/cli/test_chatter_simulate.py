"""`chatter simulate`: recordings whose truth the detector then finds."""

import json

import h5py
import numpy as np
import pytest

from procmodel.io.records import read_record

SHORT = ["--rate", 12800, "--before", 0.5, "--cutting", 0.4, "--after", 0.1, "--seed", 4]
SPEED = ["--spindle-speed", 5000]


def simulate(run_json, out, depth, *more):
    return run_json("chatter", "simulate", "--out", out, *SPEED, "--depth", depth, *SHORT, *more)


# |mu| of the reference case, converged, from the literature's closed case.
@pytest.mark.parametrize(
    ("depth", "multiplier", "label"), [(0.2, 0.81974278, "stable"), (0.5, 1.07397559, "chatter")]
)
def test_truth_of_the_reference_case(depth, multiplier, label, tmp_path, run_json):
    result = simulate(run_json, tmp_path / "cut.h5", depth)
    assert result["label"] == label
    assert result["multiplier"] == pytest.approx(multiplier, abs=1e-6)
    assert (result["chatter_frequency_hz"] is None) is (label == "stable")
    if label == "chatter":
        assert result["chatter_frequency_hz"] == pytest.approx(945.0, abs=1.0)
    with h5py.File(tmp_path / "cut.h5") as file:
        assert json.loads(file.attrs["truth"])["label"] == label
    assert result["truth"] == str(tmp_path / "cut.h5")


def test_the_detector_finds_the_truth(tmp_path, run_json):
    more = ("--before", 1.0, "--cutting", 0.8)
    truth = simulate(run_json, tmp_path / "cut.h5", 0.6, *more)
    run_json("chatter", "baseline", tmp_path / "cut.h5", *SPEED, "--stop", 0.95, "--start", 0.05,
             "--window", 1024, "--out", tmp_path / "b.h5")  # fmt: skip
    found = run_json("chatter", "detect", tmp_path / "cut.h5", "--baseline", tmp_path / "b.h5",
                     *SPEED, "--band", 100, 6000)  # fmt: skip
    (enters, whole), (leaves, gone) = truth["entry_s"], truth["exit_s"]
    assert (enters, gone) == pytest.approx((1.0, 1.9), abs=1e-9)
    assert enters < found["events"][0]["time_s"] < whole + 0.3
    assert found["events"][-1]["time_s"] < gone + 1024 / 12800
    # Full chatter, with the tool leaving the cut, is not quite where small chatter is.
    assert found["chatter_frequency_hz"] == pytest.approx(truth["chatter_frequency_hz"], rel=0.01)
    assert leaves > whole


def test_formats_hold_the_same_recording(tmp_path, run_json):
    records = {}
    for suffix in ("h5", "csv", "wav"):
        result = simulate(run_json, tmp_path / f"cut.{suffix}", 0.5, "--sensor", "both")
        records[suffix] = read_record(tmp_path / f"cut.{suffix}")
        assert records[suffix].rate == 12800.0
        assert len(records[suffix].samples) == result["samples"]
    # The one mode is along the feed: sensors across it would see nothing.
    assert records["h5"].channels == ("acceleration 1", "displacement 1")
    assert records["csv"].channels == ("displacement 1", "acceleration 1")
    assert records["h5"].units == ("m/s^2", "m")
    np.testing.assert_array_equal(records["h5"].samples[:, ::-1], records["csv"].samples)
    np.testing.assert_array_equal(
        records["wav"].samples, records["csv"].samples.astype(np.float32).astype(float)
    )
    assert json.loads((tmp_path / "cut.truth.json").read_text())["label"] == "chatter"


def test_seeds_and_noise(tmp_path, run_json):
    def made(*more):
        simulate(run_json, tmp_path / "cut.h5", 0.0, *more)
        return read_record(tmp_path / "cut.h5").samples

    first, other = made(), made("--seed", 5)
    np.testing.assert_array_equal(first, made())
    assert not np.array_equal(first, other)
    # Air alone: white noise of 1 m/s^2, of 7680 + 1280 samples or so, to four of its errors.
    assert np.std(first) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * len(first)))
    assert np.std(made("--noise", 0)) == 0.0


def test_several_modes(tmp_path, run_json):
    two = [
        *("--frequency", 900, "--damping", 0.02, "--mass", 0.05, "--direction", 0),
        *("--frequency", 1400, "--damping", 0.03, "--mass", 0.04, "--direction", 90),
    ]
    result = simulate(run_json, tmp_path / "cut.h5", 0.2, *two, "--teeth", 3, "--helix", 30,
                      "--runout", 0, "--runout", 2, "--runout", -1)  # fmt: skip
    assert result["channels"] == ["acceleration 1", "acceleration 2"]
    assert result["teeth"] == 3


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--out", "cut.mp3"), ("cut.mp3", ".wav, .h5")),
        (("--depth", -1), ("--depth is -1", "0 or more")),
        (("--sensor", "microphone"), ("--sensor is 'microphone'", "acceleration")),
        (("--frequency", 900), ("1 --frequency, 0 --damping, 0 --mass",)),
        (("--direction", 1, "--direction", 2), ("2 --direction for 1 modes",)),
        (("--runout", 1), ("runout",)),
        (("--milling", "climb"), ("climb",)),
        (("--cutting", 0), ("cutting lasts 0 s",)),
        (("--labelled-by", "ear"), ("labelled_by 'ear'",)),
        (("--rate", 100), ("step is", "make it")),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, run, monkeypatch, options, parts):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("chatter", "simulate", "--out", "cut.h5", *SPEED, "--depth", 0.1, *SHORT,
                         *options)  # fmt: skip
    assert (code, out, err.count("\n")) == (2, "", 1)
    for part in parts:
        assert part in err
    assert list(tmp_path.iterdir()) == []
