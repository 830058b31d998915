"""Scanning paths: what they clear, where they go, and the rules by which they change."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.wear import Hemisphere
from procmodel.wear.layer_bottoms import uniform_bottoms
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.scanning import (
    ScanningRules,
    coverage,
    finish_layer,
    finishing_caution,
    scan_layer,
    scan_layers,
)
from procmodel.wear.slicing import slices_of_slot, slices_of_solid
from procmodel.wear.slicing_reach import erode

ROUND, SQUARE = ElectrodeSection("round", 50.0), ElectrodeSection("square", 50.0)
RULES, OFF = ScanningRules(), ScanningRules(False, False, 0.0, False)
BLOCK = shapely.box(-250, -250, 250, 250)
DISC = shapely.Point(0, 0).buffer(200, quad_segs=64)
WITH_ISLANDS = (
    shapely.Point(0, 0).buffer(250)
    .difference(shapely.Point(60, 30).buffer(50))
    .difference(shapely.box(-150, -100, -80, 0))
)  # fmt: skip
DUMBBELL = shapely.union_all(
    [
        shapely.box(-200, -100, 0, 100),
        shapely.box(0, -35, 200, 35),
        shapely.Point(250, 0).buffer(90),
    ]
)
APART = shapely.union_all([shapely.box(0, 0, 100, 100), shapely.box(200, 0, 300, 90)])
REGIONS = {"block": BLOCK, "disc": DISC, "islands": WITH_ISLANDS, "dumbbell": DUMBBELL,
           "apart": APART}  # fmt: skip


def swept_by_pieces(path, electrode, gap):
    """Union of what every single cutting move clears, built from each move alone."""
    pieces = []
    moves = [path.points[i : i + 2] for i in np.flatnonzero(path.cutting)]
    for move in moves or [path.points[[0, 0]]]:
        if electrode.shape == "round":
            pieces.append(shapely.LineString(move).buffer(electrode.half + gap, quad_segs=64))
        else:
            at = [shapely.box(*(p - electrode.half), *(p + electrode.half)) for p in move]
            pieces.append(shapely.union_all(at).convex_hull.buffer(gap, quad_segs=64))
    return shapely.union_all(pieces)


def assert_clears(path, region, electrode, gap):
    """All that can be cleared is, nothing outside is cut, and no move leaves the reachable."""
    reachable = erode(region, electrode, gap)
    swept = swept_by_pieces(path, electrode, gap)
    if electrode.shape == "round":
        wanted = reachable.buffer(electrode.half + gap, quad_segs=64)
    else:
        shifts = electrode.half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1.0]])
        wanted = shapely.union_all(
            [shapely.transform(reachable, lambda xy, s=s: xy + s) for s in shifts]
        ).buffer(gap, quad_segs=64)
    assert wanted.difference(swept).area <= 1e-3 * wanted.area
    assert swept.difference(region).area <= 1e-3 * region.length
    room = reachable.buffer(1e-5)
    for i in np.flatnonzero(path.cutting):
        assert room.covers(shapely.LineString(path.points[i : i + 2]))


@pytest.mark.parametrize("pattern", ["raster", "contour"])
@pytest.mark.parametrize("electrode", [ROUND, SQUARE], ids=["round", "square"])
@pytest.mark.parametrize("name", REGIONS)
def test_everything_reachable_is_cleared_and_nothing_else(name, electrode, pattern):
    path = scan_layer(REGIONS[name], electrode, 3.0, RULES, 1, pattern)
    assert_clears(path, REGIONS[name], electrode, 3.0)
    found = coverage(path, REGIONS[name], electrode, 3.0)
    assert found.uncovered_share <= 1e-3
    assert found.region == pytest.approx(REGIONS[name].area)


@pytest.mark.slow
@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32 - 1),
    pattern=st.sampled_from(["raster", "contour", "alternate"]),
    electrode=st.sampled_from([ROUND, SQUARE]),
    overlap=st.sampled_from([0.05, 0.2, 0.5]),
    switches=st.tuples(st.booleans(), st.booleans(), st.booleans()),
    number=st.integers(1, 8),
)
def test_random_polygons_are_cleared(seed, pattern, electrode, overlap, switches, number):
    generator = np.random.default_rng(seed)
    angle = np.sort(generator.uniform(0, 2 * np.pi, 9))
    radius = generator.uniform(80, 250, 9)
    star = shapely.Polygon(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))
    at = generator.uniform(-200, 200, 2)
    region = star.buffer(0).union(shapely.Point(0, 0).buffer(60)).union(shapely.box(*at, *at + 90))
    region = region.difference(shapely.Point(*generator.uniform(-90, 90, 2)).buffer(20))
    to_and_fro, alternate, periphery = switches
    rules = ScanningRules(to_and_fro, alternate, overlap, periphery)
    path = scan_layer(region, electrode, 2.0, rules, number, pattern)
    assert_clears(path, region, electrode, 2.0)


def test_a_path_that_skips_lines_is_found_out():
    """The negative control of the checks above."""
    path = scan_layer(BLOCK, ROUND, 0.0, RULES, 1, "raster")
    halved = LayerPath(
        path.points[: len(path.points) // 2], path.cutting[: len(path.points) // 2 - 1]
    )
    with pytest.raises(AssertionError):
        assert_clears(halved, BLOCK, ROUND, 0.0)
    assert coverage(halved, BLOCK, ROUND).uncovered_share > 0.1
    outside = LayerPath(path.points + 30.0, path.cutting)
    with pytest.raises(AssertionError):
        assert_clears(outside, BLOCK, ROUND, 0.0)
    assert coverage(outside, BLOCK, ROUND).beyond > 0.05 * BLOCK.area


def test_squares_are_concentric_by_figure_5():
    path = scan_layer(BLOCK, SQUARE, 0.0, RULES, 1, "contour")
    # A -> B -> C -> D -> A on every square, from the wall inwards by a step of 40.
    wanted = [225.0, 185.0, 145.0, 105.0, 65.0, 25.0]
    assert len(path.points) == 5 * len(wanted)
    for k, half in enumerate(wanted):
        square = path.points[5 * k : 5 * k + 5]
        np.testing.assert_allclose(np.abs(square), half, atol=1e-9)
        np.testing.assert_array_equal(square[0], square[-1])
    assert path.lifted_length == 0


def test_circles_are_concentric_by_figure_18():
    path = scan_layer(DISC, ROUND, 0.0, RULES, 1, "contour")
    radius = np.hypot(*path.points.T)
    on_circle = [np.sum(np.abs(radius - r) < 0.3) for r in (175.0, 135.0, 95.0, 55.0)]
    assert min(on_circle) > 50
    assert path.turning_points < 16


def test_raster_lines_lie_a_step_apart_in_the_main_direction():
    rules = replace(RULES, inside_and_periphery=False)
    path = scan_layer(BLOCK, SQUARE, 0.0, rules, 1, "raster")
    y = np.unique(np.round(path.points[:, 1], 3))
    assert y[0] == -225.0 and y[-1] == 225.0
    assert np.max(np.diff(y)) <= 40.0 + 1e-9
    assert len(y) == math.ceil(450 / 40) + 1
    assert path.turning_points == 2 * (len(y) - 1)


def test_to_and_fro_goes_back_the_same_way_and_then_across():
    paths = [scan_layer(BLOCK, SQUARE, 0.0, RULES, n, "raster") for n in (1, 2, 3, 4, 5)]
    np.testing.assert_array_equal(paths[1].points, paths[0].points[::-1])
    np.testing.assert_array_equal(paths[3].points, paths[2].points[::-1])
    np.testing.assert_array_equal(paths[4].points, paths[0].points)
    # A-B run along x, C-D along y: figures 2 and 3.
    along = [np.sum(np.abs(np.diff(p.points, axis=0)), axis=0) for p in paths]
    assert along[0][0] > 2 * along[0][1]
    assert along[2][1] > 2 * along[2][0]


def test_rules_switched_off():
    one_way = replace(
        RULES, to_and_fro=False, alternate_direction=False, inside_and_periphery=False
    )
    paths = [scan_layer(BLOCK, SQUARE, 0.0, one_way, n, "raster") for n in (1, 2, 3)]
    for path in paths[1:]:
        np.testing.assert_array_equal(path.points, paths[0].points)
    changing = replace(one_way, alternate_direction=True)
    second = scan_layer(BLOCK, SQUARE, 0.0, changing, 2, "raster")
    np.testing.assert_array_equal(np.unique(np.round(second.points[:, 0], 6)),
                                  np.unique(np.round(paths[0].points[:, 1], 6)))  # fmt: skip


def test_without_overlap_islands_stay_between_square_contours():
    on = coverage(scan_layer(BLOCK, ROUND, 0.0, RULES, 1, "contour"), BLOCK, ROUND)
    off = coverage(scan_layer(BLOCK, ROUND, 0.0, OFF, 1, "contour"), BLOCK, ROUND)
    assert on.uncovered_share < 1e-6
    # Four corners on each of the squares leave the sliver between two discs on a diagonal.
    assert off.uncovered_share > 1e-4


def test_without_the_periphery_the_wall_of_a_disc_keeps_scallops():
    lines = replace(RULES, inside_and_periphery=False, overlap=0.0)
    off = coverage(scan_layer(DISC, ROUND, 0.0, lines, 1, "raster"), DISC, ROUND)
    on = coverage(
        scan_layer(DISC, ROUND, 0.0, replace(RULES, overlap=0.0), 1, "raster"), DISC, ROUND
    )
    assert on.uncovered_share < 1e-6 < 1e-3 < off.uncovered_share


@pytest.mark.parametrize("to_and_fro", [True, False])
def test_inside_and_periphery_come_first_in_turn(to_and_fro):
    rules = replace(RULES, to_and_fro=to_and_fro, alternate_direction=False)
    begins = []
    for n in (1, 2):
        start = shapely.Point(scan_layer(DISC, ROUND, 0.0, rules, n, "contour").points[0])
        begins.append(start.distance(erode(DISC, ROUND).exterior) < 1.0)
    assert begins == [True, False]
    for n, first in ((1, False), (2, True)):
        path = scan_layer(DISC, ROUND, 0.0, rules, n, "raster")
        # Along the wall the middle of a move lies on it, on a line across the disc it does not.
        middles = (path.points[1:] + path.points[:-1])[:16] / 2
        assert bool(np.all(np.abs(np.hypot(*middles.T) - 175.0) < 0.5)) == first


def test_alternate_pattern_changes_after_every_pair():
    rasters = [scan_layer(BLOCK, SQUARE, 0.0, RULES, n, "raster").length for n in (1, 3)]
    contour = scan_layer(BLOCK, SQUARE, 0.0, RULES, 1, "contour").length
    lengths = [scan_layer(BLOCK, SQUARE, 0.0, RULES, n, "alternate").length for n in range(1, 9)]
    wanted = [rasters[0]] * 2 + [contour] * 2 + [rasters[1]] * 2 + [contour] * 2
    np.testing.assert_allclose(lengths, wanted)


def test_slot_as_wide_as_the_electrode_is_one_line_and_the_electrode_turns():
    slot = slices_of_slot(300.0, 56.0, uniform_bottoms(30.0, 5.0))
    paths = scan_layers(slot, SQUARE, 3.0)
    assert [p.quarter_turns for p in paths] == [0, 1, 2, 3, 0, 1]
    np.testing.assert_allclose(paths[0].points, [[-122, 0], [122, 0], [-122, 0]], atol=0.02)
    assert coverage(paths[0], slot.regions[0], SQUARE, 3.0).uncovered_share < 1e-3
    assert [p.quarter_turns for p in scan_layers(slot, ROUND, 3.0)] == [0] * 6
    one_way = scan_layers(slot, SQUARE, 3.0, replace(RULES, to_and_fro=False))
    np.testing.assert_allclose(one_way[1].points, [[-122, 0], [122, 0]], atol=0.02)
    wide = scan_layers(slices_of_slot(300.0, 70.0, np.array([5.0])), SQUARE, 3.0)[0]
    assert wide.quarter_turns == 0 and len(wide.points) == 5


def test_lifted_only_between_bodies():
    path = scan_layer(APART, SQUARE, 0.0, RULES, 1, "contour")
    assert np.sum(~path.cutting) == 1
    assert path.lifted_length >= 100.0
    for name in ("block", "disc"):
        assert scan_layer(REGIONS[name], ROUND, 3.0, RULES, 1, "raster").cutting.all()


def test_layers_of_a_hemisphere_and_its_pole():
    slices = slices_of_solid(Hemisphere(100.0), uniform_bottoms(100.0, 5.0), "middle")
    wide = ElectrodeSection("round", 100.0)
    reach = slices.reach(wide, 2.0, narrow="plunge")
    paths = scan_layers(slices, wide, 2.0, reach=reach)
    assert len(paths) == 20
    for n, (path, region) in enumerate(zip(paths, slices.regions, strict=True), start=1):
        if n in reach.narrow:
            assert len(path.points) == 1
            np.testing.assert_allclose(path.points, 0.0, atol=0.1)
        else:
            assert coverage(path, region, wide, 2.0).uncovered_share < 1e-3


def test_finishing_follows_the_wall():
    path = finish_layer(WITH_ISLANDS, 40.0, ROUND, 2.0)
    walls = shapely.union_all([WITH_ISLANDS.exterior, *WITH_ISLANDS.interiors])
    distance = shapely.distance(walls, shapely.points(path.points))
    np.testing.assert_allclose(distance, 27.0, atol=0.05)
    ring = WITH_ISLANDS.difference(WITH_ISLANDS.buffer(-40.0))
    cleared = coverage(path, WITH_ISLANDS, ROUND, 2.0)
    assert cleared.reach - cleared.missed >= 0.99 * ring.area
    thick = finish_layer(BLOCK, 100.0, ROUND)
    assert {225.0, 185.0} <= set(np.round(np.max(np.abs(thick.points), axis=1), 6))


def test_finishing_wants_more_than_half_the_electrode():
    assert finishing_caution(26.0, ROUND) is None
    assert "half the finishing electrode" in str(finishing_caution(25.0, ROUND))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ScanningRules(overlap=1.0), "overlap 1"),
        (lambda: scan_layer(BLOCK, ROUND, pattern="rastr"), "did you mean 'raster'"),
        (lambda: scan_layer(BLOCK, ROUND, number=0), "layer number 0"),
        (lambda: scan_layer(BLOCK, ROUND, -1.0), "side gap -1"),
        (lambda: scan_layer(shapely.box(0, 0, 40, 40), ROUND, number=7), "fit into layer 7"),
        (lambda: finish_layer(BLOCK, 0.0, ROUND), "finishing thickness 0"),
        (lambda: finish_layer(shapely.box(0, 0, 40, 40), 9.0, ROUND), "for finishing"),
    ],
)
def test_faulty(call, words):
    with pytest.raises(InputError, match=words):
        call()
