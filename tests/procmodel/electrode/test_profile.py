"""Profiles: shapes, joints, parallels, steps along them, and what is refused."""

import math

import numpy as np
import pytest

from procmodel.electrode import (
    Arc,
    Line,
    chain,
    cone_frustum,
    curved,
    deviations,
    from_bulges,
    interpolate_profile,
    parallel,
    radius_at,
    square_frustum,
)
from procmodel.electrode.profile import directions, ends
from procmodel.electrode.profile_steps import normals, steps_of
from procmodel.errors import InputError
from tests.procmodel.electrode.shapes import PROFILES, centres_along


def test_cone_frustum():
    z = np.array([0.0, 25.0, 150.0])
    np.testing.assert_allclose(radius_at(PROFILES["cone"], z), [30.0, 35.0, 60.0])
    np.testing.assert_array_equal(radius_at(PROFILES["cone"], np.array([-1.0, 151.0])), -np.inf)


def test_square_frustum_has_flats():
    assert square_frustum(20.0, 40.0, 100.0).sides == 4
    assert square_frustum(20.0, 40.0, 100.0, 6).sides == 6
    assert cone_frustum(20.0, 40.0, 100.0).sides is None


@pytest.mark.parametrize(("convex", "sense"), [(False, -1.0), (True, 1.0)])
def test_curved(convex, sense):
    shape = curved(50.0, 50.0, 120.0, 100.0, convex)
    sagitta = 100.0 - 80.0
    assert float(radius_at(shape, 60.0)) == pytest.approx(50.0 + sense * sagitta)
    for point, expected in zip(ends(shape.pieces[0]), ([50, 0], [50, 120]), strict=True):
        np.testing.assert_allclose(point, expected, atol=1e-12)
    # Half a circle is the tightest arc.
    half = curved(100.0, 100.0, 120.0, 60.0, convex)
    assert float(radius_at(half, 60.0)) == pytest.approx(100.0 + sense * 60.0)


@pytest.mark.parametrize("name", PROFILES)
def test_radius_is_that_of_points_on_the_profile(name):
    points = centres_along(PROFILES[name], 101)
    np.testing.assert_allclose(radius_at(PROFILES[name], points[:, 1]), points[:, 0], atol=1e-8)


@pytest.mark.parametrize("distance", [12.0, -10.0])
def test_parallel_is_at_its_distance_everywhere(distance):
    profile = PROFILES["steps"]
    moved = parallel(profile, distance)
    here, there = centres_along(profile, 2001), centres_along(moved, 101)
    apart = np.min(np.hypot(*(here[None] - there[:, None]).transpose(2, 0, 1)), axis=1)
    # The nearest of many points is farther than the curve by half their distance squared.
    np.testing.assert_allclose(apart, abs(distance), atol=1e-4)
    assert np.all(np.sign(there[:, 0].max() - here[:, 0].max()) == np.sign(distance))


@pytest.mark.parametrize("name", PROFILES)
def test_pieces_of_a_parallel_join(name):
    moved = parallel(PROFILES[name], 15.0)
    for before, after in zip(moved.pieces[:-1], moved.pieces[1:], strict=True):
        np.testing.assert_allclose(ends(before)[1], ends(after)[0], atol=1e-9)
        # The parallel of a corner is an arc, so that it turns nowhere sharply.
        np.testing.assert_allclose(directions(before)[1], directions(after)[0], atol=1e-9)


@pytest.mark.parametrize("name", PROFILES)
def test_there_and_back(name):
    profile = PROFILES[name]
    back = parallel(parallel(profile, 15.0), -15.0)
    z = np.linspace(0.5, 129.5, 47)
    np.testing.assert_allclose(radius_at(back, z), radius_at(profile, z), atol=1e-9)


def test_hollow_as_tight_as_the_distance():
    profile = PROFILES["steps"]
    path = parallel(profile, 25.0)
    assert float(path.pieces[3].radius) == 0.0
    points, piece = interpolate_profile(path, 0.3)
    assert 3 not in piece
    assert np.all(np.hypot(*np.diff(points, axis=0).T) <= 0.3 + 1e-9)


@pytest.mark.parametrize("name", PROFILES)
def test_steps_along_a_profile(name):
    profile = PROFILES[name]
    exact, piece = interpolate_profile(profile, 0.3)
    rounded, same = interpolate_profile(profile, 0.3, 0.1)
    np.testing.assert_array_equal(piece, same)
    assert len(exact) - 1 == sum(steps_of(profile, 0.3))
    taken = np.hypot(*np.diff(exact, axis=0).T)
    # A piece joins the last one within rounding, and no position stands twice.
    assert taken.max() <= 0.3 + 1e-9 and taken.min() > 1e-6
    np.testing.assert_allclose(radius_at(profile, exact[:, 1]), exact[:, 0], atol=1e-8)
    assert np.abs(rounded - exact).max() <= 0.05 + 1e-9


def test_deviations():
    profile = PROFILES["hollow"]
    exact, piece = interpolate_profile(profile, 3.0)
    at_points, at_middles = deviations(profile, exact, piece)
    np.testing.assert_allclose(at_points, 0.0, atol=1e-9)
    # A chord of a hollow lies on the side of the wire, one of a bulge in the material.
    np.testing.assert_allclose(at_middles[:-1], 9.0 / (8.0 * 200.0), rtol=1e-3)
    bulge = PROFILES["bulge"]
    at_middles = deviations(bulge, *interpolate_profile(bulge, 3.0))[1]
    np.testing.assert_allclose(at_middles[:-1], -9.0 / (8.0 * 100.0), rtol=1e-3)
    across = normals(profile, exact, piece)
    shifted = deviations(profile, exact + 0.25 * across, piece)[0]
    np.testing.assert_allclose(shifted, 0.25, atol=1e-9)
    cone = PROFILES["cone"]
    points, piece = interpolate_profile(cone, 3.0)
    shifted = deviations(cone, points - 0.25 * normals(cone, points, piece), piece)[0]
    np.testing.assert_allclose(shifted, -0.25, atol=1e-9)


NAN = math.nan


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: chain([]), ("no piece",)),
        (lambda: chain([Line([1, 0], [1, 5])], sides=2), ("2 flats",)),
        (lambda: chain([Line([1.0, 0.0], [NAN, 5.0])]), ("piece 1", "finite")),
        (lambda: chain([Line([1.0, 0.0], [1.0, 0.0])]), ("piece 1", "no length")),
        (lambda: chain([Line([1.0, 0.0], [-2.0, 5.0])]), ("x = -2", "axis")),
        (lambda: chain([Line([5, 0], [5, 9]), Line([5, 12], [5, 20])]), ("piece 2", "3 um")),
        (lambda: chain([Arc([5.0, 5.0], 0.0, 0.0, 1.0)]), ("piece 1", "radius of 0")),
        (lambda: from_bulges([[1, 0]]), ("two corners",)),
        (lambda: from_bulges([[5, 0], [5, 9], [5, 19]], [0.0]), ("3 corners have 1 bulges",)),
        (lambda: cone_frustum(-1.0, 5.0, 9.0), ("tip radius", "-1")),
        (lambda: cone_frustum(1.0, 0.0, 9.0), ("base radius", "above 0")),
        (lambda: cone_frustum(1.0, 5.0, 0.0), ("height", "above 0")),
        (lambda: cone_frustum(1.0, NAN, 9.0), ("base radius", "finite")),
        (lambda: square_frustum(1.0, -5.0, 9.0), ("base half width", "-5")),
        (lambda: square_frustum(1.0, 5.0, 9.0, 1), ("1 flats",)),
        (lambda: curved(50.0, 50.0, 120.0, 59.0), ("59 um", "60 um at least")),
        (lambda: curved(10.0, 10.0, 120.0, 60.0), ("axis", "x = -50")),
        (lambda: parallel(PROFILES["steps"], 26.0), ("piece 4", "radius 25", "26 um")),
        (lambda: parallel(from_bulges([[9, 0], [9, 20], [30, 40]]), 7.0),
         ("pieces 1 and 2", "hollow corner", "z = 20", "7 um")),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(InputError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".")
    assert all(word in text for word in words), text
