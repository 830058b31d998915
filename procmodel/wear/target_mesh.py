"""Depth of a closed mesh under the places of a grid.

Lengths in um, depths downwards positive.
"""

import numpy as np

from procmodel.wear.slicing_layers import Mesh

# Places that are looked at in one go: bounds the memory.
_AT_ONCE = 2_000_000
# How far beyond its edge a triangle still counts, as a share of itself: no place between two
# triangles is lost to rounding.
_EDGE = 1e-9


def mesh_depth(mesh: Mesh, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Greatest depth of a mesh's surface at the places of a grid.

    Parameters
    ----------
    mesh : Mesh
        The volume to be removed, depths counted downwards from the workpiece surface.
    x, y : ndarray, shape (n,) and (m,) [um]
        Places along each axis, increasing.

    Returns
    -------
    ndarray, shape (n, m) [um]
        Depth, 0 beyond the mesh.
    """
    corners = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]
    a, b, c = (corners[:, i, :2] for i in range(3))
    double = _cross(b - a, c - a)
    # Walls that stand upright cover no place.
    corners, double = corners[double != 0.0], double[double != 0.0]
    flat = corners[:, :, :2]
    low, high = flat.min(axis=1), flat.max(axis=1)
    first = np.column_stack([np.searchsorted(x, low[:, 0]), np.searchsorted(y, low[:, 1])])
    last = np.column_stack(
        [np.searchsorted(x, high[:, 0], "right"), np.searchsorted(y, high[:, 1], "right")]
    )
    size = np.maximum(last - first, 0)
    counts = size[:, 0] * size[:, 1]
    found = np.zeros(len(x) * len(y))
    batch = np.cumsum(counts) // _AT_ONCE
    for part in np.split(np.arange(len(counts)), np.flatnonzero(np.diff(batch)) + 1):
        number = np.repeat(part, counts[part])
        if not len(number):
            continue
        ends = np.cumsum(counts[part])
        local = np.arange(ends[-1]) - np.repeat(ends - counts[part], counts[part])
        row, column = np.divmod(local, size[number, 1])
        row, column = row + first[number, 0], column + first[number, 1]
        place = np.column_stack([x[row], y[column]])
        triangle, area = corners[number], double[number]
        shares = [
            _cross(
                triangle[:, (i + 2) % 3, :2] - triangle[:, (i + 1) % 3, :2],
                place - triangle[:, (i + 1) % 3, :2],
            )
            / area
            for i in range(3)
        ]
        inside = np.minimum.reduce(shares) >= -_EDGE
        depth = sum(share * triangle[:, i, 2] for i, share in enumerate(shares))
        np.maximum.at(found, (row * len(y) + column)[inside], depth[inside])
    return found.reshape(len(x), len(y))


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
