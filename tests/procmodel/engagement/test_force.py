"""Cutting forces against printed values, numerical integration along the flutes, and balance."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from procmodel.engagement import (
    ForceCoefficients,
    instantaneous_force,
    mean_force,
    peak_force,
    published_coefficients,
)
from procmodel.errors import InputError

COEFFICIENTS = ForceCoefficients(796.0, 168.8, 222.0, 27.7, 30.8, 1.4)
CUT = {"flutes": 4, "axial_depth": 5.0, "feed_per_tooth": 0.04}
HELIX = {"radius": 5.0, "helix": math.radians(30.0)}
ALPHA = math.radians(11.478340954533579)


def test_slot_and_half_immersion():
    slot = mean_force(COEFFICIENTS, 0.0, math.pi, **CUT)
    np.testing.assert_allclose(slot, [-229.839, 335.544, 70.532], atol=5e-4)
    half = mean_force(COEFFICIENTS, 0.5 * math.pi, math.pi, **CUT)
    np.testing.assert_allclose(half, [23.927, 276.557, 35.266], atol=5e-4)


def local_force(phi):
    """Force per height of a flute at an angle, straight from the definition."""
    k, chip = COEFFICIENTS, CUT["feed_per_tooth"] * math.sin(phi)
    tangential = k.tangential_shear * chip + k.tangential_edge
    radial = k.radial_shear * chip + k.radial_edge
    return np.array(
        [
            -tangential * math.cos(phi) - radial * math.sin(phi),
            tangential * math.sin(phi) - radial * math.cos(phi),
            k.axial_shear * chip + k.axial_edge,
        ]
    )


def summed_force(rotation, start, exit, axial_depth, helix):
    """Force by adding up thin discs."""
    heights = (np.arange(20_000) + 0.5) * axial_depth / 20_000
    total = np.zeros(3)
    for flute in range(4):
        phi = rotation + 0.5 * math.pi * flute - heights * math.tan(helix) / 5.0
        phi = np.mod(phi, 2.0 * math.pi)
        for angle in phi[(phi >= start) & (phi <= exit)]:
            total += local_force(angle)
    return total * axial_depth / 20_000


@pytest.mark.parametrize(
    ("start", "axial_depth", "helix"),
    [(math.pi - ALPHA, 5.0, 30.0), (0.5 * math.pi, 12.0, 45.0), (0.0, 60.0, 40.0)],
)
def test_the_exact_integral_against_thin_discs(start, axial_depth, helix):
    for rotation in (0.1, 1.7, 3.0, 3.3, 5.9):
        found = instantaneous_force(
            COEFFICIENTS,
            rotation,
            start,
            math.pi,
            4,
            axial_depth,
            CUT["feed_per_tooth"],
            5.0,
            math.radians(helix),
        )
        expected = summed_force(rotation, start, math.pi, axial_depth, math.radians(helix))
        # A disc at the edge of the stock is in or out: one of each flute's may be wrong.
        np.testing.assert_allclose(found, expected, atol=4 * 60.0 * axial_depth / 20_000)


@pytest.mark.parametrize("helix", [10.0, 30.0, 55.0])
@pytest.mark.parametrize("start", [0.0, 0.5 * math.pi, math.pi - ALPHA])
def test_the_mean_over_a_turn_does_not_depend_on_the_helix(start, helix):
    rotation = np.linspace(0.0, 2.0 * math.pi, 20_000, endpoint=False)
    turn = instantaneous_force(
        COEFFICIENTS, rotation, start, math.pi, **CUT, radius=5.0, helix=math.radians(helix)
    )
    expected = mean_force(COEFFICIENTS, start, math.pi, **CUT)
    np.testing.assert_allclose(jnp.mean(turn, axis=0), expected, atol=2e-3)


def test_mean_by_quadrature():
    for axis in range(3):
        whole, _ = scipy.integrate.quad(lambda phi, i=axis: local_force(phi)[i], 0.7, 2.9)
        found = mean_force(COEFFICIENTS, 0.7, 2.9, **CUT)[axis]
        expected = CUT["flutes"] * CUT["axial_depth"] / (2.0 * math.pi) * whole
        assert float(found) == pytest.approx(expected, rel=1e-10)


def test_no_engagement_no_force():
    nothing = mean_force(COEFFICIENTS, 2.0, 2.0, **CUT)
    assert nothing.tolist() == [0.0, 0.0, 0.0]
    outside = instantaneous_force(COEFFICIENTS, 1.0, 3.0, math.pi, 1, 1.0, 0.04, **HELIX)
    np.testing.assert_allclose(outside, 0.0, atol=1e-12)


def test_readings_of_different_conditions_at_once():
    rotation, start = np.array([0.3, 1.9, 3.0]), np.array([2.0, 2.5, 2.9])
    depth, feed = np.array([2.0, 5.0, 9.0]), np.array([0.02, 0.04, 0.08])
    together = instantaneous_force(
        COEFFICIENTS, rotation, start, np.full(3, math.pi), 4, depth, feed, **HELIX
    )
    for i in range(3):
        alone = instantaneous_force(
            COEFFICIENTS, rotation[i], start[i], math.pi, 4, depth[i], feed[i], **HELIX
        )
        np.testing.assert_allclose(together[i], alone, rtol=1e-12)


@pytest.mark.parametrize("axial_depth", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("flutes", [1, 4])
def test_peak_force_against_a_fine_turn(axial_depth, flutes):
    start = np.array([math.pi - ALPHA, 0.5 * math.pi, 0.0])
    rest = {"flutes": flutes, "axial_depth": axial_depth, "feed_per_tooth": 0.04, **HELIX}
    rotation = np.linspace(0.0, 2.0 * math.pi, 20_001)
    for i, found in enumerate(peak_force(COEFFICIENTS, start, math.pi, **rest)):
        turn = instantaneous_force(COEFFICIENTS, rotation, start[i], math.pi, **rest)
        # A smooth peak between two of the 64 angles is missed by a share of 1e-3 at most.
        expected = np.max(np.hypot(turn[:, 0], turn[:, 1]))
        assert float(found) == pytest.approx(expected, rel=1e-3)


def test_published_coefficients_name_their_source():
    found = published_coefficients("Al7075-T6")
    assert found.coefficients.tangential_shear == 767.01
    assert "10.1186/s10033-021-00536-9" in found.source
    with pytest.raises(InputError, match=r"'Al7075'; did you mean 'Al7075-T6'\?\.$"):
        published_coefficients("Al7075")


def test_gradients_against_differences():
    def force(values):
        start, depth, feed, *coefficients = values
        return mean_force(ForceCoefficients(*coefficients), start, math.pi, 4, depth, feed)

    def peak(values):
        start, depth, feed, *coefficients = values
        return instantaneous_force(
            ForceCoefficients(*coefficients), 3.1, start, math.pi, 4, depth, feed, **HELIX
        )

    at = jnp.array([math.pi - ALPHA, 5.0, 0.04, 796.0, 168.8, 222.0, 27.7, 30.8, 1.4])
    for function in (force, peak):
        jacobian = np.asarray(jax.jit(jax.jacfwd(function))(at))
        steps = 1e-6 * np.asarray(at)
        for i, step in enumerate(steps):
            moved = np.zeros(9)
            moved[i] = step
            difference = (function(at + moved) - function(at - moved)) / (2.0 * step)
            np.testing.assert_allclose(jacobian[:, i], difference, rtol=1e-6, atol=1e-6)
