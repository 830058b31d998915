"""Derivatives of the z-map simulation against central differences, in both modes and jit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.wear.feed_law import layer_feeds, linear_feeds
from procmodel.wear.path_steps import path_steps
from procmodel.wear.zmap import simulate
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from tests.procmodel.wear.zmap_cases import electrode, raster, whole, width_of

# Wear ratio, side gap, bottom gap, feed per layer, feed per length, spread width, and the size of
# a roughness of the workpiece and of the electrode before.
AT = (0.31, 1.23, 0.11, 1.7, 0.012, 2.7, 0.05, 0.04)
NAMES = ("wear ratio", "side gap", "bottom gap", "feed", "feed per length", "spread width",
         "workpiece before", "electrode before")  # fmt: skip
# A cell that comes into or out of contact within the difference spoils it: the smaller, the fewer;
# the smallest derivative, of 0.04, has its sixth digit yet.
SHIFT = 2e-7


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "mode"), [("round", "local"), ("square", "spread")])
def test_derivatives_are_those_of_central_differences(shape, mode):
    tool = electrode(shape, 7.0, reach=2.0)
    paths = [*raster(6.3, 4.1, 1), whole([(0, 0), (6.3, 5.1)], turns=1), *raster(4.0, 4.0, 1)]
    steps = path_steps(paths, 1.0)
    flat = WorkpieceMap.around(steps, tool)
    rng = np.random.default_rng(5)
    rough, worn = rng.uniform(size=flat.depth.shape), rng.uniform(size=(tool.width,) * 2)
    weights, others = rng.normal(size=rough.shape), rng.normal(size=worn.shape)

    @jax.jit
    def told(at):
        ratio, side, bottom, feed, slope, width, before, lost = at
        result = simulate(
            steps,
            layer_feeds(steps, feed) + linear_feeds(steps, slope),
            ElectrodeMap(tool.section, 1.0, reach=2.0, loss=lost * worn),
            WorkpieceMap(before * rough, 1.0, flat.origin),
            ratio,
            side_gap=side,
            bottom_gap=bottom,
            wear_mode=mode,
            spread_width=width_of(mode, width),
        )
        maps = jnp.sum(weights * result.depth) + jnp.sum(others * result.electrode_loss)
        return maps + jnp.sum(result.layer_depth)

    at = jnp.array(AT)
    reverse = np.asarray(jax.jit(jax.grad(told))(at))
    pushed = jax.jit(lambda direction: jax.jvp(told, (at,), (direction,))[1])
    forward = np.asarray([pushed(direction) for direction in jnp.eye(len(AT))])
    differences = np.array(
        [(told(at + SHIFT * d) - told(at - SHIFT * d)) / (2 * SHIFT) for d in jnp.eye(len(AT))]
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-10)
    scale = np.maximum(np.abs(differences), 1e-2)
    off = dict(zip(NAMES, np.abs(reverse - differences) / scale, strict=True))
    assert max(off.values()) < 1e-5, off
    used = [name for name in NAMES if name != "spread width" or mode == "spread"]
    assert all(abs(reverse[NAMES.index(name)]) > 1e-3 for name in used)


def test_the_derivative_by_the_gap_alone():
    # Tangents that are absent take another way through the loops than those that are 0.
    tool = electrode("round", reach=1.0)
    steps = path_steps(raster(6.3, 4.1, 2), 1.0)
    flat = WorkpieceMap.around(steps, tool)
    feeds = layer_feeds(steps, 1.1)

    @jax.jit
    def mean_depth(gap):
        result = simulate(steps, feeds, tool, flat, 0.3, side_gap=gap, wear_mode="rotating")
        return jnp.mean(result.depth)

    difference = (mean_depth(0.7 + 1e-6) - mean_depth(0.7 - 1e-6)) / 2e-6
    assert float(jax.grad(mean_depth)(0.7)) == pytest.approx(float(difference), rel=1e-5)


def test_memory_of_the_reverse_pass_is_not_that_of_all_steps_times_the_map():
    tool = electrode(size=8.0)
    used = []
    for layers in (2, 16):
        steps = path_steps(raster(120.0, 6.0, layers), 1.0)
        flat = WorkpieceMap.around(steps, tool)

        def mean_depth(ratio, steps=steps, flat=flat):
            return jnp.mean(simulate(steps, layer_feeds(steps, 1.0), tool, flat, ratio).depth)

        compiled = jax.jit(jax.grad(mean_depth)).lower(0.3).compile()
        used.append(compiled.memory_analysis().temp_size_in_bytes / (8 * flat.depth.size))
    # In maps: what is kept of every layer, and the chunks of one.
    assert used[1] - used[0] < 14 * 5
    assert used[1] < 0.05 * int(steps.counts.sum())
