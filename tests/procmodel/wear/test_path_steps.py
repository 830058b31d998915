"""Paths sampled at even steps, and the feed laws on them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.wear.feed_law import fixed_length_feeds, layer_feeds, linear_feeds
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.path_steps import CHUNK, path_steps

coordinates = st.integers(-20, 20).map(float)
corners = st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=6)


def whole(points, turns=0):
    points = np.array(points, float)
    return LayerPath(points, np.ones(len(points) - 1, bool), turns)


@given(corners, st.floats(0.3, 5.0))
def test_every_corner_is_met_and_no_step_is_too_long(points, step):
    path = whole(points)
    steps = path_steps([path], step)
    live = steps.valid[0]
    x, y, length = steps.x[0][live], steps.y[0][live], steps.length[0][live]
    apart = np.hypot(np.diff(x), np.diff(y))
    np.testing.assert_allclose(apart, length[1:], atol=1e-12)
    assert length[0] == 0.0
    assert np.all(length <= step * (1 + 1e-9))
    assert np.sum(length) == pytest.approx(path.length, abs=1e-9)
    seen = set(zip(x, y, strict=True))
    assert all(tuple(point) in seen for point in path.points)


def test_lifted_moves_leave_their_ends_and_no_length():
    path = LayerPath(
        np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 10.0], [0.0, 10.0]]), np.array([True, False, True])
    )
    steps = path_steps([path], 2.0)
    live = steps.valid[0]
    np.testing.assert_array_equal(steps.x[0][live], [0, 2, 4, 4, 2, 0])
    np.testing.assert_array_equal(steps.y[0][live], [0, 0, 0, 10, 10, 10])
    np.testing.assert_array_equal(steps.length[0][live], [0, 2, 2, 0, 2, 2])


def test_few_padded_shapes_and_padding_that_stays_where_it_is():
    widths = {
        path_steps([whole([(0, 0), (count, 0)])], 1.0).x.shape[1] for count in range(1, 5000, 37)
    }
    assert all(width % CHUNK == 0 for width in widths)
    assert len(widths) <= 11
    steps = path_steps([whole([(0, 0), (3, 0)]), whole([(0, 0), (CHUNK, 0)], turns=3)], 1.0)
    assert steps.counts.tolist() == [4, CHUNK + 1]
    assert np.all(steps.x[0, 4:] == 3.0)
    assert np.all(steps.length[0, 4:] == 0.0)
    assert steps.quarter_turns.tolist() == [0, 3]
    first = steps.layers(0, 1)
    assert first.x.shape == (1, CHUNK)
    assert first.counts.tolist() == [4]


def test_one_point_is_a_plunge():
    steps = path_steps([LayerPath(np.array([[1.0, 2.0]]), np.zeros(0, bool))], 1.0)
    assert steps.counts.tolist() == [1]


def test_what_cannot_be_sampled_is_refused():
    with pytest.raises(InputError, match=r"step 0 um"):
        path_steps([whole([(0, 0), (1, 0)])], 0.0)
    with pytest.raises(InputError, match="no layers"):
        path_steps([], 1.0)
    lifted = LayerPath(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([False]))
    with pytest.raises(InputError, match="layer 2: no move"):
        path_steps([whole([(0, 0), (1, 0)]), lifted], 1.0)


@pytest.fixture
def three_layers():
    return path_steps([whole([(0, 0), (10, 0), (10, 4.5)])] * 3, 1.0)


def test_layer_feeds_come_where_a_layer_begins(three_layers):
    feeds = layer_feeds(three_layers, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(feeds[:, 0], [1.0, 2.0, 3.0])
    assert np.count_nonzero(feeds) == 3


def test_linear_feeds_add_up_to_the_length(three_layers):
    feeds = linear_feeds(three_layers, 0.02)
    np.testing.assert_allclose(np.sum(feeds, axis=1), 0.02 * 14.5)
    assert np.all(np.asarray(feeds)[~three_layers.valid] == 0.0)


@pytest.mark.parametrize(("length", "first"), [(3.0, None), (3.0, 0.0), (0.25, 0.0), (100.0, 5.0)])
def test_fixed_length_feeds_have_been_given_as_often_as_the_length_has_passed(
    three_layers, length, first
):
    feeds = np.ravel(fixed_length_feeds(three_layers, 0.5, length, first))
    start = length if first is None else first
    way = np.cumsum(np.ravel(three_layers.length))
    # Told one by one: how many of the places start, start + length, ... have been passed.
    places = start + length * np.arange(int(way[-1] / length) + 2)
    passed = [np.sum(places <= here + 1e-9) for here in way]
    np.testing.assert_allclose(np.cumsum(feeds), 0.5 * np.array(passed))


def test_feeds_are_linear_in_their_amount(three_layers):
    for law in (layer_feeds, linear_feeds, lambda s, a: fixed_length_feeds(s, a, 3.0)):
        slope = jax.jacfwd(lambda amount, law=law: law(three_layers, amount))(0.7)
        np.testing.assert_allclose(slope, law(three_layers, 1.0))


def test_feeds_that_do_not_fit_are_refused(three_layers):
    with pytest.raises(InputError, match=r"feed has shape \(2,\).*3 layers"):
        layer_feeds(three_layers, jnp.ones(2))
    with pytest.raises(InputError, match="length between feeds 0 um"):
        fixed_length_feeds(three_layers, 1.0, 0.0)
    with pytest.raises(InputError, match="before the first feed -1 um"):
        fixed_length_feeds(three_layers, 1.0, 1.0, -1.0)
