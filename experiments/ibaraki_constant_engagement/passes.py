"""The last pass on the plain and on the corrected surface; algorithm I; the paper's Newton step.

Ways along the open wall count from the beginning of the arc. Only what lies well inside the open
wall is judged: at its ends the surface of the previous pass is missing. Lengths in mm, angles in
rad.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from calibration.plans.path import PathPlan, Survey, correct_path, finished_path, survey
from experiments.ibaraki_constant_engagement.conditions import (
    Conditions,
    closed_pocket,
    open_wall,
)
from procmodel.engagement import (
    Surface,
    engagement_angle_constant_curvature,
    engagement_angle_entering_arc,
    move_places,
    previous_pass,
    previous_surface,
    stations,
)
from procmodel.engagement.backward import BackwardPass
from procmodel.engagement.contour import Contour, part
from procmodel.engagement.floor import junction_kinks, unavoidable_angle
from procmodel.engagement.forward import passes

_SPACING = 0.002
_POCKET_SPACING = 0.05
# Of the line on either side, what is looked at.
_LOOKED_AT = 6.5
# Distance of the places in the paper's Newton mode; the paper gives none.
_NEWTON_SPACING = 0.05
# Step of algorithm I and of its survey; forgetting takes r sin(alpha) = 1 mm.
_FORWARD_STEP = 0.02


@dataclass(frozen=True)
class OpenWall:
    """The paper's wall, cut by the last pass on two surfaces.

    Attributes
    ----------
    path : Contour
        Of the tool centre in the last pass, kept by algorithm II.
    target, floor : float [rad]
        Engagement that is held, and the greatest that no previous pass avoids.
    way : ndarray, shape (n,) [mm]
        From the beginning of the arc.
    before, after : Survey
        On the parallel surface and on the corrected one.
    corrected : BackwardPass
        The previous pass of algorithm II.
    kinks : ndarray, shape (2,) [rad]
        Of the surface that would hold the engagement everywhere.
    """

    path: Contour
    target: float
    floor: float
    way: np.ndarray
    before: Survey
    after: Survey
    corrected: BackwardPass
    kinks: np.ndarray


def target_on_line(conditions: Conditions) -> float:
    """Engagement on a line, which is to be held [rad]."""
    return float(
        engagement_angle_constant_curvature(conditions.radial_depth, conditions.radius, 0.0)
    )


def on_open_wall(conditions: Conditions) -> OpenWall:
    """Both surfaces and the engagement of the last pass with them."""
    r, target = conditions.radius, target_on_line(conditions)
    wall = open_wall(conditions)
    (path,) = finished_path([wall], r)
    begin, turn = conditions.line - _LOOKED_AT, conditions.path_turn
    looked_at = part(path, begin, conditions.line + turn + _LOOKED_AT)
    plain = previous_surface([wall], conditions.radial_depth, r)
    corrected = previous_pass([path], target, r)
    before = survey([looked_at], plain, r, target, _SPACING)
    after = survey([looked_at], corrected.surface, r, target, _SPACING)
    return OpenWall(
        path=path,
        target=target,
        floor=unavoidable_angle(path, target, r),
        way=before.places[0].way - _LOOKED_AT,
        before=before,
        after=after,
        corrected=corrected,
        kinks=junction_kinks(path, target, r),
    )


def at_ways(wall: OpenWall, surface: Surface, ways: np.ndarray, radius: float) -> np.ndarray:
    """Engagement at ways from the beginning of the arc, shape (n,) [rad]."""
    pieces = wall.path.segments.on_host()
    k = float(pieces.curvature[1])
    turn = np.clip(ways, 0.0, np.pi / (2.0 * k)) * k
    beyond = np.maximum(ways - np.pi / (2.0 * k), 0.0)
    start = pieces.start[1]
    point = start + np.column_stack(
        [np.minimum(ways, 0.0) + np.sin(turn) / k, (1.0 - np.cos(turn)) / k + beyond]
    )
    direction = np.column_stack([np.cos(turn), np.sin(turn)])
    return surface.engagement(point, direction, radius).angle


def transition_ways(wall: OpenWall, conditions: Conditions) -> tuple[float, float]:
    """How far before the arc engagement begins to rise, and before its end to fall [mm]."""
    fine = np.arange(-1.2, 0.0, 1e-4)
    out = conditions.path_turn
    surface, r = wall.before.surface, conditions.radius
    entering = at_ways(wall, surface, fine, r)
    leaving = at_ways(wall, surface, out + fine, r)
    changed = 1e-10
    rises = fine[np.argmax(entering > wall.target + changed)]
    falls = fine[np.argmax(leaving < leaving[0] - changed)]
    return -float(rises), -float(falls)


def closed_form(ways: np.ndarray, conditions: Conditions) -> np.ndarray:
    """Engagement of the plain path along line, arc and line, in closed form.

    Parameters
    ----------
    ways : ndarray, shape (n,) [mm]
        From the beginning of the arc.
    conditions : Conditions
        The cut.

    Returns
    -------
    ndarray, shape (n,) [rad]
        Entering by `engagement_angle_entering_arc`. At an angle theta before the end of the arc,
        once the rim leaves the stock on the second line: theta + acos((Rw - Rc cos(theta)) / r),
        Rc = Rp - r, Rw = Rp - ae, which begins at sin(theta) = r sin(alpha) / Rw.
    """
    r, ae, bend = conditions.radius, conditions.radial_depth, conditions.corner
    entering = np.asarray(engagement_angle_entering_arc(np.maximum(-ways, 0.0), ae, r, bend))
    theta = np.clip((conditions.path_turn - ways) / conditions.path_arc, 0.0, None)
    line_at = bend - ae
    last = np.arcsin(r * np.sin(entering.max()) / line_at)
    cosine = (line_at - conditions.path_arc * np.cos(theta)) / r
    leaving = theta + np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.where((ways > 0.0) & (theta < last), leaving, entering)


def on_pocket(conditions: Conditions) -> PathPlan:
    """The closed pocket by algorithm II."""
    return correct_path(
        [closed_pocket(conditions)],
        conditions.radius,
        conditions.radial_depth,
        spacing=_POCKET_SPACING,
    )


@dataclass(frozen=True)
class ForwardPasses:
    """Algorithm I on the open wall, from a parallel surface outwards.

    Attributes
    ----------
    way, miss : list of ndarray [mm]
        Of every pass: way along the path that it should have followed, and stock between the
        surface that it leaves and the one wanted; below 0 where it cuts deeper.
    off : tuple of float [rad]
        Greatest distance of the engagement from the target in every pass.
    """

    way: list[np.ndarray]
    miss: list[np.ndarray]
    off: tuple[float, ...]


def forward_on_open_wall(conditions: Conditions, target: float) -> ForwardPasses:
    """Passes of algorithm I that were to end on the wall."""
    r, count = conditions.radius, conditions.forward_passes
    first = Surface([open_wall(conditions, count * conditions.radial_depth)])
    ways, misses, off = [], [], []
    for number, (this, met) in enumerate(passes(first, target, r, count, _FORWARD_STEP), start=1):
        (path,) = this.path
        inner = part(path, 8.0, path.length - 8.0)
        seen = survey([inner], met, r, target, _FORWARD_STEP)
        off.append(float(np.max(np.abs(seen.angle - target))))
        at = stations(inner, _FORWARD_STEP)
        right = np.column_stack([at.direction[:, 1], -at.direction[:, 0]])
        way, distance = _along_wall(at.point + r * right, conditions)
        wanted = (count - number) * conditions.radial_depth
        ways.append(way)
        misses.append(distance - wanted)
    return ForwardPasses(ways, misses, tuple(off))


def _along_wall(points: np.ndarray, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
    """Way of the tool's centre beside points near the wall, and their distance from the wall."""
    bend, rc, out = conditions.corner, conditions.path_arc, conditions.path_turn
    x, y = points.T
    turn = np.arctan2(x, bend - y)
    way = np.select([x < 0.0, y > bend], [x, out + y - bend], rc * turn)
    distance = np.select([x < 0.0, y > bend], [y, bend - x], bend - np.hypot(x, y - bend))
    return way, distance


def one_step_of_surface(conditions: Conditions, target: float) -> tuple[float, float]:
    """The paper's step in algorithm II, in the arc: the surface is moved, not the path.

    Parameters
    ----------
    conditions : Conditions
        The cut.
    target : float [rad]
        Engagement that is wanted.

    Returns
    -------
    in_angle, in_cosine : float [rad]
        Engagement in the arc after one step for the radial depth, in the angle and in its cosine.
    """
    ae, r, curvature = conditions.radial_depth, conditions.radius, 1.0 / conditions.corner

    def angle(depth: Any) -> Any:
        return engagement_angle_constant_curvature(depth, r, curvature)

    def cosine(depth: Any) -> Any:
        return jnp.cos(angle(depth))

    in_angle = ae + (target - angle(ae)) / jax.grad(angle)(ae)
    in_cosine = ae + (np.cos(target) - cosine(ae)) / jax.grad(cosine)(ae)
    return float(angle(in_angle)), float(angle(in_cosine))


@dataclass(frozen=True)
class NewtonSteps:
    """Places of the plain path moved towards the target engagement.

    Attributes
    ----------
    way : ndarray, shape (n,) [mm]
        From the beginning of the arc.
    one_step : ndarray, shape (n,) [rad]
        Angle after one finite-difference step in the angle, from the given path.
    continued : ndarray, shape (n,) [rad]
        The same, each place beginning from the distance that the place before was moved.
    one_ratio : ndarray, shape (n,) [rad]
        After one step in 1 - cos(alpha), with an exact derivative.
    converged : ndarray, shape (n,) [rad]
        After as many as needed.
    moved : ndarray, shape (n,) [mm]
        How far those moved, towards the wall positive.
    middle : int
        Number of the place in the middle of the arc.
    """

    way: np.ndarray
    one_step: np.ndarray
    continued: np.ndarray
    one_ratio: np.ndarray
    converged: np.ndarray
    moved: np.ndarray
    middle: int


def newton_on_plain_path(wall: OpenWall, conditions: Conditions) -> NewtonSteps:
    """The paper's mode of algorithm I, and what an exact derivative in the cosine does instead."""
    r, surface = conditions.radius, wall.before.surface
    inner = part(wall.path, conditions.line - 2.0, conditions.line + conditions.path_turn + 2.0)
    at = stations(inner, _NEWTON_SPACING)
    places = at.point, at.direction
    one = move_places(surface, *places, wall.target, r, method="difference")
    ratio = move_places(surface, *places, wall.target, r, method="ratio", steps=1)
    full = move_places(surface, *places, wall.target, r, method="ratio")
    normal = np.column_stack([at.direction[:, 1], -at.direction[:, 0]])
    continued, x = np.empty(len(at)), 0.0
    for i in range(len(at)):
        begin = (at.point[i] + x * normal[i])[None]
        step = move_places(
            surface, begin, at.direction[i][None], wall.target, r, method="difference"
        )
        x += float(step.moved[0])
        continued[i] = step.angle[0]
    way = at.way - 2.0
    middle = int(np.argmin(np.abs(way - 0.5 * conditions.path_turn)))
    return NewtonSteps(way, one.angle, continued, ratio.angle, full.angle, full.moved, middle)
