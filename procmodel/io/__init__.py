"""Readers and writers at the edge: everything a user gives is checked here, once.

Lengths leave this package in micrometres and areas in square micrometres; those of contours in
millimetres. What is wrong with a file is said in one sentence that names the file, the row and the
remedy, as an `InputError`.
"""

from procmodel.errors import InputError
from procmodel.io.atomic import check_target, write_bytes, write_text, writing
from procmodel.io.contours import read_contours, write_contours_csv
from procmodel.io.dxf import read_dxf, write_dxf
from procmodel.io.forces import ForceReadings, read_coefficients, read_forces
from procmodel.io.gcode import (
    PolylineLayer,
    PolylineScanning,
    ProgramLayer,
    Scanning,
    polyline_program_text,
    program_text,
    write_polyline_program,
    write_program,
)
from procmodel.io.gcode_path import PathSettings, path_program_text, write_path_program
from procmodel.io.gcode_reader import GcodeProgram, read_gcode
from procmodel.io.gcode_template import GcodeTemplate, read_template
from procmodel.io.height_maps import HeightMap, read_height_map
from procmodel.io.plans import WrittenPath, WrittenPlan, read_paths, read_plan
from procmodel.io.polyline import BulgePolyline, join_edges
from procmodel.io.profiles import (
    AreaTable,
    Outline,
    Profile,
    read_area_table,
    read_outline,
    read_profile,
)
from procmodel.io.solid_map import DepthMap, read_depth_map
from procmodel.io.solids import SolidMesh, read_solid
from procmodel.io.tables import Column, Table, read_table
from procmodel.io.units import conversion_factor
from procmodel.io.writers import format_table, write_table

__all__ = [
    "AreaTable",
    "BulgePolyline",
    "Column",
    "DepthMap",
    "ForceReadings",
    "GcodeProgram",
    "GcodeTemplate",
    "HeightMap",
    "InputError",
    "Outline",
    "PathSettings",
    "PolylineLayer",
    "PolylineScanning",
    "Profile",
    "ProgramLayer",
    "Scanning",
    "SolidMesh",
    "Table",
    "WrittenPath",
    "WrittenPlan",
    "check_target",
    "conversion_factor",
    "format_table",
    "join_edges",
    "path_program_text",
    "polyline_program_text",
    "program_text",
    "read_area_table",
    "read_coefficients",
    "read_contours",
    "read_depth_map",
    "read_dxf",
    "read_forces",
    "read_gcode",
    "read_height_map",
    "read_outline",
    "read_paths",
    "read_plan",
    "read_profile",
    "read_solid",
    "read_table",
    "read_template",
    "write_bytes",
    "write_contours_csv",
    "write_dxf",
    "write_path_program",
    "write_polyline_program",
    "write_program",
    "write_table",
    "write_text",
    "writing",
]
