"""Labelled cuts: the table, the recordings, and the scores of their windows."""

import numpy as np
import pytest

from calibration.chatter_cuts import _within, null_numbers, read_labels, score_cuts
from calibration.chatter_detection import Source, detector_for
from procmodel.chatter import CUTTING, detect, scores
from procmodel.errors import InputError
from procmodel.io.baselines import load_baselines
from procmodel.io.records import read_record
from tests.calibration import labelled_cuts as shapes

BAND = (200.0, 3500.0)
HEADER = "file,label,spindle speed [1/min],tool"


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shop")
    return shapes.shop(folder, labels=("stable", "marginal", "chatter", "chatter"))


def test_a_table_is_read_with_its_units_and_empty_cells(shop):
    table, _ = shop
    text = table.read_text().replace("spindle speed [1/min]", "spindle speed [Hz]")
    other = table.parent / "other.csv"
    other.write_text("# cuts of Monday\n" + text.replace("6000", "100").replace(",", ";"))
    rows = read_labels(other)
    assert [row.label for row in rows] == ["stable", "marginal", "chatter", "chatter"]
    assert rows[0].spindle_speed == pytest.approx(6000.0)
    assert (rows[0].start, rows[0].stop, rows[1].start) == (0.1, None, None)
    assert rows[1].file == table.parent / "cut 1.wav"
    assert rows[3].name == f"{other}, row 6"


def test_scores_are_those_of_the_detector_in_the_windows_of_the_cut(shop):
    table, file = shop
    baselines = load_baselines(file)
    cuts, detector = score_cuts(read_labels(table), baselines, band=BAND, window=512)
    assert [cut.label for cut in cuts] == ["stable", "marginal", "chatter", "chatter"]
    record = read_record(table.parent / "cut 2.wav")
    source = Source(record.rate, record.channels, record.units)
    own, _ = detector_for(baselines, source, 6000.0, band=BAND)
    found = detect(own, record.samples).observations
    inside = [o.engagement == CUTTING for o in found]
    from calibration.chatter_detection import air_cut_at

    plain = scores(record.samples, air_cut_at(baselines, 6000.0), own.settings)
    np.testing.assert_array_equal(cuts[2].scores, plain.score[np.array(inside)])
    assert cuts[2].step == 256 / 8000.0 and cuts[2].length == 512 / 8000.0
    # The first window is of the entry, and so is the second.
    assert 0 < inside.count(False) <= 2
    assert np.median(cuts[2].scores) > 2.0 * np.median(cuts[0].scores)
    count, bins = null_numbers(detector, baselines, 6000.0)
    assert count == baselines.overrides[0].count
    assert bins == np.isfinite(detector.scorer.offset).sum()


def test_averaged_scores_and_distances_follow_each_other(shop):
    table, file = shop
    options = {"band": BAND, "keep_distances": True}
    single, detector = score_cuts(read_labels(table), load_baselines(file), **options)
    for cut in single:
        np.testing.assert_allclose(np.nanmax(cut.distances, axis=1), cut.scores, rtol=1e-9)
        assert cut.frequencies[0] >= 200.0 - detector.settings.windowing.resolution
        # Multiples of the rotation are left out.
        at = np.argmin(np.abs(cut.frequencies - 500.0))
        assert np.isnan(cut.distances[:, at]).all()
    three, _ = score_cuts(read_labels(table), load_baselines(file), band=BAND, averaged=3)
    for one, other in zip(single, three, strict=True):
        d = one.distances
        mean = np.nanmax((d[2:] + d[1:-1] + d[:-2]) / 3.0, axis=1)
        # The window of the entry is averaged too, so that the first two are not among these.
        np.testing.assert_allclose(other.scores[-len(mean) :], mean, rtol=1e-9)
        assert other.length == pytest.approx(one.length + 2 * one.step)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", "the table is empty: begin it with a header, file,label"),
        (HEADER, "there is a header but no cut below it"),
        (HEADER.replace("label", "labels") + "\n", "row 1: column 'label' is missing among"),
        (HEADER + ",tool\n", "row 1: column 'tool' stands twice among"),
        (HEADER.replace(" [1/min]", ""), "row 1: column 'spindle speed' has no unit"),
        (HEADER.replace("1/min", "mm"), "row 1: column 'spindle speed'"),
        (HEADER + "\ncut 0.wav,chater,6000,T1", "row 2: label 'chater' is unknown; did you mean"),
        (HEADER + "\n\ncut 0.wav,,6000,T1", "row 3: column 'label' is empty"),
        (HEADER + "\ncut 9.wav,stable,6000,T1", "row 2: there is no file 'cut 9.wav' in"),
        (HEADER + "\ncut 0.wav,stable,fast,T1", "row 2: column 'spindle speed' holds 'fast'"),
        (HEADER + "\ncut 0.wav,stable,0,T1", "row 2: .* write a number above 0"),
        (HEADER + "\ncut 0.wav,stable,6,0,T1", "row 2: 5 cells where the header names 4"),
        (
            HEADER + ",start [s],stop [s]\ncut 0.wav,stable,6000,T1,2,1",
            "row 2: start 2 s is not before stop 1 s",
        ),
        (
            HEADER + ",start [s],stop [s]\ncut 0.wav,stable,6000,T1,-2,1",
            "row 2: column 'start' holds '-2': write a number of 0 or more",
        ),
    ],
)
def test_faulty_tables_name_file_and_row(shop, table, words):
    path = shop[0].parent / "faulty.csv"
    path.write_text(table)
    with pytest.raises(InputError, match=words) as caught:
        read_labels(path)
    assert "faulty.csv" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("row", "options", "words"),
    [
        ("cut 0.wav,stable,7000,T1", {}, "row 2: .*spindle speed 6000 1/min, the record has 7000"),
        ("air.wav,stable,6000,T1", {}, "row 2: air.wav: the tool cuts in none of 249 windows"),
        ("cut 0.wav,stable,6000,T1", {"window": 1024}, "row 2: .*window length 512, not 1024"),
        ("cut 0.wav,stable,6000,T1", {"channels": ["z"]}, "row 2: .*'z'"),
        ("labels.csv,stable,6000,T1", {}, "row 2: .*labels.csv"),
        ("nothing.wav,stable,6000,T1", {}, "row 2: .*every window is stuck"),
    ],
)
def test_recordings_that_do_not_fit_name_file_and_row(shop, row, options, words):
    path = shop[0].parent / "cuts.csv"
    path.write_text(f"{HEADER}\n{row}\n")
    shapes.record(path.parent / "nothing.wav", np.full(8000, 0.5))
    with pytest.raises(InputError, match=words) as caught:
        score_cuts(read_labels(path), load_baselines(shop[1]), band=BAND, **options)
    assert "cuts.csv" in str(caught.value) and "\n" not in str(caught.value)


def test_averaging_is_at_least_one(shop):
    with pytest.raises(InputError, match="averaged spectra are 0"):
        score_cuts(read_labels(shop[0]), load_baselines(shop[1]), averaged=0)
    with pytest.raises(InputError, match="there is no labelled cut"):
        score_cuts([], load_baselines(shop[1]))


def test_windows_partly_of_the_air_behind_a_cut_are_left_out():
    def kept(cutting):
        return _within(np.array(cutting, bool), 3).astype(int).tolist()

    assert kept([0, 1, 1, 1, 1, 1, 0]) == [0, 1, 1, 0, 0, 0, 0]
    # Of two cuts each loses its own; a record that ends in the cut has no air behind it.
    assert kept([1, 1, 1, 1, 0, 1, 1, 1, 1]) == [1, 0, 0, 0, 0, 1, 1, 1, 1]
    # One too short to lose them keeps them all.
    assert kept([0, 1, 1, 0]) == [0, 1, 1, 0]
