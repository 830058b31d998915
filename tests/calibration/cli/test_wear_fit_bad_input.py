"""Each fault: one line on stderr naming file, place and remedy; exit code 2; nothing written."""

import numpy as np
import pytest

from .conftest import CAVITY, wall


def table(header, rows):
    return "\n".join([header, *(",".join(f"{v:.6f}" for v in row) for row in rows)]) + "\n"


def good_rows():
    return np.column_stack(wall()).tolist()


def with_cell(row, column, text):
    lines = table("x [um],z [um]", good_rows()).splitlines()
    cells = lines[row - 1].split(",")
    cells[column] = text
    lines[row - 1] = ",".join(cells)
    return "\n".join(lines)


def swapped():
    rows = good_rows()
    rows[4], rows[5] = rows[5], rows[4]
    return table("x [um],z [um]", rows)


def doubled():
    rows = good_rows()
    rows[6][0] = rows[5][0]
    return table("x [um],z [um]", rows)


FAULTS = {
    "missing unit": (table("x,z", good_rows()), ("'x'", "x [um]")),
    "wrong unit": (table("x [s],z [um]", good_rows()), ("'x'", "s")),
    "NaN": (with_cell(9, 1, "nan"), ("row 9",)),
    "empty cell": (with_cell(9, 1, ""), ("row 9",)),
    "not a number": (with_cell(9, 1, "12,5x"), ("row 9",)),
    "unsorted x": (swapped(), ("row 7", "sort")),
    "duplicate x": (doubled(), ("row",)),
    "fewer points than parameters": (table("x [um],z [um]", good_rows()[:1]), ("1",)),
    "too deep": (table("x [um],z [um]", [[x, 9 * z] for x, z in good_rows()]), ("deep", "feed")),
    "empty file": ("", ("empty",)),
    "header alone": ("x [um],z [um]\n", ("row",)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_profile(fault, tmp_path, run):
    text, words = FAULTS[fault]
    path = tmp_path / "faulty.csv"
    path.write_text(text)
    expect_refusal(run, tmp_path, path, words)


def test_wrong_encoding(tmp_path, run):
    path = tmp_path / "faulty.csv"
    path.write_bytes(table("x [um],z [um]", good_rows()).encode("utf-16"))
    expect_refusal(run, tmp_path, path, ("UTF-8",))


def test_folder_instead_of_file(tmp_path, run):
    path = tmp_path / "faulty.csv"
    path.mkdir()
    expect_refusal(run, tmp_path, path, ("folder", "directory"), any_word=True)


def test_missing_file(tmp_path, run):
    expect_refusal(run, tmp_path, tmp_path / "faulty.csv", ("exist", "no such", "not"), True)


def expect_refusal(run, folder, path, words, any_word=False):
    before = sorted(folder.iterdir())
    picture, result = folder / "fit.png", folder / "fit.json"
    code, out, err = run("wear", "fit", path, *CAVITY, "--json", "--plot", picture, "--out", result)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert "faulty.csv" in err
    found = [word in err for word in words]
    assert any(found) if any_word else all(found), err
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--feed", "0.05"], ("--feed", "resolution")),
        (["--feed", "-2"], ("--feed",)),
        (["--step", "0"], ("step",)),
        (["--step", "300"], ("step",)),
        (["--half-width", "nan"], ("half width",)),
        (["--section", "triangle"], ("triangle", "square")),
        (["--electrode-area", "7000"], ("--electrode-diameter", "--electrode-area")),
        (["--layers", "500"], ("layers",)),
        (["--reach", "both"], ("--reach",)),
        (["--noise", "0"], ("--noise",)),
        (["--solver", "box"], ("box_lm",)),
        (["--plot", "fit.docx"], (".png",)),
        (["--no-such"], ("--no-such",)),
        (["--gap", "-3"], ("gap",)),
    ],
)
def test_faulty_option(change, words, profile, tmp_path, run):
    before = sorted(tmp_path.iterdir())
    code, out, err = run("wear", "fit", profile, *CAVITY, *change, "--json")
    assert code == 2, (out, err)
    assert out == ""
    assert err.count("\n") == 1
    assert all(word in err for word in words), err
    assert sorted(tmp_path.iterdir()) == before


def test_output_in_a_missing_folder_is_refused(profile, tmp_path, run):
    target = tmp_path / "nowhere" / "fit.json"
    code, out, err = run("wear", "fit", profile, *CAVITY, "--json", "--out", target)
    assert (code, out) == (2, "")
    assert "nowhere" in err
