"""`chatter baseline` and `chatter detect`: files in, events out, what is refused or flagged."""

import contextlib
import io
import json

import h5py
import numpy as np
import pytest

from calibration.cli import main
from procmodel.io.baselines import load_baselines
from tests.calibration.chatter_recordings import (
    CHATTER_HZ,
    CHATTERS,
    LENGTH,
    RATE,
    ROTATION,
    SPEED,
    noise,
    recording,
    table,
)
from tests.measured import MILLING_CUT, needs
from tests.procmodel.io.record_shapes import write_hdf5, write_tdms, write_wav

CUT = ["--spindle-speed", SPEED, "--band", 50, 3000]
KEYS = {
    "windows", "score_max", "events", "rotation_hz", "chatter_frequency_hz", "threshold", "status",
    "bad_windows", "warnings",
}  # fmt: skip


def baseline(folder, record, name="b.h5", *more):
    """A file of baselines, by the command."""
    with pytest.raises(SystemExit) as stop, contextlib.redirect_stdout(io.StringIO()):
        main([str(a) for a in (
            "chatter", "baseline", record, "--spindle-speed", SPEED, "--window", LENGTH,
            "--out", folder / name, *more,
        )])  # fmt: skip
    assert stop.value.code == 0
    return folder / name


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Air and a cut as HDF5, and the baseline of the first."""
    folder = tmp_path_factory.mktemp("chatter")
    write_hdf5(folder / "air.h5", noise(4.0, 11), ("y",), rate=RATE)
    write_hdf5(folder / "cut.h5", recording(), ("y",), rate=RATE)
    baseline(folder, folder / "air.h5")
    return folder


def test_json_of_a_cut(folder, run_json):
    result = run_json("chatter", "detect", folder / "cut.h5", "--baseline", folder / "b.h5", *CUT)
    assert set(result) >= KEYS
    assert set(result["events"][0]) >= {"time_s", "frequency_hz", "score", "state"}
    first = result["events"][0]
    assert CHATTERS < first["time_s"] < CHATTERS + 4 * LENGTH / RATE
    assert first["frequency_hz"] == pytest.approx(CHATTER_HZ, abs=0.2 * RATE / LENGTH)
    assert first["state"] == "chatter"
    # The averaged spectrum, whose threshold is half the other, is the first to tell.
    assert (first["statistic"], first["score"] > 50.0) == ("averaged distance", True)
    voted = run_json("chatter", "detect", folder / "cut.h5", "--baseline", folder / "b.h5", *CUT,
                     "--averaged-threshold", 0)["events"][0]  # fmt: skip
    assert (voted["statistic"], voted["score"] > 100.0) == ("distance", True)
    assert voted["time_s"] >= first["time_s"]
    assert result["rotation_hz"] == pytest.approx(ROTATION, abs=0.05)
    assert result["threshold"] == 100.0
    assert result["warnings"] == []
    assert result["bad_windows"] == {"not_finite": 0, "stuck": 0, "clipped": 0}


def test_report_table_and_picture(folder, run):
    events, picture = folder / "events.csv", folder / "cut.png"
    code, out, err = run(
        "chatter", "detect", folder / "cut.h5", "--baseline", folder / "b.h5", *CUT,
        "--events", events, "--plot", picture, "--averaged-threshold", 0,
    )  # fmt: skip
    assert (code, err) == (0, "")
    for word in ("status", "chatter from 3.", "rotation", "threshold 100", "Hz on y, distance"):
        assert word in out
    assert ".." not in out
    head, *rows = events.read_text().splitlines()
    assert head == ("time [s],frequency [Hz],score [-],state,statistic,growth rate [1/s],channel")
    assert len(rows) == out.count("Hz on y, ")
    assert rows[0].split(",")[3:5] == ["chatter", "distance"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_part_of_a_recording(folder, run_json):
    command = ("chatter", "detect", folder / "cut.h5", "--baseline", folder / "b.h5", *CUT)
    whole = run_json(*command)
    part = run_json(*command, "--start", 2.5, "--stop", 3.5)
    assert part["windows"] == 1 + (RATE - LENGTH) // (LENGTH // 2)
    assert CHATTERS < part["events"][0]["time_s"] < CHATTERS + 4 * LENGTH / RATE
    before = run_json(*command, "--stop", 3.0)
    assert before["events"] == []
    assert before["chatter_frequency_hz"] is None
    assert whole["windows"] > part["windows"]


def test_thresholds_and_votes(folder, run_json):
    command = ("chatter", "detect", folder / "cut.h5", "--baseline", folder / "b.h5", *CUT)
    highest = run_json(*command)["score_max"]
    silent = run_json(*command, "--threshold", 1.01 * highest, "--averaged-threshold", 0)
    assert silent["events"] == []
    one = run_json(*command, "--threshold", (1 - 1e-9) * highest, "--averaged-threshold", 0,
                   "--votes", 1)  # fmt: skip
    assert one["events"][0]["time_s"] == one["score_max_time_s"]
    ignored = run_json(*command, "--ignore", CHATTER_HZ)
    assert ignored["score_max"] < 0.5 * highest


def test_a_tuned_threshold(folder, run_json, run):
    command = ("chatter", "detect", folder / "cut.h5", "--baseline", folder / "b.h5", *CUT)
    tuned, picture = folder / "tuned.json", folder / "tuned.png"
    tuned.write_text(json.dumps({"threshold": {"value": 63.5, "interval90": [40.0, 90.0]}}))
    assert run_json(*command, "--tuned", tuned, "--plot", picture)["threshold"] == 63.5
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, _, err = run(*command, "--tuned", tuned, "--threshold", 3)
    assert (code, err.count("\n")) == (2, 1)
    assert "--threshold and --tuned" in err
    tuned.write_text('{"threshold": 3}')
    code, _, err = run(*command, "--tuned", tuned)
    assert (code, err.count("\n")) == (2, 1)
    assert "tuned.json" in err and "chatter tune --json" in err


@pytest.mark.parametrize("kind", ["tdms", "wav", "csv"])
def test_formats_give_the_same_events(kind, tmp_path, run_json):
    quiet, cut = noise(4.0, 11), recording()
    write = {
        "csv": table,
        "tdms": lambda path, values: write_tdms(path, values, ("y",), rate=RATE),
        "wav": lambda path, values: write_wav(path, values.astype(np.float32), int(RATE)),
    }[kind]
    files = [write(tmp_path / f"{n}.{kind}", v) for n, v in (("air", quiet), ("cut", cut))]
    rate = ["--rate", RATE] if kind == "csv" else []
    made = baseline(tmp_path, files[0], "b.h5", *rate)
    result = run_json("chatter", "detect", files[1], "--baseline", made, *CUT, *rate)
    reference = tmp_path / "cut.h5"
    write_hdf5(reference, cut, ("y",), rate=RATE)
    write_hdf5(tmp_path / "air.h5", quiet, ("y",), rate=RATE)
    same = run_json("chatter", "detect", reference, "--baseline",
                    baseline(tmp_path, tmp_path / "air.h5", "r.h5"), *CUT)  # fmt: skip
    assert [e["time_s"] for e in result["events"]] == [e["time_s"] for e in same["events"]]
    for one, other in zip(result["events"], same["events"], strict=True):
        assert one["score"] == pytest.approx(other["score"], rel=1e-5)


def test_several_channels_and_one_of_them(tmp_path, run_json):
    names = ("x", "y", "z")
    quiet, cut = noise(4.0, 5, 3), noise(5.0, 6, 3)
    cut[:, 1] = recording()[:, 0]
    write_hdf5(tmp_path / "air.h5", quiet, names, rate=RATE)
    write_hdf5(tmp_path / "cut.h5", cut, names, rate=RATE)
    made = baseline(tmp_path, tmp_path / "air.h5")
    command = ("chatter", "detect", tmp_path / "cut.h5", "--baseline", made, *CUT)
    result = run_json(*command)
    assert {e["channel"] for e in result["events"]} == {"y"}
    assert run_json(*command, "--channel", "z", "--channel", "y")["events"]
    assert run_json(*command, "--channel", "x")["events"] == []


def test_overrides_share_a_file(folder, run, run_json):
    slow = folder / "slow.h5"
    write_hdf5(slow, noise(4.0, 12), ("y",), rate=RATE)
    made = folder / "both.h5"
    made.write_bytes((folder / "b.h5").read_bytes())
    add = ("chatter", "baseline", slow, "--window", LENGTH, "--out", made, "--add")
    result = run_json(*add, "--spindle-speed", 5400, "--override", 90)
    assert [o["override_percent"] for o in result["overrides"]] == [100.0, 90.0]
    assert [w.split(":")[0] for w in result["warnings"]] == [
        "rotation not found"
    ]  # its lines are those of 6000 1/min
    held = load_baselines(made)
    assert [each.spindle_speed for each in held.overrides] == [6000.0, 5400.0]
    code, _, err = run(*add, "--spindle-speed", 5400, "--override", 90)
    assert (code, err.count("\n")) == (2, 1)
    assert "both.h5" in err and "already holds a baseline at override 90 %" in err
    wrong = run_json(*add, "--spindle-speed", 6000, "--override", 80)
    assert any("do not go with the overrides" in each for each in wrong["warnings"])
    for speed, code in ((6000, 0), (5400, 0), (5700, 2)):
        assert run("chatter", "detect", folder / "cut.h5", "--baseline", made, "--band", 50, 3000,
                   "--spindle-speed", speed)[0] == code  # fmt: skip
    code, _, err = run("chatter", "detect", folder / "cut.h5", "--baseline", made, *CUT,
                       "--override", 70)  # fmt: skip
    assert code == 2
    assert "no baseline at override 70 %, only at 100, 90, 80" in err


def test_the_baseline_says_what_it_is(folder, run_json, run):
    result = run_json("chatter", "baseline", folder / "air.h5", "--spindle-speed", SPEED,
                      "--window", 1024, "--hop", 1024, "--taper", "rectangular", "--start", 0.5,
                      "--stop", 2.5, "--out", folder / "other.h5")  # fmt: skip
    assert result["windows"] == int(2.0 * RATE) // 1024
    assert (result["window"], result["hop"], result["taper"]) == (1024, 1024, "rectangular")
    assert result["rotation_found"] is True
    assert result["channels"] == ["y"]
    held = load_baselines(folder / "other.h5")
    assert (held.window_length, held.hop, held.taper) == (1024, 1024, "rectangular")
    assert held.overrides[0].count == result["windows"]
    code, out, _ = run("chatter", "baseline", folder / "cut.h5", "--spindle-speed", SPEED,
                       "--window", LENGTH, "--out", folder / "other.h5")  # fmt: skip
    assert code == 0
    assert "warning  not steady: from 2." in out


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--spindle-speed", 0), ("--spindle-speed is 0", "above 0")),
        (("--spindle-speed", 7000), ("b.h5", "spindle speed 6000 1/min", "7000 1/min")),
        (("--rate", 12800), ("cut.h5", "holds a rate of 6400 Hz", "12800")),
        (("--channel", "w"), ("cut.h5", "no channel 'w'")),
        (("--window", 1024), ("b.h5", "window length 512, not 1024")),
        (("--band", 3000, 50), ("--band is 3000 50", "must rise")),
        (("--band", 99, 101), ("no frequency between 99 and 101 Hz",)),
        (("--votes", 6), ("6 of 5 windows",)),
        (("--threshold", -1), ("--threshold is -1", "above 0")),
        (("--ignore", "nan"), ("--ignore is nan", "above 0")),
        (("--teeth", 0), ("number of teeth is 0",)),
        (("--start", 9), ("cut.h5", "start at 9 s", "behind the end")),
        (("--stop", 0.05), ("cut.h5", "320 samples", "one window of 512")),
        (("--plot", "cut.txt"), ("cut.txt", ".png")),
        (("--override", 70), ("b.h5", "override 70 %", "only at 100")),
        (("--baseline", "cut.h5"), ("cut.h5", "holds no baselines")),
        (("--baseline", "none.h5"), ("none.h5",)),
    ],
)
def test_bad_input_is_one_sentence(folder, run, monkeypatch, options, parts):
    monkeypatch.chdir(folder)
    given = ["--baseline", "b.h5", *CUT]
    code, out, err = run("chatter", "detect", "cut.h5", *given, *options)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


def test_faults_of_a_recording_are_named(folder, tmp_path, run_json):
    clean = recording()
    cases = {}
    cases["not finite: "] = clean.copy()
    cases["not finite: "][4000] = np.nan
    cases["stuck: "] = clean.copy()
    cases["stuck: "][5000:6000] = 0.25
    cases["clipped: "] = np.clip(clean, -2.0, 2.0)
    cases["outlier at the start: "] = clean.copy()
    cases["outlier at the start: "][0] = 900.0
    for name, samples in cases.items():
        write_hdf5(tmp_path / "cut.h5", samples, ("y",), rate=RATE)
        result = run_json("chatter", "detect", tmp_path / "cut.h5",
                          "--baseline", folder / "b.h5", *CUT)  # fmt: skip
        assert any(each.startswith(name) for each in result["warnings"]), name
        field = name.strip(": ").replace(" ", "_")
        if field in result["bad_windows"]:
            assert result["bad_windows"][field] > 0


def test_a_dead_sensor_is_refused(folder, tmp_path, run):
    write_hdf5(tmp_path / "cut.h5", np.full((30_000, 1), 0.3), ("y",), rate=RATE)
    code, out, err = run("chatter", "detect", tmp_path / "cut.h5", "--baseline", folder / "b.h5",
                         *CUT)  # fmt: skip
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "cut.h5" in err and "same value for longer than a signal would" in err
    code, out, err = run("chatter", "baseline", tmp_path / "cut.h5", "--spindle-speed", SPEED,
                         "--out", tmp_path / "b.h5")  # fmt: skip
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "channel 'y' is stuck at 0.3 throughout" in err
    assert not (tmp_path / "b.h5").exists()


def test_a_truncated_file_is_named(folder, tmp_path, run, run_json):
    whole = write_tdms(tmp_path / "cut.tdms", recording(), ("y",), rate=RATE)
    content = whole.read_bytes()
    whole.write_bytes(content[: len(content) - 9000])
    result = run_json("chatter", "detect", whole, "--baseline", folder / "b.h5", *CUT)
    assert any(each.startswith("truncated: ") for each in result["warnings"])
    assert result["events"]
    code, _, err = run("chatter", "baseline", whole, "--spindle-speed", SPEED, "--out",
                       tmp_path / "t.h5")  # fmt: skip
    assert (code, err.count("\n")) == (2, 1)
    assert "cut.tdms" in err
    damaged = tmp_path / "b.h5"
    damaged.write_bytes((folder / "b.h5").read_bytes()[:-500])
    code, _, err = run("chatter", "detect", folder / "cut.h5", "--baseline", damaged, *CUT)
    assert (code, err.count("\n")) == (2, 1)
    assert "b.h5" in err


def test_the_rate_must_be_told_where_the_file_does_not(folder, tmp_path, run):
    with h5py.File(tmp_path / "cut.h5", "w") as file:
        file["y"] = recording()[:, 0]
        file["y"].attrs["unit"] = "m/s^2"
    command = ("chatter", "detect", tmp_path / "cut.h5", "--baseline", folder / "b.h5", *CUT)
    code, _, err = run(*command)
    assert (code, err.count("\n")) == (2, 1)
    assert "does not tell its sampling rate" in err
    assert run(*command, "--rate", RATE)[0] == 0
    code, _, err = run(*command, "--rate", 2 * RATE)
    assert code == 2
    assert "the baseline was made at the rate 6400 Hz, the record has 12800 Hz" in err


@needs(MILLING_CUT)
@pytest.mark.parametrize("window", [1024, 2048, 4096])
def test_the_measured_cut(window, tmp_path, run_json):
    made = tmp_path / "b.h5"
    of = ("--rate", 10000, "--spindle-speed", 5000)
    air = run_json("chatter", "baseline", MILLING_CUT, *of, "--start", 0.5, "--stop", 3.0,
                   "--window", window, "--out", made)  # fmt: skip
    assert any(each.startswith("values repeated: ") for each in air["warnings"])
    result = run_json("chatter", "detect", MILLING_CUT, "--baseline", made, *of, "--threshold", 100,
                      "--band", 50, 2400, "--teeth", 4)  # fmt: skip
    assert 3.8 <= result["events"][0]["time_s"] <= 4.1
    assert result["events"][0]["state"] == "chatter"
    # The cut ends at 5.05 s; a window that began in it may still end later.
    assert all(3.8 <= each["time_s"] <= 5.05 + window / 1e4 for each in result["events"])
    assert result["score_max_air"] < 50.0
    assert 684.0 <= result["chatter_frequency_hz"] <= 693.0
    assert result["score_max"] > 1e4
