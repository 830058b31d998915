"""Following a recording while it is written: what comes, what is missing, what came twice."""

import io
import os
import threading
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io.record_follow import Block, Gap, follow
from tests.procmodel.io.record_shapes import RATE, rf64, table_text, vibration, write_wav


class Writer:
    """Appends a piece to a file whenever the follower waits, and then asks it to stop."""

    def __init__(self, path, pieces):
        self.path, self.pieces, self.waits = path, list(pieces), 0
        path.write_bytes(b"")
        self.sleep(0.0)

    def sleep(self, seconds):
        self.waits += 1
        if self.pieces:
            with self.path.open("ab") as file:
                file.write(self.pieces.pop(0))

    def stop(self):
        return not self.pieces and self.waits > 1000


def split(content, sizes):
    """Content in pieces of the sizes, in turn."""
    pieces = []
    while content:
        size = sizes[len(pieces) % len(sizes)]
        pieces.append(content[:size])
        content = content[size:]
    return pieces


def followed(path, pieces, **arguments):
    """Follower of a file that grows by the pieces, and what it gave."""
    writer = Writer(path, pieces)
    follower = follow(path, sleep=writer.sleep, idle=5.0, **arguments)
    return follower, list(follower)


def joined(items):
    return np.concatenate([item.samples for item in items if isinstance(item, Block)])


def assert_numbered(items):
    """Each block and gap begins where the one before it ends."""
    due = 0
    for item in items:
        assert item.first == due
        due += len(item.samples) if isinstance(item, Block) else item.missing or 0


def gaps(items):
    return [(item.first, item.missing) for item in items if isinstance(item, Gap)]


def rows_of(count, rate=RATE):
    """Lines of a table, and its header."""
    lines = table_text(vibration(count, 2), rate).encode().splitlines(keepends=True)
    return lines[0], lines[1:]


@given(st.lists(st.integers(1, 20000), min_size=1, max_size=6), st.integers(1, 700))
def test_growing_table_gives_every_sample_once(tmp_path_factory, sizes, block_length):
    samples = vibration(1500, 2)
    content = table_text(samples).encode()
    path = tmp_path_factory.mktemp("grow") / "r.csv"
    sizes = [max(size, len(content) // 200) for size in sizes]
    follower, items = followed(path, split(content, sizes), block_length=block_length)
    np.testing.assert_array_equal(joined(items), samples)
    assert_numbered(items)
    assert max(len(item.samples) for item in items) <= block_length
    assert (follower.rate, follower.units, follower.clocked) == (RATE, ("m/s^2",) * 2, True)
    assert follower.counts.samples == 1500 and follower.counts.gaps == 0
    assert follower.status == "nothing came for 5 s after 1500 samples"


def test_channels_units_and_rate_given(tmp_path):
    content = b"# milled\ny [mm/s^2];x [g]\n" + b"1,5;2\n" * 100
    follower, items = followed(tmp_path / "r.csv", split(content, [77]), rate=1e3, channels="x")
    assert (follower.rate, follower.channels, follower.units) == (1e3, ("x",), ("m/s^2",))
    assert not follower.clocked
    np.testing.assert_array_equal(joined(items), np.full((100, 1), 2 * 9.80665))


@pytest.mark.parametrize("piece", [37, 5000, 10**7])
def test_gaps_are_told_by_the_time(tmp_path, piece):
    header, rows = rows_of(3000)
    content = header + b"".join(rows[:1100] + rows[1101:2000] + rows[2250:])
    follower, items = followed(tmp_path / "r.csv", split(content, [piece]), rate=RATE)
    assert gaps(items) == [(1100, 1), (2000, 250)]
    assert_numbered(items)
    samples = vibration(3000, 2)
    for item in items:
        if isinstance(item, Block):
            here = samples[item.first : item.first + len(item.samples)]
            np.testing.assert_array_equal(item.samples, here)
    assert (follower.counts.gaps, follower.counts.missing) == (2, 251)
    assert "251 missing" in follower.status
    sentences = [item.sentence for item in items if isinstance(item, Gap)]
    assert sentences[0] == "1 sample is missing at 0.0429688 s"


@pytest.mark.parametrize("piece", [37, 5000, 10**7])
def test_blocks_that_come_twice_are_dropped(tmp_path, piece):
    header, rows = rows_of(3000)
    twice = rows[:1500] + rows[1000:1500] + rows[1500:2000] + rows[1999:2000] + rows[2000:]
    content = header + b"".join(twice)
    follower, items = followed(tmp_path / "r.csv", split(content, [piece]))
    np.testing.assert_array_equal(joined(items), vibration(3000, 2))
    assert_numbered(items)
    counts = follower.counts
    assert (counts.repeated_blocks, counts.repeated, counts.gaps) == (2, 501, 0)
    assert "501 dropped because they came twice" in follower.status


def test_clock_that_is_rounded_and_block_lost_and_repeated_at_once(tmp_path):
    """A block that is sent again after a later one was lost: its place is behind, then a gap."""
    samples = vibration(4000, 1)
    lines = table_text(samples, digits=6).encode().splitlines(keepends=True)
    rows = lines[1:]
    content = lines[0] + b"".join(rows[:2000] + rows[1500:2000] + rows[2500:])
    follower, items = followed(tmp_path / "r.csv", split(content, [9999]))
    assert follower.rate == RATE
    assert gaps(items) == [(2000, 500)]
    np.testing.assert_array_equal(joined(items), np.delete(samples, np.s_[2000:2500], axis=0))
    assert follower.counts.repeated == 500


def test_long_run_does_not_drift(tmp_path):
    """A clock 40 ppm off the rate given shows no gaps, however long it runs."""
    count = 60000
    times = np.arange(count) / 100.0 * (1 + 4e-5)
    rows = "".join(f"{time:.6f},1\n" for time in times)
    content = ("time [s],y [m]\n" + rows).encode()
    follower, items = followed(tmp_path / "r.csv", split(content, [10**5]), rate=100.0)
    assert gaps(items) == [] and follower.counts.samples == count


def test_count_of_samples_as_clock(tmp_path):
    numbers = [*range(100, 200), *range(150, 260), *range(265, 300)]
    content = "sample [1],y [m]\n" + "".join(f"{i},{i}\n" for i in numbers)
    follower, items = followed(tmp_path / "r.csv", split(content.encode(), [61]), rate=50.0)
    expected = [*range(100, 260), *range(265, 300)]
    np.testing.assert_array_equal(joined(items)[:, 0], expected)
    assert gaps(items) == [(160, 5)]
    assert follower.counts.repeated == 50


def test_source_that_starts_anew(tmp_path):
    header, rows = rows_of(2000, 100.0)
    content = header + b"".join(rows + rows[:500])
    follower, items = followed(tmp_path / "r.csv", split(content, [4000]), rate=100.0)
    samples = vibration(2000, 2)
    np.testing.assert_array_equal(joined(items), np.concatenate([samples, samples[:500]]))
    (gap,) = [item for item in items if isinstance(item, Gap)]
    assert (gap.first, gap.missing) == (2000, None)
    assert "went back by 19.99 s" in gap.sentence
    assert (follower.counts.restarts, follower.counts.repeated) == (1, 0)


def test_rows_that_hold_no_numbers_are_counted(tmp_path):
    header, rows = rows_of(200)
    rows[100] = b"0.0039,\xff\xfe,garbled\n"
    rows[150] = b"0.00\n"
    content = header + b"".join(rows)
    follower, items = followed(tmp_path / "r.csv", split(content, [500]))
    assert follower.counts.faulty == 2
    assert gaps(items) == [(100, 1), (150, 1)]
    assert follower.counts.samples == 198


def test_stop_ends_it_at_once(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text(table_text(vibration(5000, 1)))
    seen = []
    follower = follow(path, stop=lambda: len(seen) >= 3, block_length=100)
    for item in follower:
        seen.append(item)
    assert len(seen) == 3
    assert follower.status == "stopped on request after 300 samples"
    waits = []
    follower = follow(path, stop=lambda: len(waits) >= 4, sleep=waits.append, poll=0.5)
    assert len(joined(list(follower))) == 5000
    assert waits == [0.5] * 4
    assert follower.status.startswith("stopped on request")


@pytest.mark.parametrize("size", [b"\0\0\0\0", b"\xff\xff\xff\xff", None])
def test_growing_wav(tmp_path, size):
    samples = vibration(4000, 3).astype(np.float32)
    content = write_wav(tmp_path / "whole.wav", samples).read_bytes()
    if size is not None:
        at = content.index(b"data") + 4
        content = content[:4] + size + content[8:at] + size + content[at + 4 :]
    follower, items = followed(tmp_path / "r.wav", split(content, [20, 5, 3001]))
    np.testing.assert_array_equal(joined(items), samples)
    assert_numbered(items)
    assert (follower.rate, follower.channels) == (25600.0, ("data 1", "data 2", "data 3"))


def test_wav_that_is_closed_ends_before_its_remarks(tmp_path):
    samples = vibration(400, 1).astype(np.float32)
    body = write_wav(tmp_path / "w.wav", samples).read_bytes()[8:] + b"LIST\4\0\0\0INFO"
    path = tmp_path / "r.wav"
    path.write_bytes(b"RIFF" + len(body).to_bytes(4, "little") + body)
    items = list(follow(path, idle=0.0))
    np.testing.assert_array_equal(joined(items), samples)


def test_standard_input():
    samples = vibration(3000, 2)
    follower = follow("-", stream=io.BytesIO(table_text(samples).encode()))
    np.testing.assert_array_equal(joined(list(follower)), samples)
    assert follower.status == "the source ended after 3000 samples"
    assert str(follower.path) == "standard input"
    wav = rf64(samples)
    follower = follow("-", channels="data 2", stream=io.BytesIO(wav))
    np.testing.assert_array_equal(joined(list(follower)), samples[:, 1:].astype(np.float32))


def test_bare_floats():
    samples = vibration(1000, 2).astype("<f4")
    content = samples.tobytes() + b"\0\0\0"
    headings = ["y [m/s^2]", "x [mm]"]
    follower = follow("-", RATE, raw=headings, stream=io.BytesIO(content))
    assert follower.units == ("m/s^2", "m")
    np.testing.assert_array_equal(joined(list(follower)), samples.astype(float) * [1.0, 1e-3])
    follower = follow("-", RATE, "x", raw=headings, stream=io.BytesIO(content))
    np.testing.assert_array_equal(joined(list(follower)), samples[:, 1:].astype(float) * 1e-3)
    with pytest.raises(InputError, match="does not tell its sampling rate"):
        follow("-", raw=headings, stream=io.BytesIO(content))
    with pytest.raises(InputError, match=r"raw channel 'y' has no unit: write 'y \[m/s\^2\]'"):
        follow("-", RATE, raw=["y"], stream=io.BytesIO(content))


def test_pipe_that_falls_silent_can_be_stopped():
    """Waiting for a pipe on which nothing comes does not keep the follower from stopping."""
    content = table_text(vibration(100, 1)).encode()
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as source, os.fdopen(writing, "wb") as sink:
        thread = threading.Thread(target=lambda: (sink.write(content), sink.flush()))
        thread.start()
        asked = []
        follower = follow(
            "-", stream=source, poll=0.01, stop=lambda: asked.append(1) or len(asked) > 20
        )
        items = list(follower)
        thread.join()
    assert len(joined(items)) == 100
    assert follower.status == "stopped on request after 100 samples"


def test_memory_of_a_long_table_stays_small(tmp_path):
    row = b"0.123456789;0.5\n"
    peaks = []
    for count in (100, 400):
        pieces = [b"a [m];b [m]\n", *[row * 300] * count]
        writer = Writer(tmp_path / "r.csv", pieces)
        follower = follow(tmp_path / "r.csv", 1e3, sleep=writer.sleep, idle=1.0)
        tracemalloc.start()
        total = sum(len(item.samples) for item in follower)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert total == 300 * count
    assert peaks[1] < 1.3 * peaks[0]


def test_faults_are_named(tmp_path):
    path = tmp_path / "r.csv"

    def refused(content, *words, **arguments):
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            list(follow(path, idle=0.0, **arguments))
        for word in (str(path), *words):
            assert word in str(caught.value)

    refused(b"time [s],y [m/s", "before the header was complete")
    refused(b"TDSm" + b"\0" * 40, "only tables of text and WAV")
    refused(b"\x89HDF\r\n\x1a\n" + b"\0" * 40, "only tables of text and WAV")
    refused(b"\0\1\2\3" * 10 + b"\n", "binary")
    refused(b"time [s],y\n0,1\n", "row 1", "no unit")
    refused(b"y [m]\n" + b"1\n" * 50, "sampling rate")
    refused(b"RIFF\0\0\0\0WAVE", "before the header was complete")
    header, rows = rows_of(100)
    content = header + b"".join(rows)
    refused(content, "25600 Hz, not the 20000 Hz", rate=20000.0)
    refused(content, "no channel 'y'", "acceleration 1", channels="y")
    with pytest.raises(InputError, match="no such file"):
        follow(tmp_path / "other.csv")
    path.write_bytes(content)

    def shorten(_):
        path.write_bytes(content[:50])

    with pytest.raises(InputError, match="got shorter"):
        list(follow(path, sleep=shorten))
