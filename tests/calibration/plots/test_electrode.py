"""What a picture of a wire's path shows, read back from its artists."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from calibration.plots.electrode import draw_wire_path
from procmodel.electrode import (
    cone_frustum,
    curved,
    deviations,
    interpolate_line,
    interpolate_profile,
    wire_path,
)


def drawn(profile, step=0.3, resolution=0.1, reach=25.0):
    path = wire_path(profile, reach, 0.0)
    figure = draw_wire_path(profile, path, step, resolution, reach)
    FigureCanvasAgg(figure).draw()
    return path, figure


def line_named(axes, word):
    return next(line for line in axes.lines if word in line.get_label())


def test_profile_path_wire_and_deviation():
    profile = curved(30.0, 60.0, 150.0, 200.0)
    path, figure = drawn(profile)
    section, along = figure.axes
    outline = section.lines[0].get_xydata()
    np.testing.assert_allclose(outline, interpolate_profile(profile, 0.3)[0])
    filled = section.patches[0].get_xy()
    assert filled[:, 0].min() == -filled[:, 0].max()
    exact = line_named(section, "centre of the wire").get_xydata()
    np.testing.assert_allclose(exact, interpolate_profile(path, 0.3)[0])
    round_wire = line_named(section, "wire and gap").get_xydata()
    np.testing.assert_allclose(np.hypot(*(round_wire - exact[0]).T), 25.0)
    points, piece = interpolate_profile(path, 0.3, 0.1)
    at_points, at_middles = deviations(path, points, piece)
    np.testing.assert_allclose(along.lines[0].get_ydata(), 1e3 * at_points)
    np.testing.assert_allclose(along.lines[1].get_ydata(), 1e3 * at_middles)
    assert along.lines[0].get_xdata()[-1] == pytest.approx(
        np.hypot(*np.diff(exact, axis=0).T).sum()
    )


def test_the_magnification_is_the_one_named():
    path, figure = drawn(curved(30.0, 60.0, 150.0, 200.0))
    magnified = line_named(figure.axes[0], "deviation ×")
    factor = float(magnified.get_label().split("×")[1])
    exact, piece = interpolate_profile(path, 0.3)
    points, _ = interpolate_profile(path, 0.3, 0.1)
    at_points, _ = deviations(path, points, piece)
    shifted = np.hypot(*(magnified.get_xydata() - exact).T)
    np.testing.assert_allclose(shifted, factor * np.abs(at_points), atol=1e-9)
    # Large enough to be seen, and a round number.
    assert 0.02 < shifted.max() / exact[:, 0].max() < 0.1
    assert float(f"{factor:.0e}") == factor


def test_no_wire_draws_none():
    _, figure = drawn(cone_frustum(30.0, 60.0, 150.0), reach=0.0)
    assert not [line for line in figure.axes[0].lines if line.get_label() == "wire and gap"]


def test_long_paths_are_thinned_but_keep_their_extremes():
    profile = cone_frustum(300.0, 600.0, 15_000.0)
    _, figure = drawn(profile, reach=0.0)
    points = figure.axes[1].lines[0].get_ydata()
    assert len(points) < 10_000 < len(interpolate_line((300, 0), (600, 15_000), 0.3))
    exact, piece = interpolate_profile(profile, 0.3)
    at_points, _ = deviations(profile, interpolate_profile(profile, 0.3, 0.1)[0], piece)
    assert points.max() == pytest.approx(1e3 * at_points.max())
    assert points.min() == pytest.approx(1e3 * at_points.min())
    assert len(exact) == len(at_points)
