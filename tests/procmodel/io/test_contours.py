"""Contours from drawings, programs and tables."""

import math

import ezdxf
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.io import (
    PathSettings,
    read_contours,
    write_contours_csv,
    write_dxf,
    write_path_program,
)
from tests.procmodel.io.contour_shapes import PLATE, PLATE_AREA, area, polyline, refused, stars


@pytest.fixture
def read(tmp_path):
    def write(text, **arguments):
        path = tmp_path / "wall.csv"
        path.write_text(text)
        return read_contours(path, **arguments)

    return write


@pytest.mark.parametrize("suffix", [".dxf", ".DXF"])
def test_drawings(tmp_path, suffix):
    path = tmp_path / f"wall{suffix}"
    write_dxf(path, [PLATE, polyline([(0, 0), (9, 9)], closed=False)], ["WALL", "Other"])
    (plate,) = read_contours(path, layer="wall", units="mm")
    assert plate.closed and area(plate) == pytest.approx(PLATE_AREA, rel=1e-14)
    assert len(read_contours(path)) == 2


def test_unit_and_tolerance_reach_the_drawing(tmp_path):
    path = tmp_path / "wall.dxf"
    document = ezdxf.new(units=0)
    document.modelspace().add_ellipse((0, 0), (1, 0), 0.5)
    document.saveas(path)
    (coarse,) = read_contours(path, units="inch", tolerance=0.1)
    (fine,) = read_contours(path, units="inch")
    assert len(fine.points) > 2 * len(coarse.points)
    assert area(fine) == pytest.approx(25.4**2 * math.pi / 2, rel=1e-3)


@pytest.mark.parametrize("suffix", [".nc", ".ngc", ".gcode", ".tap", ".cnc", ".iso", ".NC"])
def test_programs(tmp_path, suffix):
    path = tmp_path / f"wall{suffix}"
    write_path_program(path, [PLATE, PLATE], PathSettings(-1.0, 100.0, 50.0, 3000.0))
    contours = read_contours(path)
    assert [area(each) for each in contours] == pytest.approx([PLATE_AREA] * 2, rel=1e-12)
    path.write_text("G0 X0 Y0\nG1 X1")
    assert read_contours(path, units="inch")[0].points[1, 0] == 25.4


def test_other_suffixes_are_refused(tmp_path):
    assert refused(read_contours, tmp_path / "wall.step") == (
        f"{tmp_path / 'wall.step'}: '.step' is no suffix of a drawing, program or table: give "
        "a file that ends in one of .dxf, .nc, .ngc, .gcode, .tap, .cnc, .iso, .csv, .txt"
    )
    assert "'' is no suffix" in refused(read_contours, tmp_path / "wall")


def test_arguments_that_do_not_suit_the_file(tmp_path):
    for name in ("wall.csv", "wall.nc"):
        assert "layer is 'W', but only drawings (.dxf) have layers: leave layer out" in refused(
            read_contours, tmp_path / name, layer="W"
        )
    assert "units is 'mm', but a table states its units in its header: leave units out" in refused(
        read_contours, tmp_path / "wall.txt", units="mm"
    )


def test_table_of_points(read):
    (contour,) = read("x [mm],y [mm]\n0,0\n10,0\n10,5\n")
    assert not contour.closed and contour.name == "wall.csv"
    assert contour.points.tolist() == [[0, 0], [10, 0], [10, 5]]
    assert contour.bulges.tolist() == [0, 0]


def test_table_that_repeats_its_first_point_is_closed(read):
    (contour,) = read("y [um];x [cm]\n0;0\n0;1\n5000;1\n0,002;0\n")
    assert contour.closed and area(contour) == pytest.approx(25)
    (contour,) = read("x [mm],y [mm]\n0,0\n10,0\n10,5\n0,0.0001\n")
    assert not contour.closed


def test_table_with_arcs(read):
    (slot,) = read("x [mm],y [mm],bulge [-]\n-15,-5,0\n15,-5,1\n15,5,0\n-15,5,1\n-15,-5,0\n")
    assert slot.closed and area(slot) == pytest.approx(300 + 25 * math.pi, rel=1e-14)


def test_table_of_several_contours(read):
    contours = read(
        "# walls\nx [mm],y [mm],contour [-],closed [-]\n"
        "0,0,7,1\n1,0,7,1\n1,1,7,1\n\n0,0,2,0\n1,0,2,0\n1,1,2,0\n0,0,2,0\n5,5,3,1\n6,5,3,1\n"
        "6,6,3,1\n5,5,3,1\n"
    )
    assert [each.name for each in contours] == [f"wall.csv, contour {k}" for k in (7, 2, 3)]
    assert [each.closed for each in contours] == [True, False, True]
    assert [len(each.points) for each in contours] == [3, 4, 3]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x [mm],y [mm]\n0,0\n1,0\n1,0\n2,2\n",
         "wall.csv, row 3 and row 4: the points coincide at (1, 0) mm: delete one of the two "
         "points"),
        ("x [mm],y [mm],contour [-],closed [-]\n0,0,1,1\n1,0,1,1\n1,1,1,1\n0,0,2,1\n1,0,2,1\n"
         "1,1,2,1\n1,1,2,1\n",
         "wall.csv, contour 2, row 7 and row 8: the points coincide at (1, 1) mm"),
        ("x [mm],y [mm]\n0,0\n", "wall.csv: a contour of one point has no length: add a point"),
        ("x [mm],y [mm]\n0,0\n1,0\n0,0\n",
         "wall.csv: a closed contour of two points and no arc encloses nothing: delete a line "
         "drawn twice, or add a point"),
        ("x [mm],y [mm],contour [-]\n0,0,1\n1,0,1\n0,0,2\n1,0,2\n0,0,1\n",
         "wall.csv, rows 2 and 6: the rows of contour 1 are not together: put them in one block, "
         "or give the second a number of its own"),
        ("x [mm],y [mm],contour [-]\n0,0,1.5\n1,0,1.5\n",
         "wall.csv, row 2: contour 1.5 is no whole number: count the contours 1, 2, 3"),
        ("x [mm],y [mm],closed [-]\n0,0,1\n1,0,2\n",
         "wall.csv, row 3: closed is 2: write 1 or 0"),
        ("x [mm],y [mm],closed [-]\n0,0,1\n1,0,1\n1,1,0\n",
         "wall.csv, rows 2 and 4: closed is both 1 and 0 in one contour: write the same in all"),
        ("x [mm],y [mm],bulge [-]\n0,0,0\n1,0,0.5\n",
         "wall.csv, row 3: the last point of an open contour has a bulge, but no piece begins "
         "there: write 0, and the bulge at the start of its piece"),
        ("x [mm],y [mm],bulge [-]\n0,0,0\n1,0,0\n1,1,0\n0,0,0.5\n",
         "wall.csv, row 5: the last point of a contour that repeats its first point has a bulge"),
        ("x [mm],y\n0,0\n", "wall.csv, row 1: column 'y' has no unit: write 'y [mm]'"),
        ("x [mm]\n0\n", "wall.csv, row 1: no column 'y' among 'x [mm]'"),
        ("x [mm],y [mm]\n", "wall.csv: there is a header in row 1 but no reading below it"),
        ("", "wall.csv: the file is empty: begin it with a header, 'x [mm], y [mm]'"),
        ("x [mm],y [mm]\n0,nan\n", "wall.csv, row 2: column 'y' holds 'nan', not a finite number"),
    ],
)  # fmt: skip
def test_faulty_tables(read, text, sentence):
    assert sentence in refused(read, text)


@settings(deadline=None)
@given(
    shapes=st.lists(stars(largest_bulge=5.0), min_size=1, max_size=4),
    openings=st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_round_trip(tmp_path_factory, shapes, openings):
    path = tmp_path_factory.getbasetemp() / "round.csv"
    shapes = [
        polyline(each.points, each.bulges[:-1], closed=False) if opened else each
        for each, opened in zip(shapes, openings, strict=False)
    ]
    write_contours_csv(path, shapes)
    found = read_contours(path)
    assert [each.closed for each in found] == [each.closed for each in shapes]
    for each, shape in zip(found, shapes, strict=True):
        # Exactly what nine decimals say.
        np.testing.assert_allclose(each.points, shape.points, rtol=0, atol=0.5001e-9)
        np.testing.assert_allclose(each.bulges, shape.bulges, rtol=0, atol=0.5001e-9)
    write_contours_csv(path, found)
    for each, again in zip(found, read_contours(path), strict=True):
        np.testing.assert_array_equal(again.points, each.points)
        np.testing.assert_array_equal(again.bulges, each.bulges)


@pytest.mark.parametrize("closed", [True, False])
def test_a_short_last_piece_survives(tmp_path, closed):
    path = tmp_path / "short.csv"
    shape = polyline([(0, 0), (100, 0), (100, 50), (0, 2e-6)], closed=closed)
    write_contours_csv(path, [shape])
    (found,) = read_contours(path)
    assert found.closed is closed and len(found.points) == 4


def test_known_table(tmp_path):
    path = tmp_path / "out.csv"
    half = polyline([(0, 0), (2, 0)], [1, 0])
    write_contours_csv(path, [half, polyline([(-1e-12, 1 / 3), (1, 1)], closed=False)])
    assert path.read_text() == (
        "x [mm],y [mm],bulge [-],contour [-],closed [-]\n"
        "0.000000000,0.000000000,1.000000000,1,1\n"
        "2.000000000,0.000000000,0.000000000,1,1\n"
        "0.000000000,0.333333333,0.000000000,2,0\n"
        "1.000000000,1.000000000,0.000000000,2,0\n"
    )


def test_what_cannot_be_written(tmp_path):
    path = tmp_path / "out.csv"
    assert "there is no contour to write: give at least one" in refused(
        write_contours_csv, path, []
    )
    assert "the points coincide" in refused(
        write_contours_csv, path, [polyline([(0, 0), (1, 0), (1, 0)])]
    )
    assert "create it first" in refused(write_contours_csv, tmp_path / "n" / "o.csv", [PLATE])
    assert not path.exists()
