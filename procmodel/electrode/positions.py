"""Positions on a circle and on the grid of the axes, many at a time."""

import cmath
import math
from collections.abc import Callable

import numpy as np

# Most points worked on at once: what they need stays in the processor's cache.
BLOCK = 8192


def block_of(count: int) -> int:
    """Points worked on at once: few enough that the first block is a small share of the work."""
    return min(BLOCK, max(256, count // 16), count)


def fill_line(
    points: np.ndarray, start: np.ndarray, move: np.ndarray, resolution: float | None
) -> None:
    """Put ``start + i move`` into the rows of `points`.

    Every block is the first one moved on by a multiple of its length, with all the coordinates in
    one row: NumPy runs along a long row several times faster than along many short ones.
    """
    scale, unscale = grid_lines(resolution)
    count, axes = points.shape
    rows = block_of(count)
    first, further = np.empty(rows * axes), np.empty(rows * axes)
    for axis in range(axes):
        first[axis::axes] = np.arange(rows) * (move[axis] * scale) + start[axis] * scale
        further[axis::axes] = rows * move[axis] * scale
    flat = points.reshape(-1)
    for block, begin in enumerate(range(0, len(flat), len(first))):
        place = flat[begin : begin + len(first)]
        np.multiply(further[: len(place)], block, out=place)
        place += first[: len(place)]
        if unscale is not None:
            unscale(np.rint(place, out=place), place)


def fill_circle(
    points: np.ndarray,
    centre: np.ndarray,
    radius: float,
    start_angle: float,
    theta: float,
    resolution: float | None,
) -> None:
    """Put ``centre + radius (cos, sin)(start_angle + i theta)`` into the rows of `points`.

    The angle of row i is that of its block plus that within the block, and the sine and cosine of
    the sum come from one product of the two, so that only the blocks take sines. The error is
    that of one product, whatever the row.
    """
    count = len(points)
    scale, unscale = grid_lines(resolution)
    block = block_of(count)
    fine = np.empty(block, dtype=np.complex128)
    angle = theta * np.arange(block)
    np.cos(angle, out=fine.real)
    np.sin(angle, out=fine.imag)
    middle = complex(*centre) * scale
    for begin in range(0, count, block):
        rows = points[begin : begin + block]
        place = rows.view(np.complex128)[:, 0]
        turn = radius * scale * cmath.exp(1j * (start_angle + begin * theta))
        np.multiply(fine[: len(rows)], turn, out=place)
        place += middle
        if unscale is not None:
            unscale(np.rint(rows, out=rows), rows)


def grid_lines(
    resolution: float | None,
) -> tuple[float, Callable[[np.ndarray, np.ndarray], object] | None]:
    """Factor from lengths to numbers of grid lines, and what turns whole numbers back."""
    if resolution is None:
        return 1.0, None
    lines = 1.0 / resolution
    if lines == round(lines):  # dividing by a whole number gives the nearest decimal fraction
        return lines, lambda numbers, out: np.divide(numbers, lines, out=out)
    return lines, lambda numbers, out: np.multiply(numbers, resolution, out=out)


def rounded(values: np.ndarray, resolution: float | None) -> np.ndarray:
    """Nearest multiples of the resolution, all axes on their own."""
    scale, unscale = grid_lines(resolution)
    if unscale is None:
        return values
    numbers = np.rint(values * scale)
    unscale(numbers, numbers)
    return numbers


def end_angle(start_angle: float, sweep: float) -> float:
    """Angle of the end, that of the start after whole turns."""
    whole = sweep != 0.0 and math.remainder(sweep, 2.0 * math.pi) == 0.0
    return start_angle if whole else start_angle + sweep


def direction(angle: float) -> np.ndarray:
    """Unit vector at an angle."""
    return np.array([math.cos(angle), math.sin(angle)])
