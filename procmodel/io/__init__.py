"""Readers and writers at the edge: everything a user gives is checked here, once.

Lengths leave this package in micrometres and areas in square micrometres. What is wrong with a
file is said in one sentence that names the file, the row and the remedy, as an `InputError`.
"""

from procmodel.errors import InputError
from procmodel.io.atomic import check_target, write_bytes, write_text, writing
from procmodel.io.gcode import ProgramLayer, Scanning, program_text, write_program
from procmodel.io.gcode_template import GcodeTemplate, read_template
from procmodel.io.profiles import (
    AreaTable,
    Outline,
    Profile,
    read_area_table,
    read_outline,
    read_profile,
)
from procmodel.io.tables import Column, Table, read_table
from procmodel.io.units import conversion_factor
from procmodel.io.writers import format_table, write_table

__all__ = [
    "AreaTable",
    "Column",
    "GcodeTemplate",
    "InputError",
    "Outline",
    "Profile",
    "ProgramLayer",
    "Scanning",
    "Table",
    "check_target",
    "conversion_factor",
    "format_table",
    "program_text",
    "read_area_table",
    "read_outline",
    "read_profile",
    "read_table",
    "read_template",
    "write_bytes",
    "write_program",
    "write_table",
    "write_text",
    "writing",
]
