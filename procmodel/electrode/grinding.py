"""From the path of the wire to the finished electrode, and back.

The wire, of radius r_w, removes everything within r_w + g of its centre, g being the discharge
gap. The path for a wanted profile is its parallel at r_w + g, exact for lines and arcs; the
finished profile is what the discs about the path leave. The gap is random from pass to pass and
one number within a pass. The wire runs, so its own wear is neglected. A body of revolution turns
with the spindle; flats are cut one by one with the spindle indexed, the same law giving their half
width. Lengths in um, areas in um^2.

Notation: r_w wire radius, g gap, x radius or half width, z height from the tip.

References
----------
.. [1] T. Masuzawa et al., "Wire electro-discharge grinding for micro-machining", Annals of the
   CIRP 34(1), 213-216, 1985.
.. [2] X. Guo, W. Pei, Z. Yu, J. Li, shaped micro-electrodes by line and arc interpolation in wire
   electro-discharge grinding (in Chinese).
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.electrode.checks import not_negative
from procmodel.electrode.profile import (
    ROUGHLY_SMOOTH,
    Arc,
    Line,
    Piece,
    Profile,
    directions,
    ends,
    length_of,
    parallel,
    within,
)
from procmodel.errors import InputError
from procmodel.numerics import safe_sqrt

# Where the wire does not reach.
_NOT_CUT = jnp.inf


def wire_path(profile: Profile, wire_radius: float, gap: float, allowance: float = 0.0) -> Profile:
    """Path of the wire's centre that leaves a profile.

    Parameters
    ----------
    profile : Profile
        The wanted electrode.
    wire_radius : float [um]
        Radius r_w of the wire, 0 or more.
    gap : float [um]
        Discharge gap g counted on, 0 or more.
    allowance : float [um]
        What a roughing pass leaves on the profile, 0 or more.

    Returns
    -------
    Profile
        The parallel of the profile at r_w + g + allowance; around corners that bulge it goes in
        arcs about them.

    Raises
    ------
    InputError
        If a length is negative, or the profile hangs over, has a hollow tighter than that
        distance, or a hollow corner; the text says where.
    """
    distance = (
        not_negative("the wire radius", wire_radius)
        + not_negative("the gap", gap)
        + not_negative("the allowance", allowance)
    )
    path = parallel(profile, distance)
    _refuse_overhang(profile)
    return path


def with_leads(path: Profile, lead_in: float = 0.0, lead_out: float = 0.0) -> Profile:
    """Path that comes from before its start and goes on beyond its end, straight on.

    Parameters
    ----------
    path : Profile
        Path of the wire's centre.
    lead_in, lead_out : float [um]
        How far before the start and beyond the end, 0 or more. With a lead in, the tip gets its
        size from a wire that moves along the flank, whatever the gap; a lead out goes on into
        the shank.

    Returns
    -------
    Profile
        The path with a line at either end that has a lead.

    Raises
    ------
    InputError
        If a lead is negative or not finite.
    """
    before, after = not_negative("the lead in", lead_in), not_negative("the lead out", lead_out)
    pieces = list(path.pieces)
    if before > 0.0:
        start, heading = ends(path.pieces[0])[0], directions(path.pieces[0])[0]
        pieces.insert(0, Line(start - before * heading, start))
    if after > 0.0:
        end, heading = ends(path.pieces[-1])[1], directions(path.pieces[-1])[1]
        pieces.append(Line(end, end + after * heading))
    return Profile(tuple(pieces), path.sides)


def least_hollow_radius(wire_radius: ArrayLike, gap: ArrayLike) -> Array:
    """Radius of the tightest hollow that a wire can cut [um]: wire radius and gap together."""
    return jnp.asarray(wire_radius) + jnp.asarray(gap)


def ground_radius(
    path: Profile,
    wire_radius: ArrayLike,
    gap: ArrayLike,
    height: ArrayLike,
    blank_radius: ArrayLike = jnp.inf,
) -> Array:
    """Radius, or half width, that one pass of the wire leaves.

    Parameters
    ----------
    path : Profile
        Path of the wire's centre.
    wire_radius : array_like [um]
        Radius r_w of the wire.
    gap : array_like [um]
        Discharge gap g of this pass, one number; `jax.vmap` for many.
    height : array_like [um]
        Heights z above the tip.
    blank_radius : array_like [um]
        Radius before the pass.

    Returns
    -------
    Array [um]
        Least of ``x - sqrt((r_w + g)^2 - (z - z_c)^2)`` over the centres (x, z_c) of the path
        within r_w + g of the height, and of the blank, but not below 0; of the shape of
        `height`. Differentiable in everything.
    """
    z = jnp.asarray(height)
    reach = jnp.asarray(wire_radius) + jnp.asarray(gap)
    least = jnp.broadcast_to(jnp.asarray(blank_radius, dtype=float), z.shape)
    for piece in path.pieces:
        least = jnp.minimum(least, _least_left(piece, reach, z))
    return jnp.maximum(least, 0.0)


def radius_after_passes(
    paths: Sequence[Profile],
    wire_radius: ArrayLike,
    gaps: ArrayLike,
    height: ArrayLike,
    blank_radius: ArrayLike = jnp.inf,
) -> Array:
    """Radius, or half width, that several passes leave, each with its own gap.

    Parameters
    ----------
    paths : sequence of Profile, length p
        Paths of the wire's centre, roughing first.
    wire_radius : array_like [um]
        Radius of the wire.
    gaps : array_like, shape (p,) [um]
        Gap of every pass.
    height, blank_radius
        As for `ground_radius`.

    Returns
    -------
    Array [um]
        The least over the passes: the finishing pass decides, unless a roughing pass had a gap
        so wide that it cut through the allowance.
    """
    left = jnp.asarray(blank_radius, dtype=float)
    for path, gap in zip(paths, jnp.asarray(gaps), strict=True):
        left = ground_radius(path, wire_radius, gap, height, left)
    return left


def dimensions_with_gap(
    paths: Profile | Sequence[Profile],
    wanted: ArrayLike,
    gaps: ArrayLike,
    wire_radius: ArrayLike,
    blank_radius: ArrayLike = jnp.inf,
) -> Array:
    """Diameters, or widths across flats, at wanted heights for many draws of the gap.

    Parameters
    ----------
    paths : Profile or sequence of Profile, length p
        Path of the wire's centre, or those of several passes.
    wanted : array_like, shape (m,) [um]
        Heights at which the dimension is wanted.
    gaps : array_like, shape (n,), (n, p) or (n, p, 2) [um]
        Draws of the gap; with several passes one for each, or the same for all. The last shape
        is for flats, where the two that bound a width are ground one after the other, each with
        a gap of its own.
    wire_radius : array_like [um]
        Radius of the wire.
    blank_radius : array_like [um]
        Radius before the first pass.

    Returns
    -------
    Array, shape (n, m) [um]
        Twice the radius that is left, or the sum of the two half widths.

    Raises
    ------
    ValueError
        If the gaps do not fit the passes.
    """
    chained = (paths,) if isinstance(paths, Profile) else tuple(paths)
    heights, draws = jnp.asarray(wanted), jnp.asarray(gaps)
    if draws.ndim == 1:
        draws = jnp.broadcast_to(draws[:, None], (len(draws), len(chained)))
    if draws.ndim not in (2, 3) or draws.shape[1] != len(chained) or draws.shape[2:] not in [
        (), (2,),
    ]:  # fmt: skip
        raise ValueError(f"gaps of shape {draws.shape} do not fit {len(chained)} passes")

    def radius(gap: Array) -> Array:
        return radius_after_passes(chained, wire_radius, gap, heights, blank_radius)

    if draws.ndim == 2:
        return 2.0 * jax.vmap(radius)(draws)
    return jax.vmap(lambda pair: radius(pair[:, 0]) + radius(pair[:, 1]))(draws)


def section_area(radius: ArrayLike, sides: int | None = None) -> Array:
    """Area of the electrode's cross-section.

    Parameters
    ----------
    radius : array_like [um]
        Radius, or half width up to a flat.
    sides : int, optional
        Number of flats of a regular prism; none for a round electrode.

    Returns
    -------
    Array [um^2]
        pi r^2, or n a^2 tan(pi / n) for n flats at a half width a.
    """
    squared = jnp.asarray(radius) ** 2
    return squared * (math.pi if sides is None else sides * math.tan(math.pi / sides))


def index_angles(sides: int) -> np.ndarray:
    """Angles of the spindle, one for each flat [rad], shape (sides,)."""
    return 2.0 * math.pi * np.arange(sides) / sides


def _refuse_overhang(profile: Profile) -> None:
    """Refuse a profile that falls anywhere.

    Where it does not, the wire that fits into every hollow fits everywhere: to turn from facing
    one flank to facing the opposite one, hollows of at least its radius take twice that in height.
    """
    for i, piece in enumerate(profile.pieces, start=1):
        headings = [*directions(piece)]
        turned = 0.0
        if isinstance(piece, Arc):
            turned, half = abs(float(piece.sweep)), 0.5 * jnp.asarray(piece.sweep)
            second = Arc(piece.centre, piece.radius, piece.start_angle + half, half)
            headings.append(directions(second)[0])
        rises = min(float(heading[1]) for heading in headings) >= -ROUGHLY_SMOOTH
        if not rises or turned > 2.0 * math.pi:
            raise InputError(
                f"piece {i} of the profile hangs over: its height falls along the way, and a wire "
                "beside it would cut what is above; draw a profile that rises all the way."
            )


def _least_left(piece: Piece, reach: Array, height: Array) -> Array:
    """Least x that the discs about a piece reach at a height."""
    if isinstance(piece, Line):
        return _left_of_line(piece, reach, height)
    return _left_of_arc(piece, reach, height)


def _left_of_line(line: Line, reach: Array, height: Array) -> Array:
    start, _ = ends(line)
    along, _ = directions(line)
    length = length_of(line)
    level = along[1] == 0.0
    # The disc that touches the finished line at this height has its centre lower by reach * tx.
    centre = height - reach * along[0] * jnp.sign(along[1])
    way = (centre - start[1]) / jnp.where(level, 1.0, along[1])
    way = jnp.where(level, jnp.where(along[0] > 0.0, 0.0, length), way)
    way = jnp.clip(way, 0.0, length)
    return _left_of_disc(start[0] + way * along[0], start[1] + way * along[1], reach, height)


def _left_of_arc(arc: Arc, reach: Array, height: Array) -> Array:
    centre, radius = jnp.asarray(arc.centre), jnp.asarray(arc.radius)
    least = jnp.full(height.shape, _NOT_CUT)
    for point in ends(arc):
        least = jnp.minimum(least, _left_of_disc(point[0], point[1], reach, height))
    # Discs that touch the outer and the inner parallel circle at this height.
    for far, side in ((radius + reach, -1.0), (radius - reach, 1.0)):
        sine = (height - centre[1]) / jnp.where(far == 0.0, 1.0, far)
        touches = (far != 0.0) & (jnp.abs(sine) < 1.0)
        sine = jnp.where(touches, sine, 0.0)
        cosine = side * safe_sqrt(1.0 - sine**2)
        touches &= within(arc, jnp.arctan2(sine, cosine))
        x, z = centre[0] + radius * cosine, centre[1] + radius * sine
        least = jnp.minimum(least, jnp.where(touches, _left_of_disc(x, z, reach, height), _NOT_CUT))
    return least


def _left_of_disc(x: Array, z: Array, reach: Array, height: Array) -> Array:
    off = height - z
    # The guard lets a disc that ends exactly at the height count.
    reached = jnp.abs(off) <= reach * (1.0 + 1e-12)
    return jnp.where(reached, x - safe_sqrt(reach**2 - off**2), _NOT_CUT)
