"""Contours for the tests of readers and writers, and measures of them by other formulas."""

import math

import numpy as np
import pytest
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import BulgePolyline


def refused(call, *arguments, **keywords):
    """The one sentence with which a call is refused."""
    with pytest.raises(InputError) as raised:
        call(*arguments, **keywords)
    message = str(raised.value)
    assert "\n" not in message
    return message


def polyline(points, bulges=None, closed=True, name="shape"):
    count = len(points) if closed else len(points) - 1
    return BulgePolyline(
        np.array(points, float), np.zeros(count) if bulges is None else bulges, closed, name
    )


def pieces(shape):
    """Start, end and bulge of each piece."""
    count = len(shape.points)
    for k, bulge in enumerate(shape.bulges):
        yield shape.points[k], shape.points[(k + 1) % count], float(bulge)


def area(shape):
    """Signed area: shoelace formula, and for each arc the segment between it and its chord."""
    total = 0.0
    for (x0, y0), (x1, y1), bulge in pieces(shape):
        total += (x0 * y1 - x1 * y0) / 2
        if bulge:
            sweep = 4 * math.atan(bulge)
            radius = math.hypot(x1 - x0, y1 - y0) / (2 * math.sin(abs(sweep) / 2))
            total += radius**2 / 2 * (sweep - math.sin(sweep))
    return total


def arc(start, end, bulge):
    """Centre, radius, first angle and sweep of an arc, by the chord's perpendicular."""
    sweep = 4 * math.atan(bulge)
    chord = complex(*end) - complex(*start)
    # The chord is the turn of the first spoke by the sweep, less that spoke.
    spoke = chord / (complex(math.cos(sweep), math.sin(sweep)) - 1)
    centre = complex(*start) - spoke
    return (centre.real, centre.imag), abs(spoke), math.atan2(spoke.imag, spoke.real), sweep


def traced(shape, per_piece=16):
    """Points along a contour, as many on each piece."""
    path = []
    for start, end, bulge in pieces(shape):
        share = np.linspace(0, 1, per_piece + 1)
        if abs(bulge) < 1e-9:
            path.append(start + share[:, None] * (end - start))
        else:
            centre, radius, angle, sweep = arc(start, end, bulge)
            angles = angle + share * sweep
            path.append(
                np.array(centre) + radius * np.column_stack([np.cos(angles), np.sin(angles)])
            )
    return np.concatenate(path)


def star(radii, bulges, centre=(0.0, 0.0)):
    """Closed contour with one vertex in each direction, none of them coinciding."""
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    points = np.array(radii)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return polyline(points + np.array(centre), np.array(bulges, float))


@st.composite
def stars(draw, largest_bulge=1.0):
    """Random contours of lines and arcs around the origin, of 3 to 12 pieces."""
    count = draw(st.integers(3, 12))
    bulge = st.one_of(
        st.just(0.0), st.floats(0.01, largest_bulge), st.floats(-largest_bulge, -0.01)
    )
    radii = draw(st.lists(st.floats(1.0, 80.0), min_size=count, max_size=count))
    bulges = draw(st.lists(bulge, min_size=count, max_size=count))
    centre = draw(st.tuples(st.floats(-200, 200), st.floats(-200, 200)))
    return star(radii, bulges, centre)


# A plate of 40 x 20 with one corner rounded by 5.
PLATE = polyline(
    [(0, 0), (40, 0), (40, 15), (35, 20), (0, 20)],
    [0, 0, math.tan(math.pi / 8), 0, 0],
    name="plate",
)
PLATE_AREA = 40 * 20 - 25 * (1 - math.pi / 4)
