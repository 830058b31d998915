"""Moves along lines and arcs in the words of a template, for programs in any plane."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from procmodel.errors import InputError
from procmodel.io.gcode_template import Millimetres
from procmodel.io.polyline import BulgePolyline, arc_middle

# What the program writes, in mm: four decimals.
RESOLUTION = 1e-4

# Below this radius, in mm, rounding could turn an arc around.
LEAST_RADIUS = 3 * RESOLUTION


class Plane(NamedTuple):
    """How a plane's two axes, and its arcs, are called in a template.

    Attributes
    ----------
    axes, centre : tuple of str
        Of an end point; of the way from an arc's start to its centre.
    left, right : str
        The arc of a positive bulge, and of a negative one.
    """

    axes: tuple[str, str]
    centre: tuple[str, str]
    left: str
    right: str


def rounded(polyline: BulgePolyline) -> BulgePolyline:
    """The path with each vertex at a written position, so that no error adds up along it."""
    # One rounding to the nearest decimal fraction, the same as that of the format.
    points = np.array([[float(f"{value:.4f}") for value in point] for point in polyline.points])
    return BulgePolyline(points, polyline.bulges, polyline.closed, polyline.name)


def moves(
    texts: dict[str, str], common: dict[str, object], polyline: BulgePolyline, plane: Plane
) -> str:
    """Moves along a path of lines and arcs of half a circle at most, one a line.

    Parameters
    ----------
    texts : dict of str
        Template, with the keys `line` and the two arcs of the plane.
    common : dict
        What every word of the template may use.
    polyline : BulgePolyline [mm]
        The path, from `rounded`.
    plane : Plane
        How its coordinates are called.

    Returns
    -------
    str
        Moves that rounding makes vanish are left out; an arc that is flat or small to rounding
        becomes a line.

    Raises
    ------
    InputError
        If no move is left.
    """
    text = "\n".join(_moves(texts, common, polyline, plane))
    if not text:
        raise InputError(
            f"{polyline.name}: the path is shorter than the {RESOLUTION:g} mm that the program "
            "writes: delete it"
        )
    return text


def _moves(
    texts: dict[str, str], common: dict[str, object], polyline: BulgePolyline, plane: Plane
) -> Iterator[str]:
    pieces = zip(polyline.starts, polyline.ends, polyline.bulges.tolist(), strict=True)
    for start, end, bulge in pieces:
        chord = float(np.hypot(*(end - start)))
        if chord == 0:
            continue
        values = common | dict(zip(plane.axes, map(Millimetres, end), strict=True))
        sagitta = abs(bulge) * chord / 2
        radius = chord / 4 * (abs(bulge) + 1 / abs(bulge)) if bulge else np.inf
        if sagitta < RESOLUTION / 2 or radius < LEAST_RADIUS:
            yield texts["line"].format_map(values)
        else:
            way = map(Millimetres, _centre(start, end, bulge) - start)
            words = texts[plane.left if bulge > 0 else plane.right]
            yield words.format_map(values | dict(zip(plane.centre, way, strict=True)))


def _centre(start: np.ndarray, end: np.ndarray, bulge: float) -> np.ndarray:
    """Centre of an arc, on the line from the middle of its chord through that of the arc."""
    chord_middle = (start + end) / 2
    # From there the arc's middle lies at the sagitta s, the centre at s - r.
    share = 1 - (1 + bulge**-2) / 2
    return chord_middle + share * (arc_middle(start, end, bulge) - chord_middle)


def as_remark(name: str) -> str:
    """A name in the signs that a remark of a program may hold."""
    return re.sub(r"[^A-Z0-9 ,._+/-]", "_", name.upper())[:60]
