"""A measured profile of a test cavity before the fit: which way it lies and what is wrong with it.

Lengths in um. ``depth`` is positive downwards.
"""

import numpy as np

from procmodel.errors import InputError

LEAST_READINGS = 3
# Share of a half profile that may lie beyond the centre.
_BEYOND_CENTRE = 0.2


def require_profile(position: np.ndarray, height: np.ndarray, source: str) -> None:
    """Refuse readings that are not a profile.

    Parameters
    ----------
    position, height : ndarray, shape (n,) [um]
        As measured.
    source : str
        What to call the profile.

    Raises
    ------
    InputError
        If there are too few, they are not finite, or x does not increase.
    """
    if position.ndim != 1 or position.shape != height.shape or len(position) < LEAST_READINGS:
        raise InputError(
            f"{source} must hold {LEAST_READINGS} readings or more, as many x as z; it has "
            f"{position.size} and {height.size}."
        )
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(height))):
        raise InputError(f"{source} has readings that are not finite: remove them.")
    if not np.all(np.diff(position) > 0):
        worst = int(np.argmax(np.diff(position) <= 0)) + 2
        raise InputError(f"{source}: x does not increase at reading {worst}: sort the readings.")


def looks_full(height: np.ndarray) -> bool:
    """Whether both ends are on one level and the middle is away from it: both walls were seen."""
    left, middle, right = _levels(height)
    return bool(abs(middle - 0.5 * (left + right)) > 1.5 * abs(left - right) + 1e-12)


def downwards(height: np.ndarray, reach: str) -> tuple[np.ndarray, bool]:
    """Depth positive downwards, and whether z had to be turned round for it."""
    if reach == "half":
        flipped = bool(np.median(height) < 0)
    else:
        left, middle, right = _levels(height)
        flipped = bool(middle < 0.5 * (left + right))
    return (-height if flipped else height), flipped


def centre_and_surface(position: np.ndarray, depth: np.ndarray) -> tuple[float, float]:
    """First guess of the centre and of the surface's level of a full section [um]."""
    left, _, right = _levels(depth)
    surface = 0.5 * (left + right)
    deep = np.flatnonzero(depth > surface + 0.5 * (np.max(depth) - surface))
    return float(0.5 * (position[deep[0]] + position[deep[-1]])), float(surface)


def noise_of(depth: np.ndarray) -> float:
    """Noise level from second differences, which a smooth wall hardly has [um]."""
    if len(depth) < LEAST_READINGS:
        return 0.0
    return float(np.median(np.abs(np.diff(depth, 2)))) / (0.6745 * 6.0**0.5)


def require_half_profile(position: np.ndarray, depth: np.ndarray, source: str) -> None:
    """Refuse a half profile whose origin is not the centre at the workpiece surface.

    Parameters
    ----------
    position, depth : ndarray, shape (n,) [um]
        The profile.
    source : str
        What to call it.

    Raises
    ------
    InputError
        If x runs far to both sides of 0, or the outer end is deeper than the centre.
    """
    sides = sorted((max(0.0, -float(position[0])), max(0.0, float(position[-1]))))
    if sides[0] > _BEYOND_CENTRE * sides[1]:
        raise InputError(
            f"{source} has x far on both sides of 0 but only one wall: shift x so that 0 is the "
            "centre of the cavity, or measure both walls."
        )
    order = np.argsort(np.abs(position))
    part = max(1, len(order) // 10)
    centre, wall = np.median(depth[order[:part]]), np.median(depth[order[-part:]])
    if wall > centre + 3.0 * noise_of(depth):
        raise InputError(
            f"{source} is {wall:.4g} um deep at its outer end and {centre:.4g} um at x = 0: a half "
            "profile counts x from the centre and z from the workpiece surface."
        )


def depth_reached(position: np.ndarray, depth: np.ndarray, reach: str) -> float:
    """Depth of the cavity that the readings show, levelled by the ends of a full section [um]."""
    level = np.zeros_like(depth)
    if reach == "full":
        edge = max(1, len(depth) // 20)
        ends = np.r_[0:edge, len(depth) - edge : len(depth)]
        level = np.polyval(np.polyfit(position[ends], depth[ends], 1), position)
    # Not the deepest reading, which is the deepest noise; less three noise levels to be sure.
    return float(np.quantile(depth - level, 0.98)) - 3.0 * noise_of(depth)


def near_upper_edge(across: np.ndarray, half_width: float, gap: float) -> np.ndarray:
    """Readings of which it is open whether they saw the wall or the surface beside it.

    Those inside the programmed half width saw the wall for certain, for the gap only widens it;
    a centre that is a guess costs two spacings more.

    Parameters
    ----------
    across : ndarray, shape (n,) [um]
        Distance from the guessed centre, signed.
    half_width, gap : float [um]
        Programmed half width of the first layer, and the least side gap.

    Returns
    -------
    ndarray of bool, shape (n,)
        True where it is open.
    """
    spacing = float(np.median(np.diff(across)))
    distance = np.abs(across)
    inner = half_width + gap - (2.0 * spacing if np.any(across < 0) else 0.0)
    outer = half_width + gap + max(0.1 * half_width, 3.0 * spacing)
    return (distance > max(inner, 0.0)) & (distance < outer)


def _levels(height: np.ndarray) -> tuple[float, float, float]:
    """Median height at the left end, in the middle, and at the right end."""
    edge = max(1, len(height) // 20)
    middle = height[max(0, len(height) // 2 - edge) : len(height) // 2 + edge]
    return (
        float(np.median(height[:edge])),
        float(np.median(middle)),
        float(np.median(height[-edge:])),
    )
