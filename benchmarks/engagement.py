"""Engagement and corrected paths, beside the paper's Newton with shapely and with NumPy."""

import math
from functools import partial

import numpy as np

from benchmarks import measure
from benchmarks.engagement_peers import (
    QUAD_SEGS,
    NumpySurface,
    newton_by_numpy,
    newton_by_shapely,
    stock_polygon,
)
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from procmodel.engagement import (
    Contour,
    Surface,
    contour,
    forward_pass,
    move_places,
    offset,
    previous_pass,
    previous_surface,
    stations,
)

RADIUS, DEPTH, CORNER = 5.0, 0.1, 8.0
TARGET = math.acos(1.0 - DEPTH / RADIUS)
TOLERANCE = 1e-9
# Shapely's circles have corners: its own angles hold to about this [rad].
AGREEMENT = {"NumPy": 1e-7, "shapely": 2e-3}


def run(section: Section, sizes: Sizes) -> None:
    wall = pocket()
    path = offset([wall], RADIUS)[0]
    surface = previous_surface([wall], DEPTH, RADIUS)
    _places(section, sizes, wall, path, surface)
    _growth(section, sizes, path, surface)
    _ablation(section, path, surface)


def pocket() -> Contour:
    """The paper's cut all round: 60 mm by 40 mm, corners of 8 mm."""
    b = math.tan(math.pi / 8)
    x, y, c = 60.0, 40.0, CORNER
    points = [(c, 0), (x - c, 0), (x, c), (x, y - c), (x - c, y), (c, y), (0, y - c), (0, c)]
    return contour(points, [0, b] * 4)


def wavy(pieces: int) -> Contour:
    """A round wall of many arcs, a circle with waves."""
    phi = 2 * math.pi * np.arange(pieces) / pieces
    radius = 60.0 + 0.3 * np.cos(12 * phi)
    return contour(np.column_stack([radius * np.cos(phi), radius * np.sin(phi)]),
                   np.full(pieces, math.tan(math.pi / (2 * pieces))))  # fmt: skip


def _spread_places(path: Contour, count: int) -> tuple[np.ndarray, np.ndarray]:
    at = stations(path, path.length / count)
    return at.point[:count], at.direction[:count]


def _places(section: Section, sizes: Sizes, wall: Contour, path: Contour, surface: Surface) -> None:
    centres, directions = _spread_places(path, sizes.places)
    few = slice(None, None, max(1, sizes.places // sizes.shapely_places))
    previous = offset([wall], DEPTH + RADIUS)[0]
    stock = stock_polygon(previous, RADIUS)
    host = surface.host
    bulges = np.concatenate([np.asarray(c.bulges) for c in surface.contours])
    arrays = NumpySurface(host.start, host.end, bulges)
    ours = partial(move_places, surface, centres, directions, TARGET, RADIUS)
    compile_time, _ = measure.first_call(ours)
    turns = measure.interleaved(
        {
            "procmodel, Newton in c": ours,
            "NumPy, all places at once": lambda: newton_by_numpy(
                arrays, centres, directions, TARGET, RADIUS, 30, TOLERANCE
            ),
            "shapely, place by place": lambda: newton_by_shapely(
                stock, centres[few], directions[few], TARGET, RADIUS, 30, 1e-8
            ),
            "shapely, one step (the paper's)": lambda: newton_by_shapely(
                stock, centres[few], directions[few], TARGET, RADIUS, 1, 1e-8
            ),
        },
        sizes.path_repeats,
    )
    sparse = len(centres[few])
    counts = [len(centres), len(centres), sparse, sparse]
    names = list(turns.seconds)
    per_place = {n: turns.seconds[n] / c for n, c in zip(names, counts, strict=True)}
    mine = per_place[names[0]]
    section.text(
        f"The paper's cut round a pocket: r = 5 mm, a_e = 0.1 mm, corners of 8 mm. "
        f"{len(centres)} places of the parallel path are moved until the engagement angle is that "
        f"of the line; with shapely {sparse} of them, on circles of {4 * QUAD_SEGS} corners. "
        f"First call of ours, compilation in it: {compile_time:.2f} s."
    )
    section.table(
        ["contestant", "time per place", "time / ours"],
        [[n, measure.time_spread(per_place[n]), measure.ratio(per_place[n], mine)] for n in names],
    )
    moved = turns.outcomes[names[0]].moved
    for name, other, chosen in (
        ("NumPy", turns.outcomes[names[1]], slice(None)),
        ("shapely", turns.outcomes[names[2]], few),
    ):
        worst = float(np.max(np.abs(other - moved[chosen])))
        section.target(
            f"places moved as {name} moves them",
            f"at most {AGREEMENT[name]:g} mm apart", f"{worst:.1e} mm", worst <= AGREEMENT[name],
        )  # fmt: skip
    for name, wanted in ((names[1], 5.0), (names[2], 100.0)):
        found = per_place[name] / mine
        section.target(
            f"time of {name} over ours", f"at least {wanted:g}", measure.spread(found),
            bool(np.median(found) >= wanted),
        )  # fmt: skip


def _growth(section: Section, sizes: Sizes, path: Contour, surface: Surface) -> None:
    section.heading("Growth")
    rows, per_place = [], []
    for count in sizes.path_places:
        centres, directions = _spread_places(path, count)
        call = partial(surface.engagement, centres, directions, RADIUS)
        call()
        seconds = np.array([measure.timed(call)[0] for _ in range(3)])
        per_place.append(float(np.median(seconds)) / count)
        rows.append(
            ["places", f"{count}", measure.time_spread(seconds), f"{1e6 * per_place[-1]:.3f}"]
        )
    by_pieces = []
    for pieces in sizes.path_pieces:
        wall = wavy(pieces)
        met = previous_surface([wall], DEPTH, RADIUS)
        centres, directions = _spread_places(offset([wall], RADIUS)[0], sizes.places)
        call = partial(met.engagement, centres, directions, RADIUS)
        call()
        seconds = np.array([measure.timed(call)[0] for _ in range(3)])
        each = 1e6 * float(np.median(seconds)) / len(centres)
        by_pieces.append(each)
        rows.append(
            ["pieces of the wall", f"{pieces}", measure.time_spread(seconds), f"{each:.3f}"]
        )
    section.table(["what grows", "number", "time of the engagement", "µs per place"], rows)
    section.target(
        f"time per place at {sizes.path_places[-1]} places over that at {sizes.path_places[0]}",
        "at most 1.5", f"{per_place[-1] / per_place[0]:.2f}", per_place[-1] <= 1.5 * per_place[0],
    )  # fmt: skip
    section.target(
        f"time per place at {sizes.path_pieces[-1]} pieces over that at {sizes.path_pieces[0]}",
        "at most 1.5", f"{by_pieces[-1] / by_pieces[0]:.1f}", by_pieces[-1] <= 1.5 * by_pieces[0],
    )  # fmt: skip
    section.text(f"Peak memory of the process so far: {measure.peak_memory():.0f} MiB.")


def _ablation(section: Section, path: Contour, surface: Surface) -> None:
    section.heading("Ways to hold the angle")
    centres, directions = _spread_places(path, 10_000)
    rows = []

    def moving(method: str, steps: int) -> np.ndarray:
        found = move_places(surface, centres, directions, TARGET, RADIUS, method, steps=steps)
        return found.angle

    def marching() -> np.ndarray:
        along = stations(forward_pass(surface, TARGET, RADIUS).path[0], path.length / 10_000)
        return surface.engagement(along.point, along.direction, RADIUS).angle

    def explicit() -> np.ndarray:
        before = previous_pass([path], TARGET, RADIUS)
        return before.surface.engagement(centres, directions, RADIUS).angle

    ways = {
        "alpha, one step of finite differences (the paper's)": lambda: moving("difference", 1),
        "alpha, Newton": lambda: moving("angle", 30),
        "c, one step": lambda: moving("ratio", 1),
        "c, Newton": lambda: moving("ratio", 30),
        "marching equation (I, with its true feed direction)": marching,
        "explicit surface (II)": explicit,
    }
    for name, way in ways.items():
        way()
        seconds, angle = measure.timed(way)
        error = np.degrees(np.abs(angle - TARGET))
        rows.append([name, f"{error.max():.2e}", f"{error.mean():.2e}", f"{1e3 * seconds:.0f} ms"])
    section.table(["way", "greatest error [°]", "mean error [°]", "time, 10,000 places"], rows)
    section.text(
        "The Newton rows take the feed direction of the parallel path, as the paper does: on the "
        "way into an arc the corrected path turns a little against it. The explicit row keeps the "
        "last pass and leaves the overshoot that is unavoidable."
    )
