"""Algorithm I, forward: keep the surface of the previous pass and move this pass.

As an ordinary differential equation along the surface W(u): the rim of the tool leaves the stock
at W(u), q = W - o has the length r, the feed direction t is q / r turned by 90 degrees minus the
engagement angle to the left, and

    do/du = (W'(u) . q) / (r sin(alpha)) t.

It holds while W' . q > 0, and forgets where it began within r sin(alpha) of way, so that a second
lap closes a loop. Lengths in mm, angles in rad.

References
----------
.. [1] S. Ibaraki, I. Ikeda, A. Yamaji, Y. Kakino, S. Nishida, section 2.1, eqs (1), (2).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from procmodel.engagement.angle import require_target
from procmodel.engagement.biarcs import through
from procmodel.engagement.contour import Contour
from procmodel.engagement.segments import Segments, advance, dot, lengths, turned
from procmodel.engagement.surface import Surface, cleared_by

# Steps in the length r sin(alpha) within which the tool forgets where it came from.
_STEPS_TO_FORGET = 500
_COARSEST = 16.0


@dataclass(frozen=True)
class ForwardPass:
    """A pass of constant engagement on a given surface.

    Attributes
    ----------
    path : list of Contour
        Of the tool centre, wall to the right; one for each closed contour of the surface.
    closing_gap : float [mm]
        How far the second lap ends from where it began; 0 for open contours.
    least_speed : float
        Least way of the tool for a way along the surface; not above 0 where the surface turns
        away faster than the tool can follow.
    """

    path: list[Contour]
    closing_gap: float
    least_speed: float


def march(
    points: Array, tangents: Array, steps: Array, angle: float, radius: float, start: Array
) -> tuple[Array, Array, Array]:
    """Follow a surface at constant engagement, by the classical Runge-Kutta method.

    Parameters
    ----------
    points, tangents : array_like, shape (n, 3, 2) [mm, -]
        The surface and its unit tangent at the begin, middle and end of every step.
    steps : array_like, shape (n,) [mm]
        Length of every step along the surface.
    angle : float [rad]
        Engagement angle.
    radius : float [mm]
        Tool radius.
    start : array_like, shape (2,) [mm]
        Tool centre at the start.

    Returns
    -------
    centre, direction : Array, shape (n, 2) [mm, -]
        After every step.
    speed : Array, shape (n,)
        Way of the tool for a way along the surface, at the end of every step.
    """

    def motion(point: Array, tangent: Array, centre: Array) -> tuple[Array, Array, Array]:
        q = point - centre
        q = q * (radius / jnp.sqrt(dot(q, q)))
        direction = turned(q / radius, jnp.asarray(0.5 * jnp.pi - angle))
        speed = dot(tangent, q) / (radius * jnp.sin(angle))
        return speed * direction, direction, speed

    def step(centre: Array, at: tuple[Array, Array, Array]) -> tuple[Array, tuple]:
        point, tangent, h = at
        k1, _, _ = motion(point[0], tangent[0], centre)
        k2, _, _ = motion(point[1], tangent[1], centre + 0.5 * h * k1)
        k3, _, _ = motion(point[1], tangent[1], centre + 0.5 * h * k2)
        k4, _, _ = motion(point[2], tangent[2], centre + h * k3)
        centre = centre + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        # The distance from the surface does not settle by itself as the direction does.
        q = point[2] - centre
        centre = point[2] - q * (radius / jnp.sqrt(dot(q, q)))
        _, direction, speed = motion(point[2], tangent[2], centre)
        return centre, (centre, direction, speed)

    surface = (jnp.asarray(points), jnp.asarray(tangents), jnp.asarray(steps))
    _, found = jax.lax.scan(step, jnp.asarray(start), surface)
    return found


_march = jax.jit(march)


def forward_pass(
    surface: Surface, angle: float, radius: float, step: float | None = None
) -> ForwardPass:
    """Pass that has a given engagement angle everywhere on the surface of the previous one.

    Parameters
    ----------
    surface : Surface
        What the previous pass left.
    angle : float [rad]
        Engagement angle.
    radius : float [mm]
        Tool radius.
    step : float, optional [mm]
        Finest step along the surface, taken where its curvature has just jumped; r sin(alpha) / 500
        when left out. Farther on the steps grow as the path calms down.

    Returns
    -------
    ForwardPass
        The pass; of each closed contour the second lap.

    Raises
    ------
    InputError
        If the angle is not between 0 and pi.
    """
    require_target(angle)
    forgets = radius * np.sin(angle)
    finest = forgets / _STEPS_TO_FORGET if step is None else step
    paths, gap, slowest = [], 0.0, np.inf
    for boundary in surface.contours:
        pieces = boundary.segments.on_host()
        ways = _graded(boundary, finest, forgets)
        points, tangents, steps = _stages(pieces, ways)
        arm = np.asarray(angle - 0.5 * np.pi)
        first = points[0, 0] - radius * turned(tangents[0, 0], arm, np)
        laps = 2 if boundary.closed else 1
        found = _march(
            np.tile(points, (laps, 1, 1)), np.tile(tangents, (laps, 1, 1)), np.tile(steps, laps),
            angle, radius, first,
        )  # fmt: skip
        centre, direction, speed = (np.asarray(a) for a in found)
        if boundary.closed:
            lap = len(steps)
            gap = max(gap, float(np.hypot(*(centre[-1] - centre[lap - 1]))))
            centre, direction, speed = centre[lap:], direction[lap:], speed[lap:]
        else:
            centre = np.concatenate([first[None], centre])
            direction = np.concatenate([tangents[:1, 0], direction])
        slowest = min(slowest, float(speed.min()))
        paths.append(through(centre, direction, boundary.closed, boundary.name))
    return ForwardPass(paths, gap, slowest)


def _graded(boundary: Contour, finest: float, forgets: float) -> np.ndarray:
    """Ends of the steps [mm]: fine where a line or arc begins, then growing.

    Behind a jump the path's curvature settles as exp(-way / forgets). Joined by pairs of arcs its
    angle errs by the square of a step times the change of curvature, so steps may grow as the root
    of the inverse.
    """
    pieces = boundary.segments.on_host()
    length = lengths(pieces, np)
    begins = np.cumsum(length) - length
    coarsest = _COARSEST * finest
    # way(k) = -2 forgets log(1 - k / growth), until the steps are the coarsest.
    growth = 2.0 * forgets / finest
    number = np.arange(1, int(growth * (1.0 - 1.0 / _COARSEST)) + 1)
    graded = -2.0 * forgets * np.log1p(-number / growth)
    ends, waiting = [], False
    for begin, long in zip(begins, length, strict=True):
        if long <= coarsest:
            # Half of a pair of arcs, left by an earlier pass whose steps were as fine as needed.
            if waiting:
                ends.append(np.array([begin + long]))
            waiting = not waiting
            continue
        if waiting:
            ends.append(np.array([begin]))
            waiting = False
        way = graded[graded < long - finest]
        done = way[-1] if len(way) else 0.0
        even = max(1, int(np.ceil((long - done) / coarsest)))
        ends += [begin + way, begin + done + (long - done) * np.arange(1, even + 1) / even]
    if waiting:
        ends.append(begins[-1:] + length[-1:])
    return np.concatenate(ends)


def _stages(pieces: Segments, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface and tangent at begin, middle and end of every step; and the steps."""
    begins = np.concatenate([[0.0], ends[:-1]])
    steps = ends - begins
    first = np.concatenate([[0.0], np.cumsum(lengths(pieces, np))])
    # The piece of a stage is looked up just inside its step, so that a kink is seen from its side.
    within = np.stack([begins + 1e-6 * steps, begins + 0.5 * steps, ends - 1e-6 * steps], axis=1)
    owner = np.clip(np.searchsorted(first, within, side="right") - 1, 0, len(pieces) - 1)
    way = np.stack([begins, begins + 0.5 * steps, ends], axis=1) - first[owner]
    chosen = pieces[owner]
    points, tangents = advance(chosen.start, chosen.direction, chosen.curvature, way, np)
    return points, tangents, steps


def passes(
    surface: Surface, angle: float, radius: float, count: int, step: float | None = None
) -> list[tuple[ForwardPass, Surface]]:
    """Passes of constant engagement outwards, each on the surface that the one before left.

    Parameters
    ----------
    surface : Surface
        What is cleared at the beginning.
    angle, radius, step
        As for `forward_pass`.
    count : int
        Number of passes.

    Returns
    -------
    list of (ForwardPass, Surface)
        Every pass and the surface that it met.
    """
    found = []
    for _ in range(count):
        this = forward_pass(surface, angle, radius, step)
        found.append((this, surface))
        surface = Surface(cleared_by(this.path, radius))
    return found
