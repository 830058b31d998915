"""The z-map simulation: what it conserves, its peers, its statuses and what it refuses."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.zmap_peers import numpy_simulation
from procmodel.errors import InputError
from procmodel.wear.feed_law import layer_feeds, linear_feeds
from procmodel.wear.path_steps import path_steps
from procmodel.wear.zmap import simulate, simulate_layers
from procmodel.wear.zmap_maps import WorkpieceMap
from tests.procmodel.wear.zmap_cases import (
    MODES,
    as_peers_have_it,
    cut,
    electrode,
    raster,
    whole,
    width_of,
)

inside = st.floats(0.0, 12.0)
random_paths = st.lists(
    st.lists(st.tuples(inside, inside), min_size=2, max_size=4).filter(lambda p: len(set(p)) > 1),
    min_size=3, max_size=3,
)  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "mode", "gap"), [("square", "local", 0.0), *((*case, 1.3) for case in MODES)]
)
@settings(max_examples=5)
@given(paths=random_paths, turns=st.integers(0, 3), ratio=st.floats(0.01, 3.0))
def test_volume_ratio_is_kept_whatever_the_path(shape, mode, gap, paths, turns, ratio):
    tool = electrode(shape, 6.0, reach=1.3)
    layers = [whole(points, turns * number) for number, points in enumerate(paths)]
    steps = path_steps(layers, 1.0)
    workpiece = WorkpieceMap(jnp.zeros((24, 24)), 1.0, (-6.0, -6.0))
    result = simulate(
        steps, layer_feeds(steps, 0.7), tool, workpiece, ratio,
        side_gap=gap, wear_mode=mode, spread_width=width_of(mode),
    )  # fmt: skip
    assert float(jnp.sum(result.removed)) > 0
    assert float(result.volume_ratio) == pytest.approx(ratio, rel=1e-12)
    # The same from the maps that come out.
    lost = float(tool.volume(result.electrode_loss))
    assert lost == pytest.approx(float(jnp.sum(result.worn)), rel=1e-12)
    assert float(jnp.sum(result.depth)) == pytest.approx(float(jnp.sum(result.removed)), rel=1e-12)
    assert np.all(np.asarray(result.depth) <= 3 * 0.7 + 1e-12)


@pytest.mark.parametrize(
    ("shape", "mode", "gap"),
    [("square", "local", 0.0), ("square", "local", 1.3), ("round", "local", 1.3),
     ("round", "uniform", 0.0)],
)  # fmt: skip
def test_plain_loops_say_the_same(shape, mode, gap):
    tool = electrode(shape, 9.0, reach=1.3)
    # Whole cells, halves and odd places; a second layer narrower than the first, a third wider.
    paths = [*raster(14.3, 4.1, 1), *raster(9.0, 4.5, 1), *raster(14.3, 4.1, 2)]
    steps = path_steps(paths, 1.0)
    feeds = layer_feeds(steps, 0.8) + linear_feeds(steps, 0.003)
    flat = WorkpieceMap.around(steps, tool)
    rng = np.random.default_rng(3)
    start = WorkpieceMap(flat.depth + rng.uniform(0, 0.3, flat.depth.shape), 1.0, flat.origin)
    result = simulate(
        steps, feeds, tool, start, 0.37, side_gap=gap, bottom_gap=0.05, wear_mode=mode
    )
    arrays, case, part = as_peers_have_it(
        steps, feeds, tool, start, gap, wear_ratio=0.37, bottom_gap=0.05, even=mode == "uniform"
    )
    depth, loss = numpy_simulation(arrays, case)
    np.testing.assert_allclose(result.depth, depth[part], rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.electrode_loss, loss, rtol=0, atol=1e-12)


@pytest.mark.parametrize("gap", [0.0, 0.4, 1.0, 1.7])
@pytest.mark.parametrize("shape", ["square", "round"])
def test_swept_area_is_that_of_the_electrode_and_its_gap(shape, gap):
    tool = electrode(shape, 9.3, 0.5, reach=2.0)
    result = cut([whole([(0, 0), (7.7, 0)])], tool, side_gap=gap, step=0.5)
    size = 9.3 + 2 * gap
    area = size * (size + 7.7) if shape == "square" else math.pi * size**2 / 4 + size * 7.7
    assert float(result.swept_area[0]) == pytest.approx(
        area, rel=1e-12 if shape == "square" else 2e-3
    )


def test_area_of_a_round_section_converges_at_second_order():
    cells = np.array([2.0, 1.0, 0.5, 0.25])
    sizes = 20.0 + np.linspace(0.0, 4.0, 9)
    errors = [
        np.sqrt(np.mean([(electrode("round", d, c).section_area / (math.pi * d**2 / 4) - 1) ** 2
                         for d in sizes]))
        for c in cells
    ]  # fmt: skip
    order = np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert order > 1.7


def test_a_wall_stands_still_under_many_passes():
    # Without the share of a cell that is open, every pass would cut the wall's cells again.
    tool = electrode("square", 8.0, reach=0.6)
    few = cut([whole([(0, 0), (9, 0)])] * 2, tool, side_gap=0.3, ratio=0.0)
    many = cut([whole([(0, 0), (9, 0)])] * 20, tool, side_gap=0.3, ratio=0.0)
    np.testing.assert_allclose(many.depth, 10 * few.depth, rtol=1e-9)


def test_padding_does_nothing():
    tool = electrode()
    steps = path_steps(raster(8.0, 4.0, 3), 1.0)
    workpiece = WorkpieceMap.around(steps, tool)
    feeds = np.asarray(layer_feeds(steps, 1.0))
    wide = [np.pad(field, ((0, 0), (0, 300)), mode="edge") for field in steps[:3]]
    valid = np.pad(steps.valid, ((0, 0), (0, 300)))
    padded = steps._replace(x=wide[0], y=wide[1], length=wide[2], valid=valid)
    narrow = simulate(steps, feeds, tool, workpiece, 0.4)
    widened = simulate(padded, np.pad(feeds, ((0, 0), (0, 300))), tool, workpiece, 0.4)
    np.testing.assert_array_equal(narrow.depth, widened.depth)


def test_quarter_turns_turn_the_electrode_on_the_workpiece():
    # A cut along x over half of the bottom, with the electrode turned by 90 degrees, wears it as
    # the same cut turned back by 90 degrees wears one that is not turned.
    tool = electrode("square", 6.0)
    ridge = np.zeros((30, 30))
    ridge[:15] = 5.0
    turned = whole([(15, 15), (17, 15)], turns=1)
    plain = whole([(15, 15), (15, 13)])
    losses = []
    for path, depth in ((turned, ridge), (plain, np.rot90(ridge, -1))):
        steps = path_steps([path], 1.0)
        result = simulate(
            steps, layer_feeds(steps, 2.0), tool, WorkpieceMap(depth, 1.0, (0.0, 0.0)), 0.5
        )
        losses.append(np.asarray(result.electrode_loss))
    assert np.ptp(losses[0]) > 0.1
    np.testing.assert_allclose(losses[0], losses[1], atol=1e-14)


def test_wide_spread_is_uniform_wear_and_narrow_is_local():
    paths = raster(12.3, 4.1, 3)
    tool = electrode("round", 9.0, reach=1.0)
    for mode, width, accuracy in (("uniform", math.inf, 1e-12), ("local", 1e-3, 1e-4)):
        spread = cut(paths, tool, mode="spread", width=width, side_gap=0.7)
        limit = cut(paths, tool, mode=mode, side_gap=0.7)
        if mode == "uniform":
            assert np.ptp(np.asarray(spread.electrode_loss)[tool.bottom]) < accuracy
        np.testing.assert_allclose(spread.depth, limit.depth, atol=accuracy)


def test_blocks_and_a_stop_in_between_give_the_same():
    steps = path_steps([*raster(12.0, 4.0, 4), *raster(5.0, 2.5, 3)], 1.0)
    tool = electrode("round", 8.0, reach=1.0)
    workpiece = WorkpieceMap.around(steps, tool)
    rest = {"side_gap": 0.6, "wear_mode": "rotating"}
    feeds = layer_feeds(steps, 0.9)
    whole_run = simulate(steps, feeds, tool, workpiece, 0.3, **rest)
    seen = []

    def stop(done, total):
        seen.append((done, total))
        if done == 4:
            raise KeyboardInterrupt

    first = simulate_layers(steps, feeds, tool, workpiece, 0.3, block=2, progress=stop, **rest)
    assert seen == [(2, 7), (4, 7)]
    assert first.status == "stopped after layer 4 of 7; give the result as resume to go on."
    assert len(first.removed) == 4
    second = simulate_layers(steps, feeds, tool, workpiece, 0.3, block=2, resume=first, **rest)
    assert second.status == "all 7 layers are cut."
    np.testing.assert_allclose(second.depth, whole_run.depth, atol=1e-12)
    np.testing.assert_allclose(second.removed, whole_run.removed, rtol=1e-9)
    more = path_steps([*raster(12.0, 4.0, 4), *raster(5.0, 2.5, 4)], 1.0)
    longer = layer_feeds(more, 0.9)
    third = simulate_layers(more, longer, tool, workpiece, 0.3, block=2, resume=second, **rest)
    straight = simulate(more, longer, tool, workpiece, 0.3, **rest)
    np.testing.assert_allclose(third.depth, straight.depth, atol=1e-12)
    np.testing.assert_allclose(second.electrode_loss, whole_run.electrode_loss, atol=1e-12)


def test_statuses_are_sentences():
    paths = raster(8.0, 4.0, 6)
    used = cut(paths, electrode(usable_length=1.0), ratio=0.5)
    assert used.used_up > 0
    assert "used up in layer" in used.status
    assert float(used.greatest_loss[used.used_up - 1]) > 1.0
    assert cut(paths, electrode(), ratio=0.0).status.endswith("the electrode does not wear.")
    assert "nothing was removed" in cut(paths, electrode(), feed=0.0).status
    steps = path_steps(paths, 1.0)
    tool = electrode(usable_length=1.0)
    early = simulate_layers(
        steps, layer_feeds(steps, 1.0), tool, WorkpieceMap.around(steps, tool), 0.5, block=1
    )
    assert len(early.removed) == early.used_up < 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wear_ratio": -0.1}, "wear ratio -0.1 must not be below 0"),
        ({"wear_ratio": 20.0}, "wear ratio 20 is above 10.*percent"),
        ({"wear_ratio": math.nan}, "wear ratio must be a finite number"),
        ({"side_gap": 2.0}, "side gap 2 um must lie between 0 and the reach"),
        ({"wear_mode": "spred"}, "did you mean 'spread'"),
        ({"wear_mode": "rotating"}, "must be round"),
        ({"wear_mode": "spread"}, "needs a spread width"),
        ({"wear_mode": "spread", "spread_width": 0.0}, "spread width 0.0 um must be above 0"),
        ({"spread_width": 1.0}, "leave it out for local"),
        ({"feeds": np.zeros((1, 2))}, r"feeds have shape \(1, 2\)"),
        ({"workpiece": WorkpieceMap(np.zeros((5, 5)), 1.0, (0.0, 0.0))}, "lies outside the map"),
        ({"workpiece": WorkpieceMap(np.zeros((5, 5)), 2.0, (0.0, 0.0))}, "must be the same"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(change, message):
    steps = path_steps(raster(8.0, 4.0, 2), 1.0)
    tool = electrode(reach=1.0)
    given_ = {
        "feeds": layer_feeds(steps, 1.0), "workpiece": WorkpieceMap.around(steps, tool),
        "wear_ratio": 0.2, **change,
    }  # fmt: skip
    with pytest.raises(InputError, match=message):
        simulate(steps, electrode=tool, **given_)


def test_maps_that_do_not_fit_are_refused_by_name():
    with pytest.raises(InputError, match="cell 6 um is larger than half the electrode"):
        electrode(cell=6.0)
    with pytest.raises(InputError, match="cell 0 um must be above 0"):
        electrode(cell=0.0)
    with pytest.raises(InputError, match=r"loss of the electrode has shape \(3, 3\).*10 x 10"):
        electrode(loss=np.zeros((3, 3)))
    with pytest.raises(InputError, match="usable length 0 um"):
        electrode(usable_length=0.0)
    with pytest.raises(InputError, match=r"depth of the workpiece has shape \(0,\)"):
        WorkpieceMap(np.zeros(0), 1.0, (0.0, 0.0))
