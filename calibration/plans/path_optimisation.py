"""Over-engagement at junctions traded against air: the previous path, moved by gradients.

Algorithm II cuts nowhere deeper than wanted, and where a path bends into a corner the next pass
meets more than wanted (`procmodel.engagement.floor`). Here the previous pass goes deeper near such
junctions, so that the engagement is less in front of and behind each, and the peak is lower.

The law is `procmodel.engagement.swept`, on nodes of the previous path; what is reported is exact,
on the surface that the new path of lines and arcs clears. The path only moves towards the wall: a
disc that is moved back leaves the places below the target as they are (moved discs end the arc
there) and raises others, so that nothing is gained. Lengths in mm, angles in rad.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from calibration.plans.path import Survey, survey
from calibration.plans.path_nodes import Splines, opened, rebuilt, windows
from procmodel.engagement.backward import previous_pass
from procmodel.engagement.contour import Contour
from procmodel.engagement.deflection import ToolStiffness
from procmodel.engagement.force import ForceCoefficients
from procmodel.engagement.form_error import Cut
from procmodel.engagement.segments import Segments, distance_to, joined
from procmodel.engagement.surface import Surface, cleared_by
from procmodel.engagement.swept import swept_angle
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

OBJECTIVES = ("angle", "form_error")
# Of the stock between the previous tool and the finished wall: how much of it may be taken.
DEEPEST = 0.9
# Of the radial depth on a line: the scallop between two nodes on a straight path.
_SCALLOP = 5e-5
# In spacings of the nodes: of the spline's knots, and of the places that the solver looks at.
_KNOTS, _PLACES = 8, 2
# How far from where the start overshoots the path is free: in tool radii at most, and in widths
# over which a displaced disc stands out of a straight path.
_REACH, _REACH_WIDTHS = 2.0, 8.0
# Further starts, as height over what the first solution moved, and width over that of such a disc.
_HUMPS = ((2.0, 1.0), (4.0, 1.0))
# How far to either side a displaced disc may stand out, over that of a straight path.
_SIDEWAYS = 1.5
_STEPS = 300


@dataclass(frozen=True)
class OptimisedPath:
    """A previous pass moved so that the next one's engagement is even.

    Attributes
    ----------
    path : list of Contour
        Of the previous tool's centre, wall to the right.
    surface : Surface
        What it leaves, exact.
    before, after : Survey
        Engagement of the last pass after algorithm II's previous pass, and after this one.
    cost_before, cost_after : float
        The objective on the exact engagement.
    over, under : tuple of float
        Greatest deviation above and below what the target gives, before and after; exact,
        relative, near the junctions. Of the angle or of the form error, as the objective says.
    moved : float [mm]
        Greatest displacement towards the wall.
    left_on_wall : float [mm]
        Least stock that the moved part leaves on the finished wall; infinite where nothing moved.
    variables, steps, evaluations : int
        Of the solver.
    status : str
        What came of it, as a sentence.
    """

    path: list[Contour]
    surface: Surface
    before: Survey
    after: Survey
    cost_before: float
    cost_after: float
    over: tuple[float, float]
    under: tuple[float, float]
    moved: float
    left_on_wall: float
    variables: int
    steps: int
    evaluations: int
    status: str


def optimise_previous_path(
    last: list[Contour],
    target: float,
    radius: float,
    previous_radius: float | None = None,
    *,
    objective: str = "angle",
    under_weight: float = 1.0,
    power: float = 8.0,
    cut: Cut | None = None,
    coefficients: ForceCoefficients | None = None,
    tool: ToolStiffness | None = None,
    heights: ArrayLike | None = None,
    spacing: float | None = None,
) -> OptimisedPath:
    """Move the pass before a given one, so that over-engagement is traded against air.

    Parameters
    ----------
    last : list of Contour
        Path of the last pass, wall to the right.
    target : float [rad]
        Engagement angle that it is to have.
    radius : float [mm]
        Radius of its tool.
    previous_radius : float, optional [mm]
        Radius of the previous pass' tool; the same when left out.
    objective : {"angle", "form_error"}
        What is to be even: the engagement angle, or the wall's error by the tool's bending.
    under_weight : float
        Weight of a deviation below the target against one above; large, algorithm II comes back.
    power : float
        Of the norm of the deviations: 2 is least squares, 8 nearly the greatest of them.
    cut, coefficients, tool : Cut, ForceCoefficients, ToolStiffness
        For the form error only.
    heights : array_like, shape (m,) [mm]
        For the form error only: above the tool's end, 0 to the axial depth.
    spacing : float, optional [mm]
        Greatest distance of the places at which engagement is looked at; a thousandth of the
        radius.

    Returns
    -------
    OptimisedPath
        Path, surface and exact figures; algorithm II's where no better one is found.

    Raises
    ------
    InputError
        If something is impossible, missing or unknown, or the previous tool finds no room.

    Notes
    -----
    Variables are the coefficients of cubic B-splines of the displacement along the normals, in
    place of the displacements of all nodes: nodes are close, so that the scallop between them is
    5e-5 of the radial depth, and most of them would end no arc and have no gradient. So the path
    is smooth without a further term in the cost. Spline values lie between their coefficients,
    which turns bounds on the path into bounds on variables: 0, and 0.9 of the stock on the
    finished wall. Scipy's L-BFGS-B, for it keeps bounds and needs only the gradient of hundreds
    of variables; `calibration.solvers` solves for residuals, and its Jacobian would be large.
    At the start only the discs at a corner end arcs that are too long, and the others have no
    gradient towards the wall: the solver then finds the best place of that one disc alone. So it
    starts again from humps of that height around every junction, and the best end is taken.
    """
    require_float64("an optimised path")
    r2 = radius if previous_radius is None else previous_radius
    _check(last, target, radius, r2, under_weight, power, spacing)
    deviation = _deviation(objective, target, radius, cut, coefficients, tool, heights)
    start = previous_pass(last, target, radius, r2)
    between = float(np.sqrt(8.0 * _SCALLOP * min(radius, r2) * radius * (1.0 - np.cos(target))))
    step = min(radius / 1000.0 if spacing is None else spacing, _PLACES * between)
    before = survey(last, start.surface, radius, target, step)
    # A disc moved by more than the stock in excess would only cut more air.
    excess = max(0.0, radius * float(np.cos(target) - np.cos(before.angle.max())))
    reach = min(_REACH * radius, _REACH_WIDTHS * _width(r2, excess))
    lines = opened(start.path, before, radius, between, reach)
    splines = [Splines(line, _KNOTS * between) for line in lines]
    sizes = [s.variables for s in splines]
    first = np.cumsum([0, *sizes])
    count = int(first[-1])

    def result(path: list[Contour], after: Survey, seen: np.ndarray, *rest: Any) -> OptimisedPath:
        costs, over, under = [], [], []
        for now in (before, after):
            off = np.asarray(deviation(jnp.asarray(now.angle[seen]))) if seen.any() else np.zeros(1)
            weight = now.weight[seen] if seen.any() else np.ones(1)
            costs.append(float(_norm(_weighed(jnp.asarray(off), under_weight), weight, power)))
            over.append(max(float(off.max()), 0.0))
            under.append(max(float(-off.min()), 0.0))
        return OptimisedPath(
            path, after.surface, before, after, costs[0], costs[1], (over[0], over[1]),
            (under[0], under[1]), *rest,
        )  # fmt: skip

    if not count:
        none = np.zeros(len(before.angle), bool)
        return result(
            start.path, before, none, 0.0, np.inf, 0, 0, 0,
            "nothing to move: the engagement is nowhere above the target after algorithm II.",
        )  # fmt: skip
    base = np.concatenate([line.at.point for line in lines])
    normal = np.concatenate([line.normal for line in lines])
    # One variable more stands for all that are held at 0.
    which = np.concatenate(
        [np.where(s.which < 0, count, s.which + f) for s, f in zip(splines, first, strict=False)]
    )
    share = np.concatenate([s.share for s in splines])
    free = np.any((which < count) & (share > 0.0), axis=1)
    room = np.full(len(base), np.inf)
    wall = joined([c.segments.on_host() for c in cleared_by(last, radius)])
    room[free] = _distance(base[free], wall) - r2
    upper = np.full(count + 1, np.inf)
    allowed = np.clip(DEEPEST * room / np.hypot(*normal.T), 0.0, excess)
    np.minimum.at(upper, which, np.where(share > 0.0, allowed[:, None], np.inf))
    upper = np.where(np.isfinite(upper), upper, 0.0)[:count]
    half = int(np.ceil(_SIDEWAYS * _width(r2, float(upper.max())) / between)) + 4
    seen, window = windows(before, lines, free, radius, half)
    thin = np.flatnonzero(seen)[:: max(1, int(_PLACES * between / step))]
    row = np.cumsum(seen) - 1
    at = [np.concatenate([getattr(p, f) for p in before.places]) for f in ("point", "direction")]
    data = [
        jnp.asarray(a)
        for a in (at[0][thin], at[1][thin], base, normal, which, share, window[row[thin]])
    ]
    cost = jax.jit(jax.value_and_grad(partial(_cost, deviation, power)))

    def scaled(x: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = cost(jnp.asarray(x * unit), under_weight, radius, r2, *data)
        return float(value) / size, np.asarray(slope) * unit / size

    unit = float(upper.max()) or 1.0
    size = 1.0
    size = scaled(np.zeros(count))[0] or 1.0
    bounds = np.column_stack([np.zeros(count), upper / unit])
    options = {"maxiter": _STEPS, "maxfun": 2 * _STEPS, "ftol": 1e-9, "gtol": 1e-9, "maxcor": 20}
    solve = partial(minimize, scaled, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    tried = [solve(np.zeros(count))]
    peak = float(np.max(tried[0].x)) * unit
    away = np.concatenate([s.away for s in splines])
    for height, width in _HUMPS if peak > 0.0 else ():
        hump = height * peak * np.exp(-((away / (width * _width(r2, peak))) ** 2))
        tried.append(solve(np.minimum(hump / unit, bounds[:, 1])))
    found = min(tried, key=lambda one: one.fun)
    x = np.clip(found.x, 0.0, bounds[:, 1]) * unit
    path = [
        original if not s.variables else rebuilt(line, s, x[f : f + s.variables])
        for original, line, s, f in zip(start.path, lines, splines, first, strict=False)
    ]
    after = survey(last, Surface(cleared_by(path, r2)), radius, target, step)
    shift = np.sum(share * np.append(x, 0.0)[which], axis=1)
    nodes = base + shift[:, None] * normal
    gap = float(np.min(_distance(nodes[free], wall))) - r2
    steps, calls = (int(sum(one[name] for one in tried)) for name in ("nit", "nfev"))
    ended = {0: "converged", 1: "stopped at the greatest number of steps"}.get(
        found.status, "ended at a kink of the cost from which no step leads lower"
    )
    best = result(path, after, seen, float(shift.max()), gap, count, steps, calls, "")
    if best.cost_after >= best.cost_before:
        return result(
            start.path, before, seen, 0.0, np.inf, count, steps, calls,
            f"{ended}: no path is better than algorithm II's for this weight, which is returned.",
        )  # fmt: skip
    what = "engagement angle" if objective == "angle" else "form error"
    held = int(np.sum(found.x >= bounds[:, 1] * (1.0 - 1e-9)))
    text = (
        f"{ended}: the {what} is at most {100 * best.over[1]:.2f} % above what is wanted, after "
        f"{100 * best.over[0]:.2f} %, for up to {100 * best.under[1]:.2f} % below it"
    )
    if held:
        text += f"; {held} of {count} variables are held so that the finished wall is not touched"
    return OptimisedPath(**{**best.__dict__, "status": text + "."})


def _check(
    last: list[Contour], target: float, radius: float, r2: float, weight: float, power: float,
    spacing: float | None,
) -> None:  # fmt: skip
    if not last:
        raise InputError("last holds no path: give the path of the last pass.")
    if not 0.0 < target < np.pi:
        raise InputError(
            f"the target angle is {np.degrees(target):g} degrees, but must be between 0 and 180."
        )
    for name, value, unit in (
        ("radius", radius, " mm"), ("previous_radius", r2, " mm"),
        ("spacing", 1.0 if spacing is None else spacing, " mm"), ("under_weight", weight, ""),
    ):  # fmt: skip
        if not 0.0 < value < np.inf:
            raise InputError(f"{name} is {value:g}{unit}, but must be above 0 and finite.")
    if not 2.0 <= power <= 64.0:
        raise InputError(f"power is {power:g}, but must be 2 (least squares) to 64.")


def _deviation(
    objective: str, target: float, radius: float, cut: Cut | None,
    coefficients: ForceCoefficients | None, tool: ToolStiffness | None, heights: ArrayLike | None,
) -> Callable[[Array], Array]:  # fmt: skip
    """Relative deviation from what the target gives, of angles, (n,) or (n, m) at m heights."""
    if objective not in OBJECTIVES:
        raise InputError(
            f"objective {objective!r} is unknown{nearest(str(objective), OBJECTIVES)}."
        )
    if objective == "angle":
        return lambda angle: angle / target - 1.0
    if cut is None or coefficients is None or tool is None or heights is None:
        given = {"cut": cut, "coefficients": coefficients, "tool": tool, "heights": heights}
        missing = ", ".join(name for name, value in given.items() if value is None)
        raise InputError(f"the objective form_error needs {missing} too: give it.")
    z = np.atleast_1d(np.asarray(heights, float))
    if not (
        z.ndim == 1 and z.size and np.all((z >= 0.0) & (z <= float(np.asarray(cut.axial_depth))))
    ):
        raise InputError(
            f"heights must be one or more numbers from 0 to the axial depth {cut.axial_depth} mm."
        )
    if not np.isclose(float(np.asarray(cut.radius)), radius):
        raise InputError(f"radius is {radius:g} mm, but the cut's is {cut.radius} mm: give one.")
    wanted = cut.form_error(coefficients, target, tool, z)
    most = float(jnp.max(jnp.abs(wanted)))
    if most == 0.0:
        raise InputError("the target leaves no form error at these heights: give lower ones.")

    def deviation(angle: Array) -> Array:
        error = cut.form_error(coefficients, jnp.clip(angle, 0.0, jnp.pi), tool, z)
        # Above is what lies farther off the wall than with the target.
        return (error - wanted) * jnp.sign(wanted) / most

    return deviation


def _weighed(off: Array, under_weight: Any) -> Array:
    return jnp.where(off > 0.0, off, -under_weight * off)


def _norm(off: Array, weight: ArrayLike, power: float) -> Array:
    """Mean power of deviations, its root taken; scaled, so that high powers stay in range."""
    share = jnp.asarray(weight) / jnp.sum(jnp.asarray(weight))
    most = jax.lax.stop_gradient(jnp.max(off))
    most = jnp.where(most > 0.0, most, 1.0)
    powers = jnp.mean(((off / most) ** power).reshape(len(share), -1), axis=1)
    total = jnp.sum(share * powers)
    some = total > 0.0
    return most * jnp.where(some, jnp.where(some, total, 1.0) ** (1.0 / power), 0.0)


def _cost(
    deviation: Callable[[Array], Array], power: float, x: Array, under_weight: Any, radius: Any,
    r2: Any, centre: Array, direction: Array, base: Array, normal: Array, which: Array,
    share: Array, window: Array,
) -> Array:  # fmt: skip
    shift = jnp.sum(share * jnp.append(x, 0.0)[which], axis=1)
    nodes = base + shift[:, None] * normal
    angle = swept_angle(centre, direction, nodes[window], radius, r2)
    return _norm(_weighed(deviation(angle), under_weight), jnp.ones(len(window)), power)


def _width(r2: float, depth: float) -> float:
    """To either side, how far a disc moved by a depth stands out of a straight path."""
    return float(np.sqrt(2.0 * r2 * depth))


def _distance(points: np.ndarray, wall: Segments) -> np.ndarray:
    found = []
    for chunk in np.array_split(points, max(1, len(points) * len(wall) // 2_000_000)):
        pieces = wall[np.tile(np.arange(len(wall)), len(chunk))]
        apart = distance_to(pieces, np.repeat(chunk, len(wall), axis=0), np)
        found.append(apart.reshape(len(chunk), -1).min(axis=1))
    return np.concatenate(found)
