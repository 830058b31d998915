"""Reading height maps: places in any order, and what is wrong with a file, by name."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io.height_maps import read_height_map


def write(tmp_path, text):
    path = tmp_path / "map.csv"
    path.write_text(text)
    return path


def test_places_in_any_order_and_units(tmp_path):
    path = write(
        tmp_path,
        "x [mm],y [um],z [nm],sigma [um]\n0.02,0,1500,0.1\n0,0,500,0.2\n0,7,0,1\n0.01,7,9,1\n",
    )
    found = read_height_map(path)
    np.testing.assert_allclose(found.x, [20.0, 0.0, 0.0, 10.0])
    np.testing.assert_allclose(found.y, [0.0, 0.0, 7.0, 7.0])
    np.testing.assert_allclose(found.z, [1.5, 0.5, 0.0, 0.009])
    np.testing.assert_allclose(found.sigma, [0.1, 0.2, 1.0, 1.0])
    assert found.path == path


def test_sigma_may_be_missing(tmp_path):
    path = write(tmp_path, "x [um],y [um],z [um]\n0,0,1\n1,0,1\n0,1,1\n5,3,2\n")
    assert read_height_map(path).sigma is None


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0,1\n1,0,1\n0,1,1", "3 readings are no height map"),
        ("0,0,1\n1,0,1\n2,0,1\n3,0,1", "all y are 0 um"),
        ("4,0,1\n4,1,1\n4,2,1\n4,3,1", "all x are 4 um"),
        ("0,0,1\n1,0,1\n0,1,1\n1,0,2", r"rows 3 and 5: both are for the place \(1, 0\)"),
        ("0,0,1\n1,0,nan\n0,1,1\n1,1,2", "row 3: .*not a finite number"),
        ("0,0,1\n1,0,\n0,1,1\n1,1,2", "row 3: column 'z' is empty"),
    ],
)
def test_faulty_maps_are_named(tmp_path, rows, words):
    path = write(tmp_path, f"x [um],y [um],z [um]\n{rows}\n")
    with pytest.raises(InputError, match=words):
        read_height_map(path)
