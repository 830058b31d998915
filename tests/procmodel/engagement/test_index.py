"""Pieces near the rim: against every piece asked one by one, for short and long pieces."""

import math

import numpy as np
import pytest

from procmodel.engagement.contour import contour
from procmodel.engagement.index import SegmentIndex
from procmodel.engagement.segments import Segments, advance, joined, lengths

RADIUS = 5.0


def cloud(pieces, seed):
    """A ring of arcs that bulge either way, and a straight line of short pieces beside it."""
    random = np.random.default_rng(seed)
    phi = 2 * math.pi * np.arange(pieces) / pieces
    radius = 20.0 + 0.4 * np.cos(7 * phi)
    ring = contour(
        np.column_stack([radius * np.cos(phi), radius * np.sin(phi)]),
        random.uniform(-0.9, 0.9, pieces) / max(1.0, pieces / 60),
    )
    x = np.linspace(-25.0, 25.0, pieces + 1)
    points = np.column_stack([x, np.full(pieces + 1, 27.0)])
    line = Segments(points[:-1], points[1:], np.tile([1.0, 0.0], (pieces, 1)), np.zeros(pieces))
    return joined([ring.segments.on_host(), line])


def nearest_and_farthest(segments, centre):
    """Of points close to each other on every piece, the distances from a centre."""
    way = np.linspace(0.0, 1.0, 65) * lengths(segments, np)[:, None]
    points, _ = advance(
        segments.start[:, None], segments.direction[:, None], segments.curvature[:, None], way, np
    )
    away = np.hypot(*np.moveaxis(points - centre, -1, 0))
    return away.min(axis=1), away.max(axis=1), np.diff(way[:, :2])[:, 0]


@pytest.mark.parametrize("pieces", [7, 60, 900, 3000])
@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_no_piece_is_missed_and_few_are_added(pieces, margin):
    segments = cloud(pieces, 1)
    index = SegmentIndex(segments)
    random = np.random.default_rng(2)
    centres = random.uniform(-30, 30, (30, 2))
    tables = index.tables(centres, RADIUS, margin, 1 << 16)
    seen, found, wanted = np.zeros(30, int), 0, 0
    for places, table in tables:
        seen[places] += 1
        assert table.shape == (len(places), 1 << int(math.log2(table.shape[1])))
        for place, row in zip(places, table, strict=True):
            listed = row[row >= 0]
            assert len(set(listed)) == len(listed)
            near, far, step = nearest_and_farthest(segments, centres[place])
            # Between two of the points a piece may come nearer by half a step's square.
            sure = (near <= RADIUS + margin) & (far >= RADIUS - margin)
            loose = (near <= RADIUS + margin + 1.0 + step) & (far >= RADIUS - margin - 1.0 - step)
            assert set(np.flatnonzero(sure)) <= set(listed)
            found, wanted = found + len(listed), wanted + loose.sum()
    np.testing.assert_array_equal(seen, 1)
    assert found <= wanted


def test_what_is_found_does_not_grow_with_the_pieces():
    counts = []
    for pieces in (500, 5000, 50000):
        segments = cloud(pieces, 3)
        centres = np.column_stack([np.linspace(-15, 15, 40), np.full(40, 22.1)])
        tables = SegmentIndex(segments).tables(centres, RADIUS, 0.0, 1 << 16)
        counts.append(sum(np.sum(table >= 0) for _, table in tables))
    assert counts[2] <= counts[0] + 40
    assert min(counts) >= 40


def test_rows_are_split_and_nothing_is_asked_of_nobody():
    index = SegmentIndex(cloud(60, 4))
    tables = index.tables(np.zeros((1000, 2)), 20.0, 0.0, 300)
    assert [len(places) for places, _ in tables] == [250] * 4
    assert index.tables(np.zeros((0, 2)), 20.0, 0.0, 300) == []
