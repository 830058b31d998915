"""Engagement with the stock against counted rim points, the paper's cut, differences.

The rim is counted on points inside and outside the polygon of the cleared region. Its arcs are
chords, off by `sagitta`: rim points nearer than that to its boundary may be on either side, and the
angle must lie between the counts with all of them in and all of them out, give or take one spacing
of the points for each crossing.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import LineString

from procmodel.engagement.angle import (
    AIR,
    DETACHED,
    ENGAGED,
    MULTIPLE,
    SLOT,
    STATUS,
    engagement_angle_constant_curvature,
    engagement_angle_entering_arc,
    sharp_corner_angle,
)
from procmodel.engagement.contact import contact
from procmodel.engagement.contour import Contour, contour, stations
from procmodel.engagement.offset import offset, parallel, traced
from procmodel.engagement.segments import Segments, advance, lengths
from procmodel.engagement.surface import (
    Surface,
    cleared_by,
    previous_surface,
    traced_surface,
)
from procmodel.errors import InputError
from tests.procmodel.engagement.shapes import (
    QUARTER,
    along,
    box,
    circle,
    open_path,
    polygonal,
    region,
    sagitta,
    sampled,
    stars,
)

RADIUS, DEPTH, WALL = 5.0, 0.1, 8.0
LINE = math.acos(1 - DEPTH / RADIUS)
POINTS = 2000


def counted(cleared, off, centre, direction, radius):
    """Lower and upper bounds of total angle, area rate, and the angle of the arc at the wall."""
    phi = (np.arange(POINTS) + 0.5) * math.pi / POINTS
    side = np.array([-direction[1], direction[0]])
    rim = centre + radius * (np.cos(phi)[:, None] * side + np.sin(phi)[:, None] * direction)
    free = shapely.contains_xy(cleared, rim[:, 0], rim[:, 1])
    unsure = shapely.dwithin(cleared.boundary, shapely.points(rim), off)
    step = math.pi / POINTS
    slack = step * (2 + np.sum(np.diff(free.astype(int)) != 0))
    bounds = []
    for weight in (np.ones(POINTS), radius * np.sin(phi)):
        low = step * np.sum(weight[~free & ~unsure])
        high = step * np.sum(weight[~free | unsure])
        bounds.append((low - slack * weight.max(), high + slack * weight.max()))
    from_wall = slice(None, None, -1)
    not_stock, surely_free = (free | unsure)[from_wall], (free & ~unsure)[from_wall]
    low = np.argmax(not_stock) if not_stock.any() else POINTS
    high = np.argmax(surely_free) if surely_free.any() else POINTS
    bounds.append((step * (low - 1), step * (high + 1)))
    return bounds


@settings(max_examples=12)
@given(
    walls=stars(),
    depth=st.floats(0.02, 0.3),
    radius=st.floats(0.5, 1.5),
    share=st.floats(0.3, 1.0),
    seed=st.integers(0, 2**16),
)
def test_against_counted_points(walls, depth, radius, share, seed):
    path = offset(walls, radius)
    before = offset(walls, depth + share * radius)
    assume(path and before)
    surface = Surface(cleared_by(before, share * radius))
    cleared = region(surface.contours)
    shapely.prepare(cleared)
    off = max(sagitta(c) for c in surface.contours) + 1e-7
    rng = np.random.default_rng(seed)
    on = stations(path[0], 0.5)
    some = rng.integers(0, len(on), 10)
    centres, directions = on.point[some].copy(), on.direction[some].copy()
    # Half of the places are anywhere near the path, in any direction.
    centres[5:] += rng.uniform(-1.0, 1.0, (5, 2)) * radius
    heading = rng.uniform(0, 2 * np.pi, 5)
    directions[5:] = np.column_stack([np.cos(heading), np.sin(heading)])
    found = surface.engagement(centres, directions, radius)
    for i in range(10):
        total, rate, angle = counted(cleared, off, centres[i], directions[i], radius)
        assert total[0] <= found.total[i] <= total[1]
        assert rate[0] <= found.area_rate[i] <= rate[1]
        if found.status[i] in (ENGAGED, MULTIPLE, SLOT):
            assert angle[0] <= found.angle[i] <= angle[1]
        else:
            assert found.angle[i] == 0.0 and angle[0] <= 0.0
        if found.arc_count[i] <= found.arcs.shape[1]:
            spans = found.arcs[i, :, 1] - found.arcs[i, :, 0]
            assert np.all(spans >= 0)
            assert np.sum(spans) == pytest.approx(found.total[i], abs=1e-12)
    for field in found[:4]:
        assert np.all(np.isfinite(field))
    # Counted on points, the total is known to half a percent of a half circle.
    assert total[1] - total[0] < 0.03 * math.pi


def corner_wall():
    """The paper's: a line, a concave quarter of Rp = 8, a line."""
    return open_path((40, 0.0), (0.5 * math.pi * WALL, 1 / WALL), (40, 0.0))


def paper():
    walls = [corner_wall()]
    (path,) = offset(walls, RADIUS)
    return path, previous_surface(walls, DEPTH, RADIUS)


def test_the_paper_s_way_into_the_arc():
    path, surface = paper()
    before = np.array([0.8, 0.5, 0.25, 0.0])
    angle = surface.engagement(*along(path, 40 - before), RADIUS).angle
    np.testing.assert_allclose(np.degrees(angle), [11.6356, 12.7340, 14.9054, 18.7375], atol=6e-5)


def test_lines_and_arcs_of_the_paper():
    path, surface = paper()
    at = along(path, np.array([20.0, 42.0]))
    found = surface.engagement(*at, RADIUS)
    assert np.degrees(found.angle[0]) == pytest.approx(11.4783, abs=5e-5)
    assert np.degrees(found.angle[1]) == pytest.approx(18.738, abs=5e-4)
    exact = engagement_angle_constant_curvature(DEPTH, RADIUS, np.array([0.0, 1 / WALL]))
    np.testing.assert_allclose(found.angle, exact, atol=1e-9)
    np.testing.assert_allclose(found.total, found.angle, atol=1e-12)
    np.testing.assert_allclose(found.area_rate, RADIUS * (1 - np.cos(found.angle)), rtol=1e-12)
    # On the line that is the radial depth; the arc meets (Rp^2 - Rw^2) / 2 over Rp - r of it.
    rate = (WALL**2 - (WALL - DEPTH) ** 2) / 2 / (WALL - RADIUS)
    np.testing.assert_allclose(found.area_rate, [DEPTH, rate], rtol=1e-9)
    assert found.status.tolist() == [ENGAGED, ENGAGED]


def test_entering_the_arc_in_closed_form():
    path, surface = paper()
    before = np.linspace(0.0, 3.0, 301)
    found = surface.engagement(*along(path, 40 - before), RADIUS)
    exact = engagement_angle_entering_arc(before, DEPTH, RADIUS, WALL)
    np.testing.assert_allclose(found.angle, exact, atol=1e-9)


def test_the_plain_path_overshoots_by_63_percent():
    path, surface = paper()
    way = np.linspace(30, path.length - 30, 2001)
    angle = surface.engagement(*along(path, way), RADIUS).angle
    assert angle.max() / LINE - 1 == pytest.approx(0.632, abs=5e-4)
    # It falls where the end of the engaged arc leaves the stock's arc: R_w sin = r sin(alpha).
    on_arc = float(engagement_angle_constant_curvature(DEPTH, RADIUS, 1 / WALL))
    lead = (WALL - RADIUS) * math.asin(RADIUS * math.sin(on_arc) / (WALL - DEPTH))
    assert lead == pytest.approx(0.614, abs=5e-4)
    exit_at = 40 + 0.5 * math.pi * (WALL - RADIUS)
    just = exit_at - lead + np.array([-1e-6, 0.1])
    before, after = surface.engagement(*along(path, just), RADIUS).angle
    assert before == pytest.approx(on_arc, abs=1e-9)
    assert after < on_arc - 1e-4


@pytest.mark.parametrize("curvature", [0.0, 0.125, 0.19, -0.05, -0.4])
@pytest.mark.parametrize("depth", [0.05, 0.1, 0.5])
def test_constant_curvature(curvature, depth):
    if curvature == 0.0:
        walls = [open_path((60, 0.0))]
    else:
        walls = [circle(1 / abs(curvature), turn=math.copysign(1.0, curvature))]
    if curvature > 0 and depth + RADIUS >= 1 / curvature:
        pytest.skip("no room for the previous tool")
    (path,) = offset(walls, RADIUS)
    surface = previous_surface(walls, depth, min(RADIUS, 0.9 / max(curvature, 0.1) - depth))
    way = np.linspace(0.4, 0.6, 7) * path.length
    found = surface.engagement(*along(path, way), RADIUS)
    exact = float(engagement_angle_constant_curvature(depth, RADIUS, curvature))
    np.testing.assert_allclose(found.angle, exact, atol=1e-9)


@pytest.mark.parametrize("interior", [40.0, 60.0, 90.0, 120.0, 150.0])
@pytest.mark.parametrize("depth", [0.1, 1.0])
def test_sharp_corners(interior, depth):
    """Path and stock of tools of one radius, in a corner of a rhombus; th as the paths see it."""
    half = math.radians(interior) / 2
    a, b = 120 * math.cos(half), 120 * math.sin(half)
    walls = [polygonal([[-a, 0], [0, -b], [a, 0], [0, b]])]
    (path,) = offset(walls, RADIUS)
    surface = previous_surface(walls, depth, RADIUS)
    corner = int(np.argmax(np.asarray(path.points)[:, 0]))
    arriving = path.segments.on_host().direction[corner - 1]
    at = np.asarray(path.points)[corner]
    back = np.concatenate([[0.0], np.linspace(1e-3, 10, 200)])
    angle = surface.engagement(
        at - back[:, None] * arriving, np.tile(arriving, (len(back), 1)), RADIUS
    ).angle
    exact = float(sharp_corner_angle(math.radians(interior), depth, RADIUS))
    line = math.acos(1 - depth / RADIUS)
    assert exact == pytest.approx(min(math.pi, math.pi - 2 * half + line), abs=1e-12)
    assert angle[0] == pytest.approx(exact, abs=1e-6)
    assert np.argmax(angle) == 0


def scene(*more):
    """A stock whose edge runs along the x axis at y = 0, the tool above it, feed to the right."""
    return Surface([open_path((100, 0.0), start=(-50.0, 0.0)), *more])


FEED = np.array([[1.0, 0.0]])


def test_air():
    found = scene().engagement([[0.0, RADIUS + 0.01]], FEED, RADIUS)
    assert found.status[0] == AIR and "air" in STATUS[AIR]
    assert found.angle[0] == found.total[0] == found.area_rate[0] == 0.0
    np.testing.assert_array_equal(found.arcs[0], math.pi)


@pytest.mark.parametrize("below", [RADIUS + 0.5, 3 * RADIUS])
def test_slot(below):
    # Just deeper than the tool is wide; and far from every edge.
    found = scene().engagement([[0.0, -below]], FEED, RADIUS)
    assert found.status[0] == SLOT
    assert found.angle[0] == found.total[0] == math.pi
    assert found.area_rate[0] == pytest.approx(2 * RADIUS, rel=1e-12)
    np.testing.assert_array_equal(found.arcs[0, 0], [0.0, math.pi])


def test_an_island_ahead_is_a_second_arc():
    rho, ahead = 1.0, 5.5
    beta = math.acos((RADIUS**2 + ahead**2 - rho**2) / (2 * RADIUS * ahead))
    for gap, status, angle in ((-DEPTH, MULTIPLE, LINE), (0.01, DETACHED, 0.0)):
        centre = (0.0, RADIUS + gap)
        island = circle(rho, (ahead, RADIUS + gap), -1.0)
        found = scene(island).engagement([centre], FEED, RADIUS)
        assert found.status[0] == status
        assert found.angle[0] == pytest.approx(angle, abs=1e-12)
        assert found.total[0] == pytest.approx(angle + 2 * beta, rel=1e-12)
        rate = max(-gap, 0.0) + 2 * RADIUS * math.sin(beta)
        assert found.area_rate[0] == pytest.approx(rate, rel=1e-12)
        half = math.pi / 2
        np.testing.assert_allclose(found.arcs[0, 0], [half - beta, half + beta], rtol=1e-12)
        assert found.arc_count[0] == (2 if angle else 1)
    # Behind the tool an island is not cut.
    behind = scene(circle(rho, (-ahead, RADIUS - DEPTH), -1.0))
    found = behind.engagement([[0.0, RADIUS - DEPTH]], FEED, RADIUS)
    assert found.status[0] == ENGAGED
    assert found.total[0] == pytest.approx(LINE, rel=1e-12)


def test_no_surface_is_an_error():
    with pytest.raises(InputError, match="no surface: the pocket is too narrow"):
        previous_surface([box(20, 9)], 0.1, 5.0)


@given(walls=stars(), seed=st.integers(0, 2**16))
def test_in_stock_against_shapely(walls, seed):
    asked = np.random.default_rng(seed).uniform(-12, 12, (200, 2))
    inside = region(walls)
    off = max(sagitta(c) for c in walls) + 2e-4
    sure = ~shapely.dwithin(inside.boundary, shapely.points(asked), off)
    expected = ~shapely.contains_xy(inside, asked[:, 0], asked[:, 1])
    np.testing.assert_array_equal(Surface(walls).in_stock(asked)[sure], expected[sure])


@settings(max_examples=10)
@given(walls=stars(), radius=st.floats(0.5, 3.0), margin=st.floats(0.0, 1.0))
def test_windows_miss_no_segment(walls, radius, margin):
    surface = Surface(walls)
    centres = np.random.default_rng(0).uniform(-9, 9, (60, 2))
    lines = []
    for i in range(len(surface.host)):
        piece = surface.host[i : i + 1]
        way = np.linspace(0, lengths(piece, np)[0], 200)
        many = piece[np.zeros(200, int)]
        points, _ = advance(many.start, many.direction, many.curvature, way, np)
        lines.append(LineString(points))
    seen = np.zeros(60, int)
    for chosen, table in surface.windows(centres, radius, margin):
        seen[chosen] += 1
        for place, row in zip(chosen, table, strict=True):
            rim = shapely.Point(centres[place]).buffer(radius, quad_segs=64).exterior
            near = {i for i, line in enumerate(lines) if line.distance(rim) < margin - 1e-2}
            near |= {i for i, line in enumerate(lines) if line.crosses(rim)}
            assert near <= set(row[row >= 0].tolist())
    np.testing.assert_array_equal(seen, 1)


def engaged(walls, depth, previous, radius, at):
    """Angle, depth ratio, total and area rate through both offsets, differentiable."""
    _, remade = traced_surface(*ORIGIN.values())
    surface = remade(walls, depth, previous)
    many = jax.tree.map(lambda f: jnp.broadcast_to(f, (len(at[0]), *f.shape)), surface)
    found = contact(*at, radius, many, jnp.ones(many.curvature.shape, bool))
    return jnp.stack([found.angle, found.depth_ratio, found.total, found.area_rate])


ORIGIN = {
    # One corner is sharp: only there does the previous tool's radius matter.
    "walls": [
        contour(
            [[-30, -20], [22, -20], [30, -12], [30, 12], [22, 20], [-22, 20], [-30, 12]],
            [0, QUARTER, 0, QUARTER, 0, QUARTER, 0],
        ),
        circle(4.0, (-6.0, 5.0), -1.0),
    ],
    "depth": 0.3,
    "previous": 3.5,
}


def again(walls, depth, previous, radius, at):
    """The same with everything cut anew, without `traced`."""
    surface = previous_surface(walls, depth, previous)
    found = surface.engagement(*at, radius)
    return np.stack([found.angle, 1 - np.cos(found.angle), found.total, found.area_rate])


def gradient_places():
    (outer, *_) = offset(ORIGIN["walls"], RADIUS)
    # On lines, on arcs, on the ways into and out of them; of those, none at the very vertices.
    # And near the sharp corner, where the path begins and ends.
    way = np.concatenate([np.linspace(0.013, 0.987, 61), 1 - np.linspace(1e-4, 0.012, 12)])
    return along(outer, way * outer.length)


@pytest.mark.parametrize("what", ["depth", "previous", "radius"])
def test_gradients_in_lengths(what):
    at, h = gradient_places(), 1e-5
    order = ["depth", "previous", "radius"].index(what)
    values = [ORIGIN["depth"], ORIGIN["previous"], RADIUS]

    def here(x, function):
        return function(ORIGIN["walls"], *values[:order], x, *values[order + 1 :], at)

    value = values[order]
    found, slope = jax.jvp(lambda x: here(x, engaged), (jnp.asarray(value),), (jnp.asarray(1.0),))
    np.testing.assert_allclose(found, here(value, again), atol=1e-9)
    central = (here(value + h, again) - here(value - h, again)) / (2 * h)
    np.testing.assert_allclose(slope, central, atol=1e-6, rtol=1e-6)
    assert np.abs(slope).max() > 0.01


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_gradients_in_the_contour(seed):
    at, h = gradient_places(), 1e-5
    rng = np.random.default_rng(seed)
    # A contour stays smooth only under a motion of the whole; else kinks appear, which is another
    # set of pieces. So: turned, scaled and moved, the corners' bulges as they are.
    a, b, x, y = rng.normal(size=4) * [0.01, 0.01, 1, 1]
    toward = [
        (w.points @ np.array([[a, -b], [b, a]]) + [x, y], np.zeros_like(w.bulges))
        for w in ORIGIN["walls"]
    ]

    def varied(s):
        return [
            Contour(w.points + s * p, w.bulges + s * q, True)
            for w, (p, q) in zip(ORIGIN["walls"], toward, strict=True)
        ]

    values = (ORIGIN["depth"], ORIGIN["previous"], RADIUS, at)
    slope = jax.jvp(lambda s: engaged(varied(s), *values), (jnp.zeros(()),), (jnp.ones(()),))[1]
    central = (again(varied(h), *values) - again(varied(-h), *values)) / (2 * h)
    np.testing.assert_allclose(slope, central, atol=2e-6, rtol=1e-6)
    assert np.abs(slope).max() > 0.1


def test_sensitivity_on_a_line():
    """d alpha / d a_e = 1 / (r sin(alpha)), 57.6 degrees per mm in the paper's cut."""
    wall = [open_path((60, 0.0))]
    at = (jnp.array([30.0, RADIUS]), jnp.array([1.0, 0.0]))
    first = parallel(wall, DEPTH + RADIUS)
    second = parallel(first.contours, -RADIUS)

    @jax.jit
    def angle(depth):
        path = traced(wall[0].segments, first.origin, depth + RADIUS)
        surface = traced(path, second.origin, -RADIUS)
        return contact(*at, RADIUS, surface, jnp.ones(len(surface), bool)).angle

    value, slope = jax.value_and_grad(angle)(DEPTH)
    assert float(value) == pytest.approx(LINE, abs=1e-12)
    assert float(slope) == pytest.approx(1 / (RADIUS * math.sin(LINE)), rel=1e-9)
    assert math.degrees(slope) == pytest.approx(57.6, abs=0.05)


@pytest.mark.parametrize("share", [1e-2, 1e-4, 1e-6])
def test_small_radial_depths(share):
    walls = [corner_wall()]
    (path,) = offset(walls, RADIUS)
    surface = previous_surface(walls, share * RADIUS, RADIUS)
    found = surface.engagement(*along(path, np.array([20.0, 42.0])), RADIUS)
    exact = engagement_angle_constant_curvature(share * RADIUS, RADIUS, np.array([0.0, 1 / WALL]))
    # A position is known to about 1e-14 of its size, and alpha is the root of the depth.
    np.testing.assert_allclose(found.angle, exact, rtol=1e-13 / share + 1e-11)
    assert found.angle[0] == pytest.approx(math.sqrt(2 * share), rel=share)


def everything(centre, direction, radius, pieces):
    found = contact(centre, direction, radius, pieces, jnp.ones(len(pieces), bool))
    return jnp.stack([found.angle, found.depth_ratio, found.total, found.area_rate])


values = jax.jit(everything)
slopes = jax.jit(jax.jacrev(everything, (0, 1, 2, 3)))


@pytest.mark.parametrize("height", [-11.0, -5.0, 0.0, 4.9, 5.0, 5.0 - 1e-12, 5.1, 11.0])
@pytest.mark.parametrize("x", [-50.0, 0.0, 3.0])
def test_values_and_gradients_are_never_nan(height, x):
    """Deep in the stock, tangent to its edge from both sides, off it, on it, at its end."""
    edge = scene(circle(1.0, (10.0, 5.0), -1.0), box(1, 1, (-5.5, 3)).reversed()).segments
    edge = Segments(*(jnp.asarray(f) for f in edge.fields))
    at = (jnp.array([x, height]), jnp.array([1.0, 0.0]), jnp.asarray(RADIUS), edge)
    assert np.all(np.isfinite(values(*at)))
    for leaf in jax.tree.leaves(slopes(*at)):
        assert np.all(np.isfinite(leaf))


@settings(max_examples=10)
@given(walls=stars(islands=False, corners=(6, 6)), seed=st.integers(0, 2**16))
def test_random_gradients_are_never_nan(walls, seed):
    rng = np.random.default_rng(seed)
    pieces = Segments(*(jnp.asarray(f) for f in walls[0].segments.fields))
    # Around vertices, the rim just there, and anywhere.
    corner = np.asarray(walls[0].points)[seed % 6]
    heading = rng.uniform(0, 2 * np.pi)
    t = np.array([math.cos(heading), math.sin(heading)])
    for centre in (corner, corner + 2 * t, rng.uniform(-10, 10, 2)):
        at = (jnp.asarray(centre), jnp.asarray(t), jnp.asarray(2.0), pieces)
        assert np.all(np.isfinite(values(*at)))
        for leaf in jax.tree.leaves(slopes(*at)):
            assert np.all(np.isfinite(leaf))


def test_the_surface_is_the_opening():
    """The stock's edge is d away on lines, and round with the tool's radius in corners."""
    (found,) = previous_surface([box(30, 20)], 0.5, 3.0).contours
    width, height = 29.0, 19.0
    assert found.area == pytest.approx(width * height - (4 - math.pi) * 9, rel=1e-9)
    (again_,) = cleared_by([contour([[-9, -4], [9, -4], [9, 4], [-9, 4]])], 2.0)
    assert again_.area == pytest.approx(18 * 8 + 2 * 2 * 26 + math.pi * 4, rel=1e-9)
    assert len(sampled(again_)) > 8
