"""The electrode's section and a layer's path."""

import math

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.wear.layer_path import ElectrodeSection, LayerPath

PATH = LayerPath(
    np.array([[0, 0], [30, 40], [30, 100], [90, 100], [90, 0]], float),
    np.array([True, True, False, True]),
)


def test_areas_of_the_sections():
    assert ElectrodeSection("round", 50.0).area == pytest.approx(math.pi * 25.0**2)
    assert ElectrodeSection("square", 50.0).area == 2500.0
    assert ElectrodeSection("square", 50.0).half == 25.0


def test_lengths_and_turning_points():
    assert PATH.length == pytest.approx(50 + 60 + 100)
    assert PATH.lifted_length == pytest.approx(60)
    # The corner before and after the lifted move is none.
    assert PATH.turning_points == 1


def test_a_polygon_for_a_circle_has_no_turning_points():
    angle = np.linspace(0.0, 2 * np.pi, 65)
    circle = LayerPath(100 * np.column_stack([np.cos(angle), np.sin(angle)]), np.ones(64, bool))
    assert circle.turning_points == 0
    assert circle.length == pytest.approx(2 * math.pi * 100, rel=1e-3)


def test_reversed_twice_is_the_same():
    there_and_back = PATH.reversed()
    np.testing.assert_array_equal(there_and_back.points[0], PATH.points[-1])
    np.testing.assert_array_equal(there_and_back.cutting, [True, False, True, True])
    assert there_and_back.length == PATH.length
    np.testing.assert_array_equal(there_and_back.reversed().points, PATH.points)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ElectrodeSection("oval", 5.0), "oval"),
        (lambda: ElectrodeSection("round", 0.0), "above 0"),
        (lambda: LayerPath(np.zeros((0, 2)), np.zeros(0, bool)), "at least one"),
        (lambda: LayerPath(np.full((2, 2), np.nan), np.ones(1, bool)), "finite"),
        (lambda: LayerPath(np.zeros((3, 2)), np.ones(3, bool)), "every move"),
    ],
)
def test_faulty(call, words):
    with pytest.raises(InputError, match=words):
        call()
