"""Depth maps from tables of places."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io import read_depth_map, write_table

X, Y = np.arange(4) * 0.1 + 5.0, np.arange(3) * 2.5 - 1.0
DEPTH = np.arange(12.0).reshape(4, 3)


@pytest.fixture
def written(tmp_path):
    """Write rows (x, y, z); the file."""

    def write(rows):
        path = tmp_path / "map.csv"
        x, y, z = np.transpose(rows)
        write_table(path, {"x [um]": x, "y [um]": y, "z [um]": z})
        return path

    return write


def places():
    x, y = np.meshgrid(X, Y, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), DEPTH.ravel()])


@pytest.mark.parametrize("seed", range(3))
def test_rows_in_any_order(written, seed):
    found = read_depth_map(written(np.random.default_rng(seed).permutation(places())))
    np.testing.assert_allclose(found.x, X, rtol=1e-12)
    np.testing.assert_allclose(found.y, Y, rtol=1e-12)
    np.testing.assert_array_equal(found.depth, DEPTH)


def test_other_units(tmp_path):
    path = tmp_path / "map.csv"
    path.write_text("x [mm];y [mm];z [um]\n0;0;1\n0;1;2\n1;0;3\n1;1;4\n")
    found = read_depth_map(path)
    np.testing.assert_allclose(found.x, [0.0, 1000.0])
    np.testing.assert_array_equal(found.depth, [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: np.delete(rows, 5, axis=0), ["row 6", "4 x 3 places", "1 holes", "5.1, 4"]),
        (lambda rows: rows[[*range(12), 3]], ["rows 5 and 14", "5.1, -1"]),
        (
            lambda rows: rows + (np.arange(12) == 6)[:, None] * [0.03, 0, 0],
            ["row 8", "off the grid"],
        ),
        (lambda rows: rows[:3], ["row 2", "all x are 5 um"]),
        (lambda rows: rows * [1, 1, -1], ["no z is above 0", "downwards"]),
    ],
)
def test_faulty_maps(written, change, words):
    with pytest.raises(InputError) as raised:
        read_depth_map(written(change(places())))
    text = str(raised.value)
    assert "map.csv" in text and "\n" not in text
    assert all(word in text for word in words), text
