"""What a picture of a detection shows, read back from its artists."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from calibration.chatter_detection import detect_record
from calibration.chatter_trace import Trace
from calibration.plots.chatter import draw_detection
from tests.calibration.chatter_recordings import RATE, detector, recording


class Blocks:
    """A recording in one block."""

    path, start, length, fault, status = "made", 0.0, None, None, "read to the end"

    def __init__(self, samples):
        self.samples = samples

    def __iter__(self):
        return iter([self.samples])


def drawn(samples, interval=None, rows=2048, **settings):
    made = detector(**settings)
    trace = Trace(made, 0.0, rows=rows)
    found = detect_record(Blocks(samples), made, trace)
    figure = draw_detection(found, trace, ("m/s^2",), interval)
    FigureCanvasAgg(figure).draw()
    return found, trace, figure


@pytest.fixture(scope="module")
def chatter():
    return drawn(recording(), (60.0, 150.0))


def test_score_threshold_and_its_band(chatter):
    found, _, figure = chatter
    score, *_ = figure.axes
    time, values = score.lines[0].get_data()
    assert np.nanmax(values) == found.tally.score_max
    # A window's score stands from when it is known.
    assert time[np.argmax(values)] == pytest.approx(found.tally.time)
    np.testing.assert_array_equal(score.lines[1].get_ydata(), [100.0, 100.0])
    bands = [p.get_height() for p in score.patches if p.get_x() == 0.0]
    assert 90.0 in [pytest.approx(height) for height in bands]
    assert "60 to 150" in score.get_legend().get_texts()[1].get_text()


def test_states_are_shaded_and_events_marked(chatter):
    found, _, figure = chatter
    score, spectrum, *_ = figure.axes
    shades = [p for p in score.patches if p.get_x() != 0.0]
    # From entry to exit without a hole.
    spans = sorted((p.get_x(), p.get_x() + p.get_width()) for p in shades)
    for (_, end), (begin, _) in pairwise(spans):
        assert begin == pytest.approx(end)
    assert spans[0][0] == pytest.approx(2.0, abs=0.15)
    assert spans[-1][1] == pytest.approx(4.0, abs=0.3)
    marks = [line.get_xdata()[0] for line in score.lines if line.get_marker() == "v"]
    assert marks == [event.time_s for event in found.events]
    rings = [(line.get_xdata()[0], line.get_ydata()[0]) for line in spectrum.lines]
    assert rings == [(event.time_s, event.frequency_hz) for event in found.events]


def test_what_is_left_out_is_beside_the_spectrogram(chatter):
    found, trace, figure = chatter
    spectrum, made = figure.axes[1], found.detector
    strips = [p for p in spectrum.patches if not p.get_clip_on()]
    bins = made.settings.windowing.frequencies
    inside = np.zeros(len(bins), bool)
    for strip in strips:
        low, high = strip.get_y(), strip.get_y() + strip.get_height()
        inside |= (bins > low) & (bins < high)
    scorer = made.scorer
    band = slice(scorer.low, scorer.low + scorer.bins)
    np.testing.assert_array_equal(inside[band], ~made.free[band])
    assert len(strips) > 10
    image = spectrum.images[0].get_array()
    assert image.shape == (len(trace.frequencies), trace.rows)
    low, high = spectrum.get_ylim()
    assert low < 62.5 < 2987.5 < high < 0.5 * RATE


def test_loudness_of_each_state(chatter):
    _, trace, figure = chatter
    loud = figure.axes[2]
    names = [label.get_text() for label in loud.get_yticklabels()]
    assert names == ["air", "entry", "stable", "chatter", "exit"]
    heights = {n: bar.get_width() for n, bar in zip(names, loud.patches, strict=True)}
    for name, (_, _, height) in trace.loudness().items():
        assert heights[name] == pytest.approx(height[0])
    assert heights["air"] < heights["stable"] < heights["chatter"]
    assert loud.get_xlabel().startswith("channel 1 [m/s^2]: from peak to valley")


def test_very_loud_chatter_leaves_the_rest_to_be_seen():
    _, _, figure = drawn(recording(amplitude=500.0))
    assert figure.axes[2].get_xscale() == "log"


@pytest.mark.parametrize(
    ("samples", "rows"),
    [
        (recording()[: int(1.5 * RATE)], 2048),  # air alone
        (recording()[:512], 2048),  # one window
        (recording(seconds=5.0), 16),  # windows joined
        (np.concatenate([recording(), np.full((2000, 1), np.nan)]), 2048),  # not scored
    ],
    ids=["air", "one window", "joined", "faults"],
)
def test_other_recordings_can_be_drawn(samples, rows):
    _, trace, figure = drawn(samples, rows=rows)
    assert trace.rows <= rows
    assert len(figure.axes) == 4
