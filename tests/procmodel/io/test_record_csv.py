"""Recordings as text: the header, the clock, and what a row must hold."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io.record_clock import first_flaw, printed_resolution, rate_of_clock
from procmodel.io.record_units import rate_among, si_unit, split_heading
from procmodel.io.records import open_record, read_record
from tests.procmodel.io.record_shapes import RATE, table_text, vibration


@pytest.fixture
def file(tmp_path):
    def write(content, name="record.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def refused(path, *words, **arguments):
    with pytest.raises(InputError) as caught:
        read_record(path, **arguments)
    text = str(caught.value)
    assert "\n" not in text
    for word in (str(path), *words):
        assert word in text, text


@pytest.mark.parametrize(
    ("unit", "factor", "si"),
    [
        ("m/s^2", 1.0, "m/s^2"),
        ("m/s2", 1.0, "m/s^2"),
        ("m/s\N{SUPERSCRIPT TWO}", 1.0, "m/s^2"),
        ("m/s**2", 1.0, "m/s^2"),
        ("mm/s^2", 1e-3, "m/s^2"),
        ("g", 9.80665, "m/s^2"),
        ("\N{MICRO SIGN}m", 1e-6, "m"),
        ("mm/s", 1e-3, "m/s"),
        ("kN", 1e3, "N"),
        ("MN", 1e6, "N"),
        ("mV", 1e-3, "V"),
        ("N*m", 1.0, "N*m"),
        ("kW", 1e3, "W"),
        ("deg", np.pi / 180, "rad"),
        ("-", 1.0, "1"),
    ],
)
def test_units(unit, factor, si):
    found = si_unit(unit)
    assert found == (pytest.approx(factor, rel=1e-15), si)


def test_units_that_mean_nothing_here():
    with pytest.raises(InputError, match="unknown unit 'furlongz'"):
        si_unit("furlongz")
    with pytest.raises(InputError, match="measures nothing that vibrates"):
        si_unit("kg")


def test_headings_and_rates_of_properties():
    assert split_heading(" acceleration y [m/s^2] ") == ("acceleration y", "m/s^2")
    assert split_heading("force (N)") == ("force", "N")
    assert split_heading("data 1") == ("data 1", None)
    assert rate_among({"x": 3, "Sampling_Rate": 5.0}) == 5.0
    assert rate_among({"sampling rate [kHz]": "5"}) == 5000.0
    assert rate_among({"dt [ms]": 2.0}) == 500.0
    assert rate_among({"wf_increment": 1 / 51200}) == 51200.0
    assert rate_among({"rate": 0.0, "fs": float("nan"), "Rate": "slow"}) is None


@pytest.mark.parametrize(
    ("header", "separator"),
    [
        ("time [s], y [mm/s^2], force x (kN)", ","),
        ("Time (s);y [mm/s^2];force x [kN]", ";"),
        ("time_s\ty [mm/s^2]\tforce x [kN]", "\t"),
        ("# time [s], y [mm/s^2], force x [kN]", ","),
        ('\ufeff# milled\n\n"time [s]","y [mm/s^2]","force x [kN]"\r', ","),
    ],
)
def test_headers_and_units(file, header, separator):
    samples = vibration(300, 2)
    path = file(table_text(samples, header=header, separator=separator))
    record = read_record(path)
    assert (record.rate, record.channels) == (RATE, ("y", "force x"))
    assert record.units == ("m/s^2", "N")
    np.testing.assert_array_equal(record.samples, samples * [1e-3, 1e3])


def test_decimal_commas_crlf_remarks_and_trailing_separators(file):
    text = "time [ms];y [V]\r\n0,0;1,5\r\n# pause\r\n\r\n0,1;-2,5\r\n0,2;1e-1;\r\n0,3;nan\r\n"
    record = read_record(file(text))
    assert record.rate == 10000.0
    np.testing.assert_array_equal(record.samples[:, 0], [1.5, -2.5, 0.1, np.nan])


@pytest.mark.parametrize(("digits", "rate"), [(5, 2560.0), (6, 25600.0), (9, 44100.0), (7, 6103.5)])
def test_rate_out_of_rounded_times(file, digits, rate):
    """The rounding of the times neither shows in the rate nor passes for uneven steps."""
    path = file(table_text(vibration(20000, 1), rate, digits=digits))
    assert read_record(path).rate == rate
    assert open_record(path, rate=rate).rate == rate
    refused(path, "not the", rate=rate * 1.001)


def test_times_that_begin_late_or_are_too_coarse(file):
    samples = vibration(100, 1)
    late = file(table_text(samples, times=1e5 + np.arange(100) / RATE))
    record = read_record(late, start=0.001)
    assert (record.rate, record.start) == (RATE, 26 / RATE)
    np.testing.assert_array_equal(record.samples, samples[26:])
    coarse = file(table_text(samples, digits=3))
    refused(coarse, "row 2")
    np.testing.assert_array_equal(read_record(coarse, rate=RATE).samples, samples)


def test_count_of_samples(file):
    rows = [f"{count},{count * 0.5}" for count in range(7, 107)]
    path = file("\n".join(["sample [1],y [m]", *rows]))
    record = read_record(path, rate=100.0)
    assert record.channels == ("y",)
    np.testing.assert_array_equal(record.samples[:, 0], np.arange(7, 107) * 0.5)
    refused(path, "does not tell its sampling rate")
    path = file("\n".join(["sample [1],y [m]", *rows[:40], *rows[43:]]))
    refused(path, "row 42", "3 samples are missing", rate=100.0)


@pytest.mark.parametrize("batch", [100, 1 << 20])
def test_flaws_of_the_clock_name_the_row(file, monkeypatch, batch):
    """Wherever the flaw lies with regard to the batches in which the file is read."""
    monkeypatch.setattr("procmodel.io.record_csv._BYTES_AT_ONCE", batch)
    samples, times = vibration(500, 1), np.arange(500) / RATE
    for at in (100, 101, 102, 103, 499):
        gap = times + np.where(np.arange(500) >= at, 17 / RATE, 0.0)
        path = file(table_text(samples, times=gap))
        refused(path, f"row {at + 2}:", "17 samples are missing")
        np.testing.assert_array_equal(read_record(path, stop=at / RATE).samples, samples[:at])
        after = read_record(path, start=(at + 17) / RATE)
        np.testing.assert_array_equal(after.samples, samples[at:])
        refused(path, f"row {at + 2}:", "7 samples are missing", start=(at + 10) / RATE)
        refused(path, f"row {at + 2}:", "17 samples are missing", stop=(at + 10) / RATE)
        refused(file(table_text(samples, times=times + (gap > times) * 0.3 / RATE)), "uneven step")
        back = np.where(np.arange(500) >= at, times - 2 / RATE, times)
        refused(file(table_text(samples, times=back)), f"row {at + 2}:", "does not rise")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        ("# only a remark\n", ["no samples"]),
        ("time [s],y [m]\n", ["header in row 1", "no sample below"]),
        ("1,2\n3,4\n", ["row 1", "numbers instead of a header", "time [s], acceleration y"]),
        ("time [s],y\n0,1\n", ["row 1", "column 'y' has no unit", "'y [m/s^2]'", "'y [1]'"]),
        ("time,y [m]\n0,1\n", ["row 1", "'time' has no unit", "'time [s]'"]),
        ("time [m],y [m]\n0,1\n", ["row 1", "'time'", "length"]),
        ("time [s],y [furlongz]\n0,1\n", ["row 1", "column 'y'", "furlongz"]),
        ("time [s],y [m],y [N]\n0,1,2\n", ["row 1", "'y' stands twice"]),
        ("time [s],[m]\n0,1\n", ["row 1", "column"]),
        ("time [s]\n0\n1\n", ["row 1", "no signal"]),
        ("y [m]\n1\n2\n", ["sampling rate"]),
        ("time [s],y [m]\n0,1\n", ["row 2", "one time does not tell the rate"]),
        ("time [s],y [m]\n0,1\n0,2\n0,3\n", ["row 2", "do not rise"]),
        ("time [s],y [m]\n0,1\n1,\n2,3\n", ["row 3", "'y' is empty"]),
        ("time [s],y [m]\n0,1\n1,good\n2,3\n", ["row 3", "'good'", "not a number"]),
        ("time [s],y [m]\n0,1\n1\n2,3\n", ["row 3", "1 of the 2 cells"]),
        ("time [s],y [m]\n0,1\n1,2,5\n2,3\n", ["row 3", "3 cells", "decimal points"]),
        ("time [s],y [m]\n0,1\nnan,2\n2,3\n", ["row 3", "'time' holds 'nan'"]),
        ("time [s];y [m]\n0,0;1\n0,5;2.5\n", ["rows 2 and 3", "decimal commas"]),
        (b"time [s],y [m]\n0,1\n1,\xff\n", ["row 3", "0xff", "UTF-8"]),
    ],
)
def test_faults_are_named(file, text, words):
    refused(file(text), *words)


def test_table_that_is_cut_off(file):
    samples = vibration(50, 2)
    path = file(table_text(samples)[:-1].rpartition(",")[0])
    refused(path, "cut off within its last row", "49 samples up to 0.0019140625 s are sound")
    stream = open_record(path)
    np.testing.assert_array_equal(np.concatenate(list(stream)), samples[:49])
    assert "cut off" in stream.status and "49 samples" in stream.status
    np.testing.assert_array_equal(read_record(path, stop=49 / RATE).samples, samples[:49])
    whole = file(table_text(samples)[:-1])
    np.testing.assert_array_equal(read_record(whole).samples, samples)


def test_a_lost_sample_of_a_signal_is_not_a_number(file):
    record = read_record(file("time [s],y [m]\n0,1\n1,nan\n2,inf\n"))
    np.testing.assert_array_equal(record.samples[:, 0], [1, np.nan, np.inf])


def test_rate_of_a_clock():
    times = np.arange(1000) / 51200
    assert rate_of_clock(times) == 51200.0
    assert rate_of_clock(np.round(times, 6), 1e-6) == pytest.approx(51200.0, rel=1e-4)
    # The part behind a gap does not count.
    assert rate_of_clock(np.where(times > 0.01, times + 5, times)) == 51200.0
    assert rate_of_clock(np.arange(50) / 7.0) == pytest.approx(7.0, rel=1e-12)
    assert first_flaw(times, 51200.0) is None
    assert first_flaw(times, 51200.0 * 1.01).at == 1
    # Each step within the rounding, but all of them too long.
    slow = np.round(np.arange(1000) / 51000, 6)
    assert "on average" in first_flaw(slow, 51200.0, 1e-6).sentence


def test_resolution_of_printed_numbers():
    assert printed_resolution(["0", "0.001", "0.002"]) == 1e-3
    assert printed_resolution([f"{i / 1000:g}" for i in range(1000)]) == pytest.approx(1e-3)
    assert printed_resolution(["1.50e-03"]) == pytest.approx(1e-5)
    assert printed_resolution(["x", ""]) == 0.0
