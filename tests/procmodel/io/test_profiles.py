"""Profiles, outlines and tables of areas."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io import read_area_table, read_outline, read_profile
from tests.measured import OUTLINES, needs


@pytest.fixture
def file(tmp_path):
    def write(*lines):
        path = tmp_path / "scan.csv"
        path.write_text("\n".join(lines))
        return path

    return write


def test_profile(file):
    path = file("x [mm],z [um],sigma [nm]", "0,1,500", "0.5,2,600", "1,4,700")
    profile = read_profile(path)
    np.testing.assert_array_equal(profile.x, [0, 500, 1000])
    np.testing.assert_array_equal(profile.z, [1, 2, 4])
    np.testing.assert_allclose(profile.sigma, [0.5, 0.6, 0.7], rtol=1e-15)
    np.testing.assert_array_equal(profile.rows, [2, 3, 4])
    assert profile.path == path


def test_decreasing_profile_is_turned_round(file):
    profile = read_profile(file("x_um,z_um", "9,1", "5,2", "1,3"))
    np.testing.assert_array_equal(profile.x, [1, 5, 9])
    np.testing.assert_array_equal(profile.z, [3, 2, 1])
    np.testing.assert_array_equal(profile.rows, [4, 3, 2])
    assert profile.sigma is None


@pytest.mark.parametrize(
    ("lines", "parts"),
    [
        (["0,0", "2,0", "", "1,0", "5,0"], ["row 5", "turns back from 2 to 1", "sort the rows"]),
        (["9,0", "5,0", "6,0", "1,0"], ["row 4", "turns back from 5 to 6", "sort the rows"]),
        (["0,0", "1,0", "1,3", "2,0"], ["rows 3 and 4", "x is 1 um in both", "keep one"]),
        (["0,0", "1,0", "2,0", "1,0"], ["rows 3 and 5", "x is 1 um in both"]),
        (["0,0", "1,0"], ["row 3", "after 2 readings", "at least 3"]),
        (["0,0"], ["row 2", "after 1 reading:", "at least 3"]),
    ],
)
def test_faulty_profiles(file, lines, parts):
    with pytest.raises(InputError) as raised:
        read_profile(file("x_um,z_um", *lines))
    for part in ["scan.csv", *parts]:
        assert part in str(raised.value)


@pytest.mark.parametrize(("sigma", "word"), [("0", "zero"), ("-1", "negative")])
def test_sigma_must_be_positive(file, sigma, word):
    path = file("x_um,z_um,sigma_um", "0,0,1", f"1,0,{sigma}", "2,0,1")
    with pytest.raises(InputError, match=rf"scan\.csv, row 3: {word} sigma .* greater than zero"):
        read_profile(path)


def test_outline_keeps_its_order(file):
    outline = read_outline(file("y_um,x_um", "0,5", "1,3", "0,5", "2,4"))
    np.testing.assert_array_equal(outline.points, [[5, 0], [3, 1], [5, 0], [4, 2]])
    np.testing.assert_array_equal(outline.rows, [2, 3, 4, 5])


def test_short_outline(file):
    with pytest.raises(InputError, match=r"scan\.csv, row 3: .* an outline needs at least 3"):
        read_outline(file("x_um,y_um", "0,5", "1,3"))


def test_area_table(file):
    table = read_area_table(file("z [um],area [mm^2]", "0,0.25", "10,0"))
    np.testing.assert_array_equal(table.z, [0, 10])
    np.testing.assert_array_equal(table.area, [250000, 0])
    np.testing.assert_array_equal(table.rows, [2, 3])


@pytest.mark.parametrize(
    ("lines", "parts"),
    [
        (["0,9", "5,-4"], ["row 3", "negative area (-4 um^2)", "zero or more"]),
        (["-1,9", "5,4"], ["row 2", "z starts at -1 um", "downwards from 0"]),
        (["0,9", "5,4", "5,3"], ["row 4", "z is 5 um after 5 um in row 3", "sort the rows"]),
        (["0,9"], ["row 2", "a table of areas needs at least 2"]),
    ],
)
def test_faulty_area_tables(file, lines, parts):
    with pytest.raises(InputError) as raised:
        read_area_table(file("z_um,area_um2", *lines))
    for part in ["scan.csv", *parts]:
        assert part in str(raised.value)


@needs(OUTLINES)
@pytest.mark.parametrize(
    ("name", "count", "first", "last"),
    [
        ("flat1_tool_um.csv", 18, (0, 5000), (9800, 5000)),
        ("flat1_work_um.csv", 40, (699, 350), (10670, 350)),
        ("tip1_tool_um.csv", 32, (0, 10000), (9775, 10000)),
        ("tip1_work_um.csv", 32, (725, -25), (10605, -8)),
    ],
)
def test_measured_outlines(name, count, first, last):
    outline = read_outline(OUTLINES / name)
    assert outline.points.shape == (count, 2)
    assert tuple(outline.points[0]) == first
    assert tuple(outline.points[-1]) == last
    np.testing.assert_array_equal(outline.rows, np.arange(2, count + 2))
