"""`chatter watch`: the events of `detect` as they happen, what is missing, and how it ends."""

import contextlib
import io
import json
import signal
import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest
import scipy.io

from calibration.chatter_detection import air_cut_at
from procmodel.chatter import detect
from procmodel.io.baselines import load_baselines
from tests.calibration.chatter_recordings import (
    CHATTERS,
    LENGTH,
    RATE,
    SPEED,
    detector,
    noise,
    recording,
    table,
)
from tests.measured import MILLING_CUT, needs

from .test_chatter_detect import CUT, baseline

COMMAND = [sys.executable, "-c", "from calibration.cli import main; main()", "chatter", "watch"]


class Stdin:
    """Standard input that holds these bytes."""

    def __init__(self, stream):
        self.buffer = stream


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watch")
    air = table(folder / "air.csv", noise(4.0, 11))
    baseline(folder, air, "b.h5", "--rate", RATE)
    table(folder / "cut.csv", recording())
    return folder


def watched(run, folder, source, *more, rate=("--rate", RATE)):
    """Lines of JSON: the events, and the end."""
    code, out, err = run("chatter", "watch", source, "--baseline", folder / "b.h5", *rate, *CUT,
                         "--json", *more)  # fmt: skip
    assert code == 0, err
    *events, end = map(json.loads, out.splitlines())
    return events, end, err


def test_events_are_those_of_detect_to_the_bit(folder, run, run_json, monkeypatch):
    result = run_json("chatter", "detect", folder / "cut.csv", "--baseline", folder / "b.h5",
                      "--rate", RATE, *CUT)  # fmt: skip
    table_file = folder / "events.csv"
    for source in ("-", folder / "cut.csv"):
        content = (folder / "cut.csv").read_bytes()
        monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(content)))
        events, end, err = watched(run, folder, source, "--until-idle", 0.2, "--events", table_file)
        assert events == result["events"]
        assert len(events) > 0
        assert end["events"] == len(events)
        for key in ("windows", "score_max", "states", "status", "rotation_hz", "bad_windows",
                    "chatter_frequency_hz", "threshold"):  # fmt: skip
            assert end[key] == result[key]
        assert end["samples"] == len(recording())
        assert (end["gaps"], end["repeated"], err) == (0, 0, "")
        rows = table_file.read_text().splitlines()[1:]
        assert [float(row.split(",")[2]) for row in rows] == [e["score"] for e in events]


def test_the_closing_line_is_for_people(folder, run, monkeypatch):
    content = (folder / "cut.csv").read_bytes()
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(content)))
    code, out, err = run("chatter", "watch", "-", "--baseline", folder / "b.h5", "--rate", RATE,
                         *CUT)  # fmt: skip
    assert (code, err) == (0, "")
    *events, closing = out.splitlines()
    assert events[0].startswith("chatter at 3.")
    assert closing.startswith(f"the source ended after {len(recording())} samples; ")
    assert "chatter from 3." in closing
    assert ".." not in out


def test_gaps_and_repetitions_are_counted_and_survived(folder, run, monkeypatch, tmp_path):
    samples = recording()
    count = len(samples)
    # A short gap in the air, a long one before chatter, a block twice, a row of rubbish.
    lost = {*range(3000, 3100), *range(15_000, 17_000)}
    rows = [i for i in range(count) if i not in lost]
    again = rows.index(9000)
    rows = rows[: again + 512] + rows[again:]
    text = table(tmp_path / "gaps.csv", samples, rows=rows).read_text()
    lines = text.splitlines()
    lines.insert(500, "rubbish,1")
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO("\n".join(lines).encode() + b"\n")))
    events, end, err = watched(run, folder, "-")
    assert (end["gaps"], end["missing"]) == (2, len(lost))
    assert (end["repeated_blocks"], end["repeated"]) == (1, 512)
    assert end["faulty_rows"] == 1
    assert end["samples"] == count - len(lost)
    assert err.count("samples are missing at") == 2
    # Times go on over the gaps.
    assert CHATTERS < events[0]["time_s"] < CHATTERS + 4 * LENGTH / RATE
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO("\n".join(lines).encode() + b"\n")))
    code, out, _ = run("chatter", "watch", "-", "--baseline", folder / "b.h5", "--rate", RATE,
                       *CUT)  # fmt: skip
    assert code == 0
    for words in (
        "2 gaps with 2100 samples missing", "1 block of 512 samples came twice",
        "1 row without numbers",
    ):  # fmt: skip
        assert words in out.splitlines()[-1]


def test_a_source_that_starts_anew(folder, run, monkeypatch):
    samples = recording()[:, 0].tolist()
    # The count goes back by more than 10 s, to where a new recording begins.
    first = [f"{100_000 + i},{value!r}" for i, value in enumerate(samples[: round(2.5 * RATE)])]
    second = [f"{i},{value!r}" for i, value in enumerate(samples)]
    text = "\n".join(["sample [1],y [m/s^2]", *first, *second]) + "\n"
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(text.encode())))
    events, end, err = watched(run, folder, "-")
    assert (end["restarts"], end["gaps"], end["repeated"]) == (1, 1, 0)
    assert end["samples"] == len(first) + len(second)
    assert "the source started anew" in err
    assert 2.5 + CHATTERS < events[0]["time_s"] < 2.5 + CHATTERS + 4 * LENGTH / RATE


def test_bare_floats(folder, run, monkeypatch):
    samples = recording().astype("<f4")
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(samples.tobytes())))
    events, end, err = watched(run, folder, "-", "--raw", "y [m/s^2]")
    assert "no clock" in err
    assert end["samples"] == len(samples)
    quiet = air_cut_at(load_baselines(folder / "b.h5"), SPEED)
    expected = detect(detector(quiet), samples.astype(float))
    assert [(e["time_s"], e["score"]) for e in events] == [
        (e.time_s, e.score) for e in expected.events
    ]


def test_faults_are_said_once_and_counted(folder, run, monkeypatch):
    samples = recording().astype("<f4")
    samples[[2000, 9000, 12_000]] = np.nan
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(samples.tobytes())))
    events, end, err = watched(run, folder, "-", "--raw", "y [m/s^2]")
    assert end["bad_windows"]["not_finite"] == 6
    assert err.count("warning  not finite at") == 1
    assert "NaN" not in json.dumps(end)
    assert len(events) > 0


class Endless(io.RawIOBase):
    """Bare floats that are made when they are read."""

    def __init__(self, count):
        self.left, self.piece = count, noise(1.0, 3).astype("<f4").tobytes()

    def read(self, size=-1):
        if not self.left:
            return b""
        self.left -= 1
        return self.piece


def test_memory_does_not_grow(folder, run, monkeypatch):
    def peak(seconds):
        monkeypatch.setattr(sys, "stdin", Stdin(Endless(seconds)))
        tracemalloc.start()
        _, end, _ = watched(run, folder, "-", "--raw", "y [m/s^2]")
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert end["samples"] == seconds * int(RATE)
        return most

    peak(5)
    short, long = peak(15), peak(150)
    # 135 s more are 3.5 MB of floats, twice that as samples.
    assert long < short + 200_000


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--until-idle", 0), ("--until-idle is 0", "above 0")),
        (("--channel", "w"), ("standard input", "no channel 'w'")),
        (("--spindle-speed", 7000), ("b.h5", "spindle speed 6000 1/min")),
        (("--rate", 3200), ("b.h5", "rate 6400 Hz, the record has 3200 Hz")),
        (("--raw", "y"), ("raw channel 'y' has no unit",)),
        (("--window", 64), ("b.h5", "window length 512, not 64")),
    ],
)
def test_bad_input_is_one_sentence(folder, run, monkeypatch, options, parts):
    content = (folder / "cut.csv").read_bytes()
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(content)))
    code, out, err = run("chatter", "watch", "-", "--baseline", folder / "b.h5", "--rate", RATE,
                         *CUT, *options)  # fmt: skip
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


def test_a_source_that_ends_at_once(folder, run, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(b"")))
    code, _, err = run("chatter", "watch", "-", "--baseline", folder / "b.h5", *CUT)
    assert (code, err.count("\n")) == (2, 1)
    assert "ended before the header was complete" in err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_growing_file_until_a_signal(number, folder, tmp_path):
    header, *rows = (folder / "cut.csv").read_text().splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    growing.write_text(header + "".join(rows[: len(rows) // 2]))
    arguments = [str(a) for a in (growing, "--baseline", folder / "b.h5", "--rate", RATE, *CUT)]
    with subprocess.Popen(
        COMMAND + arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        time.sleep(0.2)
        with growing.open("a") as file:
            file.write("".join(rows[len(rows) // 2 : -100]))
        # Chatter is in the second half: it is said while the file is still open-ended.
        assert process.stdout.readline().startswith("chatter at 3.")
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")
    assert out.splitlines()[-1].startswith("stopped on request after ")


def test_a_reader_that_goes_away(folder):
    arguments = [str(a) for a in ("-", "--baseline", folder / "b.h5", "--rate", RATE, *CUT)]
    with subprocess.Popen(
        COMMAND + arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        # It may end before it has read everything.
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write((folder / "cut.csv").read_bytes())
            process.stdin.close()
        err = process.stderr.read().decode()
        assert process.wait(timeout=30) == 0
    assert err == "stopped: nobody reads the events any more.\n"


@needs(MILLING_CUT)
def test_the_measured_cut_through_standard_input(tmp_path, run, run_json, monkeypatch):
    values = scipy.io.loadmat(MILLING_CUT)["data"][:, 0].astype(float).tolist()
    rows = [f"{i / 1e4:.4f},{value!r}" for i, value in enumerate(values)]
    text = "\n".join(["time [s],data [1]", *rows]) + "\n"
    of = ("--spindle-speed", 5000, "--band", 50, 2400, "--threshold", 100, "--teeth", 4)
    for window in (1024, 4096):
        made = tmp_path / f"b{window}.h5"
        run("chatter", "baseline", MILLING_CUT, "--rate", 10000, "--spindle-speed", 5000,
            "--start", 0.5, "--stop", 3.0, "--window", window, "--out", made)  # fmt: skip
        result = run_json(
            "chatter", "detect", MILLING_CUT, "--rate", 10000, "--baseline", made, *of
        )
        monkeypatch.setattr(sys, "stdin", Stdin(io.BytesIO(text.encode())))
        code, out, err = run("chatter", "watch", "-", "--baseline", made, *of, "--json")
        assert (code, err) == (0, "")
        *events, end = map(json.loads, out.splitlines())
        assert events == result["events"]
        assert end["score_max"] == result["score_max"]
