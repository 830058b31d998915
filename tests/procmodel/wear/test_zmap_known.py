"""What comes out of the z-map simulation against the laws it does not contain.

Sources: eqs. (1) to (3) of Yu and Masuzawa 1997; the path laws of a bottom that wears evenly
(a pass leaves h = dZ exp(-x / lambda), lambda = S_e / (R W), and repeated passes are tilted by
L_e); the wedge and the cone that a steady feed per length k leaves on the tip, from the balance of
volumes: every cell of a fixed tip loses k per length and cuts k / R, so the tip rises by k / R; a
ring of a turning tip cuts along its width 2 r only but wears along 2 pi r.
"""

import math

import numpy as np
import pytest

from procmodel.wear import electrode_wear, layer_depth
from procmodel.wear.feed_law import fixed_length_feeds, linear_feeds
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.path_steps import path_steps
from procmodel.wear.zmap import simulate
from procmodel.wear.zmap_maps import WorkpieceMap
from tests.procmodel.wear.zmap_cases import MODES, cut, electrode, raster, whole


def expected(result, tool, feed, ratio):
    """Layer depths of eq. (3) for the areas that the paths cover."""
    return layer_depth(feed, result.swept_area, ratio, tool.section_area)


@pytest.mark.parametrize(("shape", "mode"), MODES)
def test_layers_have_the_depth_of_eq_3_after_the_start(shape, mode):
    tool = electrode(shape)
    result = cut(raster(16.0, 8.0, 24, to_and_fro=False), tool, mode=mode, width=2.0)
    error = np.asarray(result.layer_depth / expected(result, tool, 1.0, 0.2) - 1.0)
    assert np.max(np.abs(error[16:])) < 1e-4
    # The first layer is another: the electrode has not yet the wear it will begin the others with.
    assert error[0] > 0.1


def test_crossed_directions_have_the_depth_of_eq_3_in_the_mean():
    # Layers of a cycle differ for good; their mean cannot.
    across = raster(16.0, 8.0, 2)
    along = [LayerPath(path.points[:, ::-1].copy(), path.cutting) for path in across]
    tool = electrode()
    result = cut((across + along) * 9, tool)
    error = np.asarray(result.layer_depth / expected(result, tool, 1.0, 0.2) - 1.0)
    cycles = error.reshape(-1, 4)
    assert np.max(np.abs(cycles[5:])) > 0.01
    assert np.max(np.abs(np.mean(cycles[5:], axis=1))) < 1e-3


@pytest.mark.parametrize(("u", "decay"), [(1.0, 0.22), (2.0, 0.40)])
def test_the_start_fades_as_the_delay_equation_says(u, decay):
    tool = electrode(size=6.0)
    length = 120.0
    ratio = u * tool.section_area / (6.0 * (length + 6.0))
    result = cut([whole([(0, 0), (length, 0)])] * 9, tool, ratio=ratio, mode="uniform")
    error = np.asarray(result.layer_depth / expected(result, tool, 1.0, ratio) - 1.0)
    # The slowest pair of roots makes e[n+2] = a e[n+1] + b e[n] with |root|^2 = -b.
    e = error[2:]
    (_, b), *_ = np.linalg.lstsq(np.column_stack([e[1:-1], e[:-2]]), e[2:])
    assert math.sqrt(-b) == pytest.approx(decay, rel=0.15)


def test_one_pass_falls_off_exponentially():
    ratio, errors = 0.02, []
    for cell in (2.0, 1.0, 0.5):
        tool = electrode(cell=cell)
        result = cut([whole([(0, 0), (100, 0)])], tool, ratio=ratio, step=cell, mode="uniform")
        middle = np.asarray(result.depth)[:, result.depth.shape[1] // 2]
        way = result.surface.x + 5.0
        inner = (way > 12.0) & (way < 100.0)
        law = np.exp(-way * ratio / 10.0)
        errors.append(np.max(np.abs(middle / law - 1.0)[inner]))
    assert errors[0] > errors[1] > errors[2]
    # Of second order in R (the plunge), and of first order in the cell.
    assert errors[2] < 1e-3


def test_repeated_passes_one_way_are_tilted_by_the_wear_of_a_layer():
    tool = electrode()
    errors = []
    for length in (50.0, 100.0, 200.0):
        ratio = 1.0 * tool.section_area / (10.0 * (length + 10.0))
        result = cut(
            [whole([(0, 0), (length, 0)])] * 14, tool, ratio=ratio, mode="spread", width=math.inf
        )
        middle = np.asarray(result.depth)[:, result.depth.shape[1] // 2]
        bottom = middle[middle > 0]
        wear = float(electrode_wear(1.0, 10.0 * (length + 10.0), ratio, tool.section_area))
        assert wear == pytest.approx(0.5)
        errors.append(abs((bottom[0] - bottom[-1]) / wear - 1.0))
    assert errors[2] < 0.01
    # The electrode's own length on the path is what is left: it halves as the path doubles.
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("mode", ["uniform", "local"])
def test_the_rules_of_the_path_keep_the_bottom_flat_within_one_feed(mode):
    # To and fro, directions crossed, lines that overlap: the rules 2 and 3 of the paper.
    across = raster(24.0, 8.0, 2)
    along = [LayerPath(path.points[:, ::-1].copy(), path.cutting) for path in across]
    valleys = []
    for paths in ((across + along) * 6, across[:1] * 24):
        result = cut(paths, electrode(), ratio=0.1, mode=mode)
        inner = np.abs(result.surface.x - 12.0) < 16.0
        valleys.append(np.ptp(np.asarray(result.depth)[np.ix_(inner, inner)]))
    assert valleys[0] < 1.0
    assert valleys[0] < 0.9 * valleys[1]


FEED, RATIO = 0.02, 0.2


def groove(shape, mode, cell, length, fixed=None):
    """A groove cut with a feed per length, and its area over the last third but the end."""
    tool = electrode(shape, cell=cell)
    steps = path_steps([whole([(0, 0), (length, 0)])], cell)
    feeds = linear_feeds(steps, FEED)
    if fixed is not None:
        feeds = fixed_length_feeds(steps, FEED * fixed, fixed)
    flat = WorkpieceMap.around(steps, tool)
    result = simulate(steps, feeds, tool, flat, RATIO, wear_mode=mode)
    there = (result.surface.x > 0.6 * length) & (result.surface.x < 0.85 * length)
    area = float(np.mean(np.sum(np.asarray(result.depth)[there], axis=1))) * cell
    return tool, np.asarray(result.electrode_loss), area


def test_a_fixed_tip_becomes_a_wedge():
    cells, heights = np.array([2.0, 1.0, 0.5]), []
    for cell in cells:
        tool, loss, area = groove("square", "local", cell, 200.0)
        middle = loss[:, tool.width // 2]
        slope = np.diff(middle) / cell
        # The wear under neighbours is exactly k / R apart, once it is steady.
        np.testing.assert_allclose(slope, FEED / RATIO, rtol=2e-3)
        assert area == pytest.approx(FEED * tool.section_area / RATIO, rel=2e-2)
        heights.append(1.0 - np.ptp(middle) / (10.0 * FEED / RATIO))
    order = np.polyfit(np.log(cells), np.log(heights), 1)[0]
    assert order == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_a_rotating_tip_becomes_a_cone():
    cells, errors = np.array([1.0, 0.5, 0.25]), []
    for cell in cells:
        tool, loss, area = groove("round", "rotating", cell, 250.0)
        radius = np.hypot(*tool.centres)
        flank = (radius > 1.0) & (radius < 4.0)
        slope = np.polyfit(radius[flank], loss[flank], 1)[0]
        errors.append(1.0 - slope / (math.pi * FEED / RATIO))
        assert area == pytest.approx(FEED * tool.section_area / RATIO, rel=1e-3)
    assert errors[-1] < 0.06
    assert np.polyfit(np.log(cells), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("fixed", [2.0, 5.0])
def test_fixed_length_compensation_cuts_the_same_groove(fixed):
    tool, _, area = groove("square", "local", 1.0, 250.0, fixed)
    assert area == pytest.approx(FEED * tool.section_area / RATIO, rel=1e-3)


def squares(half, apart):
    """Concentric squares from the inside (fig. 5)."""
    sizes = np.arange(half, 0.0, -apart)[::-1]
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    return whole(np.concatenate([size * corners for size in sizes]))


@pytest.mark.slow
def test_sub_feeds_make_eq_4_hold_for_a_frustum():
    # A pyramid from 200 um down in steps of 10 um, electrode 50 um square.
    tool = electrode(size=50.0, cell=2.5)
    found = []
    for parts in (1, 4, 8):
        paths = []
        for half_width in 100.0 - 10.0 * np.arange(7):
            path = squares(half_width - 25.0, 40.0)
            paths += [path.reversed() if n % 2 else path for n in range(parts)]
        result = cut(paths, tool, feed=10.0 / parts, step=2.5, mode="uniform")
        area = np.asarray(result.swept_area).reshape(-1, parts)[:, 0]
        depth = np.sum(np.asarray(result.removed).reshape(-1, parts), axis=1) / area
        law = np.asarray(layer_depth(10.0, area, 0.2, tool.section_area))
        found.append(np.sqrt(np.mean((depth / law - 1.0) ** 2)))
    # As a separate study of such a frustum had it: a thin-layer law.
    np.testing.assert_allclose(found, [0.11, 0.033, 0.018], rtol=0.25)
