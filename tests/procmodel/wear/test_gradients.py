"""Derivatives of the wear laws by every parameter, against finite differences.

Every number of a cavity is a leaf of its pytree, so that one vector holds wear ratio, electrode
area, gap, all feeds and half widths, and the section's own lengths.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from procmodel.wear import (
    AnnulusSection,
    CircleSection,
    LayeredCavity,
    PolygonSection,
    SquareSection,
    continuous_wall_depth,
    layer_feed,
    wear_ratio_of_layer,
)

# Half widths, of which the last is below the corner radius of 12 um; no two equal.
HALF_WIDTHS = np.array([60.0, 47.0, 31.0, 14.5, 9.0])
L_SHAPE = np.array([(0, 0), (130, 0), (130, 60), (70, 60), (70, 120), (0, 120)], float)

SECTIONS = {
    "square": SquareSection(),
    "rounded square": SquareSection(corner_radius=12.0),
    "circle": CircleSection(),
    "ring": AnnulusSection(CircleSection(), thickness=10.5),
    "rounded square ring": AnnulusSection(SquareSection(corner_radius=12.0), thickness=10.5),
    "polygon": PolygonSection(L_SHAPE, electrode_radius=8.0),
}


def cavity_with(section):
    half_widths = HALF_WIDTHS
    if isinstance(section, PolygonSection):
        half_widths = section.half_width - np.array([0.0, 4.0, 9.0, 15.0, 21.0])
    feeds = np.array([4.0, 4.2, 3.9, 4.4, 3.7])
    return LayeredCavity(half_widths, feeds, section, 0.31, 2100.0, gap=3.0)


def outputs_and_vector():
    """What all the cavities give, as a function of all their numbers, and those numbers."""
    cavities = {name: cavity_with(section) for name, section in SECTIONS.items()}
    cavities = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), cavities)
    everything, rebuild = ravel_pytree(cavities)
    # A corner radius of 0 stands for "sharp", which no derivative can leave.
    free = np.flatnonzero(everything)

    def outputs(v):
        parts = [
            [c.layer_areas, c.depths, c.electrode_wear, c.wall_positions]
            for c in rebuild(everything.at[free].set(v)).values()
        ]
        return jnp.concatenate([quantity for part in parts for quantity in part])

    return outputs, everything[free]


def finite_differences(function, vector, relative_step=1e-3):
    """Five-point derivative, shape (outputs, inputs)."""
    vector = np.asarray(vector, float)
    columns = []
    for i, value in enumerate(vector):
        step = relative_step * max(abs(value), 1e-3)

        def at(k, i=i, step=step):
            moved = vector.copy()
            moved[i] += k * step
            return np.asarray(function(moved))

        columns.append((8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12.0 * step))
    return np.stack(columns, axis=-1)


def assert_relative(found, expected, tolerance=1e-6):
    """Every entry to the relative tolerance; exact zeros to rounding of their row."""
    found, expected = np.asarray(found), np.asarray(expected)
    noise = 1e-10 * np.max(np.abs(expected), axis=-1, keepdims=True)
    assert np.all(np.abs(found - expected) <= tolerance * np.abs(expected) + noise)


def test_every_parameter_of_every_section_under_jit_and_vmap():
    outputs, vector = outputs_and_vector()
    # Wear ratio, electrode area, gap, five feeds and half widths, and the sections' own lengths.
    assert vector.size == 6 * 13 + (0 + 1 + 0 + 1 + 2 + 1)
    expected = finite_differences(jax.jit(outputs), vector)
    # Every parameter does something, or its column would test nothing.
    assert np.all(np.max(np.abs(expected), axis=0) > 0)
    forward = jax.jit(jax.vmap(jax.jacfwd(outputs)))(jnp.stack([1.01 * vector, vector]))
    assert_relative(forward[1], expected)
    assert np.max(np.abs(np.asarray(forward[0]) / np.where(expected, expected, 1.0) - 1)) > 1e-3
    reverse = jax.jit(jax.jacrev(outputs))(vector)
    np.testing.assert_allclose(reverse, forward[1], rtol=1e-9, atol=1e-12)


def test_wrong_derivatives_would_be_seen():
    expected = np.array([[3.0, 0.0, -1e-3]])
    with pytest.raises(AssertionError):
        assert_relative(expected * (1.0 + 3e-6), expected)


@pytest.mark.parametrize(
    ("law", "arguments"),
    [
        (layer_feed, (3.0, 4.1e4, 0.23, 7.9e3)),
        (wear_ratio_of_layer, (4.0, 2.5, 4.1e4, 7.9e3)),
        (continuous_wall_depth, (60.0, 250.0, 3.8e-5, 4.0, 0.7)),
    ],
)
def test_scalar_laws(law, arguments):
    vector = np.array(arguments)
    expected = finite_differences(lambda v: law(*v)[None], vector)
    found = jax.jit(jax.grad(law, argnums=tuple(range(len(arguments)))))(*arguments)
    assert_relative(np.stack(found), expected[0])


def test_no_wear_and_no_gap_have_finite_derivatives():
    # The start of many fits: R = 0, gap = 0, sharp corner given as radius 0.
    def depths(section, ratio, gap):
        return LayeredCavity(HALF_WIDTHS, 4.0, section, ratio, 2100.0, gap).depths

    derivatives = jax.jit(jax.jacfwd(depths, argnums=(0, 1, 2)))
    for section in (SquareSection(0.0), SquareSection(12.0)):
        by_section, by_ratio, by_gap = derivatives(section, 0.0, 0.0)
        # Depth lost per wear ratio: dZ S_w / S_e in every layer.
        expected = -np.cumsum(4.0 * np.asarray(section.area(HALF_WIDTHS)) / 2100.0)
        np.testing.assert_allclose(by_ratio, expected, rtol=1e-12)
        np.testing.assert_array_equal(by_gap, 0.0)  # without wear no area matters
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(by_section))


def test_wall_depth_away_from_the_kinks():
    cavity = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), cavity_with(SquareSection(12.0)))
    walls = np.asarray(cavity.wall_positions)
    # Between the corners, on the floor, on the edge's ramp, outside; both sides of the centre.
    positions = np.concatenate([0.5 * (walls[1:] + walls[:-1]), [2.0, walls[0] + 1.0, 90.0]])
    positions = np.concatenate([positions, -positions + 0.3])
    vector, rebuild = ravel_pytree((cavity, jnp.asarray(positions)))

    def wall(v, edge_width):
        c, x = rebuild(v)
        return c.wall_depth(x, edge_width)

    value = jax.jit(wall)
    both_modes = jax.jit(lambda v, w: (jax.jacfwd(wall)(v, w), jax.jacrev(wall)(v, w)))
    for edge_width in (0.0, 2.5):
        # Steps short enough to stay between two kinks.
        expected = finite_differences(lambda v, w=edge_width: value(v, w), vector, 1e-5)
        forward, reverse = both_modes(vector, edge_width)
        scale = np.max(np.abs(expected))
        np.testing.assert_allclose(forward, expected, rtol=1e-6, atol=1e-8 * scale)
        np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12)
        by_ratio = np.asarray(forward)[:, vector.size - len(positions) - 3]
        assert 10 <= np.count_nonzero(by_ratio) < len(positions)


def test_depth_error_from_an_error_in_the_wear_ratio():
    # Physics note: the relative error of a layer is -(u / (1 + u)) times that of R.
    cavity = cavity_with(CircleSection())
    u = 0.31 * math.pi * (HALF_WIDTHS + 3.0) ** 2 / 2100.0

    def thickness(ratio):
        c = LayeredCavity(cavity.half_widths, cavity.feeds, cavity.section, ratio, 2100.0, 3.0)
        return jnp.diff(c.depths, prepend=0.0)

    sensitivity = 0.31 * jax.jacfwd(thickness)(0.31) / thickness(0.31)
    np.testing.assert_allclose(sensitivity, -u / (1.0 + u), rtol=1e-12)
