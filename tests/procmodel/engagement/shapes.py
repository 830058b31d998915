"""Contours for the tests of engagement, and polygons of them by other formulas than the package's.

Arcs are sampled from centre and radius; what lies within a distance of a contour is put together
from capsules, sectors of rings and discs, one piece after the other. shapely's buffer() of a finely
sampled ring would not do: it simplifies its input by up to 1 % of the distance.
"""

import math
from typing import NamedTuple

import numpy as np
import shapely
from hypothesis import assume
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from procmodel.engagement.contour import contour, from_segments
from procmodel.engagement.segments import Segments, advance, lengths

QUAD_SEGS = 256
FINEST = 0.5 * math.pi / QUAD_SEGS
QUARTER = math.tan(math.pi / 8)  # the bulge of a quarter circle


def circle(radius, centre=(0.0, 0.0), turn=1.0):
    x, y = centre
    return contour([[x + radius, y], [x - radius, y]], [turn, turn], name="circle")


def along(path, way):
    """Points and directions at arc lengths of a path."""
    pieces = path.segments.on_host()
    begin = np.concatenate([[0.0], np.cumsum(lengths(pieces, np))])
    owner = np.clip(np.searchsorted(begin, way, side="right") - 1, 0, len(pieces) - 1)
    c = pieces[owner]
    return advance(c.start, c.direction, c.curvature, way - begin[owner], np)


def polygonal(points, name="polygon"):
    return contour(points, name=name)


def box(width, height, centre=(0.0, 0.0)):
    a, b = 0.5 * width, 0.5 * height
    return polygonal(np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) + np.asarray(centre), "box")


def rounded_rectangle(width, height, corner):
    """Counter-clockwise, from the left end of the lower side."""
    a, b = 0.5 * width, 0.5 * height
    c, d = a - corner, b - corner
    points = [[-c, -b], [c, -b], [a, -d], [a, d], [c, b], [-c, b], [-a, d], [-a, -d]]
    return contour(points, [0.0, QUARTER] * 4, name="rounded rectangle")


def d_shape(radius):
    """Half disc above the x axis."""
    return contour([[-radius, 0.0], [radius, 0.0]], [0.0, 1.0], name="D")


def dumbbell(half, neck, length, side):
    """Two square chambers of a side, joined by a neck of a length and a half-width `half`."""
    inner, outer = 0.5 * length, 0.5 * length + side
    assert neck == 2.0 * half
    points = [
        [-outer, -0.5 * side], [-inner, -0.5 * side], [-inner, -half], [inner, -half],
        [inner, -0.5 * side], [outer, -0.5 * side], [outer, 0.5 * side], [inner, 0.5 * side],
        [inner, half], [-inner, half], [-inner, 0.5 * side], [-outer, 0.5 * side],
    ]  # fmt: skip
    return polygonal(points, "dumbbell")


def open_path(*pieces, start=(0.0, 0.0), heading=0.0):
    """Smooth open path of pieces (length, curvature)."""
    point, rows = np.array(start, float), []
    for length, kappa in pieces:
        tangent = np.array([math.cos(heading), math.sin(heading)])
        if kappa == 0.0:
            after = point + length * tangent
        else:
            normal = np.array([-tangent[1], tangent[0]])
            sweep = kappa * length
            after = point + (math.sin(sweep) * tangent + (1 - math.cos(sweep)) * normal) / kappa
        rows.append((point, after, tangent, kappa))
        point, heading = after, heading + kappa * length
    start, end, direction, curvature = (np.array(column) for column in zip(*rows, strict=True))
    return from_segments(Segments(start, end, direction, curvature), False, "path")


class Piece(NamedTuple):
    start: np.ndarray
    end: np.ndarray
    bulge: float

    @property
    def arc(self):
        """Centre, radius, angle at the start, sweep: by half the chord and the sagitta."""
        chord = self.end - self.start
        half = 0.5 * math.hypot(*chord)
        apothem = half * (1.0 - self.bulge**2) / (2.0 * self.bulge)
        normal = np.array([-chord[1], chord[0]]) / (2.0 * half)
        centre = 0.5 * (self.start + self.end) + apothem * normal
        arm = self.start - centre
        return centre, math.hypot(*arm), math.atan2(arm[1], arm[0]), 4.0 * math.atan(self.bulge)

    @property
    def straight(self):
        # Flatter than this, the rise is below 1e-10 of the chord.
        return abs(self.bulge) < 1e-10


def pieces(path):
    points, count = np.asarray(path.points), len(path.bulges)
    return [
        Piece(points[i], points[(i + 1) % len(points)], float(path.bulges[i])) for i in range(count)
    ]


def around(centre, radius, begin, sweep, least=8):
    """Points of an arc, both ends among them."""
    count = max(least, math.ceil(abs(sweep) / FINEST))
    angle = begin + sweep * np.linspace(0.0, 1.0, count + 1)
    return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def sampled(path):
    """Points on a contour; of an arc, every 90 degrees / QUAD_SEGS or closer."""
    rows = [p.start[None] if p.straight else around(*p.arc)[:-1] for p in pieces(path)]
    return np.concatenate(rows if path.closed else [*rows, np.asarray(path.points)[-1:]])


def sagitta(path, distance=0.0):
    """How far chords stay from arcs at most, in polygons of all here, at up to a distance."""
    off = [distance * (1.0 - math.cos(0.5 * FINEST))]
    for p in pieces(path):
        if not p.straight:
            _, radius, _, sweep = p.arc
            step = min(FINEST, abs(sweep) / 8)
            off.append((radius + distance) * (1.0 - math.cos(0.5 * step)))
    return max(off)


def region(contours):
    """Polygon of what lies to the left of closed contours."""
    whole = Polygon()
    for c in contours:
        whole = whole.symmetric_difference(shapely.make_valid(Polygon(sampled(c))))
    return whole


def stroke(contours, distance):
    """All that is within a distance of contours."""
    parts = []
    for c in contours:
        parts += [Point(p).buffer(distance, quad_segs=QUAD_SEGS) for p in np.asarray(c.points)]
        for p in pieces(c):
            if p.straight:
                parts.append(
                    LineString([p.start, p.end]).buffer(distance, quad_segs=4, cap_style="flat")
                )
                continue
            centre, radius, begin, sweep = p.arc
            outer = around(centre, radius + distance, begin, sweep)
            inner = around(centre, max(radius - distance, 0.0), begin, sweep)
            parts.append(Polygon(np.concatenate([outer, inner[::-1]])).buffer(0))
    return shapely.union_all(parts)


def eroded(contours, distance):
    """What of the region is at least a distance from its boundary."""
    return region(contours).difference(stroke(contours, distance))


def dilated(contours, distance):
    return region(contours).union(stroke(contours, distance))


@st.composite
def stars(draw, size=10.0, corners=(3, 9), bend=0.6, islands=True):
    """A pocket with arcs and sharp corners, and at times an island in it."""
    count = draw(st.integers(*corners))
    share = st.floats(0.0, 1.0)
    angle = 2.0 * np.pi * (np.arange(count) + 0.6 * np.array([draw(share) for _ in range(count)]))
    angle /= count
    radius = size * (0.45 + 0.55 * np.array([draw(share) for _ in range(count)]))
    straight = st.just(0.0)
    bulge = [draw(straight | st.floats(-bend, bend)) for _ in range(count)]
    bulge = [b if abs(b) > 1e-3 else 0.0 for b in bulge]
    wall = contour(
        radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]), bulge, name="star"
    )
    outline = Polygon(sampled(wall))
    assume(outline.is_valid and wall.area > 0.2 * size**2)
    if not islands or not draw(st.booleans()):
        return [wall]
    where = size * np.array([draw(st.floats(-0.3, 0.3)), draw(st.floats(-0.3, 0.3))])
    small = size * draw(st.floats(0.05, 0.2))
    kind = draw(st.sampled_from(["circle", "triangle", "lens"]))
    if kind == "circle":
        island = circle(small, where, -1.0)
    elif kind == "triangle":
        corner = -2.0 * np.pi * np.arange(3) / 3
        island = polygonal(where + small * np.column_stack([np.cos(corner), np.sin(corner)]))
    else:
        island = contour(where + small * np.array([[1.0, 0.0], [-1.0, 0.0]]), [-0.4, -0.7])
    assume(outline.contains(Polygon(sampled(island)).buffer(0.01 * size)))
    return [wall, island]


def total_length(contours):
    return sum(float(np.sum(lengths(c.segments.on_host(), np))) for c in contours)
