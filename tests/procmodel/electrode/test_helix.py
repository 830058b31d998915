"""Arcs in any plane and helices: against rotations, cylinders and lines."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from procmodel.electrode import interpolate_arc, interpolate_helix, interpolate_space_arc
from procmodel.errors import InputError


def lengths_of(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1)


@given(
    st.floats(1.0, 100.0), st.floats(-20.0, 20.0), st.floats(-300.0, 300.0), st.floats(0.2, 30.0)
)
def test_any_helix(radius, sweep, rise, step):
    if abs(sweep) < 1e-3:
        sweep = 1e-3
    points = interpolate_helix((1.0, 2.0, 3.0), radius, 0.4, sweep, rise, step)
    local = points - [1.0, 2.0, 3.0]
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), radius, rtol=1e-12)
    end = [radius * math.cos(0.4 + sweep), radius * math.sin(0.4 + sweep), rise]
    np.testing.assert_allclose(local[-1], end, atol=1e-10)
    taken = lengths_of(points)
    assert np.all(taken <= step * (1.0 + 1e-8))
    # The steps but the last are as long as allowed, unless they reach across the circle.
    if len(taken) > 1 and taken[0] < 0.999 * step:
        across = math.hypot(2.0 * radius, math.pi * rise / sweep)
        assert taken[0] == pytest.approx(across)
    np.testing.assert_allclose(taken[:-1], taken[0], rtol=1e-9)
    # The third axis moves in step with the angle.
    if len(points) > 2:
        np.testing.assert_allclose(np.diff(local[:-1, 2]), local[1, 2], atol=1e-9)


def test_a_step_that_reaches_across_the_circle_is_half_a_turn():
    points = interpolate_helix((0, 0, 0), 1.0, 0.0, 3.0, 1.0, 3.0)
    np.testing.assert_allclose(points, [[1, 0, 0], [math.cos(3.0), math.sin(3.0), 1.0]])
    turn = interpolate_helix((0, 0, 0), 1.0, 0.0, 2.0 * math.pi, 1.0, 3.0)
    np.testing.assert_allclose(turn, [[1, 0, 0], [-1, 0, 0.5], [1, 0, 1.0]], atol=1e-12)


def test_length_of_a_helix():
    points = interpolate_helix((0, 0, 0), 50.0, 0.0, 6.0 * math.pi, 90.0, 0.3)
    length = 6.0 * math.pi * math.hypot(50.0, 90.0 / (6.0 * math.pi))
    # Chords of 0.3 um on a radius of 50 um are 1.5e-6 shorter than their arcs.
    assert lengths_of(points).sum() == pytest.approx(length, rel=2e-6)
    assert len(points) - 1 == math.ceil(length / 0.3)


@pytest.mark.parametrize(("plane", "axes"), [("xy", [0, 1, 2]), ("zx", [2, 0, 1]),
                                             ("yz", [1, 2, 0])])  # fmt: skip
@pytest.mark.parametrize("resolution", [None, 0.1])
def test_a_flat_helix_is_the_arc_of_its_plane(plane, axes, resolution):
    flat = interpolate_arc((4.0, 5.0), 30.0, 0.3, -2.0, 0.3, resolution)
    centre = np.zeros(3)
    centre[axes[:2]] = 4.0, 5.0
    got = interpolate_helix(centre, 30.0, 0.3, -2.0, 0.0, 0.3, resolution, plane)
    np.testing.assert_allclose(got[:, axes[:2]], flat, atol=1e-12)
    np.testing.assert_array_equal(got[:, axes[2]], 0.0)


def test_arc_in_any_plane_turns_like_a_screw():
    normal = np.array([1.0, -2.0, 0.5])
    centre, spoke = np.array([10.0, 20.0, 30.0]), 40.0 * np.array([2.0, 1.0, 0.0]) / math.sqrt(5.0)
    points = interpolate_space_arc(centre, centre + spoke, normal, -2.5, 0.5)
    theta = 2.0 * math.asin(0.5 / 80.0)
    angles = -np.minimum(theta * np.arange(len(points)), 2.5)
    axis = normal / np.linalg.norm(normal)
    turned = Rotation.from_rotvec(angles[:, None] * axis).apply(spoke)
    np.testing.assert_allclose(points, centre + turned, atol=1e-11)
    risen = interpolate_space_arc(centre, centre + spoke, 7.0 * normal, 2.5, 0.5, rise=12.0)
    assert (risen[-1] - risen[0]) @ axis == pytest.approx(12.0)


def test_no_turn_is_one_position():
    np.testing.assert_allclose(interpolate_helix((0, 0, 1), 5.0, 0.0, 0.0, 0.0, 0.3), [[5, 0, 1]])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: interpolate_helix((0, 0, 0), 5, 0, 0, 3.0, 0.3), ("without turning", "line")),
        (lambda: interpolate_helix((0, 0, 0), 5, 0, 1, 3.0, 0.3, plane="xz"), ("'xz'", "zx")),
        (lambda: interpolate_helix((0, 0), 5, 0, 1, 3.0, 0.3), ("centre", "3 numbers")),
        (lambda: interpolate_helix((0, 0, 0), 5, 0, 1, math.nan, 0.3), ("rise", "finite")),
        (lambda: interpolate_helix((0, 0, 0), 5, 0, 1, 1, 0.05, 0.1), ("step", "resolution")),
        (lambda: interpolate_space_arc((0, 0, 0), (5, 0, 2), (0, 0, 1), 1, 0.3), ("2 um off",)),
        (lambda: interpolate_space_arc((0, 0, 0), (5, 0, 0), (0, 0, 0), 1, 0.3), ("normal",)),
        (lambda: interpolate_space_arc((0, 0, 0), (0, 0, 0), (0, 0, 1), 1, 0.3), ("radius",)),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(InputError) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert all(word in str(caught.value) for word in words), caught.value
