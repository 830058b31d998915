"""Error of a surface, against figures worked out by hand."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.wear.surface_error import cleared_cells, surface_error


def test_figures_of_a_small_map():
    target = np.array([[0.0, 4.0], [10.0, 10.0]])
    depth = np.array([[0.0, 1.0], [9.0, 12.0]])
    error = surface_error(depth, target)
    # Errors -3, -1, +2 over three cells.
    assert error.rms == pytest.approx(np.sqrt(14.0 / 3.0))
    assert error.mean == pytest.approx(-2.0 / 3.0)
    assert error.max == 3.0
    assert error.peak_to_valley == 3.0
    assert np.isnan(error.map[0, 0])
    np.testing.assert_allclose(error.map[1], [-1.0, 2.0])


def test_region_holds_what_was_cut_and_what_should_have_been():
    depth, target = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 2.0]])
    assert cleared_cells(depth, target).tolist() == [[True, False, True]]
    assert cleared_cells(depth, target, before=1.0).tolist() == [[False, False, True]]


def test_given_region_and_bottom_are_used():
    depth, target = np.array([[1.0, 2.0, 4.0]]), np.zeros((1, 3))
    error = surface_error(depth, target, depth < 3.0, np.array([[True, True, False]]))
    assert (error.max, error.peak_to_valley) == (2.0, 1.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.ones((2, 2)), np.ones((2, 3))), "target has shape"),
        ((np.ones((2, 2)), np.ones((2, 2)), np.ones(2, bool)), "region has shape"),
        ((np.zeros((2, 2)), np.zeros((2, 2))), "no cell"),
        ((np.full((2, 2), np.nan), np.ones((2, 2))), "not a finite number"),
    ],
)
def test_bad_maps_are_named(arguments, words):
    with pytest.raises(InputError, match=words):
        surface_error(*arguments)
