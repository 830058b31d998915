"""Finished radius, diameter and cross-section: numbers by hand, inverses, derivatives."""

import math

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.electrode.size import (
    finished_diameter,
    finished_radius,
    path_radius,
    rectangle_area,
    round_area,
)

LENGTHS = st.floats(0.1, 1e3)


def test_the_wire_stands_its_radius_and_a_gap_outside_the_electrode():
    # Wire of 100 um, gap of 15 um, electrode of 60 um: the centre runs at 30 + 50 + 15.
    assert float(path_radius(30.0, 50.0, 15.0)) == 95.0
    assert float(finished_radius(95.0, 50.0, 15.0)) == 30.0
    assert float(finished_diameter(95.0, 50.0, 15.0)) == 60.0


@given(LENGTHS, LENGTHS, LENGTHS)
def test_path_and_radius_are_inverses(radius, wire, gap):
    back = finished_radius(path_radius(radius, wire, gap), wire, gap)
    assert float(back) == pytest.approx(radius, abs=1e-12 * (radius + wire + gap))


def test_a_wider_gap_leaves_a_thinner_electrode_by_twice_as_much():
    assert float(jax.grad(finished_diameter, argnums=2)(95.0, 50.0, 15.0)) == -2.0
    assert float(jax.grad(finished_diameter, argnums=0)(95.0, 50.0, 15.0)) == 2.0


def test_draws_of_the_gap_broadcast_against_sizes():
    gaps, paths = np.array([11.2, 18.3]), np.array([[95.0], [120.0], [150.0]])
    found = finished_diameter(paths, 50.0, gaps)
    np.testing.assert_allclose(found, 2 * (paths - 50.0 - gaps), rtol=1e-15)


def test_cross_sections():
    assert float(round_area(100.0)) == pytest.approx(math.pi * 50.0**2, rel=1e-15)
    assert float(rectangle_area(40.0, 50.0)) == 2000.0
    # Relative change of the area is twice that of the diameter.
    assert float(jax.grad(round_area)(100.0)) == pytest.approx(2 * math.pi * 2500 / 100, rel=1e-15)
