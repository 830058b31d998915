"""Drawings in DXF, read and written."""

import math
import os
import subprocess
import sys

import ezdxf
import numpy as np
import pytest
from ezdxf.enums import InsertUnits
from hypothesis import given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import read_dxf, write_dxf
from procmodel.io.dxf import INSUNITS
from tests.procmodel.io.contour_shapes import (
    PLATE,
    PLATE_AREA,
    arc,
    area,
    pieces,
    polyline,
    refused,
    stars,
    traced,
)

DOWN = {"extrusion": (0, 0, -1)}


@pytest.fixture
def drawing(tmp_path):
    """A drawing that `draw` fills through the modelspace, and that is then read."""

    def write(draw, units=4, version="R2010", **arguments):
        document = ezdxf.new(version, units=units)
        draw(document.modelspace())
        path = tmp_path / "wall.dxf"
        document.saveas(path)
        return read_dxf(path, **arguments)

    return write


def draw_slot(space, shift=(0, 0)):
    """Slot of length 30 and width 10 about the origin, its edges out of order."""
    x, y = shift
    space.add_arc((15 + x, y), 5, 270, 90)
    space.add_line((-15 + x, 5 + y), (15 + x, 5 + y))
    space.add_arc((-15 + x, y), 5, 90, 270)
    space.add_line((-15 + x, -5 + y), (15 + x, -5 + y))


SLOT_AREA = 300 + 25 * math.pi


def test_a_slot_of_lines_and_arcs_out_of_order(drawing):
    (slot,) = drawing(draw_slot)
    assert slot.closed
    assert slot.name == "wall.dxf, layer 0, contour 1"
    assert area(slot) == pytest.approx(SLOT_AREA, rel=1e-13)
    assert sorted(slot.bulges.round(12).tolist()) == [0, 0, 1, 1]


def test_open_chain_keeps_the_direction_of_its_first_edge(drawing):
    def draw(space):
        space.add_line((10, 0), (0, 0))
        space.add_line((10, 0), (10, 10))

    (chain,) = drawing(draw)
    assert not chain.closed
    np.testing.assert_array_equal(chain.points, [(10, 10), (10, 0), (0, 0)])


@pytest.mark.parametrize("attributes", [{}, DOWN])
def test_circle_is_counter_clockwise(drawing, attributes):
    (circle,) = drawing(lambda space: space.add_circle((3, 4), 2, dxfattribs=attributes))
    assert area(circle) == pytest.approx(4 * math.pi, rel=1e-14)
    assert circle.points.mean(axis=0).tolist() == [-3 if attributes else 3, 4]


def test_arc_of_a_full_turn_is_a_circle(drawing):
    (circle,) = drawing(lambda space: space.add_arc((3, 4), 2, 0, 360))
    assert circle.closed and area(circle) == pytest.approx(4 * math.pi, rel=1e-14)


@pytest.mark.parametrize("attributes", [{}, DOWN])
@pytest.mark.parametrize(("first", "last"), [(10, 100), (350, 20), (20, 350), (-30, 200)])
def test_arcs_run_as_ezdxf_places_them(drawing, attributes, first, last):
    placed = []

    def draw(space):
        entity = space.add_arc((30, 10, 7), 4, first, last, dxfattribs=attributes)
        placed.extend([*entity.flattening(1e-3), entity.start_point, entity.end_point])

    (found,) = drawing(draw)
    path = traced(found)
    for point, expected in ((path[0], placed[-2]), (path[-1], placed[-1])):
        assert point.tolist() == pytest.approx([expected.x, expected.y], abs=1e-12)
    sweep = math.radians((last - first) % 360)
    assert found.length == pytest.approx(4 * sweep, rel=1e-12)
    assert np.sign(found.bulges).tolist() == [-1 if attributes else 1] * len(found.bulges)
    # Points of the arc as the library draws it lie on ours, not on the rest of the circle.
    for point in placed[:-2]:
        gaps = np.hypot(*(path - (point.x, point.y)).T)
        assert gaps.min() < 4 * sweep / 16


@pytest.mark.parametrize("old_style", [False, True])
@pytest.mark.parametrize("attributes", [{}, DOWN])
@pytest.mark.parametrize("closed", [False, True])
def test_polylines_with_bulges(drawing, old_style, attributes, closed):
    vertices = [(0, 0, 0), (40, 0, 0), (40, 15, math.tan(math.pi / 8)), (35, 20, 0), (0, 20, 0)]
    vertices = [(x + 100, y, bulge) for x, y, bulge in vertices]

    def draw(space):
        add = space.add_polyline2d if old_style else space.add_lwpolyline
        add(vertices, format="xyb", close=closed, dxfattribs=attributes)

    (found,) = drawing(draw)
    side = -1 if attributes else 1
    assert found.closed is closed
    expected = [(side * x, y) for x, y, _ in vertices]
    np.testing.assert_array_equal(found.points, expected)
    np.testing.assert_array_equal(
        found.bulges, [side * bulge for *_, bulge in vertices][: len(found.bulges)]
    )
    if closed:
        assert area(found) == pytest.approx(side * PLATE_AREA, rel=1e-13)


def test_polyline_along_minus_z_joins_a_line_along_z(drawing):
    def draw(space):
        space.add_lwpolyline([(-10, 0), (-10, 5), (0, 5)], dxfattribs=DOWN)
        space.add_line((0, 5), (10, 0))

    (found,) = drawing(draw)
    assert found.closed and abs(area(found)) == pytest.approx(25)


def test_repeated_last_point_of_a_closed_polyline_is_dropped(drawing):
    square = [(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)]
    (marked,) = drawing(lambda space: space.add_lwpolyline(square, close=True))
    (unmarked,) = drawing(lambda space: space.add_lwpolyline(square, close=False))
    for found in (marked, unmarked):
        assert found.closed and len(found.points) == 4 and area(found) == 100


def test_old_style_polyline_in_space_at_constant_z(drawing):
    points = [(0, 0, 3), (10, 0, 3), (10, 10, 3)]
    (found,) = drawing(lambda space: space.add_polyline3d(points, close=True))
    assert found.closed and area(found) == 50


@pytest.mark.parametrize("tolerance", [0.1, 1e-3])
def test_a_circle_as_spline_lies_within_the_tolerance(drawing, tolerance):
    def draw(space):
        circle = ezdxf.math.ConstructionEllipse.from_arc(center=(5, 5), radius=20)
        space.add_spline().apply_construction_tool(ezdxf.math.BSpline.from_ellipse(circle))

    (found,) = drawing(draw, tolerance=tolerance)
    assert found.closed and not found.bulges.any()
    distances = np.hypot(*(traced(found) - 5).T)
    # The farthest vertices are joined ends that may move by half the tolerance.
    assert np.all(np.abs(distances - 20) < tolerance)
    assert np.abs(distances - 20).max() > tolerance / 50
    assert area(found) == pytest.approx(400 * math.pi, abs=2 * math.pi * 20 * tolerance)


def test_spline_through_points(drawing):
    points = [(0, 0), (10, 5), (20, -5), (30, 0)]
    (found,) = drawing(lambda space: space.add_spline(points))
    assert not found.closed
    for point in points:
        assert np.hypot(*(found.points - point).T).min() < 1e-9


@pytest.mark.parametrize("span", [(0, 2 * math.pi), (0.3, 4.0)])
def test_ellipse_lies_within_the_tolerance(drawing, span):
    (found,) = drawing(lambda space: space.add_ellipse((1, 2), (30, 0), 0.4, *span), tolerance=1e-2)
    assert found.closed is (span[0] == 0)
    x, y = (traced(found) - (1, 2)).T
    # First-order distance from the ellipse.
    level = (x / 30) ** 2 + (y / 12) ** 2 - 1
    slope = np.hypot(2 * x / 900, 2 * y / 144)
    assert np.all(np.abs(level / slope) < 1e-2)
    if found.closed:
        assert area(found) == pytest.approx(30 * 12 * math.pi, rel=1e-3)


# The lengths by the definition of each unit, apart from the table in the code.
@pytest.mark.parametrize(
    ("code", "millimetres"),
    [(1, 25.4), (2, 304.8), (4, 1), (5, 10), (6, 1000), (9, 0.0254), (13, 1e-3), (14, 100)],
)
def test_unit_of_the_drawing(drawing, code, millimetres):
    (circle,) = drawing(
        lambda space: space.add_circle((3, 0), 2 / millimetres), units=code, tolerance=1e-6
    )
    assert area(circle) == pytest.approx(4 * math.pi, rel=1e-12)
    assert circle.points.mean(axis=0)[0] == pytest.approx(3 * millimetres, rel=1e-12)


@pytest.mark.parametrize(("code", "millimetres"), [(1, 25.4), (13, 1e-3)])
def test_the_tolerance_is_in_mm_whatever_the_unit(drawing, code, millimetres):
    def draw(space):
        circle = ezdxf.math.ConstructionEllipse.from_arc(radius=20 / millimetres)
        space.add_spline().apply_construction_tool(ezdxf.math.BSpline.from_ellipse(circle))

    (found,) = drawing(draw, units=code, tolerance=0.01)
    off = np.abs(np.hypot(*traced(found).T) - 20).max()
    # Halving the lines quarters the distance, and half the tolerance is asked of the library.
    assert 0.01 / 10 < off < 0.01


def test_units_agree_with_ezdxf():
    for code, (_, millimetres) in INSUNITS.items():
        # It has no factors of microinch and mil.
        if code not in (8, 9):
            factor = ezdxf.units.conversion_factor(InsertUnits(code), InsertUnits.Millimeters)
            assert factor == pytest.approx(millimetres, rel=1e-6)


def test_units_given_as_argument(tmp_path):
    path = tmp_path / "wall.dxf"
    document = ezdxf.new(units=0)
    document.modelspace().add_circle((0, 0), 1)
    document.saveas(path)
    (circle,) = read_dxf(path, units="inch")
    assert area(circle) == pytest.approx(25.4**2 * math.pi, rel=1e-14)
    assert refused(read_dxf, path) == (
        f"{path}: the drawing does not state its unit ($INSUNITS is 0): "
        'give units="mm" or set the unit in the drawing program'
    )
    document.units = 1
    document.saveas(path)
    assert area(read_dxf(path, units="inch")[0]) == area(circle)
    assert refused(read_dxf, path, units="mm") == (
        f"{path}: the drawing states its unit as inch ($INSUNITS 1), but units is 'mm': "
        "leave units out, or correct the drawing"
    )
    assert "unit 'N' measures" in refused(read_dxf, path, units="N")


OLD_DRAWING = (
    "0 SECTION 2 HEADER 9 $ACADVER 1 AC1009 {header}0 ENDSEC 0 SECTION 2 ENTITIES "
    "0 LINE 8 W 10 0 20 0 11 3 21 4 0 ENDSEC 0 EOF "
)


@pytest.mark.parametrize("form", [OLD_DRAWING, OLD_DRAWING[OLD_DRAWING.index("0 SECTION 2 ENT") :]])
def test_an_old_drawing_states_no_unit(tmp_path, form):
    path = tmp_path / "old.dxf"
    path.write_text(form.format(header="").replace(" ", "\n"))
    (line,) = read_dxf(path, units="mm")
    assert line.points.tolist() == [[0, 0], [3, 4]]
    assert line.name == "old.dxf, layer W, contour 1"
    assert "does not state its unit ($INSUNITS is 0)" in refused(read_dxf, path)


@pytest.mark.parametrize(("code", "millimetres"), [(1, 25.4), (4, 1.0), (5, 10.0)])
def test_an_old_drawing_that_states_its_unit(tmp_path, code, millimetres):
    path = tmp_path / "old.dxf"
    path.write_text(OLD_DRAWING.format(header=f"9 $INSUNITS 70 {code} ").replace(" ", "\n"))
    assert read_dxf(path)[0].length == pytest.approx(5 * millimetres, rel=1e-14)


@pytest.mark.parametrize("code", [3, 18, 99])
def test_unknown_units_are_refused(drawing, code):
    def draw(space):
        space.add_circle((0, 0), 1)
        space.doc.header["$INSUNITS"] = code

    message = refused(drawing, draw)
    assert f"the drawing's unit, $INSUNITS {code}, is unknown or not one of workpieces" in message
    assert "set it to 4 (mm)" in message


def two_layers(space):
    draw_slot(space)
    space.add_circle((100, 0), 1, dxfattribs={"layer": "Wall"})
    space.add_circle((200, 0), 2, dxfattribs={"layer": "Island"})
    for layer in ("Wall", "Island", "Empty"):
        space.doc.layers.add(layer)


def test_layers(drawing):
    (wall,) = drawing(two_layers, layer="WALL")
    assert wall.name == "wall.dxf, layer Wall, contour 1"
    assert area(wall) == pytest.approx(math.pi)
    assert [each.name for each in drawing(two_layers)] == [
        f"wall.dxf, layer {layer}, contour 1" for layer in ("0", "Wall", "Island")
    ]


def test_unknown_and_empty_layers_are_refused(drawing):
    assert "there is no layer 'WALLS': choose one of 0, Defpoints, Empty, Island, Wall" in refused(
        drawing, two_layers, layer="WALLS"
    )
    message = refused(drawing, two_layers, layer="Empty")
    assert "no line, arc, circle, polyline, spline or ellipse on layer 'Empty'" in message


@pytest.mark.parametrize("hide", ["freeze", "off"])
def test_hidden_layers(drawing, hide):
    def draw(space):
        two_layers(space)
        getattr(space.doc.layers.get("Wall"), hide)()
        space.add_line((0, 0), (1, 1), dxfattribs={"invisible": 1})

    assert [each.name for each in drawing(draw)] == [
        f"wall.dxf, layer {layer}, contour 1" for layer in ("0", "Island")
    ]
    assert "layer 'wall' is frozen or off: show it" in refused(drawing, draw, layer="wall")


def test_other_entities_are_passed_over(drawing):
    def texts(space):
        space.add_text("R5")
        space.add_point((1, 1))
        space.add_point((2, 2, 9))
        space.add_hatch().paths.add_polyline_path([(0, 0), (1, 0), (1, 1)])
        space.add_linear_dim(base=(0, 2), p1=(0, 0), p2=(3, 0)).render()

    def draw(space):
        texts(space)
        draw_slot(space)

    assert len(drawing(draw)) == 1
    assert "shown (passed over: 1 DIMENSION, 1 HATCH, 2 POINT, 1 TEXT): draw the contour" in (
        refused(drawing, texts)
    )


def test_kinds_that_nobody_knows_are_passed_over(tmp_path):
    path = tmp_path / "odd.dxf"
    text = OLD_DRAWING.format(header="").replace("0 LINE", "0 MYSTERY 8 W 0 LINE")
    path.write_text(text.replace(" ", "\n"))
    (line,) = read_dxf(path, units="mm")
    assert line.points.tolist() == [[0, 0], [3, 4]]


def test_paper_space_is_not_read(drawing):
    def draw(space):
        space.doc.layout("Layout1").add_circle((0, 0), 1)

    assert "no line, arc, circle" in refused(drawing, draw)


def block_of(space, name, draw):
    draw(space.doc.blocks.new(name))


def test_inserted_blocks_are_placed(drawing):
    def draw(space):
        block_of(space, "SLOT", draw_slot)
        space.add_blockref(
            "SLOT",
            (100, 50),
            dxfattribs={"xscale": 2, "yscale": 2, "zscale": 2, "rotation": 90, "layer": "Wall"},
        )

    (slot,) = drawing(draw, layer="Wall")
    assert slot.closed and area(slot) == pytest.approx(4 * SLOT_AREA, rel=1e-12)
    low, high = traced(slot).min(axis=0), traced(slot).max(axis=0)
    assert [*low, *high] == pytest.approx([90, 10, 110, 90], abs=1e-9)


@pytest.mark.parametrize("scales", [(-1, 1), (1, -1)])
def test_mirrored_blocks(drawing, scales):
    def part(block):
        block.add_lwpolyline([(0, 0), (10, 0, 0, 0, 1), (10, 10), (0, 10)], close=True)

    def draw(space):
        block_of(space, "PART", part)
        space.add_blockref("PART", (0, 0), dxfattribs={"xscale": scales[0], "yscale": scales[1]})

    (found,) = drawing(draw)
    assert abs(area(found)) == pytest.approx(100 + 12.5 * math.pi, rel=1e-12)
    x, y = traced(found).T
    extent = (15, 10)
    for values, scale, size in zip((x, y), scales, extent, strict=True):
        assert sorted([values.min(), values.max()]) == pytest.approx(
            sorted([0, scale * size]), abs=1e-9
        )


def test_unevenly_scaled_arcs_become_lines(drawing):
    def draw(space):
        block_of(space, "DISC", lambda block: block.add_circle((0, 0), 10))
        space.add_blockref("DISC", (0, 0), dxfattribs={"xscale": 2})

    (found,) = drawing(draw)
    assert found.closed and area(found) == pytest.approx(200 * math.pi, rel=1e-4)


def test_rows_of_insertions_and_blocks_in_blocks(drawing):
    def draw(space):
        block_of(space, "HOLE", lambda block: block.add_circle((0, 0), 1))
        block_of(space, "PAIR", lambda block: block.add_blockref("HOLE", (5, 0)))
        space.add_blockref(
            "PAIR",
            (0, 0),
            dxfattribs={"column_count": 3, "column_spacing": 10, "row_count": 2, "row_spacing": 7},
        )

    holes = drawing(draw)
    centres = sorted(tuple(hole.points.mean(axis=0).round(9)) for hole in holes)
    assert centres == [(x, y) for x in (5, 15, 25) for y in (0, 7)]


def test_layers_of_blocks(drawing):
    def part(block):
        block.add_circle((0, 0), 1)
        block.add_circle((0, 0), 2, dxfattribs={"layer": "Inner"})

    def draw(hide):
        def fill(space):
            block_of(space, "PART", part)
            space.doc.layers.add("Outer")
            space.doc.layers.add("Inner")
            space.add_blockref("PART", (0, 0), dxfattribs={"layer": "Outer"})
            space.add_circle((50, 0), 3)
            if hide:
                getattr(space.doc.layers.get("Outer"), hide)()

        return fill

    def radii(hide):
        return [round(math.sqrt(area(each) / math.pi), 9) for each in drawing(draw(hide))]

    assert radii(None) == [1, 2, 3]
    # Off hides what shows on the layer itself, frozen the whole insertion.
    assert radii("off") == [2, 3]
    assert radii("freeze") == [3]


def test_blocks_that_cannot_be_placed(drawing):
    def missing(space):
        space.add_blockref("NOWHERE", (0, 0))

    def circular(space):
        one = space.doc.blocks.new("ONE")
        two = space.doc.blocks.new("TWO")
        one.add_blockref("TWO", (0, 0))
        two.add_blockref("ONE", (0, 0))
        space.add_blockref("ONE", (0, 0))

    assert "block 'NOWHERE' is not in the drawing: delete the insertion" in refused(
        drawing, missing
    )
    assert "inserted in each other more than 16 deep, or in a circle" in refused(drawing, circular)


@pytest.mark.parametrize(
    ("draw", "parts"),
    [
        (
            lambda space: space.add_line((0, 0, 0), (1, 0, 2), dxfattribs={"layer": "W"}),
            ["layer W, LINE ", "z varies from 0 to 2 mm: flatten the drawing to one plane"],
        ),
        (
            lambda space: space.add_circle((0, 0), 1, dxfattribs={"extrusion": (0, 1, 1)}),
            ["layer 0, CIRCLE ", "its plane is inclined (extrusion 0, 1, 1)"],
        ),
        (
            lambda space: space.add_arc((0, 0), 1, 0, 90, dxfattribs={"extrusion": (1, 0, 0)}),
            ["layer 0, ARC ", "its plane is inclined (extrusion 1, 0, 0): flatten"],
        ),
        (
            lambda space: space.add_lwpolyline(
                [(0, 0), (1, 0)], dxfattribs={"extrusion": (0.1, 0, 1)}
            ),
            ["layer 0, LWPOLYLINE ", "its plane is inclined"],
        ),
        (
            lambda space: space.add_spline([(0, 0, 0), (1, 0, 1), (2, 0, 0)]),
            ["layer 0, SPLINE ", "z varies from 0 to "],
        ),
        (
            lambda space: space.add_ellipse((0, 0), (0, 1, 1), 0.5),
            ["layer 0, ELLIPSE ", "z varies from -1 to 1 mm"],
        ),
        (
            lambda space: space.add_polyline3d([(0, 0, 0), (1, 0, 1)]),
            ["layer 0, POLYLINE ", "z varies from 0 to 1 mm"],
        ),
        (
            lambda space: (
                space.add_line((0, 0, 1), (1, 0, 1)),
                space.add_lwpolyline([(1, 0), (2, 0)], dxfattribs={"elevation": 4}),
            ),
            ["LWPOLYLINE ", "it lies at z = 4 mm, what is drawn before it on the layer at 1 mm"],
        ),
        (
            lambda space: space.add_circle((0, 0), 0),
            ["CIRCLE ", "its radius is zero: delete it"],
        ),
        (
            lambda space: space.add_line((3, 4), (3, 4)),
            ["layer 0, LINE ", "the edge at (3, 4) mm is 0 mm long", "delete it"],
        ),
        (
            lambda space: space.add_lwpolyline([(0, 0), (1, 0), (1, 0), (1, 1)]),
            ["wall.dxf, layer 0, contour 1, vertex 2 and vertex 3: the points coincide"],
        ),
        (
            lambda space: [space.add_line((0, 0), (1, k)) for k in range(3)],
            ["3 ends meet at (0, 0) mm", "delete a line drawn twice or the branch"],
        ),
        (
            lambda space: [space.add_line((0, 0), (1, 0)) for _ in range(2)],
            ["a closed contour of two points and no arc encloses nothing", "drawn twice"],
        ),
        (
            lambda space: space.add_polyline2d([]),
            ["wall.dxf, layer 0: the polylines have no points: draw the contour again"],
        ),
        (
            lambda space: space.add_circle((0, 0), math.nan),
            ["CIRCLE ", "not a finite number"],
        ),
    ],
)  # fmt: skip
def test_faulty_drawings(drawing, draw, parts):
    message = refused(drawing, draw)
    for part in ["wall.dxf", *parts]:
        assert part in message


def test_elevation_along_minus_z(drawing):
    def draw(space):
        space.add_line((0, 0, 4), (10, 0, 4))
        space.add_lwpolyline([(0, 0), (0, 5), (-10, 0)], dxfattribs={"elevation": -4, **DOWN})

    (found,) = drawing(draw)
    assert found.closed and abs(area(found)) == 25


def test_files_that_are_no_drawings(tmp_path):
    path = tmp_path / "wall.dxf"
    for content in (b"", b"hello\n", b"\0\1\2" * 50, b"0\nSECTION\n2\nENTITIES\n0\nLINE\n8\n"):
        path.write_bytes(content)
        message = refused(read_dxf, path)
        assert message.startswith(f"{path}: this is not a DXF drawing, or it is damaged (")
        assert message.endswith("): save it anew from the drawing program")
    assert "no such file" in refused(read_dxf, tmp_path / "none.dxf")
    assert "this is a folder" in refused(read_dxf, tmp_path)
    assert "tolerance is 0 mm" in refused(read_dxf, path, tolerance=0)


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_damaged_drawings_are_refused_or_read(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    source, path = folder / "sound.dxf", folder / "damaged.dxf"
    if not source.exists():
        document = ezdxf.new("R2000", units=4)
        draw_slot(document.modelspace())
        document.modelspace().add_spline([(50, 0), (60, 5), (70, 0)])
        document.modelspace().add_lwpolyline([(80, 0), (90, 0, 0, 0, 0.5), (90, 10)], close=True)
        document.saveas(source)
    lines = source.read_text().split("\n")
    first = next(k for k, line in enumerate(lines) if line == "ENTITIES")
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(first, len(lines) - 1))
        action = data.draw(st.sampled_from(["delete", "replace", "end"]))
        if action == "delete":
            del lines[place]
        elif action == "replace":
            lines[place] = data.draw(st.sampled_from(["-1", "1e400", "nan", "x", "0", "", "LINE"]))
        else:
            del lines[place:]
        if first >= len(lines):
            break
    path.write_text("\n".join(lines))
    try:
        contours = read_dxf(path)
    except InputError as error:
        assert "damaged.dxf" in str(error) and "\n" not in str(error)
    else:
        assert contours


@settings(deadline=None, max_examples=40)
@given(
    shapes=st.lists(stars(largest_bulge=1.0), min_size=1, max_size=4),
    closed=st.booleans(),
)
def test_round_trip(tmp_path_factory, shapes, closed):
    path = tmp_path_factory.getbasetemp() / "round.dxf"
    if not closed:
        shapes = [polyline(each.points, each.bulges[:-1], closed=False) for each in shapes]
    write_dxf(path, shapes, [f"L{k}" for k in range(len(shapes))])
    found = read_dxf(path)
    assert [each.name for each in found] == [
        f"round.dxf, layer L{k}, contour 1" for k in range(len(shapes))
    ]
    for each, shape in zip(found, shapes, strict=True):
        assert each.closed is closed
        # The text holds 16 digits.
        np.testing.assert_allclose(each.points, shape.points, rtol=1e-15, atol=0)
        np.testing.assert_allclose(each.bulges, shape.bulges, rtol=1e-15, atol=0)


def test_written_drawing_as_ezdxf_sees_it(tmp_path):
    path = tmp_path / "out.dxf"
    open_line = polyline([(0, 0), (1, 2)], closed=False)
    write_dxf(path, [PLATE, open_line], ["WALL", "PATH 1"])
    document = ezdxf.readfile(path)
    assert document.dxfversion == "AC1024"
    assert document.header["$INSUNITS"] == 4
    assert not document.audit().has_errors
    plate, line = document.modelspace()
    assert [plate.dxf.layer, line.dxf.layer] == ["WALL", "PATH 1"]
    assert [plate.closed, line.closed] == [True, False]
    assert [point[2] for point in plate.get_points("xyb")] == PLATE.bulges.tolist()
    assert "PATH 1" in document.layers


def test_the_same_contours_give_the_same_file(tmp_path):
    first = tmp_path / "first.dxf"
    write_dxf(first, [PLATE])
    before = ezdxf.options.write_fixed_meta_data_for_testing
    program = (
        "import sys; from procmodel.io import read_dxf, write_dxf;"
        "write_dxf(sys.argv[2], read_dxf(sys.argv[1]))"
    )
    for seed in range(4):
        # Sets of strings are run through in another order under each seed.
        again = tmp_path / f"again {seed}.dxf"
        environment = {**os.environ, "PYTHONHASHSEED": str(seed)}
        command = [sys.executable, "-c", program, first, again]
        subprocess.run(command, check=True, env=environment)
        assert again.read_bytes() == first.read_bytes()
    assert before is ezdxf.options.write_fixed_meta_data_for_testing is False


def test_what_cannot_be_written(tmp_path):
    path = tmp_path / "out.dxf"
    assert "there is no contour to write" in refused(write_dxf, path, [])
    assert "1 contours but layers are ['A', 'B']: give one name for each" in refused(
        write_dxf, path, [PLATE], ["A", "B"]
    )
    assert "layers are 'W'" in refused(write_dxf, path, [PLATE], "W")
    for name in ("", "A*B", "A\nB"):
        assert "has a name that drawings do not allow" in refused(write_dxf, path, [PLATE], [name])
    doubled = polyline([(0, 0), (1, 0), (1, 0)])
    assert "the points coincide" in refused(write_dxf, path, [doubled])
    assert "does not exist: create it first" in refused(
        write_dxf, tmp_path / "none" / "out.dxf", [PLATE]
    )
    assert list(tmp_path.iterdir()) == []


def test_bulges_above_one_are_written_and_halved_when_read(tmp_path):
    path = tmp_path / "out.dxf"
    keyhole = polyline([(0, 0), (1, 0)], [-0.1, 3.0])
    write_dxf(path, [keyhole])
    (found,) = read_dxf(path)
    assert len(found.points) == 3
    assert area(found) == pytest.approx(area(keyhole), rel=1e-12)
    radii = [arc(*piece)[1] for piece in pieces(found)]
    assert radii[1] == pytest.approx(radii[2], rel=1e-12)


def test_importing_io_does_not_load_what_only_contours_need():
    program = (
        "import sys; import procmodel.io;"
        "assert not {'ezdxf', 'scipy', 'jax', 'shapely', 'pint'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
