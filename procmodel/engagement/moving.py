"""Algorithm I place by place: each place of a given path is moved across it to hold the angle.

Newton's method for the distance x to the wall at which c(x) = 1 - cos(alpha) is the wanted one. At
the crossing p (a unit vector from the centre o) of the rim with a piece of curvature kappa, start s
and normal n there,

    F = kappa |o - s + r p|^2 / 2 - n . (o - s + r p) = 0,   c = 1 + p . side,

and with G = kappa (o - s + r p) - n the slope is dc/dx = -(G . m) / (r G . left(p)) left(p) . side,
m the direction of moving and `side` the one away from the wall. Lengths in mm, angles in rad.

References
----------
.. [1] S. Ibaraki, I. Ikeda, A. Yamaji, Y. Kakino, S. Nishida, section 2.1, eqs (1), (2).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from procmodel.engagement.contact import contact
from procmodel.engagement.segments import Segments, left
from procmodel.engagement.surface import Surface, padded_rows
from procmodel.errors import InputError

METHODS = ("ratio", "angle", "difference")
_STEPS = 30
# Of the tool radius: the step of the finite difference in the paper's baseline.
_DIFFERENCE = 1e-5
_SETTLED = 1e-12
# Of the tool radius: how far the pieces at hand let a place move before they are looked up anew.
_AT_HAND = 0.04
# In pieces of the surface: the same where they are short.
_PIECES_AT_HAND = 1.0
_WIDEST = 32
_MET = 1e-9
_FEWEST = 256


@dataclass(frozen=True)
class MovedPath:
    """Places moved across a path so that each has a given engagement angle.

    Attributes
    ----------
    moved : ndarray, shape (n,) [mm]
        Towards the wall positive.
    angle : ndarray, shape (n,) [rad]
        Engagement angle reached, the feed direction being that of the given path.
    steps : int
        Steps that the slowest place took.
    converged : ndarray of bool, shape (n,)
        Where the angle is met; the one step of the paper's mode is not judged.
    """

    moved: np.ndarray
    angle: np.ndarray
    steps: int
    converged: np.ndarray


def move_places(
    surface: Surface,
    centres: np.ndarray,
    directions: np.ndarray,
    angle: float,
    radius: float,
    method: str = "ratio",
    steps: int = _STEPS,
    reach: float | None = None,
) -> MovedPath:
    """Move every place of a path across it until the engagement angle is met.

    Parameters
    ----------
    surface : Surface
        What the previous pass left.
    centres, directions : ndarray, shape (n, 2) [mm, -]
        The given path, wall to the right.
    angle : float [rad]
        Engagement angle that is wanted.
    radius : float [mm]
        Tool radius.
    method : {"ratio", "angle", "difference"}
        Newton's method in c = 1 - cos(alpha), or in alpha itself, with derivatives by automatic
        differentiation; or the paper's own: one step in alpha with a finite difference.
    steps : int
        Greatest number of steps.
    reach : float, optional [mm]
        Farthest that a place may be moved; half the tool radius when left out.

    Returns
    -------
    MovedPath
        How far every place moved. Places that cannot meet the angle stay where they got to, and
        are not converged.

    Raises
    ------
    InputError
        If the method is unknown.
    """
    if method not in METHODS:
        raise InputError(f"method is {method!r}: choose one of {', '.join(METHODS)}.")
    o, t = np.asarray(centres, float), np.asarray(directions, float)
    limit = 0.5 * radius if reach is None else reach
    found = _Found(np.zeros(len(o)), np.zeros(len(o)), np.zeros(len(o), bool), 0)
    rest = np.arange(len(o))
    if method == "ratio":
        rest = _by_nearest_crossing(surface, o, t, angle, radius, limit, steps, found)
    for chosen, table in surface.windows(o[rest], radius, limit):
        found.put(
            rest[chosen],
            *_newton(
                surface.segments, *padded_rows(o[rest[chosen]], t[rest[chosen]], table), angle,
                radius, limit, steps, method,
            ),
        )  # fmt: skip
    return MovedPath(found.moved, found.angle, found.steps, found.met)


@dataclass
class _Found:
    """What is known of the places so far."""

    moved: np.ndarray
    angle: np.ndarray
    met: np.ndarray
    steps: int

    def put(self, places: np.ndarray, moved: Any, angle: Any, met: Any, steps: Any) -> None:
        count = len(places)
        self.moved[places] = np.asarray(moved)[:count]
        self.angle[places] = np.asarray(angle)[:count]
        self.met[places] = np.asarray(met)[:count]
        self.steps = max(self.steps, int(steps))


def _by_nearest_crossing(
    surface: Surface, o: np.ndarray, t: np.ndarray, angle: float, radius: float, limit: float,
    steps: int, found: _Found,
) -> np.ndarray:  # fmt: skip
    """Newton's method on the crossing nearest to the wall alone; the places where it says nothing.

    Those are the ones that have no crossing ahead, or none behind which the stock reaches to the
    wall. Pieces are looked up within a short way of the place, and anew where it went farther.
    """
    free = min(limit, _AT_HAND * radius, _PIECES_AT_HAND * surface.index.spacing)
    fields = tuple(np.ascontiguousarray(c) for c in _columns(surface.host))
    x, y, tx, ty = (np.ascontiguousarray(c) for c in (*o.T, *t.T))
    moved, ratio, slope = np.zeros((3, len(o)))
    holds, taken = np.zeros(len(o), bool), 0
    rest = np.arange(len(o))
    while len(rest) and taken < steps:
        here = np.empty((len(rest), 2))
        here[:, 0] = x[rest] + moved[rest] * ty[rest]
        here[:, 1] = y[rest] - moved[rest] * tx[rest]
        away, most = [rest[:0]], 0
        for chosen, table in surface.windows(here, radius, free):
            if table.shape[1] > _WIDEST:
                continue
            rows, base, used = rest[chosen], moved[rest[chosen]], 0
            # First a look at all of them: the ones that are met already are left behind.
            for looped in (False, True):
                at = [x[rows], y[rows], tx[rows], ty[rows], base, moved[rows]]
                if looped:
                    at += [ratio[rows], slope[rows]]
                *state, did = _moved(
                    fields, _filled(table.T, -1), _filled(np.stack(at), 1.0), angle, radius,
                    limit, free, steps - taken,
                )  # fmt: skip
                to, c, rise, still, far, sound = (np.asarray(p)[: len(rows)] for p in state)
                moved[rows], ratio[rows], slope[rows], holds[rows] = to, c, rise, sound
                away.append(rows[far])
                used = int(did)
                if not still.any():
                    break
                rows, table, base = rows[still], table[still], base[still]
            most = max(most, used)
        taken += most
        rest = np.sort(np.concatenate(away))
    reached = 2.0 * np.arcsin(np.sqrt(np.clip(0.5 * ratio, 0.0, 1.0)))
    met = np.abs(reached - angle) <= _MET
    found.put(np.flatnonzero(holds), moved[holds], reached[holds], met[holds], taken)
    return np.flatnonzero(~holds)


def _columns(segments: Segments) -> tuple:
    start, end, direction, curvature = segments.fields
    return (*start.T, *end.T, *direction.T, curvature, np.hypot(*(end - start).T))


def _filled(rows: np.ndarray, value: float) -> np.ndarray:
    """Filled up along the last axis to one of a few sizes, by an eighth at most."""
    count = rows.shape[-1]
    unit = max(_FEWEST, 1 << max(0, count.bit_length() - 4))
    filled = np.full((len(rows), count + -count % unit), value, rows.dtype)
    filled[:, :count] = rows
    return filled


@partial(jax.jit, static_argnames=("method",))
def _newton(
    segments: Segments,
    centres: Array,
    directions: Array,
    table: Array,
    angle: float,
    radius: float,
    limit: float,
    steps: int,
    method: str,
) -> tuple[Array, Array, Array, Array]:
    """Distance moved, angle reached and whether it is met, shape (n,); and the steps taken."""
    near, there = segments[jnp.maximum(table, 0)], table >= 0
    normal = -left(directions)
    in_ratio = method == "ratio"
    target = 2.0 * jnp.sin(0.5 * angle) ** 2 if in_ratio else jnp.asarray(angle)

    def value(x: Array) -> Array:
        found = contact(centres + x[:, None] * normal, directions, radius, near, there)
        return found.depth_ratio if in_ratio else found.angle

    def value_and_slope(x: Array) -> tuple[Array, Array]:
        if method == "difference":
            h, here = _DIFFERENCE * radius, value(x)
            return here, (value(x + h) - here) / h
        return jax.jvp(value, (x,), (jnp.ones_like(x),))

    def wanting(state: tuple[Array, Array, Array]) -> Array:
        _, last, count = state
        return (count < steps) & jnp.any(jnp.abs(last) > _SETTLED * radius)

    def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, _, count = state
        here, slope = value_and_slope(x)
        flat = jnp.abs(slope) < 1e-12
        change = jnp.where(flat, 0.0, (target - here) / jnp.where(flat, 1.0, slope))
        new = jnp.clip(x + change, -limit, limit)
        return new, new - x, count + 1

    zero = jnp.zeros(len(centres))
    if method == "difference":
        x, _, count = step((zero, zero, jnp.asarray(0)))
    else:
        x, _, count = jax.lax.while_loop(
            wanting, step, (zero, jnp.full_like(zero, jnp.inf), jnp.asarray(0))
        )
    found = contact(centres + x[:, None] * normal, directions, radius, near, there)
    met = jnp.abs(found.angle - angle) <= _MET
    return x, found.angle, met, count


class _Pieces(NamedTuple):
    """Pieces near each place, coordinate by coordinate so that places fill the vector units."""

    x: Array
    y: Array
    end_x: Array
    end_y: Array
    tangent_x: Array
    tangent_y: Array
    curvature: Array
    span: Array
    present: Array


def _crossing(
    pieces: _Pieces, x: Array, y: Array, t: tuple[Array, Array], r: float
) -> tuple[Array, Array, Array]:
    """Depth ratio c, its slope dc/dx, and whether the rim goes into the stock there for good.

    That is not so where no crossing leads, and where the flank at the wall is not in the stock.
    """
    tx, ty = t
    side_x, side_y = -ty, tx
    sx, sy, ex, ey, dx, dy, kappa, span, present = pieces
    nx, ny = -dy, dx
    wx, wy, vx, vy = x - sx, y - sy, x - ex, y - ey
    squared = wx * wx + wy * wy
    level = 0.5 * kappa * (squared + r * r) - (nx * wx + ny * wy)
    gx, gy = r * (kappa * wx - nx), r * (kappa * wy - ny)
    steepness = gx * gx + gy * gy
    square = steepness - level * level
    real = square > 0.0
    root = jnp.sqrt(jnp.where(real, square, 1.0))
    inverse = 1.0 / jnp.where(steepness > 0.0, steepness, 1.0)
    cx, cy = ex - sx, ey - sy
    out_first, out_last = squared >= r * r, vx * vx + vy * vy >= r * r
    both = (out_first == out_last) & real
    slack = 1e-9 * r

    def crossing(swing: Array, passes: Array) -> tuple[Array, Array, Array]:
        px = (-level * gx - swing * gy) * inverse
        py = (-level * gy + swing * gx) * inverse
        qx, qy = wx + r * px, wy + r * py
        along = qx * cx + qy * cy
        above = (cx * qy - cy * qx) * jnp.sign(kappa)
        within = (along >= -slack * span) & (along <= span * (span + slack))
        within &= above <= slack * span
        here = (passes | (both & within)) & present & (px * tx + py * ty >= 0.0)
        return jnp.where(here, px * side_x + py * side_y, jnp.inf), px, py

    across, px, py = crossing(root, ~out_first & out_last)
    entering, _, _ = crossing(-root, out_first & ~out_last)
    chosen = jnp.argmin(across, axis=0)[None]
    across, px, py, kappa, wx, wy, nx, ny = (
        jnp.take_along_axis(a, chosen, axis=0)[0] for a in (across, px, py, kappa, wx, wy, nx, ny)
    )
    goes_in = (across < jnp.min(entering, axis=0)) & (across < jnp.inf)
    hx, hy = kappa * (wx + r * px) - nx, kappa * (wy + r * py) - ny
    steep = r * (hy * px - hx * py)
    found = goes_in & (steep != 0.0)
    turned = (px * side_y - py * side_x) / jnp.where(found, steep, 1.0)
    slope = (hx * side_x + hy * side_y) * turned
    found &= slope != 0.0
    return jnp.where(found, 1.0 + across, 0.0), slope, found


@jax.jit
def _moved(
    fields: tuple[Array, ...],
    table: Array,
    places: Array,
    angle: float,
    radius: float,
    limit: float,
    free: float,
    steps: int,
) -> tuple[Array, Array, Array, Array, Array, Array, Array | int]:
    """Distance moved, c reached, its slope, who wants more steps, who waits, who is sound; steps.

    Places that moved by more than `free` wait for their pieces to be looked up anew. Where c and
    its slope are not given with the places, only these are found.
    """
    number = jnp.maximum(table, 0)
    pieces = _Pieces._make([*(field[number] for field in fields), table >= 0])
    x, y, tx, ty, base, moved, *known = places
    target = 2.0 * jnp.sin(0.5 * angle) ** 2
    near_enough = _SETTLED * jnp.sin(angle)

    def at(moved: Array) -> tuple[Array, Array, Array]:
        return _crossing(pieces, x + moved * ty, y - moved * tx, (tx, ty), radius)

    def wanting(state: tuple) -> Array:
        return (state[-1] < steps) & jnp.any(state[3])

    def step(state: tuple) -> tuple:
        at_hand, ratio, slope, open_, far, holds, count = state
        change = jnp.where(open_, (target - ratio) / jnp.where(open_, slope, 1.0), 0.0)
        new = jnp.clip(at_hand + change, -limit, limit)
        ratio, slope, found = at(new)
        far |= jnp.abs(new - base) > free
        holds &= found | far
        open_ &= found & ~far & (jnp.abs(ratio - target) > near_enough)
        open_ &= jnp.abs(new - at_hand) > _SETTLED * radius
        return new, ratio, slope, open_, far, holds, count + 1

    if known:
        ratio, slope = known
        holds = slope != 0.0
    else:
        ratio, slope, holds = at(moved)
    open_ = holds & (jnp.abs(ratio - target) > near_enough)
    state = (moved, ratio, slope, open_, jnp.zeros_like(open_), holds, 0)
    if known:
        state = jax.lax.while_loop(wanting, step, state)
    new, ratio, slope, open_, far, holds, count = state
    return new, ratio, slope, open_, far, holds, count
