"""Programs that move a wire along profiles in the plane of X and Z, as generic ISO G-code.

The words come from a template, `profile_iso.toml`, that a user adapts to a control. They are no
maker's dialect: check a program before running it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from procmodel.errors import InputError
from procmodel.io.atomic import check_target, write_text
from procmodel.io.gcode_moves import Plane, as_remark, moves, rounded
from procmodel.io.gcode_template import FeedRate, Millimetres, TemplateKind, read_texts
from procmodel.io.polyline import BulgePolyline, arc_middle, checked

# Positive bulges turn from X to Z, which is clockwise where the plane is that of Z and X.
_PLANE = Plane(("x", "z"), ("i", "k"), "clockwise_arc", "counterclockwise_arc")

_EVERYWHERE = ("pass_count", "shape", "safe_x", "feed")

PROFILES = TemplateKind(
    generic="profile_iso.toml",
    allowed={
        "header": _EVERYWHERE,
        "index": (*_EVERYWHERE, "angle"),
        "pass": (*_EVERYWHERE, "number", "name", "start_x", "start_z", "moves"),
        "line": (*_EVERYWHERE, "x", "z"),
        "clockwise_arc": (*_EVERYWHERE, "x", "z", "i", "k"),
        "counterclockwise_arc": (*_EVERYWHERE, "x", "z", "i", "k"),
        "footer": _EVERYWHERE,
    },
    needed={
        "index": ("angle",),
        "pass": ("start_x", "start_z", "moves"),
        "line": ("x", "z"),
        "clockwise_arc": ("x", "z", "i", "k"),
        "counterclockwise_arc": ("x", "z", "i", "k"),
    },
)


@dataclass(frozen=True)
class ProfileSettings:
    """How the wire moves along its paths.

    Attributes
    ----------
    feed : float, mm/min
        Feed rate along the paths and on the way to them.
    safe_x : float, mm
        X of the moves from path to path, beyond every path.
    angles : tuple of float, deg
        Angles of the spindle at which every path is run; none for a turning spindle.

    Raises
    ------
    InputError
        If a value is out of its range; the text names it.
    """

    feed: float
    safe_x: float
    angles: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        # Less would be written as zero.
        if not 1e-4 <= self.feed < float("inf"):
            raise InputError(f"feed is {self.feed:g}: give a number of at least 0.0001")
        if not abs(self.safe_x) < float("inf"):
            raise InputError(f"safe_x is {self.safe_x:g}: give a number of mm")


def write_profile_program(
    path: str | os.PathLike[str],
    polylines: Sequence[BulgePolyline],
    settings: ProfileSettings,
    template: str | os.PathLike[str] | None = None,
) -> None:
    """Write the program to a file, completely or not at all; see `profile_program_text`.

    Raises
    ------
    InputError
        As `profile_program_text`, or if the file cannot be written.
    """
    check_target(path)
    write_text(path, profile_program_text(polylines, settings, template))


def profile_program_text(
    polylines: Sequence[BulgePolyline],
    settings: ProfileSettings,
    template: str | os.PathLike[str] | None = None,
) -> str:
    """Program that moves the wire along each path in turn, at each angle of the spindle.

    Parameters
    ----------
    polylines : sequence of BulgePolyline [mm]
        Paths of the wire's centre as (x, z), in their order.
    settings : ProfileSettings
        Feed rate, retreat and angles.
    template : path-like, optional
        A changed copy of `profile_iso.toml`; without it, the generic words.

    Returns
    -------
    str
        The program, in absolute millimetres rounded to 0.1 um. Moves that rounding makes vanish
        are left out; an arc that is flat or small to rounding becomes a line.

    Raises
    ------
    InputError
        If there is no path, one is faulty or reaches beyond `safe_x`, or the template is faulty;
        the text names it.
    """
    if not polylines:
        raise InputError("the program has no path: give at least one")
    texts = read_texts(PROFILES, template)
    angles = settings.angles
    common: dict[str, object] = {
        "pass_count": len(polylines),
        "shape": f"{len(angles)} FLATS, SPINDLE INDEXED" if angles else "SPINDLE TURNING",
        "safe_x": Millimetres(settings.safe_x),
        "feed": FeedRate(settings.feed),
    }
    blocks = [texts["header"].format_map(common)]
    for number, polyline in enumerate(polylines, start=1):
        block = _pass(texts, common, number, polyline, settings.safe_x)
        for angle in angles:
            blocks += [texts["index"].format_map(common | {"angle": Millimetres(angle)}), block]
        if not angles:
            blocks.append(block)
    blocks.append(texts["footer"].format_map(common))
    return "\n".join(blocks) + "\n"


def _pass(
    texts: dict[str, str],
    common: dict[str, object],
    number: int,
    polyline: BulgePolyline,
    safe_x: float,
) -> str:
    whole = checked(polyline).with_arcs_halved()
    written = rounded(whole)
    middles = arc_middle(whole.starts, whole.ends, whole.bulges)
    reach = max(float(np.max(written.points[:, 0])), float(np.max(middles[:, 0])))
    if reach > safe_x:
        raise InputError(
            f"{polyline.name}: the path reaches x = {reach:g} mm, beyond the safe_x of "
            f"{safe_x:g} mm: give a larger safe_x"
        )
    start_x, start_z = map(Millimetres, written.points[0])
    return texts["pass"].format_map(
        common
        | {
            "number": number,
            "name": as_remark(polyline.name),
            "start_x": start_x,
            "start_z": start_z,
            "moves": moves(texts, common, written, _PLANE),
        }
    )
