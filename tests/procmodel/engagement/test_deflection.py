"""Bending of a tool against the integrated beam equation and printed cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from procmodel.engagement import Cantilever, MeasuredStiffness, cantilever_deflection

TOOL = Cantilever(diameter=10.0, overhang=40.0, youngs_modulus=6e5)


def integrated(force, load, place, stiffness):
    """E I w'' = M from the clamp on, with M = F (b - x) up to the load."""

    def bend(x, state):
        return [state[1], force * max(load - x, 0.0) / stiffness]

    way = scipy.integrate.solve_ivp(
        bend, (0.0, max(place, 1e-9)), [0.0, 0.0], rtol=1e-11, atol=1e-15, max_step=0.05
    )
    return way.y[0, -1]


@pytest.mark.parametrize("load_height", [0.0, 2.5, 17.0, 35.0])
@pytest.mark.parametrize("at_height", [0.0, 2.5, 20.0, 39.0])
def test_against_the_beam_equation(load_height, at_height):
    stiffness = 6e5 * np.pi * 8.0**4 / 64.0
    expected = integrated(80.0, 40.0 - load_height, 40.0 - at_height, stiffness)
    found = TOOL.deflection(80.0, load_height, at_height)
    assert float(found) == pytest.approx(expected, rel=1e-6)


def test_end_load_is_the_textbook_case():
    assert float(TOOL.end_stiffness) == pytest.approx(3 * 6e5 * np.pi * 8.0**4 / 64 / 40.0**3)
    assert float(TOOL.deflection(100.0, 0.0, 0.0)) == pytest.approx(100.0 / TOOL.end_stiffness)
    # Twice the overhang gives way eight times as far, 0.8 of the diameter 1 / 0.8^4 times.
    longer = Cantilever(10.0, 80.0, 6e5)
    assert float(TOOL.end_stiffness / longer.end_stiffness) == pytest.approx(8.0)
    thinner = Cantilever(8.0, 40.0, 6e5)
    assert float(thinner.end_stiffness / TOOL.end_stiffness) == pytest.approx(0.8**4)


def test_load_and_place_can_be_exchanged():
    load, place = np.meshgrid(np.linspace(0.0, 30.0, 7), np.linspace(0.0, 30.0, 7))
    there = TOOL.deflection(50.0, load, place)
    np.testing.assert_allclose(there, TOOL.deflection(50.0, place, load), rtol=1e-14)


def test_behind_the_clamp_nothing_bends():
    assert float(TOOL.deflection(100.0, 45.0, 0.0)) == 0.0
    assert float(TOOL.deflection(100.0, 0.0, 45.0)) == 0.0


def test_measured_stiffness_is_the_same_at_every_height():
    tool = MeasuredStiffness(5000.0)
    found = tool.deflection(np.full((3, 1), 100.0), 0.0, np.arange(4.0))
    assert found.shape == (3, 4)
    np.testing.assert_allclose(found, 0.02, rtol=1e-15)


def test_gradients_against_differences():
    def deflection(values):
        diameter, overhang, modulus, force, load, place = values
        return Cantilever(diameter, overhang, modulus).deflection(force, load, place)

    for heights in ([2.0, 9.0], [9.0, 2.0]):
        at = jnp.array([10.0, 40.0, 6e5, 80.0, *heights])
        gradient = np.asarray(jax.jit(jax.grad(deflection))(at))
        for i in range(6):
            step = np.zeros(6)
            step[i] = 1e-5 * float(at[i])
            difference = (deflection(at + step) - deflection(at - step)) / (2.0 * step[i])
            assert gradient[i] == pytest.approx(float(difference), rel=1e-6)


def test_gradient_where_load_and_place_meet():
    # Value, slope and curvature are continuous there: both one-sided derivatives are the same.
    slope = jax.grad(cantilever_deflection, argnums=(1, 2))(1.0, 30.0, 30.0, 6e5, 200.0)
    expected = 30.0**2 / (2.0 * 6e5 * 200.0)
    np.testing.assert_allclose(slope, expected, rtol=1e-12)
