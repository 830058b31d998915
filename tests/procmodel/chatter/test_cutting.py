"""Geometry and force of the cut against the milling forces of another room, sums, and balance."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from procmodel.chatter.cutting import (
    Cut,
    CuttingCoefficients,
    Tool,
    directional_stiffness,
    engaged_between,
    force_directions,
    imbalance_force,
    left_surface,
    pieces,
    tooth_reach,
)
from procmodel.engagement import ForceCoefficients, instantaneous_force, mean_force
from procmodel.engagement.force import force_per_height
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes_plant import COEFFICIENTS, FEED, SLOT, TOOL, UP

# K_t, K_n and their edge coefficients, in SI and in N/mm^2 and N/mm.
WITH_EDGE = CuttingCoefficients(6e8, 2e8, 2e4, 3e4)
IN_MM = ForceCoefficients(600.0, 200.0, 0.0, 20.0, 30.0, 0.0)
HELICAL = Tool(3, radius=0.005, helix=math.radians(35.0))


def test_engagement():
    np.testing.assert_allclose(engaged_between(1.0, "down"), [0.0, math.pi], atol=1e-15)
    np.testing.assert_allclose(engaged_between(0.5, "down"), [0.5 * math.pi, math.pi])
    np.testing.assert_allclose(engaged_between(0.25, "up"), [0.0, math.pi / 3.0])


def test_force_of_a_tooth_against_the_milling_room():
    angle = np.linspace(0.0, math.pi, 13)
    per_chip, at_edge = force_directions(WITH_EDGE, angle)
    found = per_chip * (FEED * np.sin(angle))[:, None] + at_edge
    expected = force_per_height(IN_MM, angle, FEED * 1e3)[:, :2] * 1e3
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)


@functools.partial(jax.jit, static_argnames="slices")
def static_force(tool, cut, coefficients, turned, turn, depth, slices):
    """Force of a tool that does not vibrate, during steps, shape (m, 2)."""
    m = len(turned)
    parts = pieces(tool, cut, coefficients, turned, jnp.full(m, turn), jnp.full(m, depth), slices)
    surface = left_surface(tool, cut, parts.outwards, jnp.zeros((m, 1, 2)), slices)
    chip = (tooth_reach(tool, slices) - surface)[..., None]
    return jnp.sum(chip * parts.per_chip + parts.at_edge, axis=1)


@pytest.mark.parametrize("slices", [1, 7])
@pytest.mark.parametrize("cut", [SLOT, UP])
def test_mean_force_over_a_turn_against_the_milling_room(cut, slices):
    turn = 1.0 / 3000
    turned = (np.arange(3000) + 0.5) * turn
    found = static_force(HELICAL, cut, WITH_EDGE, turned, turn, 4e-3, slices).mean(axis=0)
    expected = mean_force(IN_MM, cut.start, cut.exit, 3, 4.0, FEED * 1e3)[:2]
    # Chip and direction are those of a slice's middle, 0.56 rad long in all.
    np.testing.assert_allclose(found, expected, rtol=1e-3 if slices > 1 else 5e-2, atol=0.02)


def test_slices_converge_to_the_exact_integral_along_the_helix():
    turned = np.linspace(0.0, 1.0, 37, endpoint=False)
    exact = instantaneous_force(
        IN_MM, 2.0 * np.pi * turned, UP.start, UP.exit, 3, 12.0, FEED * 1e3, 5.0, HELICAL.helix
    )[:, :2]
    errors = []
    for slices in (8, 16, 32, 64):
        found = static_force(HELICAL, UP, WITH_EDGE, turned, 1e-9, 12e-3, slices)
        errors.append(np.sqrt(np.mean((found - exact) ** 2)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 1.8) & (orders < 2.2))
    assert errors[-1] < 1e-3 * np.sqrt(np.mean(np.square(exact)))


def test_a_straight_tooth_counts_for_what_it_cut_within_a_step():
    # Of one tooth, with steps that end nowhere near the edges: the shares add up to the arc.
    one = Tool(1)
    cut = Cut(0.3, 2.0, FEED)
    turn = 1.0 / 97.3
    turned = 0.123 * turn + turn * np.arange(97)
    parts = pieces(
        one, cut, CuttingCoefficients(0.0, 1.0), turned, np.full(97, turn), np.ones(97), 1
    )
    shares = np.linalg.norm(parts.per_chip[:, 0], axis=-1)
    assert np.sum(shares) * 2.0 * np.pi * turn == pytest.approx(1.7, rel=1e-12)
    # And a step that contains the entry has just its part of it.
    assert np.sum((shares > 1e-9) & (shares < 1.0 - 1e-9)) == 2


@pytest.mark.parametrize("helix", [0.0, 35.0])
def test_directional_stiffness_against_quadrature(helix):
    tool = Tool(3, radius=0.005, helix=math.radians(helix))
    depth, lag = 12e-3, math.tan(math.radians(helix)) / 0.005
    for turned in (0.03, 0.21, 0.77):
        expected = np.zeros((2, 2))
        for tooth in range(3):
            first = 2.0 * math.pi * (turned + tooth / 3)

            def entry(z, i, j, first=first):
                phi = (first - lag * z) % (2.0 * math.pi)
                if not float(UP.start) <= phi <= float(UP.exit):
                    return 0.0
                n, t = (math.sin(phi), math.cos(phi)), (math.cos(phi), -math.sin(phi))
                return (-6e8 * t[i] - 2e8 * n[i]) * n[j]

            edges = [
                (first - edge + 2.0 * math.pi * k) / lag
                for k in range(-3, 3)
                for edge in (float(UP.start), float(UP.exit))
                if lag
            ]
            inside = [z for z in edges if 0.0 < z < depth] or None
            for i in range(2):
                for j in range(2):
                    value, _ = scipy.integrate.quad(entry, 0.0, depth, (i, j), points=inside)
                    expected[i, j] += value
        found = directional_stiffness(tool, UP, COEFFICIENTS, turned, depth)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-3)


def test_directional_stiffness_of_the_reference_case():
    # -a h(t) with h = sum of g s (K_t c + K_n s), two teeth in a slot.
    turned = np.linspace(0.01, 0.49, 9)
    phi = 2.0 * np.pi * turned
    expected = -0.5e-3 * np.sin(phi) * (6e8 * np.cos(phi) + 2e8 * np.sin(phi))
    found = directional_stiffness(TOOL, SLOT, COEFFICIENTS, turned, 0.5e-3)[:, 0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-6)


def test_a_pass_out_of_the_cut_leaves_the_surface_of_the_one_before():
    outwards = np.array([[[1.0, 0.0]]])
    one = Tool(1)
    # The last pass stayed 30 um behind the nominal one, the one before was where it should be.
    earlier = np.array([[[-30e-6, 0.0], [0.0, 0.0]]])
    surface = left_surface(one, Cut(0.0, math.pi, 20e-6), outwards, earlier, 1)
    # After one pass -20 - 30, after two passes -40.
    assert float(surface[0, 0]) == pytest.approx(-40e-6)
    surface = left_surface(one, Cut(0.0, math.pi, 40e-6), outwards, earlier, 1)
    assert float(surface[0, 0]) == pytest.approx(-70e-6)


def test_a_short_tooth_leaves_its_chip_to_the_next():
    tool = Tool(2, runout=[0.0, -30e-6])
    outwards = np.array([[[1.0, 0.0], [1.0, 0.0]]])
    surface = left_surface(tool, Cut(0.0, math.pi, 20e-6), outwards, np.zeros((1, 4, 2)), 1)
    chip = tooth_reach(tool, 1) - surface[0]
    # The long tooth cuts the feed of both, the short one misses the surface by 10 um.
    np.testing.assert_allclose(chip, [40e-6, -10e-6], rtol=1e-12)


def test_imbalance_turns_with_the_tool():
    tool = Tool(2, imbalance=1e-6)
    force = imbalance_force(tool, np.array([0.0, 0.25]), np.array([100.0, 200.0]))
    size = 1e-6 * (200.0 * math.pi) ** 2
    np.testing.assert_allclose(force, [[0.0, size], [4.0 * size, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Tool(0), r"^teeth is 0, but must be a whole number, 1 or more\.$"),
        (lambda: Tool(2, radius=0.0), r"^radius is 0 m, but must be above 0\.$"),
        (lambda: Tool(2, helix=1.6), r"^helix is 1\.6 rad, but must be at least 0 and at most 1"),
        (lambda: Tool(2, runout=[1e-6]), r"one number for each of the 2 teeth"),
        (lambda: Tool(2, runout=[0.0, math.nan]), r"^runout is nan m, but must be a finite"),
        (lambda: Cut(2.0, 1.0, FEED), r"a tooth must enter before it leaves"),
        (lambda: Cut(0.0, 3.2, FEED), r"^exit is 3\.2 rad, but must be at most 3\.14159\.$"),
        (lambda: Cut(0.0, 1.0, -FEED), r"^feed per tooth is -0\.0001 m, but must be at least 0\.$"),
        (lambda: CuttingCoefficients(math.inf, 0.0), r"^tangential is inf N/m\^2"),
        (lambda: engaged_between(0.5, "dwn"), r"^milling 'dwn' is unknown; did you mean 'down'\?"),
        (lambda: engaged_between(1.5), r"^immersion is 1\.5, but must be above 0 and at most 1\.$"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(InputError, match=message):
        make()
