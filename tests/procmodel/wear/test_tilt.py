"""The tilt along a path: closed forms, a plain loop, conservation and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.wear.tilt import (
    one_way_pass,
    start_up_decay,
    start_up_layers,
    steady_tilt,
    tilted_layers,
)


def one_way(count):
    return np.ones(count, bool)


def to_and_fro(count):
    return np.arange(count) % 2 == 0


@pytest.mark.parametrize("u", [0.25, 1.0, 3.0])
def test_a_single_pass_is_an_exponential(u):
    pieces = 400
    cut = tilted_layers([2.0], u, one_way(1), pieces).depth[0]
    middles = (np.arange(pieces) + 0.5) / pieces
    np.testing.assert_allclose(cut, one_way_pass(middles, 2.0, u), rtol=(u / pieces) ** 2)
    assert float(jnp.mean(cut)) == pytest.approx(2.0 * (1.0 - np.exp(-u)) / u, rel=1e-12)


@pytest.mark.parametrize("u", [0.25, 1.0, 2.0])
@pytest.mark.parametrize("way", [one_way, to_and_fro])
def test_steady_layers_obey_equation_3(u, way):
    # The decay is that of one-way scanning; to and fro takes longer.
    count = 2 * start_up_layers(u, 1e-8)
    depth = tilted_layers(np.full(count, 3.0), u, way(count), 60).depth.mean(axis=1)
    assert float(depth[-1] - depth[-2]) == pytest.approx(3.0 / (1.0 + u), rel=1e-5)


def test_the_tilt_of_one_way_scanning_converges_on_the_wear_of_a_layer():
    errors = [
        abs(float(tilted_layers(np.ones(40), 1.0, one_way(40), m).tilt[-1] - steady_tilt(1.0, 1.0)))
        for m in (50, 100, 200)
    ]
    assert float(steady_tilt(1.0, 1.0)) == 0.5
    # What half a piece at either end lacks: first order.
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2.0, rtol=1e-3)


def test_to_and_fro_turns_the_tilt_over_and_leaves_it():
    depth = np.asarray(tilted_layers(np.ones(41), 1.0, to_and_fro(41), 100).depth)
    slopes = depth[:, -1] - depth[:, 0]
    assert slopes[-1] == pytest.approx(-slopes[-2], rel=1e-6)
    assert abs(slopes[-1]) == pytest.approx(0.5, abs=0.01)


def test_known_feeds_level_the_bottom():
    feeds = np.concatenate([np.ones(30), [0.5, 0.2, 0.08, 0.03]])
    tilt = tilted_layers(feeds, 1.0, to_and_fro(34), 100).tilt
    assert float(tilt[29]) == pytest.approx(0.5, abs=0.01)
    assert float(tilt[-1]) == pytest.approx(0.011, abs=0.003)


@pytest.mark.parametrize(("u", "decay"), [(0.25, 0.05), (1.0, 0.22), (2.0, 0.40), (8.0, 0.83)])
def test_the_start_dies_out_at_the_known_rate(u, decay):
    assert start_up_decay(u) == pytest.approx(decay, abs=0.005)


@pytest.mark.parametrize("u", [2.0, 8.0])
def test_layers_show_that_rate(u):
    depth = np.asarray(tilted_layers(np.ones(60), u, one_way(60), 800).depth).mean(axis=1)
    deviation = np.diff(depth) * (1.0 + u) - 1.0
    # A pair of complex modes obeys a recurrence of two terms; faster modes have died out by then.
    x = deviation[4:14]
    terms = np.stack([x[1:-1], x[:-2]], axis=1)
    found = np.linalg.lstsq(terms / x[2:, None], np.ones(len(x) - 2))[0]
    assert np.sqrt(-found[1]) == pytest.approx(start_up_decay(u), rel=0.02)


def plain(feeds, u, forward, pieces):
    """The same walk, piece by piece."""
    depth, tip, lost, q = np.zeros(pieces), 0.0, 0.0, u / pieces
    for feed, onwards in zip(feeds, forward, strict=True):
        tip += feed
        for i in range(pieces) if onwards else reversed(range(pieces)):
            overlap = max(tip - depth[i], 0.0)
            worn = overlap * (1.0 - np.exp(-q))
            depth[i] += worn / q
            tip -= worn
            lost += worn
    return depth, lost


def test_against_a_plain_loop_and_volume_is_conserved():
    rng = np.random.default_rng(3)
    feeds, forward = rng.uniform(0.0, 2.0, 12), rng.random(12) < 0.5
    found = tilted_layers(feeds, 1.3, forward, 37)
    depth, lost = plain(feeds, 1.3, forward, 37)
    np.testing.assert_allclose(found.depth[-1], depth, rtol=1e-12)
    assert float(jnp.sum(found.wear)) == pytest.approx(lost, rel=1e-12)
    assert float(jnp.sum(found.wear)) == pytest.approx(1.3 * depth.mean(), rel=1e-12)


def test_without_wear_there_is_no_tilt():
    found = tilted_layers([1.0, 2.0], 0.0, one_way(2), 10)
    np.testing.assert_allclose(found.depth, [[1.0] * 10, [3.0] * 10])
    assert float(jnp.sum(found.wear)) == 0.0


def test_derivatives_against_finite_differences():
    feeds, wear = np.array([1.0, 1.0, 0.7, 0.4]), np.full(4, 0.8)

    def mean_square(feeds, wear):
        depth = tilted_layers(feeds, wear, to_and_fro(4), 30).depth[-1]
        return jnp.mean((depth - 2.0) ** 2)

    by_feeds, by_wear = jax.grad(mean_square, (0, 1))(jnp.asarray(feeds), jnp.asarray(wear))
    for i in range(4):
        step = np.eye(4)[i] * 1e-6
        up, down = mean_square(feeds + step, wear), mean_square(feeds - step, wear)
        assert float(by_feeds[i]) == pytest.approx(float(up - down) / 2e-6, rel=1e-6)
        up, down = mean_square(feeds, wear + step), mean_square(feeds, wear - step)
        assert float(by_wear[i]) == pytest.approx(float(up - down) / 2e-6, rel=1e-6)
    forward = jax.jacfwd(mean_square)(jnp.asarray(feeds), jnp.asarray(wear))
    np.testing.assert_allclose(forward, by_feeds, rtol=1e-12)
    # The derivative without wear is that of little wear.
    edge = jax.grad(mean_square, 1)(jnp.asarray(feeds), jnp.zeros(4))
    near = jax.grad(mean_square, 1)(jnp.asarray(feeds), jnp.full(4, 1e-7))
    np.testing.assert_allclose(edge, near, rtol=1e-5)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tilted_layers([1.0, 1.0], 1.0, one_way(3)), "give one direction for every feed"),
        (lambda: tilted_layers([1.0], 1.0, one_way(1), 0), "pieces is 0"),
        (lambda: start_up_decay(0.0), "relative wear is 0, but must be above 0"),
        (lambda: start_up_layers(1.0, 2.0), "tolerance is 2"),
        (lambda: start_up_layers(1e6), "the electrode is gone before the end of a layer"),
    ],
)
def test_refusals(call, words):
    with pytest.raises(InputError, match=words):
        call()
