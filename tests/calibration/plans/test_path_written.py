"""What is written: rounded, fitted with arcs, and never through the wall."""

import numpy as np
import pytest
import shapely

from calibration.plans.path import correct_path
from calibration.plans.path_written import as_written
from procmodel.engagement.contour import contour, oriented
from tests.procmodel.engagement.shapes import dilated, open_path, region, rounded_rectangle

RADIUS, DEPTH = 5.0, 0.1


def plan_of(walls, side="inside", **options):
    return correct_path(oriented(walls, side), RADIUS, DEPTH, spacing=0.02, **options)


@pytest.fixture(scope="module")
def wall():
    return rounded_rectangle(22, 20, 8)


@pytest.fixture(scope="module")
def forward(wall):
    return plan_of([wall], method="forward")


def beyond(wall, path):
    """How far outside of the wall the tool cuts [mm], by polygons."""
    inside = region([wall])
    outside = dilated(path, RADIUS).difference(inside)
    corners = shapely.points(shapely.get_coordinates(outside))
    return float(np.max(shapely.distance(inside, corners), initial=0.0))


def test_constructed_paths_keep_their_lines_and_arcs(wall):
    plan = plan_of([wall])
    passes, engagement = as_written(plan, 1e-4)
    assert [len(one) for one in passes] == [len(one) for one in plan.passes]
    for one, exact in zip(passes, plan.passes, strict=True):
        for written, true in zip(one, exact, strict=True):
            assert len(written.bulges) == len(true.bulges)
            points = np.asarray(written.points)
            assert points == pytest.approx(np.round(points, 4), abs=1e-12)
            # Half a unit of the fourth decimal, in x and in y.
            assert points == pytest.approx(np.asarray(true.points), abs=0.5001e-4)
    # 0.05 um of stock at the angle's sensitivity of 1 / (r sin 11.5 deg), and the floor's kink.
    assert float(np.max(engagement.angle)) == pytest.approx(
        float(np.max(plan.after.angle)), abs=np.radians(0.02)
    )
    assert beyond(wall, passes[-1]) <= 1e-3


@pytest.mark.parametrize("tolerance", [1e-4, 2e-3])
def test_marched_path_becomes_few_arcs_within_the_tolerance(wall, forward, tolerance):
    passes, _ = as_written(forward, tolerance)
    (written,), (marched,) = passes[-1], forward.passes[-1]
    assert len(written.bulges) < 0.2 * len(marched.bulges)
    apart = _apart(written, marched)
    assert apart <= tolerance + 1e-4  # rounding moves a vertex by up to 0.71e-4
    assert beyond(wall, passes[-1]) <= tolerance + 1e-3


def test_coarser_tolerance_takes_fewer_arcs(forward):
    fine, coarse = (len(as_written(forward, t)[0][-1][0].bulges) for t in (1e-4, 2e-3))
    assert coarse < fine


def _apart(one, other):
    """Largest distance of the vertices of the finer contour from the other one."""
    line = shapely.LinearRing(one.flattened(1e-6))
    return float(np.max(shapely.distance(line, shapely.points(np.asarray(other.points)))))


def test_engagement_is_that_of_the_rounded_paths(wall):
    """Paths moved by more than rounding show it: the figures are no copy of the plan's."""
    plan = plan_of([wall])
    (inner,), last = plan.passes
    deeper = contour(np.asarray(inner.points) + np.array([0.05, 0.0]), np.asarray(inner.bulges))
    moved = type(plan)(**{**vars(plan), "passes": [[deeper], last]})
    _, engagement = as_written(moved, 1e-4)
    # On the left side 0.15 mm are left, on the right 0.05.
    angles = [np.arccos(1.0 - depth / RADIUS) for depth in (0.05, 0.15)]
    assert np.min(np.abs(engagement.angle - angles[0])) < 1e-5
    assert np.min(np.abs(engagement.angle - angles[1])) < 1e-5


def test_open_paths_stay_open():
    plan = plan_of([open_path((20.0, 0.0), (10.0, 0.1), (20.0, 0.0))], "left")
    passes, engagement = as_written(plan, 1e-4)
    assert all(not c.closed for one in passes for c in one)
    assert set(np.unique(engagement.status)) == set(np.unique(plan.after.status))
