"""Profiles of electrodes as chains of lines and arcs, and their parallels.

A profile runs from the tip upwards in the plane of radius x and height z: z = 0 at the tip, x the
radius of a body of revolution or the half width up to a flat of a prism. The material is on its
left, the wire on its right. Lengths in um, angles in rad; arcs turn from x towards z.

Lines, arcs and profiles are pytrees: what is computed from them is differentiable in their end
points, centres, radii and angles.
"""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.electrode.checks import not_negative, positive
from procmodel.errors import InputError
from procmodel.numerics import safe_sqrt

# Two ends are the same point within this distance [um].
_JOINED = 1e-6
# Directions that differ by less turn no corner [rad].
_SMOOTH = 1e-9
# A hollow corner of less is a bulge that was written with four decimals: at 100 um from it the wire
# cuts 2e-6 um too deep, and its path steps back by 0.02 um.
ROUGHLY_SMOOTH = 2e-4


Value = Array | np.ndarray | float


class Line(eqx.Module):
    """A straight piece of a profile.

    Attributes
    ----------
    start, end : array_like, shape (2,) [um]
        Its ends as (x, z).
    """

    start: Value
    end: Value


class Arc(eqx.Module):
    """A round piece of a profile.

    Attributes
    ----------
    centre : array_like, shape (2,) [um]
        Centre of its circle.
    radius : array_like [um]
        Radius, 0 or more.
    start_angle : array_like [rad]
        Where it starts, from x towards z.
    sweep : array_like [rad]
        How far it goes: positive where the electrode bulges (convex), negative in a hollow.
    """

    centre: Value
    radius: Value
    start_angle: Value
    sweep: Value


Piece = Line | Arc


class Profile(eqx.Module):
    """A chain of lines and arcs, as `chain` or a shape makes it.

    Attributes
    ----------
    pieces : tuple of Line or Arc
        From the tip upwards, each starting where the one before ends.
    sides : int or None
        Number of flats of a prism or pyramid, whose half width x is; None for a body of
        revolution.
    """

    pieces: tuple[Piece, ...]
    sides: int | None = eqx.field(static=True, default=None)


def chain(pieces: Sequence[Piece], sides: int | None = None) -> Profile:
    """Profile from pieces, checked.

    Parameters
    ----------
    pieces : sequence of Line or Arc
        From the tip upwards.
    sides : int, optional
        Number of flats, 3 or more; none for a body of revolution.

    Returns
    -------
    Profile
        The profile.

    Raises
    ------
    InputError
        If there is no piece, one has no length or is not finite, one does not start where the
        last one ends, x goes below 0, or there are fewer than 3 flats.
    """
    if not pieces:
        raise InputError("the profile has no piece: give at least one line or arc.")
    if sides is not None and sides < 3:
        raise InputError(f"the electrode has {sides} flats, but a prism has at least 3.")
    before = None
    for i, piece in enumerate(pieces, start=1):
        leaves = [np.asarray(leaf, dtype=float) for leaf in jax.tree.leaves(piece)]
        if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
            raise InputError(f"piece {i} of the profile is not finite: give numbers of um and rad.")
        if isinstance(piece, Arc) and not float(piece.radius) > 0.0:
            raise InputError(f"piece {i} has a radius of {float(piece.radius):g} um: give more.")
        start, end = (np.asarray(point) for point in ends(piece))
        if float(length_of(piece)) <= _JOINED:
            raise InputError(f"piece {i} of the profile has no length: leave it out.")
        if before is not None and np.linalg.norm(start - before) > _JOINED:
            gap = np.linalg.norm(start - before)
            raise InputError(
                f"piece {i} of the profile starts {gap:g} um from the end of piece {i - 1}: "
                "let it start there."
            )
        low = _least_x(piece)
        if low < -_JOINED:
            raise InputError(
                f"piece {i} of the profile reaches x = {low:g} um, beyond the axis: radii and half "
                "widths are 0 or more."
            )
        before = end
    return Profile(tuple(pieces), sides)


def from_bulges(
    points: ArrayLike, bulges: ArrayLike | None = None, sides: int | None = None
) -> Profile:
    """Profile from its corners.

    Parameters
    ----------
    points : array_like, shape (n, 2) [um]
        Corners as (x, z), from the tip upwards.
    bulges : array_like, shape (n,) or (n - 1,), optional
        Of the piece that starts at each corner: tangent of a quarter of its sweep; 0 for a line,
        positive for a convex arc. A last one, behind the last corner, is not used.
    sides : int, optional
        As for `chain`.

    Returns
    -------
    Profile
        The profile.

    Raises
    ------
    InputError
        As `chain`, or if there are fewer than two corners, or not a bulge for each piece.
    """
    corners = np.asarray(points, dtype=float)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 2:
        raise InputError("a profile needs at least two corners, each with x and z.")
    bent = np.zeros(len(corners)) if bulges is None else np.asarray(bulges, dtype=float)
    if bent.ndim != 1 or not 0 <= len(corners) - len(bent) <= 1:
        raise InputError(
            f"{len(corners)} corners have {bent.size} bulges: give one for each piece."
        )
    pieces: list[Piece] = []
    for start, end, bulge in zip(corners[:-1], corners[1:], bent, strict=False):
        chord = float(np.linalg.norm(end - start))
        if bulge == 0.0 or chord == 0.0:
            pieces.append(Line(start, end))
            continue
        sweep = 4.0 * math.atan(bulge)
        # From the middle of the chord to the left of the way by the share cot(sweep / 2) / 2.
        left = np.array([start[1] - end[1], end[0] - start[0]])
        centre = 0.5 * (start + end) + left * (1.0 - bulge**2) / (4.0 * bulge)
        spoke = start - centre
        begin = math.atan2(spoke[1], spoke[0])
        pieces.append(Arc(centre, float(np.hypot(*spoke)), begin, sweep))
    return chain(pieces, sides)


def cone_frustum(tip_radius: float, base_radius: float, height: float) -> Profile:
    """Cone frustum, a cylinder with equal radii, or a cone with a tip radius of 0.

    Parameters
    ----------
    tip_radius, base_radius : float [um]
        Radii at the tip and at the height.
    height : float [um]
        Height.

    Returns
    -------
    Profile
        One line.

    Raises
    ------
    InputError
        If a length is negative, or height or base radius is 0.
    """
    return chain([_flank(tip_radius, base_radius, height, "radius")])


def square_frustum(
    tip_half_width: float, base_half_width: float, height: float, sides: int = 4
) -> Profile:
    """Square frustum, or one with another number of flats.

    Parameters
    ----------
    tip_half_width, base_half_width : float [um]
        Distances of the flats from the axis at the tip and at the height.
    height : float [um]
        Height.
    sides : int
        Number of flats.

    Returns
    -------
    Profile
        One line.

    Raises
    ------
    InputError
        As `cone_frustum`, or if there are fewer than 3 flats.
    """
    return chain([_flank(tip_half_width, base_half_width, height, "half width")], sides)


def curved(
    tip_radius: float, base_radius: float, height: float, arc_radius: float, convex: bool = False
) -> Profile:
    """Body of revolution with one arc from tip to base.

    Parameters
    ----------
    tip_radius, base_radius : float [um]
        Radii at the tip and at the height.
    height : float [um]
        Height.
    arc_radius : float [um]
        Radius of the arc, at least half the distance of its ends.
    convex : bool
        Whether the arc bulges; otherwise it is a hollow.

    Returns
    -------
    Profile
        One arc of half a circle or less.

    Raises
    ------
    InputError
        As `cone_frustum`, if the arc's radius is too small for its ends, or a hollow reaches
        the axis.
    """
    flank = _flank(tip_radius, base_radius, height, "radius")
    start, end = np.asarray(flank.start), np.asarray(flank.end)
    radius, half = positive("the radius of the arc", arc_radius), 0.5 * math.dist(start, end)
    if radius < half * (1.0 - 1e-12):
        raise InputError(
            f"an arc of radius {radius:g} um cannot reach from tip to base, {2 * half:g} um apart: "
            f"its radius is {half:g} um at least."
        )
    bulge = half / (radius + math.sqrt(max(radius**2 - half**2, 0.0)))
    return from_bulges(np.stack([start, end]), np.array([bulge if convex else -bulge]))


def _flank(tip: float, base: float, height: float, what: str) -> Line:
    low, high = not_negative(f"the tip {what}", tip), positive(f"the base {what}", base)
    return Line(np.array([low, 0.0]), np.array([high, positive("the height", height)]))


def ends(piece: Piece) -> tuple[Array, Array]:
    """Start and end of a piece.

    Parameters
    ----------
    piece : Line or Arc
        The piece.

    Returns
    -------
    tuple of Array, shape (2,) [um]
        The two points.
    """
    if isinstance(piece, Line):
        return jnp.asarray(piece.start), jnp.asarray(piece.end)
    return _on(piece, piece.start_angle), _on(piece, piece.start_angle + jnp.asarray(piece.sweep))


def length_of(piece: Piece) -> Array:
    """Length of a piece [um]."""
    if isinstance(piece, Line):
        return safe_sqrt(jnp.sum((jnp.asarray(piece.end) - jnp.asarray(piece.start)) ** 2))
    return jnp.abs(jnp.asarray(piece.radius) * piece.sweep)


def directions(piece: Piece) -> tuple[Array, Array]:
    """Unit vectors along a piece at its start and at its end."""
    if isinstance(piece, Line):
        along = (jnp.asarray(piece.end) - jnp.asarray(piece.start)) / length_of(piece)
        return along, along
    sense = _sense(piece)
    angles = piece.start_angle, piece.start_angle + jnp.asarray(piece.sweep)
    first, last = (sense * jnp.stack([-jnp.sin(a), jnp.cos(a)]) for a in angles)
    return first, last


def parallel(profile: Profile, distance: ArrayLike) -> Profile:
    """Profile at a distance on the right, the side of the wire.

    Parameters
    ----------
    profile : Profile
        The profile.
    distance : array_like [um]
        How far; negative on the left.

    Returns
    -------
    Profile
        Lines moved, arcs with the same centre and sweep, and around every corner that bulges
        an arc about the corner; from a parallel back to the profile, those arcs get radius 0.

    Raises
    ------
    InputError
        If a hollow arc is tighter than the distance, or two pieces meet in a hollow corner. Under
        JAX's transformations these are not looked at, and every joint gets an arc, if need be of
        no sweep.
    """
    d = jnp.asarray(distance)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((profile, d)))
    pieces: list[Piece] = []
    for i, piece in enumerate(profile.pieces):
        if i > 0:
            corner = _corner_arc(profile.pieces[i - 1], piece, d)
            if traced or _turns(corner, float(d), i):
                pieces.append(corner)
        if not traced:
            _refuse_tight(piece, float(d), i + 1)
        pieces.append(_moved(piece, d))
    return Profile(tuple(pieces), profile.sides)


def _sense(arc: Arc) -> Array:
    return jnp.where(jnp.asarray(arc.sweep) < 0.0, -1.0, 1.0)


def _moved(piece: Piece, distance: Array) -> Piece:
    if isinstance(piece, Line):
        along, _ = directions(piece)
        step = distance * jnp.stack([along[1], -along[0]])
        return Line(jnp.asarray(piece.start) + step, jnp.asarray(piece.end) + step)
    radius = jnp.asarray(piece.radius) + _sense(piece) * distance
    return Arc(piece.centre, radius, piece.start_angle, piece.sweep)


def _corner_arc(before: Piece, after: Piece, distance: Array) -> Arc:
    """The arc about the corner between two pieces."""
    arriving, leaving = directions(before)[1], directions(after)[0]
    cross = arriving[0] * leaving[1] - arriving[1] * leaving[0]
    turn = jnp.arctan2(cross, jnp.sum(arriving * leaving))
    normal = jnp.arctan2(-arriving[0], arriving[1])  # on the right of the way
    begin = normal + jnp.where(distance < 0.0, jnp.pi, 0.0)
    return Arc(ends(after)[0], jnp.abs(distance), begin, turn)


def _turns(corner: Arc, distance: float, number: int) -> bool:
    """Whether there is a corner; one that is hollow is refused."""
    turn = float(corner.sweep)
    if abs(turn) <= _SMOOTH or distance == 0.0:
        return False
    if (turn > 0.0) == (distance > 0.0):
        return True
    if abs(turn) <= ROUGHLY_SMOOTH:
        return False
    x, z = np.asarray(corner.centre).tolist()
    raise InputError(
        f"pieces {number} and {number + 1} of the profile meet in a hollow corner at x = {x:g} um, "
        f"z = {z:g} um, which a wire cannot cut: round it with a radius of {abs(distance):g} um or "
        "more."
    )


def _refuse_tight(piece: Piece, distance: float, number: int) -> None:
    if isinstance(piece, Line) or float(piece.radius) + float(_sense(piece)) * distance >= 0.0:
        return
    raise InputError(
        f"piece {number} of the profile is a hollow of radius {float(piece.radius):g} um, tighter "
        f"than wire radius and gap together ({abs(distance):g} um): give it a larger radius or "
        "take a thinner wire."
    )


def radius_at(profile: Profile, height: ArrayLike) -> Array:
    """Radius, or half width, of a profile at given heights.

    Parameters
    ----------
    profile : Profile
        The profile.
    height : array_like [um]
        Heights z.

    Returns
    -------
    Array [um]
        The outermost point at each height, of the shape of `height`; -inf beyond the ends.
    """
    z = jnp.asarray(height)
    found = jnp.full(z.shape, -jnp.inf)
    for piece in profile.pieces:
        start, end = ends(piece)
        if isinstance(piece, Line):
            rise = end[1] - start[1]
            share = (z - start[1]) / jnp.where(rise == 0.0, 1.0, rise)
            inside = (share >= -1e-12) & (share <= 1.0 + 1e-12) & (rise != 0.0)
            radius = start[0] + share * (end - start)[0]
            found = jnp.maximum(found, jnp.where(inside, radius, -jnp.inf))
            continue
        centre, radius = jnp.asarray(piece.centre), jnp.asarray(piece.radius)
        sine = (z - centre[1]) / radius
        across = safe_sqrt(1.0 - sine**2)
        for cosine in (across, -across):
            angle = jnp.arctan2(sine, cosine)
            inside = (jnp.abs(sine) <= 1.0 + 1e-12) & within(piece, angle)
            found = jnp.maximum(found, jnp.where(inside, centre[0] + radius * cosine, -jnp.inf))
    return found


def within(arc: Arc, angle: Array) -> Array:
    """Whether an arc reaches an angle, its ends included."""
    sweep = jnp.asarray(arc.sweep)
    beyond = jnp.mod(_sense(arc) * (angle - arc.start_angle), 2.0 * jnp.pi)
    return (beyond <= jnp.abs(sweep) + 1e-9) | (beyond >= 2.0 * jnp.pi - 1e-9)


def _on(arc: Arc, angle: Any) -> Array:
    turned = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return jnp.asarray(arc.centre) + jnp.asarray(arc.radius) * turned


def _least_x(piece: Piece) -> float:
    low = min(float(point[0]) for point in ends(piece))
    if isinstance(piece, Arc) and bool(within(piece, jnp.asarray(math.pi))):
        low = min(low, float(jnp.asarray(piece.centre)[0] - piece.radius))
    return low
