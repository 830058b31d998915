"""Profiles and paths of the wire cut into steps, and how far the steps are off them.

Lengths in um.
"""

import math

import numpy as np

from procmodel.electrode.interpolation import (
    arc_steps,
    interpolate_arc,
    interpolate_line,
    line_steps,
)
from procmodel.electrode.profile import Line, Piece, Profile, directions, length_of


def interpolate_profile(
    profile: Profile, step: float, resolution: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions along a profile or the path of the wire, piece by piece.

    Parameters
    ----------
    profile : Profile
        The profile or path.
    step, resolution : float [um]
        As for `procmodel.electrode.interpolate_line`.

    Returns
    -------
    points : numpy.ndarray, shape (n, 2) [um]
        As (x, z), where pieces join once.
    piece : numpy.ndarray, shape (n,), int
        Number of the piece that each point ends or lies in, from 0.

    Raises
    ------
    InputError
        As `procmodel.electrode.interpolate_line`.
    """
    parts: list[np.ndarray] = []
    numbers: list[np.ndarray] = []
    for i, piece in enumerate(profile.pieces):
        if isinstance(piece, Line):
            points = interpolate_line(
                np.asarray(piece.start), np.asarray(piece.end), step, resolution
            )
        elif float(piece.radius) <= 0.0:
            continue  # where a hollow is as tight as the wire, its centre stands still
        else:
            points = interpolate_arc(
                np.asarray(piece.centre), float(piece.radius), float(piece.start_angle),
                float(piece.sweep), step, resolution,
            )  # fmt: skip
        points = points[1:] if parts else points
        parts.append(points)
        numbers.append(np.full(len(points), i))
    return np.concatenate(parts), np.concatenate(numbers)


def deviations(
    profile: Profile, points: np.ndarray, piece: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far positions, and the middles of the steps between them, are off a profile.

    Parameters
    ----------
    profile : Profile
        What was interpolated.
    points, piece : numpy.ndarray, shape (n, 2) [um] and (n,)
        From `interpolate_profile`.

    Returns
    -------
    at_points : numpy.ndarray, shape (n,) [um]
        Distance from the piece, across it: what rounding adds; positive on the side of the wire.
    at_middles : numpy.ndarray, shape (n - 1,) [um]
        The same of the middles of the steps: rounding and chord together.
    """
    middles = 0.5 * (points[1:] + points[:-1])
    at_points, at_middles = np.zeros(len(points)), np.zeros(len(middles))
    for i, one in enumerate(profile.pieces):
        mine = piece == i
        at_points[mine] = _off(one, points[mine])
        at_middles[mine[1:]] = _off(one, middles[mine[1:]])
    return at_points, at_middles


def steps_of(profile: Profile, step: float) -> list[int]:
    """Steps that every piece takes; see `procmodel.electrode.interpolation.line_steps`."""
    return [
        line_steps(float(length_of(piece)), step)[0]
        if isinstance(piece, Line)
        else arc_steps(float(piece.radius), float(piece.sweep), step)[0]
        for piece in profile.pieces
    ]


def _off(piece: Piece, points: np.ndarray) -> np.ndarray:
    if isinstance(piece, Line):
        along = np.asarray(directions(piece)[0])
        return (points - np.asarray(piece.start)) @ np.array([along[1], -along[0]])
    off = np.hypot(*(points - np.asarray(piece.centre)).T) - float(piece.radius)
    return math.copysign(1.0, float(piece.sweep)) * off


def normals(profile: Profile, points: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Directions across a profile at positions along it, towards the side of the wire.

    Parameters
    ----------
    profile : Profile
        The profile.
    points, piece : numpy.ndarray, shape (n, 2) [um] and (n,)
        From `interpolate_profile`.

    Returns
    -------
    numpy.ndarray, shape (n, 2)
        Unit vectors.
    """
    across = np.empty_like(points)
    for i, one in enumerate(profile.pieces):
        mine = piece == i
        if isinstance(one, Line):
            along = np.asarray(directions(one)[0])
            across[mine] = [along[1], -along[0]]
        else:
            spoke = points[mine] - np.asarray(one.centre)
            sense = math.copysign(1.0, float(one.sweep))
            across[mine] = sense * spoke / np.hypot(*spoke.T)[:, None]
    return across
