"""Wear ratio from the outlines of a worn electrode and of the workpiece that it cut.

Both outlines belong to one cross-section of a sinking operation, so that areas stand for volumes
per unit width and the wear ratio is the quotient of two areas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from procmodel.errors import InputError

if TYPE_CHECKING:
    from shapely import Polygon

# An outline may stop short of the line that closes it by this share of its height.
LARGEST_SHORTFALL = 0.1

# Independent errors of hundreds of points rarely exceed this many standard deviations.
LARGEST_DEVIATION = 3.0


@dataclass(frozen=True)
class VolumeRatio:
    """Wear ratio by the volume-ratio estimator, with its uncertainty.

    Attributes
    ----------
    ratio : float
        Electrode area lost over workpiece area removed.
    std : float
        Standard deviation of the ratio from the digitising error alone.
    eroded_area, eroded_area_std : float, um^2
        Area lost by the electrode.
    removed_area, removed_area_std : float, um^2
        Area removed from the workpiece below its top.
    digitising_error : float, um
        The error that was assumed.
    """

    ratio: float
    std: float
    eroded_area: float
    eroded_area_std: float
    removed_area: float
    removed_area_std: float
    digitising_error: float


def volume_ratio(
    tool: ArrayLike,
    work: ArrayLike,
    unworn: ArrayLike | None = None,
    *,
    digitising_error: float,
) -> VolumeRatio:
    """Estimate the wear ratio from two measured outlines.

    Parameters
    ----------
    tool : array-like, shape (n, 2), um
        Points x, y along the worn electrode, from one side over the tip to the other; the unworn
        tip is at y = 0 and y points into the electrode. The outline is closed across its top.
    work : array-like, shape (m, 2), um
        Points along the machined workpiece, its top at y = 0 and depth negative. The outline is
        closed along y = 0; what lies above does not count.
    unworn : array-like, shape (k, 2), um, optional
        Corners of the unworn electrode, exactly known. By default the rectangle over the x range
        of `tool` from y = 0 to the highest y of `tool`, which shares the errors of those points.
    digitising_error : float, um
        Standard deviation of each coordinate of each measured point, all independent. It cannot
        be read off the outlines: their coordinates are multiples of a pixel, but the error of
        picking an edge is larger than that grid. One pixel of the picture is a fair value.

    Returns
    -------
    VolumeRatio
        The ratio and both areas with standard deviations.

    Raises
    ------
    InputError
        If an outline crosses itself, stops far below the line that closes it, or the electrode
        seems to have grown; if nothing was eroded or removed; if `digitising_error` is negative.

    Notes
    -----
    An area below a line y = level is the sum over the edges of the integral of level - y, so its
    gradient with respect to every point is exact, also where an edge crosses the line and where a
    closing vertical moves with the end of the outline. The standard deviations follow from these
    gradients to first order.

    The standard deviation holds no common error of all points. A wrong scale cancels in the ratio,
    but a shift of y = 0 by d changes an area by d times the width of the outline.

    Outlines whose ends stop short of the closing line are extended vertically to it, by at most a
    tenth of their height.
    """
    if not 0 <= digitising_error < float("inf"):
        raise InputError(
            f"digitising_error is {digitising_error:g} um: give zero or a positive number"
        )
    tool_points, work_points = _points("tool", tool), _points("work", work)
    _refuse_crossings("tool", tool_points)
    _refuse_crossings("work", work_points)

    removed, removed_gradient = _removed_area(work_points)
    if unworn is None:
        corners = _rectangle(tool_points)
        eroded, eroded_gradient = _eroded_from_rectangle(tool_points)
    else:
        corners = _points("unworn", unworn)
        _refuse_crossings("unworn", np.vstack([corners, corners[:1]]))
        eroded, eroded_gradient = _eroded_from_polygon(tool_points, corners)
    _refuse_growth(tool_points, corners, LARGEST_DEVIATION * digitising_error)
    if eroded <= 0:
        raise InputError(
            f"tool outline: the eroded area is {eroded:g} um^2, so nothing was worn: "
            "check that y = 0 is the unworn tip and that y points into the electrode"
        )

    ratio = eroded / removed
    eroded_std = digitising_error * float(np.linalg.norm(eroded_gradient))
    removed_std = digitising_error * float(np.linalg.norm(removed_gradient))
    std = ratio * float(np.hypot(eroded_std / eroded, removed_std / removed))
    return VolumeRatio(ratio, std, eroded, eroded_std, removed, removed_std, digitising_error)


def area_below(points: np.ndarray, level: float) -> tuple[float, np.ndarray]:
    """Area between an outline and the line y = level above it, and its exact gradient.

    Parameters
    ----------
    points : numpy.ndarray, shape (n, 2), um
        The outline; parts above the line do not count, ends below it are joined to it vertically.
    level : float, um
        The line that closes the outline.

    Returns
    -------
    area : float, um^2
        Positive, whichever way the outline runs.
    gradient : numpy.ndarray, shape (n, 2), um
        Derivative of the area with respect to each coordinate, the level held.
    """
    x, depth = points[:, 0], level - points[:, 1]
    start, end = depth[:-1], depth[1:]
    width = np.diff(x)
    mean, by_start, by_end = _mean_positive_part(start, end)

    gradient = np.zeros_like(points)
    gradient[:-1, 0] -= mean
    gradient[1:, 0] += mean
    gradient[:-1, 1] -= width * by_start
    gradient[1:, 1] -= width * by_end
    area = float(np.sum(width * mean))
    return (area, gradient) if area >= 0 else (-area, -gradient)


def _mean_positive_part(
    start: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of max(v, 0) while v runs evenly from start to end, and its two derivatives."""
    # With P(v) = max(v, 0)^2 / 2 the mean is (P(end) - P(start)) / (end - start).
    crossing = (start > 0) != (end > 0)
    below = (start > 0) & (end > 0)
    difference = np.where(crossing, end - start, 1.0)
    positive_start, positive_end = np.maximum(start, 0.0), np.maximum(end, 0.0)
    part = (positive_end**2 - positive_start**2) / (2 * difference)
    mean = np.where(crossing, part, np.where(below, (start + end) / 2, 0.0))
    by_start = np.where(crossing, (part - positive_start) / difference, np.where(below, 0.5, 0.0))
    by_end = np.where(crossing, (positive_end - part) / difference, np.where(below, 0.5, 0.0))
    return mean, by_start, by_end


def _removed_area(work: np.ndarray) -> tuple[float, np.ndarray]:
    lowest, highest = float(np.min(work[:, 1])), float(np.max(work[:, 1]))
    if highest >= -lowest:
        raise InputError(
            f"work outline: it reaches {highest:g} um above the workpiece top at y = 0 but "
            f"{-lowest:g} um below it: give depths as negative y"
        )
    _refuse_open_ends("work", work, 0.0, "the workpiece top")
    area, gradient = area_below(work, 0.0)
    if area <= 0:
        raise InputError(
            "work outline: the removed area is 0 um^2: give the outline from one side of the "
            "pocket to the other"
        )
    return area, gradient


def _eroded_from_polygon(tool: np.ndarray, unworn: np.ndarray) -> tuple[float, np.ndarray]:
    top = float(np.max(unworn[:, 1]))
    _refuse_open_ends("tool", tool, top, "the top of the unworn electrode")
    worn_area, worn_gradient = area_below(tool, top)
    return _polygon(unworn).area - worn_area, -worn_gradient


def _eroded_from_rectangle(tool: np.ndarray) -> tuple[float, np.ndarray]:
    """Eroded area where the rectangle itself hangs on the outermost points of the outline."""
    highest = int(np.argmax(tool[:, 1]))
    left, right = int(np.argmin(tool[:, 0])), int(np.argmax(tool[:, 0]))
    top = float(tool[highest, 1])
    width = float(tool[right, 0] - tool[left, 0])
    _refuse_open_ends("tool", tool, top, "its top")
    worn_area, worn_gradient = area_below(tool, top)

    gradient = -worn_gradient
    gradient[right, 0] += top
    gradient[left, 0] -= top
    # Raising the top adds to the rectangle and, between the ends, as much to the worn electrode.
    gradient[highest, 1] += width - abs(tool[-1, 0] - tool[0, 0])
    return width * top - worn_area, gradient


def _rectangle(tool: np.ndarray) -> np.ndarray:
    left, right = np.min(tool[:, 0]), np.max(tool[:, 0])
    top = np.max(tool[:, 1])
    if top <= 0:
        raise InputError(
            "tool outline: no part lies above the unworn tip at y = 0: "
            "let y point into the electrode"
        )
    return np.array([[left, 0.0], [right, 0.0], [right, top], [left, top]])


def _points(name: str, outline: ArrayLike) -> np.ndarray:
    points = np.asarray(outline, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.all(np.isfinite(points)):
        raise ValueError(f"{name} outline must be finite and of shape (n, 2), not {points.shape}")
    if len(points) < 3:
        raise InputError(f"{name} outline: it has {len(points)} points: give at least 3")
    return points


def _polygon(corners: np.ndarray) -> Polygon:
    # Loading shapely takes a quarter of a second that only this estimator has to spend.
    import shapely

    return shapely.Polygon(corners)


def _refuse_open_ends(name: str, points: np.ndarray, level: float, closing_line: str) -> None:
    height = level - float(np.min(points[:, 1]))
    for index in (0, len(points) - 1):
        shortfall = level - points[index, 1]
        if height > 0 and shortfall > LARGEST_SHORTFALL * height:
            raise InputError(
                f"{name} outline: {_describe(points, index)} ends it {shortfall:g} um short of "
                f"{closing_line} at y = {level:g}: digitise both sides up to there"
            )


def _refuse_crossings(name: str, points: np.ndarray) -> None:
    """Refuse an outline two of whose edges meet, naming the points between which they run."""
    import shapely

    # A point digitised twice is harmless, but its empty edge would touch the next but one.
    kept = np.flatnonzero(np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1)))
    if len(kept) < 2:
        raise InputError(f"{name} outline: all its points are one: give the whole outline")
    edges = shapely.linestrings(np.stack([points[kept[:-1]], points[kept[1:]]], axis=1))
    first, second = shapely.STRtree(edges).query(edges, predicate="intersects")
    meeting = second > first + 1
    if np.array_equal(points[0], points[-1]):
        # A closed outline ends where it began.
        meeting &= ~((first == 0) & (second == len(edges) - 1))
    pairs = sorted(zip(first[meeting].tolist(), second[meeting].tolist(), strict=True))
    if pairs:
        one, other = pairs[0]
        raise InputError(
            f"{name} outline: the edge after {_describe(points, int(kept[one]))} crosses the edge "
            f"after {_describe(points, int(kept[other]))}: correct or delete the point out of order"
        )


def _refuse_growth(tool: np.ndarray, unworn: np.ndarray, tolerance: float) -> None:
    """Refuse a worn electrode that sticks out of the unworn one by more than `tolerance`."""
    import shapely

    electrode = _polygon(unworn)
    top = float(np.max(unworn[:, 1]))
    counted = np.column_stack([tool[:, 0], np.minimum(tool[:, 1], top)])
    distances = shapely.distance(shapely.points(counted), electrode)
    worst = int(np.argmax(distances))
    # Points on a slanted wall lie off it by rounding, even without any error.
    rounding = 1e-9 * float(np.max(np.abs(unworn)))
    if distances[worst] > tolerance + rounding:
        raise InputError(
            f"tool outline: {_describe(tool, worst)} lies {distances[worst]:.4g} um outside the "
            f"unworn electrode, more than {LARGEST_DEVIATION:g} digitising errors "
            f"({tolerance:g} um), but an electrode cannot grow: "
            "check the unworn outline, the zero point and the scale"
        )


def _describe(points: np.ndarray, index: int) -> str:
    x, y = points[index]
    return f"point {index + 1} ({x:g}, {y:g})"
