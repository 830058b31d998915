"""Tool paths of constant engagement: what a path does, and the corrected one.

Lengths in mm, angles in rad inside and degrees in what is reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from procmodel.engagement import STATUS, engagement_angle_constant_curvature
from procmodel.engagement.angle import AIR, CORNER_TOO_SMALL, require_target
from procmodel.engagement.backward import previous_pass
from procmodel.engagement.contour import Contour, Stations, corner_turns, stations
from procmodel.engagement.floor import unavoidable_angle
from procmodel.engagement.forward import passes as forward_passes
from procmodel.engagement.offset import offset
from procmodel.engagement.segments import distance_to, end_directions, joined
from procmodel.engagement.surface import Engagement, Surface, cleared_by, previous_surface
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

METHODS = ("backward", "forward")
# A turn [rad] beyond what coordinates rounded to 0.1 um make of a smooth path.
_SHARP = 0.01
# Greatest number of places that a path is looked at.
_MOST_PLACES = 4_000_000


@dataclass(frozen=True)
class Survey:
    """Engagement along one pass.

    Attributes
    ----------
    path : list of Contour
        Of the tool centre, wall to the right.
    surface : Surface
        What the pass meets.
    places : list of Stations
        Along each contour of the path.
    angle, area_rate, total : ndarray, shape (n,) [rad, mm, rad]
        At all places, one contour after the other.
    status : ndarray of int, shape (n,)
        Key into `procmodel.engagement.STATUS`.
    target : float [rad]
        Engagement angle that is wanted.
    """

    path: list[Contour]
    surface: Surface
    places: list[Stations]
    angle: np.ndarray
    area_rate: np.ndarray
    total: np.ndarray
    status: np.ndarray
    target: float

    @property
    def weight(self) -> np.ndarray:
        """Way that every place stands for [mm], shape (n,)."""
        weights = []
        for at in self.places:
            gap = np.where(np.diff(at.segment) == 0, np.diff(at.way), 0.0)
            weights.append(0.5 * (np.append(gap, 0.0) + np.append(0.0, gap)))
        return np.concatenate(weights)

    @property
    def overshoot(self) -> float:
        """Greatest engagement angle over the target, less 1."""
        return float(np.max(self.angle)) / self.target - 1.0

    def as_dict(self) -> dict[str, Any]:
        """Figures in degrees and per cent, over all places that cut, weighted by their way."""
        cuts = self.status != AIR
        degrees, weight = np.degrees(self.angle[cuts]), self.weight[cuts]
        codes, counts = np.unique(self.status, return_counts=True)
        names = [STATUS[int(c)].split(":")[0].replace(" ", "_") for c in codes]
        figures: dict[str, Any] = dict.fromkeys(("min_deg", "max_deg", "p99_deg", "mean_deg"))
        if len(degrees):
            order = np.argsort(degrees)
            share = np.cumsum(weight[order]) / np.sum(weight)
            figures = {
                "min_deg": float(degrees.min()),
                "max_deg": float(degrees.max()),
                "p99_deg": float(degrees[order][min(np.searchsorted(share, 0.99), len(order) - 1)]),
                "mean_deg": float(np.sum(degrees * weight) / np.sum(weight)),
            }
        figures["overshoot_percent"] = 100.0 * self.overshoot
        figures["points"] = len(self.angle)
        figures["statuses"] = dict(zip(names, counts.tolist(), strict=True))
        return figures


@dataclass(frozen=True)
class PathPlan:
    """A corrected path beside the plain one.

    Attributes
    ----------
    method : {"backward", "forward"}
        Which algorithm.
    target : float [rad]
        Engagement angle that is held.
    radius, previous_radius : float [mm]
        Radius of the tool, and of that of the passes before the last.
    before : Survey
        The last pass, on the surface that a parallel pass leaves.
    after : Survey
        The last pass, on the surface that the corrected passes leave.
    surveys : list of Survey
        Every pass whose engagement is held, in the order of cutting; the last is `after`.
    passes : list of list of Contour
        All paths in the order of cutting.
    floor : float [rad]
        Greatest angle of the last pass that no previous pass can avoid.
    miss : tuple of float [mm]
        Least and greatest stock that the last pass leaves on the wall; below 0 where it cuts
        deeper.
    notes : tuple of str
        What to know about the plan, as sentences.
    """

    method: str
    target: float
    radius: float
    previous_radius: float
    before: Survey
    after: Survey
    surveys: list[Survey]
    passes: list[list[Contour]]
    floor: float
    miss: tuple[float, float]
    notes: tuple[str, ...] = field(default=())

    def as_dict(self) -> dict[str, Any]:
        """Figures as the command prints them."""
        after = self.after.as_dict()
        return {
            "method": self.method,
            "target_deg": float(np.degrees(self.target)),
            "before": self.before.as_dict(),
            "after": after,
            "passes": [survey.as_dict() for survey in self.surveys],
            "floor_percent": 100.0 * (self.floor / self.target - 1.0),
            "left_on_wall_mm": {"min": self.miss[0], "max": self.miss[1]},
            "points": after["points"],
            "statuses": after["statuses"],
            "notes": list(self.notes),
        }


def survey(
    path: Sequence[Contour], surface: Surface, radius: float, target: float, spacing: float
) -> Survey:
    """Engagement along a pass.

    Parameters
    ----------
    path : sequence of Contour
        Of the tool centre, wall to the right.
    surface : Surface
        What the pass meets; beyond the ends of open contours it goes on straight.
    radius : float [mm]
        Tool radius.
    target : float [rad]
        Engagement angle that is wanted.
    spacing : float [mm]
        Greatest distance of the places.

    Returns
    -------
    Survey
        The engagement; corners into which the tool does not fit are marked.

    Raises
    ------
    InputError
        If the spacing asks for more than four million places.
    """
    require_float64("a path")
    length = sum(contour.length for contour in path)
    if length / spacing > _MOST_PLACES:
        raise InputError(
            f"{length / spacing:.3g} places of {spacing:g} mm on {length:.4g} mm of path are more "
            f"than {_MOST_PLACES}: take a larger spacing."
        )
    places = [stations(contour, spacing) for contour in path]
    met = surface
    if not all(c.closed for c in surface.contours):
        met = Surface([_lengthened(c, 2.0 * radius) for c in surface.contours])
    found: Engagement = met.engagement(
        np.concatenate([at.point for at in places]),
        np.concatenate([at.direction for at in places]),
        radius,
    )
    corner = np.concatenate([_at_tight_corner(c, at) for c, at in zip(path, places, strict=True)])
    status = np.where(corner & (found.status != AIR), CORNER_TOO_SMALL, found.status)
    return Survey(
        list(path), surface, places, found.angle, found.area_rate, found.total, status, target
    )


def finished_path(walls: Sequence[Contour], radius: float) -> list[Contour]:
    """Path of the last pass: parallel to the walls.

    Parameters
    ----------
    walls : sequence of Contour
        Finished walls, free side to the left.
    radius : float [mm]
        Tool radius.

    Returns
    -------
    list of Contour
        The path.

    Raises
    ------
    InputError
        If the tool finds no room between the walls.
    """
    path = offset(walls, radius)
    if not path:
        raise InputError(
            f"a tool of diameter {2 * radius:g} mm finds no room between the walls: take a smaller "
            "tool."
        )
    return path


def target_angle(radial_depth: float, radius: float, target: float | None = None) -> float:
    """Engagement angle to hold, checked: that of the straight line unless given.

    Parameters
    ----------
    radial_depth, radius : float [mm]
        Radial depth of cut, and tool radius.
    target : float, optional [rad]
        What is wanted.

    Returns
    -------
    float [rad]
        The angle.

    Raises
    ------
    InputError
        If radius, depth or angle are impossible.
    """
    if not 0.0 < radius < np.inf:
        raise InputError(f"the tool diameter is {2 * radius:g} mm, but must be above 0.")
    if not 0.0 < radial_depth < 2.0 * radius:
        raise InputError(
            f"the radial depth is {radial_depth:g} mm, but must be above 0 and below the tool "
            f"diameter of {2 * radius:g} mm."
        )
    if target is None:
        return float(engagement_angle_constant_curvature(radial_depth, radius, 0.0))
    require_target(target)
    return target


def radius_before(previous_radius: float | None, radius: float) -> float:
    """Radius of the previous pass' tool, checked: that of this pass' tool unless given.

    Raises
    ------
    InputError
        If it is not above 0.
    """
    chosen = radius if previous_radius is None else previous_radius
    if not 0.0 < chosen < np.inf:
        raise InputError(f"the previous tool's diameter is {2 * chosen:g} mm, but must be above 0.")
    return chosen


def spacing_or_usual(spacing: float | None, radius: float) -> float:
    """Distance of the places looked at [mm], checked: a thousandth of the radius unless given.

    Raises
    ------
    InputError
        If it is not above 0.
    """
    chosen = radius / 1000.0 if spacing is None else spacing
    if not 0.0 < chosen < np.inf:
        raise InputError(f"the spacing is {chosen:g} mm, but must be above 0.")
    return chosen


def correct_path(
    walls: Sequence[Contour],
    radius: float,
    radial_depth: float,
    *,
    target: float | None = None,
    method: str = "backward",
    previous_radius: float | None = None,
    passes: int = 1,
    spacing: float | None = None,
) -> PathPlan:
    """Passes that hold the engagement angle along finished walls.

    Parameters
    ----------
    walls : sequence of Contour
        Finished walls, free side to the left (`procmodel.engagement.contour.oriented`).
    radius : float [mm]
        Tool radius.
    radial_depth : float [mm]
        Radial depth of cut on a straight wall.
    target : float, optional [rad]
        Engagement angle to hold; that of a straight wall when left out.
    method : {"backward", "forward"}
        Backward keeps the last pass and changes those before it (algorithm II); forward goes
        outwards from what is cleared and misses the wall in the end (algorithm I).
    previous_radius : float, optional [mm]
        Radius of the tool of the passes before the last, backward only; the same when left out.
    passes : int
        Passes that are corrected: backward, before the last; forward, all of them.
    spacing : float, optional [mm]
        Distance of the places at which engagement is looked at; a thousandth of the radius.

    Returns
    -------
    PathPlan
        The paths, and the engagement before and after.

    Raises
    ------
    InputError
        If something is impossible, or the tool finds no room.
    """
    require_float64("a path")
    angle = target_angle(radial_depth, radius, target)
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown{nearest(method, METHODS)}")
    if not 1 <= passes <= 1000:
        raise InputError(f"passes is {passes}, but must be 1 to 1000.")
    r2 = radius_before(previous_radius, radius)
    if method == "forward" and r2 != radius:
        raise InputError("forward has one tool for all passes: leave out the previous diameter.")
    step = spacing_or_usual(spacing, radius)
    last = finished_path(walls, radius)
    plain = previous_surface(walls, radial_depth, r2)
    before = survey(last, plain, radius, angle, step)
    notes: list[str] = []
    if method == "backward":
        surveys, chain = _backwards(last, angle, radius, r2, passes, step, notes)
        held = [*reversed(surveys)]
        cut = [*reversed(chain)]
    else:
        begin = previous_surface(walls, passes * radial_depth, radius)
        found = forward_passes(begin, angle, radius, passes)
        held = [survey(this.path, met, radius, angle, step) for this, met in found]
        cut = [this.path for this, _ in found]
        slowest = min(this.least_speed for this, _ in found)
        if slowest <= 0.0:
            notes.append(
                "the surface turns away faster than the tool can follow in places, and the "
                "engagement is not held there"
            )
    miss = _left_on_walls(cut[-1], walls, radius)
    if miss[1] > 1e-4 and method == "forward":
        notes.append(
            f"the last pass leaves up to {miss[1]:.4f} mm on the walls: algorithm I does not end "
            "on the finished contour; finish with a plain pass or take the backward method"
        )
    corners = int(np.sum(before.status == CORNER_TOO_SMALL)) // 2
    if corners:
        notes.append(
            f"{corners} corner(s) of the walls are narrower than the tool: material stays in them, "
            "and the tool turns on the spot"
        )
    floor = max(unavoidable_angle(c, angle, radius, r2) for c in last)
    return PathPlan(
        method, angle, radius, r2, before, held[-1], held, cut, floor, miss, tuple(notes)
    )


def _backwards(
    last: list[Contour],
    angle: float,
    radius: float,
    previous_radius: float,
    count: int,
    spacing: float,
    notes: list[str],
) -> tuple[list[Survey], list[list[Contour]]]:
    """Passes inwards from the last one, and what each held one meets."""
    surveys, chain = [], [last]
    for number in range(count):
        tool = radius if number == 0 else previous_radius
        try:
            inner = previous_pass(chain[-1], angle, tool, previous_radius)
        except InputError:
            if number == 0:
                raise
            notes.append(
                f"only {number} of {count} passes find room inside the pocket; the rest is left out"
            )
            break
        surveys.append(survey(chain[-1], inner.surface, tool, angle, spacing))
        chain.append(inner.path)
    return surveys, chain


def _left_on_walls(
    path: Sequence[Contour], walls: Sequence[Contour], radius: float
) -> tuple[float, float]:
    """Least and greatest distance from what is cleared to the walls, beside the cleared side."""
    boundary = cleared_by(path, radius)
    points = np.concatenate(
        [_away_from_ends(c, stations(c, 0.05 * radius), 2.0 * radius).point for c in boundary]
    )
    wall = joined([w.segments.on_host() for w in walls])
    gaps = np.empty(len(points))
    for chunk in np.array_split(
        np.arange(len(points)), max(1, len(points) * len(wall) // 2_000_000)
    ):
        near = distance_to(
            wall[np.tile(np.arange(len(wall)), len(chunk))],
            np.repeat(points[chunk], len(wall), axis=0),
            np,
        )
        gaps[chunk] = near.reshape(len(chunk), -1).min(axis=1)
    beyond = Surface(walls).in_stock(points) & (gaps > 1e-7 * radius)
    signed = np.where(beyond, -gaps, gaps)
    return float(signed.min()), float(signed.max())


def _lengthened(path: Contour, length: float) -> Contour:
    """An open contour with a straight piece before and after it: the rim reaches past its ends."""
    # Parallel curves of rounded open paths keep slivers, which are no walls that go on.
    if path.closed or path.length < 1e-3 * length:
        return path
    pieces, points = path.segments.on_host(), np.asarray(path.points)
    before = points[0] - length * pieces.direction[0]
    after = points[-1] + length * end_directions(pieces, np)[-1]
    return Contour(
        np.concatenate([before[None], points, after[None]]),
        np.pad(np.asarray(path.bulges), 1),
        False,
        path.name,
    )


def _away_from_ends(path: Contour, at: Stations, radius: float) -> Stations:
    """All places of a closed path, and those of an open one that are a radius from its ends."""
    length = float(at.way[-1])
    if path.closed or length <= 3.0 * radius:
        return at
    inner = (at.way >= radius) & (at.way <= length - radius)
    fields = (at.point, at.direction, at.curvature, at.way, at.segment)
    return Stations(*(value[inner] for value in fields))


def _at_tight_corner(path: Contour, at: Stations) -> np.ndarray:
    """Places at vertices where the path turns sharply towards the free side."""
    turns = corner_turns(path)
    if not path.closed:
        turns = np.concatenate([[0.0], turns])
    sharp = turns > _SHARP
    first = np.append(True, np.diff(at.segment) != 0)
    last = np.append(np.diff(at.segment) != 0, True)
    following = np.roll(sharp, -1)
    if not path.closed:
        following[-1] = False
    return (first & sharp[at.segment]) | (last & following[at.segment])
