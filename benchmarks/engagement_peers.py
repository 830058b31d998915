"""What a user would write instead: the finite-difference Newton, with shapely and with NumPy."""

import math

import numpy as np
import shapely
from shapely import LineString, Polygon
from shapely.geometry import box

from procmodel.engagement import Contour

QUAD_SEGS = 128
# Of the finite difference [mm].
STEP = 1e-5


def stock_polygon(path: Contour, radius: float) -> Polygon:
    """Stock around what a tool cleared that went along a closed path, as polygons."""
    bend = float(np.max(np.abs(np.asarray(path.segments.curvature))))
    rise = (1.0 - math.cos(math.pi / (4 * QUAD_SEGS))) / bend
    points = path.flattened(rise)
    cleared = Polygon(points).buffer(radius, quad_segs=QUAD_SEGS)
    stock = box(*points.min(axis=0) - 3 * radius, *points.max(axis=0) + 3 * radius)
    return stock.difference(cleared)


_PHI = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * QUAD_SEGS + 1)
_COS, _SIN = np.cos(_PHI), np.sin(_PHI)


def angle_by_shapely(
    stock: Polygon, centre: np.ndarray, direction: np.ndarray, radius: float
) -> float:
    """Engaged part of the leading half circle: its length in the stock over the radius."""
    side = np.array([-direction[1], direction[0]])
    rim = LineString(centre + radius * (_COS[:, None] * direction + _SIN[:, None] * side))
    return rim.intersection(stock).length / radius


def angles_by_shapely(
    stock: Polygon, centres: np.ndarray, directions: np.ndarray, radius: float
) -> np.ndarray:
    """The same for all places in one call of shapely."""
    side = np.column_stack([-directions[:, 1], directions[:, 0]])
    arm = _COS[:, None] * directions[:, None] + _SIN[:, None] * side[:, None]
    rims = shapely.linestrings(centres[:, None] + radius * arm)
    return shapely.length(shapely.intersection(rims, stock)) / radius


def newton_by_shapely(
    stock: Polygon,
    centres: np.ndarray,
    directions: np.ndarray,
    target: float,
    radius: float,
    most: int,
    tolerance: float,
) -> np.ndarray:
    """Distance that every place is moved to the right, one place after the other."""
    moved = np.zeros(len(centres))
    for i, (centre, direction) in enumerate(zip(centres, directions, strict=True)):
        normal = np.array([direction[1], -direction[0]])
        x = 0.0
        for _ in range(most):
            here = angle_by_shapely(stock, centre + x * normal, direction, radius)
            if abs(here - target) < tolerance:
                break
            there = angle_by_shapely(stock, centre + (x + STEP) * normal, direction, radius)
            x += (target - here) * STEP / (there - here)
        moved[i] = x
    return moved


class NumpySurface:
    """Lines and arcs of a closed surface as arrays, for all places at once.

    The crossing nearest to the wall is the one farthest to the side of the wall: one arc cosine
    for each place. An arc of a half circle at most is told from its circle by the chord.
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, bulge: np.ndarray):
        straight = np.abs(bulge) < 1e-12
        self.line = start[straight]
        step = (end - start)[straight]
        self.line_length = np.hypot(*step.T)
        self.along = step / self.line_length[:, None]
        self.start, end, bulge = start[~straight], end[~straight], bulge[~straight]
        self.chord = end - self.start
        across = np.column_stack([-self.chord[:, 1], self.chord[:, 0]])
        middle = 0.5 * (self.start + end)
        self.centre = middle + across * ((1 - bulge**2) / (4 * bulge))[:, None]
        self.squared = np.sum((self.start - self.centre) ** 2, axis=1)
        self.turn = np.sign(bulge)

    def angle(self, centres: np.ndarray, directions: np.ndarray, radius: float) -> np.ndarray:
        """Engagement angle: from the wall to the nearest crossing on the leading half; 0 in air."""
        x, y = centres[:, :1], centres[:, 1:]
        tx, ty = directions[:, :1], directions[:, 1:]
        farthest = np.full(len(centres), -np.inf)
        for rx, ry, real in (*self._on_lines(x, y, radius), *self._on_arcs(x, y, radius)):
            leads = real & (rx * tx + ry * ty >= 0)
            side = np.where(leads, rx * ty - ry * tx, -np.inf)
            np.maximum(farthest, side.max(axis=1, initial=-np.inf), out=farthest)
        return np.where(farthest >= -radius, np.arccos(np.clip(farthest / radius, -1, 1)), 0.0)

    def _on_lines(self, x: np.ndarray, y: np.ndarray, r: float) -> list[tuple]:
        qx, qy = x - self.line[:, 0], y - self.line[:, 1]
        dx, dy = self.along.T
        ahead, across = qx * dx + qy * dy, qx * dy - qy * dx
        square = r * r - across**2
        meets, half = square > 0, np.sqrt(np.maximum(square, 0))
        return [
            (s * dx - across * dy, s * dy + across * dx,
             meets & (ahead + s >= 0) & (ahead + s <= self.line_length))
            for s in (half, -half)
        ]  # fmt: skip

    def _on_arcs(self, x: np.ndarray, y: np.ndarray, r: float) -> list[tuple]:
        ex, ey = self.centre[:, 0] - x, self.centre[:, 1] - y
        squared = ex * ex + ey * ey
        along = 0.5 * (1 + (r * r - self.squared) / squared)
        square = r * r / squared - along**2
        meets, height = square > 0, np.sqrt(np.maximum(square, 0))
        found = []
        for h in (height, -height):
            rx, ry = along * ex - h * ey, along * ey + h * ex
            px, py = x + rx - self.start[:, 0], y + ry - self.start[:, 1]
            beyond = (self.chord[:, 0] * py - self.chord[:, 1] * px) * self.turn
            found.append((rx, ry, meets & (beyond <= 0)))
        return found


def newton_by_numpy(
    surface: NumpySurface,
    centres: np.ndarray,
    directions: np.ndarray,
    target: float,
    radius: float,
    most: int,
    tolerance: float,
) -> np.ndarray:
    """The same for all places at once; places that are done are left alone."""
    normal = np.column_stack([directions[:, 1], -directions[:, 0]])
    x, going = np.zeros(len(centres)), np.arange(len(centres))
    for _ in range(most):
        here = surface.angle(
            centres[going] + x[going, None] * normal[going], directions[going], radius
        )
        open_ = np.abs(here - target) >= tolerance
        going, here = going[open_], here[open_]
        if not len(going):
            break
        there = surface.angle(
            centres[going] + (x[going, None] + STEP) * normal[going], directions[going], radius
        )
        x[going] += (target - here) * STEP / (there - here)
    return x
