"""Multipliers against printed ones and semi-discretisation, limits, frequencies, gradients."""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from procmodel.chatter import lobes
from procmodel.chatter.cutting import CuttingCoefficients, Tool, directional_stiffness
from procmodel.chatter.modes import Modes
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes_plant import (
    COEFFICIENTS,
    DOWN,
    FLIP_SPEED,
    KNOWN,
    KNOWN_NAMES,
    MODE,
    SLOT,
    SPEED,
    TOOL,
    UP,
)

THREE = Modes(
    [922.0, 1300.0, 1700.0], [0.011, 0.02, 0.015], [0.04, 0.06, 0.05], [[1, 0], [0, 1], [0.6, 0.8]]
)
HELICAL = Tool(3, radius=0.004, helix=math.radians(30.0))


def semi_discretised(modes, tool, cut, speed, depth, intervals):
    """Largest multiplier by semi-discretisation of order 0, coefficients averaged."""
    w, q = np.asarray(modes.angular), len(modes.frequency)
    way, mass = np.asarray(modes.direction), np.asarray(modes.mass)
    step = 1.0 / (speed * tool.teeth * intervals)
    offsets = (np.arange(20) + 0.5) / 20
    at = (np.arange(intervals)[:, None] + offsets) / (intervals * tool.teeth)
    stiffness = np.asarray(directional_stiffness(tool, cut, COEFFICIENTS, at, depth)).mean(axis=1)
    free = np.block(
        [
            [np.zeros((q, q)), np.eye(q)],
            [np.diag(-(w**2)), np.diag(-2.0 * np.asarray(modes.damping) * w)],
        ]
    )
    push = np.concatenate([np.zeros((q, 2)), way / mass[:, None]])
    read = np.concatenate([way.T, np.zeros((2, q))], axis=1)
    # The state, then the tip at the ends of the intervals of the last pitch, the latest first.
    whole = np.eye(2 * q + 2 * intervals)
    for c in stiffness:
        system = np.block([[free + push @ c @ read, -push @ c], [np.zeros((2, 2 * q + 2))]])
        both = scipy.linalg.expm(step * system)[: 2 * q]
        delayed = 0.5 * (whole[-2:] + whole[-4:-2])
        after = both[:, : 2 * q] @ whole[: 2 * q] + both[:, 2 * q :] @ delayed
        whole = np.concatenate([after, read @ whole[: 2 * q], whole[2 * q : -2]])
    return np.max(np.abs(np.linalg.eigvals(whole)))


def extrapolated(modes, tool, cut, speed, depth, intervals=60):
    """Semi-discretisation, its leading error of second order taken off."""
    coarse, fine = (
        semi_discretised(modes, tool, cut, speed, depth, n) for n in (intervals, 2 * intervals)
    )
    return (4.0 * fine - coarse) / 3.0


@pytest.mark.parametrize(("cut", "depth", "known"), KNOWN, ids=KNOWN_NAMES)
def test_known_multipliers(cut, depth, known):
    found = lobes.largest_multiplier(MODE, TOOL, cut, COEFFICIENTS, SPEED, depth)
    # The printed values have 8 decimals.
    assert float(found) == pytest.approx(known, abs=1e-8)


def test_convergence_is_exponential_with_the_degree():
    of = functools.partial(lobes.largest_multiplier, MODE, TOOL, DOWN, COEFFICIENTS, SPEED, 0.5e-3)
    exact = of(degree=24)
    errors = [abs(float(of(degree=d) - exact)) for d in (6, 9, 12, 15)]
    assert all(after < 0.05 * before for before, after in itertools.pairwise(errors))
    assert errors[-1] < 1e-9


@pytest.mark.parametrize(
    ("modes", "tool", "cut", "depth"),
    [(MODE, TOOL, SLOT, 0.4075e-3), (THREE, HELICAL, UP, 1.5e-3), (THREE, HELICAL, SLOT, 6e-3)],
    ids=["one mode", "three modes, helix", "helix longer than a pitch"],
)
def test_against_semi_discretisation(modes, tool, cut, depth):
    found = float(lobes.largest_multiplier(modes, tool, cut, COEFFICIENTS, 120.0, depth))
    assert found == pytest.approx(extrapolated(modes, tool, cut, 120.0, depth), rel=2e-3)
    # The check tells a depth that is a tenth off.
    other = float(lobes.largest_multiplier(modes, tool, cut, COEFFICIENTS, 120.0, 1.1 * depth))
    assert abs(other / found - 1.0) > 4e-3


def test_in_air_a_vibration_dies_out_by_its_damping():
    found = lobes.stability(MODE, TOOL, SLOT, COEFFICIENTS, SPEED, 0.0)
    w = 2.0 * math.pi * 922.0
    assert found.growth == pytest.approx(-0.011 * w, rel=1e-9)
    assert found.frequency == pytest.approx(922.0 * math.sqrt(1.0 - 0.011**2), rel=1e-9)
    assert found.kind.startswith("stable")


def test_a_small_helix_is_nearly_none():
    straight, slight = (
        float(lobes.largest_multiplier(MODE, Tool(2, helix=h), UP, COEFFICIENTS, SPEED, 5e-4))
        for h in (0.0, 1e-5)
    )
    assert slight == pytest.approx(straight, abs=1e-5)


@pytest.mark.parametrize(("speed", "limit"), [(10000.0, 0.3224e-3), (12500.0, 2.7070e-3)])
def test_known_limits(speed, limit):
    found = lobes.depth_limit(MODE, TOOL, SLOT, COEFFICIENTS, speed / 60.0, 3.2e-3)
    assert found == pytest.approx(limit, abs=0.6e-7)


def test_the_limit_at_5000_is_where_semi_discretisation_has_it():
    # In print it is 0.4075 mm, where |mu| is still 0.99906 by both.
    found = lobes.depth_limit(MODE, TOOL, SLOT, COEFFICIENTS, SPEED, 0.8e-3)
    assert found == pytest.approx(0.4075e-3, rel=4e-3)
    fine = extrapolated(MODE, TOOL, SLOT, SPEED, found, intervals=100)
    assert fine == pytest.approx(1.0, abs=1e-4)
    assert extrapolated(MODE, TOOL, SLOT, SPEED, 0.4075e-3, intervals=100) < 0.9995


def test_lobes_over_speeds():
    speeds = np.array([5000.0, 10000.0, 60000.0]) / 60.0
    found = lobes.depth_limits(MODE, TOOL, SLOT, COEFFICIENTS, speeds, 0.6e-3, samples=12)
    assert found[1] == pytest.approx(0.3224e-3, rel=1e-3)
    assert found[0] > found[1]
    shallow = lobes.depth_limits(MODE, TOOL, SLOT, COEFFICIENTS, speeds[:1], 0.1e-3, samples=3)
    assert shallow.tolist() == [math.inf]


def test_chatter_frequencies():
    flip = lobes.stability(MODE, TOOL, SLOT, COEFFICIENTS, FLIP_SPEED, 3e-3)
    assert flip.frequency == pytest.approx(5.0 * FLIP_SPEED, rel=1e-9)
    assert flip.kind.startswith("period doubling")
    found = lobes.chatter_frequency(MODE, TOOL, SLOT, COEFFICIENTS, SPEED, 0.5e-3)
    assert found == pytest.approx(945.0, abs=0.5)


def test_gradients_against_differences():
    pieces = lobes.pitch_pieces(THREE, HELICAL, UP, 120.0, 1.5e-3)

    def size(values):
        modes = Modes(values[:3], values[3:6], values[6:9], THREE.direction)
        force = CuttingCoefficients(values[9], values[10])
        return lobes.largest_multiplier(
            modes, HELICAL, UP, force, values[11], 1.5e-3, degree=9, pieces=pieces
        )

    at = jnp.concatenate([THREE.frequency, THREE.damping, THREE.mass, jnp.array([6e8, 2e8, 120.0])])
    slope = jax.jit(jax.grad(size))(at)
    size = jax.jit(size)
    for i in range(len(at)):
        step = np.zeros(len(at))
        # Eigenvalues are good to 1e-10 or so, which a smaller step would show.
        step[i] = 1e-4 * at[i]
        difference = (size(at + step) - size(at - step)) / (2.0 * step[i])
        assert slope[i] == pytest.approx(float(difference), rel=1e-4, abs=1e-6 / float(at[i]))


def test_bad_input():
    with pytest.raises(InputError, match=r"^deepest is 0 m, but must be above 0\.$"):
        lobes.depth_limit(MODE, TOOL, SLOT, COEFFICIENTS, SPEED, 0.0)
    with pytest.raises(InputError, match=r"^pieces is missing: give those of pitch_pieces"):
        jax.grad(lambda s: lobes.largest_multiplier(MODE, TOOL, SLOT, COEFFICIENTS, s, 1e-3))(SPEED)
