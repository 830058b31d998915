"""Recordings in every format: the samples, and a sentence for everything that may be wrong."""

import logging
import re
import tracemalloc

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter

from procmodel.errors import InputError
from procmodel.io.record_checks import flags, held_samples
from procmodel.io.records import open_record, read_record
from tests.measured import MILLING_CUT, needs
from tests.procmodel.io import record_shapes as shapes

RATE = shapes.RATE
FORMATS = ["tdms", "wav", "hdf5", "mat", "mat73", "csv"]


def written(form, folder, samples):
    """The samples in a file, and what they are to be read as."""
    path = folder / f"record.{'mat' if form == 'mat73' else 'h5' if form == 'hdf5' else form}"
    if form == "tdms":
        return shapes.write_tdms(path, samples), samples
    if form == "wav":
        return shapes.write_wav(path, samples.astype(np.float32)), samples.astype(np.float32)
    if form == "hdf5":
        return shapes.write_hdf5(path, samples), samples
    if form == "mat":
        scipy.io.savemat(path, {"data": samples, "fs": RATE, "note": "milled"})
    elif form == "mat73":
        shapes.write_mat73(path, data=samples, fs=np.array([RATE]))
    else:
        path.write_text(shapes.table_text(samples))
    return path, samples


NAMES = {
    "tdms": ("y", "z"),
    "wav": ("data 1", "data 2"),
    "hdf5": ("y", "z"),
    "mat": ("data 1", "data 2"),
    "mat73": ("data 1", "data 2"),
    "csv": ("acceleration 1", "acceleration 2"),
}
UNITS = {form: "m/s^2" if form in ("tdms", "hdf5", "csv") else "1" for form in FORMATS}


@pytest.fixture(params=FORMATS)
def recording(request, tmp_path):
    return request.param, *written(request.param, tmp_path, shapes.vibration())


def refused(call, *words):
    """The sentence of the refusal, in which all the words stand."""
    with pytest.raises(InputError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text
    return text


def test_every_format_gives_its_samples(recording):
    form, path, samples = recording
    record = read_record(path)
    np.testing.assert_array_equal(record.samples, samples)
    assert record.samples.dtype == np.float64
    assert record.rate == RATE
    assert record.channels == NAMES[form]
    assert record.units == (UNITS[form],) * 2
    assert (record.path, record.start) == (path, 0.0)
    np.testing.assert_allclose(record.times[[0, 1, -1]], [0, 1 / RATE, 4999 / RATE], rtol=1e-15)


def test_streaming_gives_the_same_in_blocks_of_any_size(recording):
    _, path, samples = recording
    for size in (1024, 4999, 10000):
        stream = open_record(path, block_length=size)
        assert stream.status == "not read yet"
        blocks = list(stream)
        assert [len(block) for block in blocks] == [
            min(size, 5000 - start) for start in range(0, 5000, size)
        ]
        np.testing.assert_array_equal(np.concatenate(blocks), samples)
        assert stream.status == "read to the end: 5000 samples"
        assert stream.length in (5000, None)
        # Once more from the beginning.
        np.testing.assert_array_equal(next(iter(stream)), samples[:size])


def test_part_and_channel(recording):
    form, path, samples = recording
    name = NAMES[form][1]
    record = read_record(path, channels=name, start=0.05, stop=0.1)
    np.testing.assert_array_equal(record.samples, samples[1280:2560, 1:])
    assert (record.channels, record.start) == ((name,), 0.05)
    both = read_record(path, channels=NAMES[form][::-1], stop=5000 / RATE)
    np.testing.assert_array_equal(both.samples, samples[:, ::-1])


def test_rate_given_must_agree(recording):
    _, path, _ = recording
    assert read_record(path, rate=RATE, stop=0.01).rate == RATE
    refused(lambda: read_record(path, rate=10000), str(path), "25600 Hz", "10000 Hz")


def test_wrong_requests_are_named(recording):
    form, path, _ = recording
    close = NAMES[form][0] + "x"
    refused(lambda: open_record(path, channels=close), "no channel", close, "did you mean")
    refused(lambda: open_record(path, channels=[]), "channels is empty")
    refused(lambda: open_record(path, channels=[NAMES[form][0]] * 2), "twice")
    refused(lambda: read_record(path, start=9.0), "start at 9 s lies behind the end")
    refused(lambda: read_record(path, stop=9.0), "stop at 9 s", "0.195")
    refused(lambda: read_record(path, start=0.1, stop=0.1), "later stop")
    refused(lambda: open_record(path, start=-1.0), "start is -1 s")
    refused(lambda: open_record(path, rate=0.0), "rate is 0 Hz")
    refused(lambda: open_record(path, block_length=0), "block_length")


def test_missing_empty_and_foreign_files(tmp_path):
    (tmp_path / "run.tdms").write_bytes(b"")
    refused(lambda: read_record(tmp_path / "rum.tdms"), "no such file", "'run.tdms'")
    refused(lambda: read_record(tmp_path / "run.tdms"), "empty")
    refused(lambda: read_record(tmp_path), "folder")
    for suffix, word in ((".tdms", "TDMS"), (".wav", "WAV"), (".h5", "HDF5"), (".mat", "MATLAB")):
        path = tmp_path / f"foreign{suffix}"
        path.write_bytes(b"\x00\x01picture" * 40)
        refused(lambda path=path: read_record(path), str(path), f"not a {word}")
    path = tmp_path / "foreign.csv"
    path.write_bytes(b"\x00\x01picture" * 40)
    refused(lambda: read_record(path), "binary")


@given(st.data())
def test_damage_is_refused_or_harmless(tmp_path_factory, data):
    """No byte that is overwritten or cut off makes another error than the house's own."""
    folder = tmp_path_factory.mktemp("damaged")
    form = data.draw(st.sampled_from(FORMATS))
    path, _ = written(form, folder, shapes.vibration(300))
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, min(len(content), 2000) - 1))
    content[at] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(1, len(content)))])
    try:
        record = read_record(path)
    except InputError as error:
        assert str(path) in str(error)
    else:
        assert record.samples.shape[1] >= 1


# TDMS


def test_tdms_units_groups_and_rates(tmp_path):
    path, samples = tmp_path / "rig.tdms", shapes.vibration(100, 1)[:, 0]
    step = {"wf_increment": 1e-4}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("a", "y", samples, {**step, "unit_string": "g"}),
                ChannelObject("b", "y", samples.astype(np.float32), {**step, "unit_string": "mV"}),
                ChannelObject("b", "count", np.arange(100), {**step, "unit_string": "Ticks"}),
                ChannelObject("b", "remarks", ["x", "y"]),
            ]
        )
    record = read_record(path)
    assert record.channels == ("a/y", "b/y", "count")
    assert record.units == ("m/s^2", "V", "Ticks")
    assert record.rate == pytest.approx(10000.0, rel=1e-15)
    np.testing.assert_array_equal(record.samples[:, 0], samples * 9.80665)
    np.testing.assert_array_equal(
        record.samples[:, 1], samples.astype(np.float32).astype(float) * 1e-3
    )
    np.testing.assert_array_equal(record.samples[:, 2], np.arange(100))
    assert read_record(path, channels="b/count").channels == ("count",)
    refused(lambda: read_record(path, channels="y"), "several channels 'y'", "'a/y' or 'b/y'")


def test_tdms_channels_that_do_not_belong_together(tmp_path):
    path, samples = tmp_path / "rig.tdms", np.arange(100.0)
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("a", "y", samples), ChannelObject("a", "t", samples)])
        writer.write_segment([ChannelObject("b", "slow", samples[:10])])
    refused(lambda: read_record(path, rate=1e3), "differ in length", "'y' 100", "'slow' 10")
    refused(lambda: read_record(path, channels="y"), "does not tell its sampling rate")
    assert read_record(path, 1e3, "slow").samples.shape == (10, 1)
    with TdmsWriter(path) as writer:
        for name, step in (("y", 1e-3), ("z", 2e-3)):
            writer.write_segment([ChannelObject("a", name, samples, {"wf_increment": step})])
    refused(lambda: read_record(path), "'y' has 1000 Hz but 'z' has 500 Hz")


@pytest.mark.parametrize("layout", ["contiguous", "interleaved"])
def test_tdms_cut_off(tmp_path, layout, capfd):
    samples = shapes.vibration(1000)
    path = shapes.write_tdms(tmp_path / "rig.tdms", samples, segments=4)
    content = path.read_bytes()
    if layout == "interleaved":
        # Bit 5 of each segment's table of contents; the same bytes, read in turn.
        content = re.sub(rb"TDSm(.)", lambda m: b"TDSm" + bytes([m[1][0] | 0x20]), content)
        path.write_bytes(content)
        samples = np.concatenate([p.T.reshape(-1, 2) for p in np.split(samples, 4)])
        np.testing.assert_array_equal(read_record(path).samples, samples)
    # 60 values are missing: of the last channel where they lie one behind the other.
    path.write_bytes(content[: -60 * 8])
    sound = 940 if layout == "contiguous" else 970
    refused(lambda: read_record(path), "cut off", f"{sound} samples up to {sound / RATE:.9g}")
    stream = open_record(path)
    assert (stream.length, stream.fault is None) == (sound, False)
    np.testing.assert_array_equal(np.concatenate(list(stream)), samples[:sound])
    assert "cut off" in stream.status and f"{sound} samples are sound" in stream.status
    part = read_record(path, stop=sound / RATE)
    np.testing.assert_array_equal(part.samples, samples[:sound])
    assert capfd.readouterr() == ("", "")
    assert logging.getLogger("nptdms.reader").level == logging.WARNING


@pytest.mark.parametrize("left", [1, 20, 27, 60, 100])
def test_tdms_cut_off_within_what_stands_before_the_samples(tmp_path, left):
    samples = shapes.vibration(1000)
    path = shapes.write_tdms(tmp_path / "rig.tdms", samples, segments=4)
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"TDSm") + left])
    refused(lambda: read_record(path), "cut off", "750 samples")
    np.testing.assert_array_equal(np.concatenate(list(open_record(path))), samples[:750])


def test_tdms_of_a_rig_that_crashed(tmp_path):
    samples = shapes.vibration(1000)
    path = shapes.write_tdms(tmp_path / "rig.tdms", samples, segments=4)
    content = bytearray(path.read_bytes())
    last = content.rindex(b"TDSm")
    content[last + 12 : last + 20] = b"\xff" * 8
    path.write_bytes(content)
    refused(lambda: read_record(path), "cut off", "1000 samples")
    np.testing.assert_array_equal(np.concatenate(list(open_record(path))), samples)


def test_tdms_of_a_big_endian_controller(tmp_path):
    path, samples = tmp_path / "rig.tdms", shapes.vibration(300, 1)
    content = shapes.big_endian_tdms(samples[:, 0])
    path.write_bytes(content)
    record = read_record(path)
    assert (record.rate, record.channels) == (RATE, ("y",))
    np.testing.assert_array_equal(record.samples, samples)
    path.write_bytes(content[:-800])
    refused(lambda: read_record(path), "cut off", "200 samples")


# WAV


def test_wav_integers_are_fractions_of_full_scale(tmp_path):
    rng = np.random.default_rng(1)
    for bits, write in ((16, shapes.write_wav16), (24, shapes.write_wav24)):
        top = 2 ** (bits - 1)
        integers = rng.integers(-top, top, (200, 3))
        integers[0], integers[1] = -top, top - 1
        record = read_record(write(tmp_path / "i.wav", integers))
        np.testing.assert_array_equal(record.samples, integers / top)
        assert record.channels == ("data 1", "data 2", "data 3")
    integers = rng.integers(-(2**31), 2**31, (200, 1), dtype=np.int32)
    record = read_record(shapes.write_wav(tmp_path / "i.wav", integers))
    np.testing.assert_array_equal(record.samples, integers / 2.0**31)
    assert record.channels == ("data",)
    octets = rng.integers(0, 256, (201, 1), dtype=np.uint8)
    record = read_record(shapes.write_wav(tmp_path / "i.wav", octets))
    np.testing.assert_array_equal(record.samples, (octets - 128.0) / 128.0)


def test_wav_agrees_with_scipy(tmp_path):
    samples = shapes.vibration(777, 4).astype(np.float32)
    path = shapes.write_wav(tmp_path / "f.wav", samples, 51200)
    rate, values = scipy.io.wavfile.read(path)
    record = read_record(path)
    assert record.rate == rate
    np.testing.assert_array_equal(record.samples, values)


def test_wav_with_remarks_around_the_samples(tmp_path):
    samples = shapes.vibration(50, 1).astype(np.float32)
    content = shapes.write_wav(tmp_path / "f.wav", samples).read_bytes()
    remark = b"LIST" + (5).to_bytes(4, "little") + b"INFOx\0"
    body = content[8:12] + remark + content[12:] + remark
    path = tmp_path / "remarks.wav"
    path.write_bytes(b"RIFF" + len(body).to_bytes(4, "little") + body)
    np.testing.assert_array_equal(read_record(path).samples, samples)


def test_wav_cut_off_or_not_closed(tmp_path):
    samples = shapes.vibration(1000).astype(np.float32)
    path = shapes.write_wav(tmp_path / "f.wav", samples)
    content = path.read_bytes()
    path.write_bytes(content[:-81])
    refused(lambda: read_record(path), "cut off", "1000 samples", "989 samples up to")
    stream = open_record(path)
    np.testing.assert_array_equal(np.concatenate(list(stream)), samples[:989])
    assert "989 samples are sound" in stream.status
    at = content.index(b"data") + 4
    for size in (b"\0" * 4, b"\xff" * 4):
        path.write_bytes(content[:at] + size + content[at + 4 :])
        refused(lambda: read_record(path), "not closed", "1000 samples")
        np.testing.assert_array_equal(np.concatenate(list(open_record(path))), samples)
    path.write_bytes(content[:30])
    refused(lambda: read_record(path), "ends within its header")


def test_wav_with_64_bit_sizes_and_unknown_encodings(tmp_path):
    samples = shapes.vibration(100).astype(np.float32)
    path = tmp_path / "long.wav"
    path.write_bytes(shapes.rf64(samples))
    np.testing.assert_array_equal(read_record(path).samples, samples)
    path.write_bytes(shapes.rf64(samples, size=8 * 120))
    refused(lambda: read_record(path), "120 samples", "100 samples up to")
    content = bytearray(shapes.rf64(samples))
    content[content.index(b"fmt ") + 8] = 2
    path.write_bytes(content)
    refused(lambda: read_record(path), "encoding 2 cannot be read", "save them as")


# HDF5 and MATLAB


def test_hdf5_units_rates_and_shapes(tmp_path):
    path, samples = tmp_path / "r.h5", shapes.vibration(400, 3)
    with h5py.File(path, "w") as file:
        file["force x [kN]"] = samples[:, 0]
        file["block"] = samples.T.astype(np.float32)
        file["block"].attrs["units"] = "mm"
        file["sampling rate [kHz]"] = 10.0
        file["picture"] = np.zeros((400, 300))
        file["cube"] = np.zeros((400, 2, 2))
        file["text"] = "milled"
    record = read_record(path)
    assert record.rate == 10000.0
    assert set(zip(record.channels, record.units, strict=True)) == {
        ("force x", "N"),
        *((f"block {i}", "m") for i in (1, 2, 3)),
    }
    found = dict(zip(record.channels, record.samples.T, strict=True))
    np.testing.assert_array_equal(found["force x"], samples[:, 0] * 1e3)
    np.testing.assert_allclose(found["block 3"], samples[:, 2] * 1e-3, rtol=1e-6)


@pytest.mark.parametrize("form", ["hdf5", "mat", "mat73"])
def test_vector_of_times_tells_the_rate(tmp_path, form):
    samples, times = np.arange(500.0), 3.0 + np.arange(500) / 51200.0
    path = tmp_path / f"r.{form[:3]}"

    def save(times):
        arrays = {"time": times, "y": samples}
        if form == "mat":
            scipy.io.savemat(path, arrays)
        elif form == "mat73":
            shapes.write_mat73(path, **arrays)
        else:
            with h5py.File(path, "w") as file:
                for name, array in arrays.items():
                    file[name] = array

    save(times)
    record = read_record(path)
    assert (record.rate, record.channels) == (51200.0, ("y",))
    save(times.astype(np.float32))
    assert read_record(path).rate == pytest.approx(51200.0, rel=1e-2)
    save(np.where(np.arange(500) < 300, times, times + 0.01))
    refused(lambda: read_record(path), "'time'", "sample 301", "512 samples are missing")


def test_file_without_rate_or_signal(tmp_path):
    path = tmp_path / "r.mat"
    scipy.io.savemat(path, {"data": np.arange(10.0)})
    refused(lambda: read_record(path), "does not tell its sampling rate", "Hz")
    scipy.io.savemat(path, {"fs": 100.0, "note": "milled"})
    refused(lambda: read_record(path), "no channel of numbers")
    refused(lambda: read_record(path, channels="data"), "no channel 'data'", "no signal")


# Memory


@pytest.mark.parametrize("form", ["tdms", "wav", "hdf5", "csv"])
def test_memory_does_not_grow_with_the_recording(tmp_path, form):
    peaks = []
    for count in (60_000, 240_000):
        samples = shapes.vibration(1000, 1)
        if form == "csv":
            row = "0.123456789,"
            path = tmp_path / "r.csv"
            path.write_text("a [m], b [m]\n" + f"{row}0.5\n" * count)
        else:
            tiled = np.tile(samples, (count // 1000, 1))
            if form == "tdms":
                path = shapes.write_tdms(tmp_path / "r.tdms", tiled, ("y",), segments=count // 4000)
            else:
                path, _ = written(form, tmp_path, np.tile(tiled, (1, 2)))
        tracemalloc.start()
        total = sum(len(block) for block in open_record(path, RATE, block_length=4096))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert total == count
    # The whole recording would take four times as much; TDMS keeps a note on every segment.
    assert peaks[1] < 1.6 * peaks[0]
    if form in ("wav", "hdf5"):
        assert peaks[1] < 240_000 * 2 * 8 / 4


# A real recording


@needs(MILLING_CUT)
def test_recording_of_milling():
    record = read_record(MILLING_CUT, rate=10000.0)
    assert (record.channels, record.units) == (("data",), ("1",))
    assert record.samples.shape == (80018, 1)
    values = scipy.io.loadmat(MILLING_CUT)["data"]
    np.testing.assert_array_equal(record.samples, values)
    blocks = list(open_record(MILLING_CUT, rate=10000.0, block_length=777))
    np.testing.assert_array_equal(np.concatenate(blocks), values)
    part = read_record(MILLING_CUT, 10000.0, start=3.4, stop=5.0)
    np.testing.assert_array_equal(part.samples, values[34000:50000])
    refused(lambda: read_record(MILLING_CUT), "sampling rate")
    # Every value stands twice, and nothing else is wrong with it.
    assert held_samples(values[:, 0]) == 2
    (finding,) = flags(values)
    assert finding.name == "values repeated"
    assert (finding.first_sample, finding.count) == (1, 40009)
