"""Reading tables: the forms a file may have, and a sentence for each that it may not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import Column, read_table

XZ = [Column("x", "um"), Column("z", "um")]


@pytest.fixture
def file(tmp_path):
    def write(content, name="scan.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def assert_reads(path, x, z, rows, columns=XZ):
    table = read_table(path, columns)
    np.testing.assert_array_equal(table.values["x"], x)
    np.testing.assert_array_equal(table.values["z"], z)
    np.testing.assert_array_equal(table.rows, rows)
    assert table.path == path
    assert table.values["x"].dtype == np.float64


@pytest.mark.parametrize(
    "header",
    [
        "x [um],z [um]",
        "x (um),z (um)",
        "x_um,z_um",
        "x[um],z(um)",
        "X [um], Z_um",
        '"x [um]","z [um]"',
        "x [\u00b5m],z [\u03bcm]",
        "# x_um,z_um",
        "#x [um],z [um]",
        "# x_um,z_um (unworn rectangle 0..9800 x 0..5000, tip at z=0)",
        "# x_um,z_um (unworn: (0,10000),(0,8465),(4887.5,0))",
        "x [um] measured, z [um] (downwards, from the top)",
        "x_um (left; right), z_um",
        "x [um],z [um],z_min [um]",
        "x [um],z [um],z_min",
        "x_um;z_um",
        "x_um\tz_um",
    ],
)
def test_accepted_headers(file, header):
    separator = ";" if header == "x_um;z_um" else "\t" if "\t" in header else ","
    extra = separator + "9" if "min" in header else ""
    rows = [separator.join(pair) + extra for pair in (["1", "2"], ["3", "4.5"])]
    assert_reads(file("\n".join([header, *rows])), [1, 3], [2, 4.5], [2, 3])


def test_values_come_in_the_wanted_unit(file):
    assert_reads(file("x [mm],z [nm]\n1.5,2500\n2,1000"), [1500, 2000], [2.5, 1], [2, 3])


def test_order_and_extra_columns_do_not_matter(file):
    path = file("point,z [um],remark,x [um]\n1,2,rough,3\n2,4,,5")
    assert_reads(path, [3, 5], [2, 4], [2, 3])


def test_blank_lines_comments_crlf_and_bom(file):
    path = file("\ufeff\r\n# milled today\r\nx [um],z [um]\r\n\r\n1,2\r\n# pause\r\n  \r\n3,4\r\n")
    assert_reads(path, [1, 3], [2, 4], [5, 8])


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas(file, separator):
    path = file(f"x [um]{separator}z [um]\n1,5{separator}-2,25\n3{separator}1,0e-1")
    assert_reads(path, [1.5, 3], [-2.25, 0.1], [2, 3])


def test_quoted_cells_and_trailing_separators(file):
    assert_reads(file('x [um],z [um]\n"1","2",\n3,4,,'), [1, 3], [2, 4], [2, 3])


def test_comment_before_the_header_may_speak_of_columns(file):
    path = file("# x [um], z [um] swapped, as x [mm] was wrong\nz [um],x [um]\n1,2\n3,4")
    assert_reads(path, [2, 4], [1, 3], [3, 4])


def test_header_in_a_comment_below_another_comment(file):
    assert_reads(file("# measured with x [mm] stage\n# x_um,z_um\n1,2\n"), [1], [2], [3])


def test_optional_column(file):
    columns = [*XZ, Column("sigma", "um", required=False, positive=True)]
    assert "sigma" not in read_table(file("x_um,z_um\n1,2"), columns).values
    table = read_table(file("x_um,z_um,sigma_nm\n1,2,500"), columns)
    assert table.values["sigma"] == [0.5]


def test_names_of_several_words(file):
    path = file("Spindle_Speed [1/min]\n6000")
    table = read_table(path, [Column("spindle speed", "1/s")])
    assert table.values["spindle speed"] == pytest.approx(100)


FAULTS = {
    "empty": ("", ["the file is empty", "header, 'x [um], z [um]'"]),
    "blank": ("\n \n", ["the file is empty"]),
    "only comments": ("# nothing yet", ["only comments", "'x [um], z [um]'"]),
    "no rows": ("x_um,z_um\n", ["header in row 1", "add at least one row"]),
    "no rows, comment": ("# x_um,z_um\n#\n", ["header in row 1", "add at least one row"]),
    "no header": ("1,2\n3,4", ["row 1", "starts with numbers", "write 'x [um], z [um]' above"]),
    "no header, comma": ("1,5;2\n", ["row 1", "starts with numbers"]),
    "no header, comment": ("# run 7\n1,2\n", ["row 2", "starts with numbers"]),
    "missing": ("x_um,depth_um\n1,2", ["row 1", "no column 'z'", "'depth_um'", "'z [um]'"]),
    "nearest": (
        "x_um,zz [um],w [um]\n1,2,3",
        ["no column 'z' among 'x_um', 'zz [um]', 'w [um]'", "rename 'zz [um]' to 'z [um]'"],
    ),
    "spaces": ("x_um  z_um\n1  2", ["no column 'z'", "comma, semicolon or tab"]),
    "no unit": ("x,z [um]\n1,2", ["row 1", "column 'x' has no unit: write 'x [um]'"]),
    "no unit, comment": ("# x,z\n1,2", ["row 1", "column 'x' has no unit: write 'x [um]'"]),
    "empty unit": ("x [],z [um]\n1,2", ["column 'x' has no unit: write 'x [um]'"]),
    "loose unit": ("x um,z um\n1,2", ["column 'x' has no unit: write 'x [um]'"]),
    "unknown unit": ("x [um],z [umm]\n1,2", ["row 1", "column 'z'", "'umm'", "write 'um'"]),
    "time": ("x [um],z [s]\n1,2", ["row 1", "column 'z'", "'s' measures time", "in 'um'"]),
    "time, appended": ("x_um,z_s\n1,2", ["row 1", "column 'z'", "'s' measures time"]),
    "duplicate": ("x_um,z_um,Z [mm]\n1,2,3", ["row 1", "column 'z' stands twice", "keep one"]),
    "word": ("x_um,z_um\n1,2\n\n3,deep", ["row 4", "column 'z' holds 'deep'", "not a number"]),
    "marker": ("# x_um,z_um\nn/a,n/a", ["row 2", "column 'x' holds 'n/a'", "not a number"]),
    "underscore": ("x_um,z_um\n1,1_000", ["row 2", "'1_000'", "not a number"]),
    "nan": ("x_um,z_um\n1,2\n3,nan", ["row 3", "column 'z' holds 'nan', not a finite number"]),
    "inf": ("x_um,z_um\n-inf,2", ["row 2", "column 'x' holds '-inf', not a finite number"]),
    "overflow": ("x_mm,z_um\n1e307,2", ["row 2", "column 'x' holds '1e307'", "finite"]),
    "empty cell": ("x_um,z_um\n1,2\n3,\n", ["row 3", "column 'z' is empty", "delete the row"]),
    "too few": ("x_um,z_um\n1,2\n# remark\n3", ["row 4", "1 of the 2 cells", "complete the row"]),
    "too many": ("x_um,z_um\n1,5,2,5", ["row 2", "4 cells", "decimal points", "semicolons"]),
    "too many, header": ("x_um,z_um,\n1,5,2", ["row 2", "3 cells where the header names 2"]),
    "too many, semicolons": ("x_um;z_um\n1;2;5", ["row 2", "3 cells", "delete those"]),
    "one column": ("x_um\n1,5", ["row 1", "no column 'z'"]),
    "marks": ("x_um;z_um\n1.5;2\n3;1,234", ["rows 2 and 3", "decimal", "one of them"]),
    "thousands": ("x_um;z_um\n1;1.234,5", ["row 2", "decimal", "one of them"]),
}


@pytest.mark.parametrize(("content", "parts"), FAULTS.values(), ids=FAULTS.keys())
def test_faulty_tables_are_explained(file, content, parts):
    with pytest.raises(InputError) as raised:
        read_table(file(content), XZ)
    for part in ["scan.csv", *parts]:
        assert part in str(raised.value)


def test_a_decimal_comma_in_a_table_of_one_column_is_not_guessed(file):
    with pytest.raises(InputError, match=r"scan\.csv, row 2: 2 cells where the header names 1"):
        read_table(file("x_um\n1,5"), [Column("x", "um")])


@pytest.mark.parametrize(("value", "sign"), [("-3", "negative"), ("0", "zero")])
def test_positive_columns(file, value, sign):
    path = file(f"area [um^2]\n5\n{value}")
    with pytest.raises(InputError, match=rf"scan\.csv, row 3: {sign} area .*greater than zero"):
        read_table(path, [Column("area", "um^2", positive=True)])


@pytest.mark.parametrize(
    ("content", "row"),
    [("x_um,z_um\n1,2".encode("utf-16"), None), (b"x_um,z_um\n1,2\n3,\xb54", 3), (b"\0\1", None)],
    ids=["utf-16", "latin-1", "binary"],
)
def test_wrong_encodings(file, content, row):
    with pytest.raises(InputError) as raised:
        read_table(file(content), XZ)
    assert "scan.csv" in str(raised.value)
    assert "save it as CSV UTF-8" in str(raised.value)
    assert row is None or f"row {row}" in str(raised.value)


def test_missing_file_with_a_near_name(file):
    with pytest.raises(InputError, match=r"scam\.csv: no such file: did you mean 'scan\.csv'\?"):
        read_table(file("x").with_name("scam.csv"), XZ)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(InputError, match=r"a\.csv: no such file: check the name"):
        read_table(tmp_path / "a.csv", XZ)
    with pytest.raises(InputError, match=r"b\.csv: no such file: folder .* does not exist"):
        read_table(tmp_path / "a" / "b.csv", XZ)


def test_folder_instead_of_file(tmp_path):
    with pytest.raises(InputError, match="this is a folder: give the name of a file in it"):
        read_table(tmp_path, XZ)


@settings(deadline=None)
@given(st.text(alphabet='xz_um[]()#;,\t\n\r 12.5-"sé', max_size=40))
def test_any_text_is_read_or_explained(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(text.encode())
    try:
        table = read_table(path, XZ)
    except InputError as error:
        assert "any.csv" in str(error)
    else:
        assert np.all(np.isfinite(table.values["x"]))
        assert len(table.rows) == len(table.values["z"]) > 0
