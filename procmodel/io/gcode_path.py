"""Programs that move the tool centre along given paths, as generic ISO G-code.

The words come from a template, `path_iso.toml`, that a user adapts to a control. They are no
maker's dialect: check a program before running it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from procmodel.errors import InputError
from procmodel.io.atomic import check_target, write_text
from procmodel.io.gcode_moves import RESOLUTION, Plane, as_remark, moves, rounded
from procmodel.io.gcode_template import FeedRate, Millimetres, TemplateKind, read_texts
from procmodel.io.polyline import BulgePolyline, checked

_PLANE = Plane(("x", "y"), ("i", "j"), "counterclockwise_arc", "clockwise_arc")

_EVERYWHERE = ("pass_count", "z", "safe_z", "feed", "plunge_feed", "spindle_speed")

PATHS = TemplateKind(
    generic="path_iso.toml",
    allowed={
        "header": _EVERYWHERE,
        "pass": (*_EVERYWHERE, "number", "name", "start_x", "start_y", "moves"),
        "line": (*_EVERYWHERE, "x", "y"),
        "clockwise_arc": (*_EVERYWHERE, "x", "y", "i", "j"),
        "counterclockwise_arc": (*_EVERYWHERE, "x", "y", "i", "j"),
        "footer": _EVERYWHERE,
    },
    needed={
        "pass": ("z", "start_x", "start_y", "moves"),
        "line": ("x", "y"),
        "clockwise_arc": ("x", "y", "i", "j"),
        "counterclockwise_arc": ("x", "y", "i", "j"),
    },
)


@dataclass(frozen=True)
class PathSettings:
    """How the tool moves along its paths.

    Attributes
    ----------
    z : float, mm
        Axial depth: Z of the tool's tip while it cuts, below `safe_height`.
    feed : float, mm/min
        Feed rate of the tool centre along the paths.
    plunge_feed : float, mm/min
        Feed rate in Z.
    spindle_speed : float, 1/min
        Speed of the spindle.
    safe_height : float, mm
        Z of the moves from path to path.

    Raises
    ------
    InputError
        If a value is out of its range; the text names it.
    """

    z: float
    feed: float
    plunge_feed: float
    spindle_speed: float
    safe_height: float = 5.0

    def __post_init__(self) -> None:
        for name in ("feed", "plunge_feed", "spindle_speed"):
            value = getattr(self, name)
            # Less would be written as zero.
            if not 1e-4 <= value < float("inf"):
                raise InputError(f"{name} is {value:g}: give a number of at least 0.0001")
        for name in ("z", "safe_height"):
            if not abs(getattr(self, name)) < float("inf"):
                raise InputError(f"{name} is {getattr(self, name):g}: give a number of mm")
        if not self.z <= self.safe_height - RESOLUTION:
            raise InputError(
                f"z is {self.z:g} mm, not below the safe_height of {self.safe_height:g} mm: "
                "give a smaller z or a larger safe_height"
            )


def write_path_program(
    path: str | os.PathLike[str],
    polylines: Sequence[BulgePolyline],
    settings: PathSettings,
    template: str | os.PathLike[str] | None = None,
) -> None:
    """Write the program to a file, completely or not at all; see `path_program_text`.

    Raises
    ------
    InputError
        As `path_program_text`, or if the file cannot be written.
    """
    check_target(path)
    write_text(path, path_program_text(polylines, settings, template))


def path_program_text(
    polylines: Sequence[BulgePolyline],
    settings: PathSettings,
    template: str | os.PathLike[str] | None = None,
) -> str:
    """Program that moves the tool centre along each path in turn.

    Parameters
    ----------
    polylines : sequence of BulgePolyline [mm]
        Paths of the tool centre, in their order; each is run from its first point on, a closed
        one back to it.
    settings : PathSettings
        Depth, feed rates and speed.
    template : path-like, optional
        A changed copy of `path_iso.toml`; without it, the generic words.

    Returns
    -------
    str
        The program, in absolute millimetres rounded to 0.1 um. Moves that rounding makes vanish
        are left out; an arc that is flat or small to rounding (radius below 0.3 um) becomes a
        line, and one of more than half a circle two arcs.

    Raises
    ------
    InputError
        If there is no path, one is faulty (`procmodel.io.polyline.checked`) or shorter than the
        resolution, or the template is faulty (`procmodel.io.read_template`); the text names it.
    """
    if not polylines:
        raise InputError("the program has no path: give at least one")
    texts = read_texts(PATHS, template)
    common: dict[str, object] = {
        "pass_count": len(polylines),
        "z": Millimetres(settings.z),
        "safe_z": Millimetres(settings.safe_height),
        "feed": FeedRate(settings.feed),
        "plunge_feed": FeedRate(settings.plunge_feed),
        "spindle_speed": FeedRate(settings.spindle_speed),
    }
    blocks = [texts["header"].format_map(common)]
    for number, polyline in enumerate(polylines, start=1):
        written = rounded(checked(polyline).with_arcs_halved())
        start_x, start_y = map(Millimetres, written.points[0])
        values = common | {
            "number": number,
            "name": as_remark(polyline.name),
            "start_x": start_x,
            "start_y": start_y,
            "moves": moves(texts, common, written, _PLANE),
        }
        blocks.append(texts["pass"].format_map(values))
    blocks.append(texts["footer"].format_map(common))
    return "\n".join(blocks) + "\n"
