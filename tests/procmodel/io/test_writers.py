"""Tables that are written can be read back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.io import Column, format_table, read_table, write_table


def test_known_text():
    columns = {"layer [-]": [1, 2], "feed [um]": [18.0, 16.48], "depth [um]": [-0.0, -1e-9]}
    assert format_table(columns, decimals=2, comments=["R = 0.2\nfitted", ""]) == (
        "# R = 0.2\n# fitted\nlayer [-],feed [um],depth [um]\n1,18.00,0.00\n2,16.48,0.00\n"
    )


def test_numpy_integers_stay_integers():
    assert format_table({"n [-]": np.arange(2), "m [-]": np.array([True, False])}, 0) == (
        "n [-],m [-]\n0,1\n1,0\n"
    )


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"a [um]": [1.0], "b [um]": [1.0, 2.0]}, "equally long"),
        ({"a [um]": [[1.0]]}, "flat"),
        ({"a, b [um]": [1.0]}, "sign"),
        ({"# a [um]": [1.0]}, "sign"),
        ({"a [um]": [np.nan]}, "not finite"),
    ],
)
def test_tables_that_could_not_be_read_back_are_refused(columns, message):
    with pytest.raises(ValueError, match=message):
        format_table(columns)


numbers = st.floats(-1e9, 1e9)


@settings(deadline=None)
@given(
    rows=st.lists(st.tuples(st.integers(-(10**12), 10**12), numbers, numbers), min_size=1),
    decimals=st.integers(0, 9),
    comments=st.lists(
        st.one_of(
            st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=30),
            st.sampled_from(["x [um], z [um]", "z_um", "#", "1,2,3"]),
        ),
        max_size=3,
    ),
)
def test_round_trip(tmp_path_factory, rows, decimals, comments):
    layer, x, z = (np.array(column) for column in zip(*rows, strict=True))
    path = tmp_path_factory.getbasetemp() / "round.csv"
    write_table(path, {"layer [-]": layer, "x [um]": x, "z [um]": z}, decimals, comments)
    table = read_table(path, [Column("layer", "-"), Column("z", "um"), Column("x", "um")])
    np.testing.assert_array_equal(table.values["layer"], layer)
    # Half a unit of the last decimal, and the spacing of doubles at 1e9.
    tolerance = 0.5 * 10.0**-decimals + 2.4e-7
    np.testing.assert_allclose(table.values["x"], x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(table.values["z"], z, rtol=0, atol=tolerance)
    assert np.all(np.diff(table.rows) == 1)


def test_null_characters_in_comments_are_refused():
    with pytest.raises(ValueError, match="null character"):
        format_table({"x [um]": [1.0]}, comments=["\0"])


def test_empty_columns_leave_the_header():
    assert format_table({"x [um]": []}) == "x [um]\n"
