"""Form error against summed thin discs, an envelope of the turning tool, and limits."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.engagement import (
    Cantilever,
    Cut,
    ForceCoefficients,
    MeasuredStiffness,
    engaged_between,
    form_error,
    instantaneous_force,
    mean_force,
    peak_force,
    wall_force,
)
from procmodel.errors import InputError

COEFFICIENTS = ForceCoefficients(796.0, 168.8, 222.0, 27.7, 30.8, 1.4)
TOOL = Cantilever(10.0, 40.0, 6e5)
LINE, ARC = np.radians([11.478340954533579, 18.7375])
PAPER = Cut(flutes=4, axial_depth=5.0, feed_per_tooth=0.04, radius=5.0, helix=math.radians(30.0))
# Several flutes at a time, and flutes that lag more than a turn.
DEEP = Cut(3, 35.0, 0.05, 4.0, math.radians(45.0))
SLIM = Cut(2, 12.0, 0.03, 3.0, math.radians(38.0), "up")
DISCS = 40_000


def beam(load, place):
    """Deflection of the tool under 1 N, heights from the end: w'' = M / (E I), by hand."""
    b, x = 40.0 - load, 40.0 - place
    stiffness = 6e5 * math.pi * 8.0**4 / 64.0
    beyond = np.where(x > b, x - b, 0.0)
    return (b * x**2 / 2.0 - x**3 / 6.0 + beyond**3 / 6.0) / stiffness


def summed_error(cut, angle, height):
    """Force and error by adding up thin discs of all flutes at the instant of the wall."""
    start, wall = (math.pi - angle, math.pi) if cut.milling == "down" else (0.0, 0.0)
    exit = start + angle
    lag = math.tan(cut.helix) / cut.radius
    z = (np.arange(DISCS) + 0.5) * cut.axial_depth / DISCS
    force = error = 0.0
    for flute in range(cut.flutes):
        phi = wall + lag * (height - z) + 2.0 * math.pi * flute / cut.flutes
        phi -= 2.0 * math.pi * np.round((phi - 0.5 * (start + exit)) / (2.0 * math.pi))
        cuts = (phi > start) & (phi < exit)
        k, chip = COEFFICIENTS, cut.feed_per_tooth * np.sin(phi)
        tangential = k.tangential_shear * chip + k.tangential_edge
        radial = k.radial_shear * chip + k.radial_edge
        across = (tangential * np.sin(phi) - radial * np.cos(phi)) * cut.axial_depth / DISCS
        force += np.sum(across[cuts])
        error += np.sum((across * beam(z, height))[cuts])
    return force, error if cut.milling == "down" else -error


@pytest.mark.parametrize(
    ("cut", "angle"),
    [(PAPER, LINE), (PAPER, ARC), (DEEP, 1.3), (DEEP, 3.0), (SLIM, 0.4), (SLIM, 2.5)],
)
def test_against_thin_discs(cut, angle):
    heights = np.array([0.0, 0.03, 0.31, 0.5, 0.77, 1.0]) * cut.axial_depth
    found = cut.form_error(COEFFICIENTS, angle, TOOL, heights)
    forces = cut.wall_force(COEFFICIENTS, angle, heights)
    # A disc at an edge of the stock is in or out: one at either end of each flute's piece.
    disc = 80.0 * cut.axial_depth / DISCS
    most = 2 * cut.flutes * disc * 3
    for i, height in enumerate(heights):
        force, error = summed_error(cut, angle, height)
        assert float(forces[i, 1]) == pytest.approx(force, abs=most)
        assert float(found[i]) == pytest.approx(error, abs=most / float(TOOL.end_stiffness))


def envelope(cut, angle, height, stiffness):
    """How far the flutes come towards the wall at a height, as the bent tool turns.

    Nothing of the instant at which the wall is generated goes in.
    """
    down = cut.milling == "down"
    start, exit = (math.pi - angle, math.pi) if down else (0.0, angle)
    rotation = np.linspace(0.0, 2.0 * math.pi, 200_001)
    force = instantaneous_force(
        COEFFICIENTS, rotation, start, exit, cut.flutes, cut.axial_depth, cut.feed_per_tooth,
        cut.radius, cut.helix,
    )  # fmt: skip
    phi = rotation - height * math.tan(cut.helix) / cut.radius
    y = np.asarray(force)[:, 1] / stiffness + cut.radius * np.cos(phi)
    return np.min(y) + cut.radius if down else cut.radius - np.max(y)


@pytest.mark.parametrize("milling", ["down", "up"])
@pytest.mark.parametrize("height", [1.0, 2.0, 4.0])
def test_sign_and_size_by_the_envelope_of_the_turning_tool(milling, height):
    cut = Cut(4, 5.0, 0.04, 5.0, PAPER.helix, milling)
    # So stiff that the tool's giving way does not shift the instant.
    stiffness = 1e7
    found = cut.form_error(COEFFICIENTS, ARC, MeasuredStiffness(stiffness), [height])
    expected = envelope(cut, ARC, height, stiffness)
    assert float(found[0]) == pytest.approx(expected, rel=1e-3)


def test_down_milling_leaves_material_and_a_great_chip_in_up_milling_cuts_into_the_wall():
    up = Cut(4, 5.0, 0.04, 5.0, PAPER.helix, "up")
    assert np.all(PAPER.form_error(COEFFICIENTS, LINE, TOOL, [0.0, 2.0, 4.0]) > 0.0)
    # Up milling: the radial force at the wall pushes off it, the tangential force of a thick chip
    # pulls into it.
    shallow = up.form_error(COEFFICIENTS, LINE, TOOL, [2.0])
    rubbing = ForceCoefficients(796.0, 0.0, 0.0, 27.7, 0.0, 0.0)
    assert float(shallow[0]) > 0.0
    assert float(up.form_error(rubbing, 1.2, TOOL, [4.0])[0]) < 0.0


def test_along_a_path_one_flute_at_a_time():
    # z + alpha / lag below the upper end: the whole engaged arc lies above z, whatever z.
    reach = ARC / (math.tan(PAPER.helix) / 5.0)
    heights = np.array([0.0, 0.4, 5.0 - reach - 1e-6])
    force = PAPER.wall_force(COEFFICIENTS, ARC, heights)
    np.testing.assert_allclose(force, np.broadcast_to(force[0], (3, 3)), rtol=1e-12)
    # And it is the whole turn's mean, brought together: N flutes share a turn.
    mean = np.asarray(PAPER.mean_force(COEFFICIENTS, ARC))
    whole = mean * 2.0 * math.pi / (4 * 5.0) / (math.tan(PAPER.helix) / 5.0)
    np.testing.assert_allclose(force[0], whole, rtol=1e-12)
    top = PAPER.form_error(COEFFICIENTS, ARC, TOOL, [5.0])
    np.testing.assert_allclose(top, 0.0, atol=1e-16)


@pytest.mark.parametrize("cut", [PAPER, DEEP, SLIM])
def test_one_stiffness_at_all_heights_is_force_over_stiffness(cut):
    heights = np.linspace(0.0, cut.axial_depth, 23)
    angles = np.array([0.1, 0.9, 2.0, 3.1])
    error = cut.form_error(COEFFICIENTS, angles, MeasuredStiffness(4000.0), heights)
    force = np.asarray(cut.wall_force(COEFFICIENTS, angles, heights))[..., 1]
    sign = 1.0 if cut.milling == "down" else -1.0
    assert error.shape == (4, 23)
    # Quadrature against the closed form, in units of the greatest force.
    np.testing.assert_allclose(error * 4000.0, sign * force, atol=1e-9 * np.max(np.abs(force)))


def test_mean_and_peak_are_those_of_the_functions():
    angles = np.array([LINE, ARC])
    start, exit = engaged_between(angles)
    mean = mean_force(COEFFICIENTS, start, exit, 4, 5.0, 0.04)
    np.testing.assert_allclose(PAPER.mean_force(COEFFICIENTS, angles), mean, rtol=1e-14)
    peak = peak_force(COEFFICIENTS, start, exit, 4, 5.0, 0.04, 5.0, PAPER.helix)
    np.testing.assert_allclose(PAPER.peak_force(COEFFICIENTS, angles), peak, rtol=1e-14)


def test_air_leaves_no_error_and_no_nan():
    def error(angle):
        return PAPER.form_error(COEFFICIENTS, angle, TOOL, jnp.array([0.0, 2.0, 5.0]))

    assert error(0.0).tolist() == [0.0, 0.0, 0.0]
    assert np.all(np.isfinite(jax.jacfwd(error)(0.0)))
    assert np.all(np.isfinite(jax.jacfwd(error)(jnp.pi)))


@pytest.mark.parametrize("milling", ["down", "up"])
def test_gradients_against_differences(milling):
    heights = jnp.array([0.0, 1.0, 2.9, 4.1])

    def error(values):
        angle, feed, overhang, *coefficients = values
        cut = Cut(4, 5.0, feed, 5.0, PAPER.helix, milling)
        tool = Cantilever(10.0, overhang, 6e5)
        return cut.form_error(ForceCoefficients(*coefficients), angle, tool, heights)

    at = jnp.array([ARC, 0.04, 40.0, 796.0, 168.8, 222.0, 27.7, 30.8, 1.4])
    forward = np.asarray(jax.jit(jax.jacfwd(error))(at))
    np.testing.assert_allclose(jax.jacrev(error)(at), forward, rtol=1e-10, atol=1e-15)
    for i in range(9):
        step = np.zeros(9)
        step[i] = 1e-6 * float(at[i])
        difference = (error(at + step) - error(at - step)) / (2.0 * step[i])
        np.testing.assert_allclose(forward[:, i], difference, rtol=1e-6, atol=1e-12)


def test_batches_of_paths_agree_with_one():
    angles = jnp.linspace(0.1, 0.4, 6).reshape(2, 3)
    heights = jnp.array([0.5, 3.5])

    def error(angle):
        return PAPER.form_error(COEFFICIENTS, angle, TOOL, heights)

    together = error(angles)
    assert together.shape == (2, 3, 2)
    np.testing.assert_allclose(jax.jit(jax.vmap(error))(angles), together, rtol=1e-12)
    np.testing.assert_allclose(error(angles[1, 2]), together[1, 2], rtol=1e-12)


def test_feed_may_change_along_the_path():
    angles, feeds = np.array([0.2, 0.2, 0.3]), np.array([0.02, 0.04, 0.06])
    args = {"flutes": 4, "axial_depth": 5.0, "radius": 5.0, "helix": PAPER.helix, "heights": [1.0]}
    together = form_error(COEFFICIENTS, angles, feed_per_tooth=feeds, tool_stiffness=TOOL, **args)
    forces = wall_force(COEFFICIENTS, angles, feed_per_tooth=feeds, **args)
    for i in range(3):
        alone = form_error(
            COEFFICIENTS, angles[i], feed_per_tooth=feeds[i], tool_stiffness=TOOL, **args
        )
        np.testing.assert_allclose(together[i], alone, rtol=1e-12)
        force = wall_force(COEFFICIENTS, angles[i], feed_per_tooth=feeds[i], **args)
        np.testing.assert_allclose(forces[i], force, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"flutes": 0}, r"^flutes is 0, but must be a whole number, 1 or more\.$"),
        ({"flutes": 2.5}, r"^flutes is 2\.5, but must be a whole number"),
        ({"axial_depth": -1.0}, r"^axial depth is -1 mm, but must be above 0\.$"),
        ({"feed_per_tooth": math.nan}, r"^feed per tooth is nan mm, but must be above 0\.$"),
        ({"radius": 0.0}, r"^radius is 0 mm, but must be above 0\.$"),
        ({"helix": 0.0}, r"^helix is 0 deg, but must be above 0 and below 90: "),
        ({"milling": "climb"}, r"^milling 'climb' is unknown; known are down, up$"),
    ],
)
def test_an_impossible_cut_is_refused(change, message):
    good = {"flutes": 4, "axial_depth": 5.0, "feed_per_tooth": 0.04, "radius": 5.0, "helix": 0.5}
    with pytest.raises(InputError, match=message):
        Cut(**(good | change))
