"""What an existing program does along a finished wall: its passes in their order."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.plans.path import (
    Survey,
    finished_path,
    radius_before,
    spacing_or_usual,
    survey,
    target_angle,
)
from procmodel.engagement.contour import Contour
from procmodel.engagement.floor import unavoidable_angle
from procmodel.engagement.surface import Surface, cleared_by, previous_surface
from procmodel.errors import InputError


@dataclass(frozen=True)
class PathCheck:
    """Engagement of every pass of a program.

    Attributes
    ----------
    surveys : list of Survey
        In the order of cutting. In up milling everything is seen in a mirror, x reversed.
    walls : list of Contour
        Finished walls, seen likewise.
    milling : {"down", "up"}
        Down where the wall is to the right of the tool (for a spindle that turns clockwise).
    floor : float [rad]
        Greatest angle along the parallel path that no previous pass can avoid.
    """

    surveys: list[Survey]
    walls: list[Contour]
    milling: str
    floor: float

    def as_dict(self) -> dict[str, Any]:
        """Figures as the command prints them; `engagement` is that of the last pass."""
        last = self.surveys[-1].as_dict()
        target = self.surveys[-1].target
        return {
            "target_deg": float(np.degrees(target)),
            "milling": self.milling,
            "engagement": last,
            "passes": [s.as_dict() for s in self.surveys],
            "floor_percent": 100.0 * (self.floor / target - 1.0),
            "points": last["points"],
            "statuses": last["statuses"],
        }


def check_path(
    walls: Sequence[Contour],
    radius: float,
    radial_depth: float,
    program: Sequence[Contour] | None = None,
    *,
    target: float | None = None,
    previous_radius: float | None = None,
    spacing: float | None = None,
) -> PathCheck:
    """Engagement of the passes of a program, or of the pass parallel to the walls.

    Parameters
    ----------
    walls : sequence of Contour
        Finished walls, free side to the left.
    radius : float [mm]
        Tool radius.
    radial_depth : float [mm]
        Stock on the walls before the first pass, over the number of passes.
    program : sequence of Contour, optional
        Paths of the tool centre in the order of cutting, as many for each pass as the walls need.
    target : float, optional [rad]
        Engagement angle to compare with; that of a straight wall when left out.
    previous_radius : float, optional [mm]
        Radius of the tool that cut before the first pass; the same when left out.
    spacing : float, optional [mm]
        Distance of the places looked at; a thousandth of the radius when left out.

    Returns
    -------
    PathCheck
        The engagement of every pass.

    Raises
    ------
    InputError
        If something is impossible, or the program does not go round as the walls do.
    """
    angle = target_angle(radial_depth, radius, target)
    step = spacing_or_usual(spacing, radius)
    r2 = radius_before(previous_radius, radius)
    plain, milling = finished_path(walls, radius), "down"
    seen = list(walls)
    passes = [plain]
    if program is not None:
        passes = _in_passes(program, len(plain), walls)
        if all(_against(one, plain) for one in passes):
            milling = "up"
            seen = [_mirrored(w).reversed() for w in seen]
            passes = [[_mirrored(c) for c in one] for one in passes]
            plain = finished_path(seen, radius)
        for i, one in enumerate(passes):
            if _against(one, plain):
                raise InputError(
                    f"pass {i + 1} of the program goes round against the others: check down and up "
                    "milling separately."
                )
    met = previous_surface(seen, len(passes) * radial_depth, r2)
    surveys = []
    for one in passes:
        surveys.append(survey(one, met, radius, angle, step))
        met = Surface(cleared_by(one, radius))
    floor = max(unavoidable_angle(c, angle, radius, radius) for c in plain)
    return PathCheck(surveys, seen, milling, floor)


def _in_passes(
    program: Sequence[Contour], loops: int, walls: Sequence[Contour]
) -> list[list[Contour]]:
    closed = walls[0].closed
    for i, move in enumerate(program):
        if move.closed != closed:
            have, need = ("open", "closed") if closed else ("closed", "open")
            raise InputError(
                f"cut {i + 1} of the program ({move.name}) is {have}, but the wall is {need}: "
                "leave lead-in and lead-out to rapid moves, or take them out of the file."
            )
    if len(program) % loops:
        raise InputError(
            f"the program has {len(program)} cuts, but every pass along these walls takes {loops}: "
            "give whole passes."
        )
    return [list(program[i : i + loops]) for i in range(0, len(program), loops)]


def _against(one: Sequence[Contour], plain: Sequence[Contour]) -> bool:
    """Whether a pass runs against the parallel path."""
    if one[0].closed:
        largest = max(one, key=lambda c: abs(c.area))
        like = max(plain, key=lambda c: abs(c.area))
        return largest.area * like.area < 0.0
    mine, theirs = (np.asarray(c[0].points, float) for c in (one, plain))
    straight = np.hypot(*(mine[0] - theirs[0])) + np.hypot(*(mine[-1] - theirs[-1]))
    return bool(straight > np.hypot(*(mine[0] - theirs[-1])) + np.hypot(*(mine[-1] - theirs[0])))


def _mirrored(path: Contour) -> Contour:
    points = np.asarray(path.points) * np.array([-1.0, 1.0])
    return Contour(points, -np.asarray(path.bulges), path.closed, path.name)
