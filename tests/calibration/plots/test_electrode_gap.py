"""What the pictures of gap and sizes show, read back from their artists."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from calibration.electrode import GapData
from calibration.electrode_gap import fit_gap
from calibration.plans.electrode import corrected_path, predict_sizes
from calibration.plots.electrode_gap import draw_gap, draw_sizes


@pytest.fixture(scope="module")
def data():
    return GapData(np.random.default_rng(7).normal(14.75, 2.3, 10), 0.41)


@pytest.fixture(scope="module")
def posterior(data):
    return fit_gap(data)


def texts(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_readings_stand_beside_the_bands(data, posterior):
    figure = draw_gap(data, posterior, 0.8)
    FigureCanvasAgg(figure).draw()
    left, right = figure.axes
    points = left.containers[0].lines[0]
    np.testing.assert_allclose(points.get_ydata(), data.gap)
    spans = [(patch.get_y(), patch.get_y() + patch.get_height()) for patch in left.patches]
    np.testing.assert_allclose(spans[0], posterior.next_gap().interval(0.8))
    np.testing.assert_allclose(spans[1], posterior.mean.interval(0.8))
    assert texts(left)[:2] == ["next gap, 80 %", "mean gap, 80 %"]
    assert "10 readings" in right.get_title(loc="left")


def test_the_posterior_is_densest_at_its_mode(data, posterior):
    right = draw_gap(data, posterior).axes[1]
    filled = right.collections[0]
    top = np.concatenate([p.vertices for p in filled.get_paths() if len(p.vertices)][-1:])
    # The innermost contour lies about the mean of the readings.
    assert top[:, 0].min() < np.mean(data.gap) < top[:, 0].max()
    assert top[:, 1].min() > 0.5 and top[:, 1].max() < 5.0


def test_sizes_are_drawn_as_differences_from_the_drawing(posterior):
    found = corrected_path([60.0, 120.0], posterior, 100.0).prediction
    figure = draw_sizes(found)
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    bars = axes.collections[0].get_segments()
    for bar, interval, wanted in zip(bars, found.interval, found.wanted, strict=True):
        np.testing.assert_allclose(np.asarray(bar)[:, 1], interval - wanted)
    allowed = [line.get_segments() for line in axes.collections[1:3]]
    assert [segment[0][0][1] for segment in allowed] == pytest.approx([-1.2, 1.2])
    assert texts(axes) == ["90 % of electrodes", "expected", "±2 %"]


def test_without_a_drawing_the_expected_sizes_are_the_reference(posterior):
    axes = draw_sizes(predict_sizes([165.0], posterior, 100.0)).axes[0]
    assert axes.get_ylabel() == "size − expected [µm]"
    assert len(axes.collections) == 1
