"""Solids: the volume of a cavity as a closed mesh (STL, OBJ, PLY, OFF).

A mesh comes in as the drawing has it, z upwards. It leaves in um with z counted downwards from the
workpiece surface, as depths are, its faces still wound so that their normals point out of it.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from procmodel.errors import InputError, nearest
from procmodel.io.textfile import read_bytes
from procmodel.io.units import conversion_factor

FORMATS = ("stl", "obj", "ply", "off")
_TOPS = ("highest", "file")


@dataclass(frozen=True)
class SolidMesh:
    """Volume to be removed, as a closed surface of triangles.

    Attributes
    ----------
    vertices : numpy.ndarray, shape (n, 3), um
        Corners (x, y, depth), the depth counted downwards from the workpiece surface.
    faces : numpy.ndarray, shape (m, 3), int
        Corners of every triangle; by the right-hand rule in (x, y, depth) the normal points
        outwards.
    path : pathlib.Path or None
        The file.
    """

    vertices: np.ndarray
    faces: np.ndarray
    path: Path | None = None

    @property
    def extents(self) -> np.ndarray:
        """Size along x, y and z, shape (3,), um."""
        return np.ptp(self.vertices, axis=0)

    @property
    def depth(self) -> float:
        """Depth of the deepest corner [um]."""
        return float(np.max(self.vertices[:, 2]))

    @property
    def volume(self) -> float:
        """Volume enclosed [um^3]."""
        return float(np.sum(_signed_volumes(self.vertices, self.faces)))


def read_solid(
    path: str | os.PathLike[str],
    unit: str = "um",
    top: Literal["highest", "file"] = "highest",
    travel: Sequence[float] | None = None,
) -> SolidMesh:
    """Read the volume of a cavity from a mesh file and check that it can be sliced.

    Parameters
    ----------
    path : path-like
        STL (ASCII or binary), OBJ, PLY or OFF, told apart by the ending.
    unit : str
        Unit of the file's numbers, "um", "mm" or any other length: none of the formats says it.
    top : {"highest", "file"}
        What becomes the workpiece surface, depth 0: the highest point of the mesh, or the height
        0 of the file, above which nothing may then stand.
    travel : sequence of three floats, optional [um]
        Travel of the machine along x, y and z.

    Returns
    -------
    SolidMesh
        The mesh, corners at the same place merged, triangles without area dropped.

    Raises
    ------
    InputError
        If the file cannot be read, is no mesh, is empty, holds a number that is not finite, is
        open, wound inconsistently or inside out, stands above the surface, or is larger than the
        travel. Bodies that overlap are found by `procmodel.wear.slice_mesh`.
    """
    path = Path(path)
    if top not in _TOPS:
        raise InputError(f"top {top!r} is unknown{nearest(top, _TOPS)}.")
    factor = conversion_factor(unit, "um")
    vertices, faces = _load(path)
    bad = int(np.sum(~np.isfinite(vertices).all(axis=1)))
    if bad:
        raise InputError(
            f"{path}: {bad} of {len(vertices)} corners are not finite numbers: export it again."
        )
    vertices, faces = _merged(vertices * factor, faces)
    if len(faces) == 0:
        raise InputError(
            f"{path}: the mesh is empty, without a triangle that has an area: export it again."
        )
    _require_closed(path, faces)
    highest = float(np.max(vertices[:, 2])) if top == "highest" else 0.0
    if np.max(vertices[:, 2]) > highest + 1e-6:
        raise InputError(
            f"{path}: the mesh stands {np.max(vertices[:, 2]):g} um above height 0, the workpiece "
            "surface: draw the cavity below it, or let its highest point be the surface."
        )
    # Counting z downwards mirrors the solid: the winding is turned round with it.
    vertices = np.column_stack([vertices[:, :2], highest - vertices[:, 2]])
    mesh = SolidMesh(vertices, faces[:, ::-1], path)
    _require_right_side_out(mesh)
    if travel is not None:
        _require_travel(mesh, travel)
    return mesh


def _load(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles as the file has them."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        known = ", ".join(f".{name}" for name in FORMATS)
        raise InputError(f"{path}: a solid ends in {known}: export it as one of them.")
    content = read_bytes(path)
    import trimesh

    try:
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
        meshes = [m for m in scene.dump() if isinstance(m, trimesh.Trimesh)]
    # The loaders raise whatever their parsing runs into: IndexError, struct.error, KeyError ...
    except Exception as error:
        raise InputError(
            f"{path}: this is no mesh in the format {kind.upper()} ({type(error).__name__}): "
            "export it again."
        ) from error
    faces, vertices, count = [], [], 0
    for mesh in meshes:
        faces.append(np.asarray(mesh.faces, dtype=np.int64) + count)
        vertices.append(np.asarray(mesh.vertices, dtype=float))
        count += len(mesh.vertices)
    if count == 0 or not any(len(f) for f in faces):
        raise InputError(
            f"{path}: the mesh is empty, or the file is no {kind.upper()}: export the solid again."
        )
    return np.concatenate(vertices), np.concatenate(faces)


def _merged(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners at the same place made one, unused ones and collapsed triangles dropped."""
    # STL repeats a corner in every triangle, with the same bits; other writers round to 1e-8.
    size = float(np.max(np.ptp(vertices, axis=0), initial=0.0)) or 1.0
    grid = np.round((vertices - vertices.min(axis=0)) / (size * 1e-9)).astype(np.int64)
    # One number instead of three to sort by: 2^30 steps and a little along each axis.
    mixed = (grid[:, 0] * np.int64(1_000_003) + grid[:, 1]) * np.int64(998_244_353) + grid[:, 2]
    _, first, inverse = np.unique(mixed, return_index=True, return_inverse=True)
    if np.any(grid[first][inverse.ravel()] != grid):  # two places with one number
        _, first, inverse = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    faces = inverse.ravel()[faces]
    apart = faces != np.roll(faces, -1, axis=1)
    faces = faces[apart.all(axis=1)]
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[first][used], renumbered.reshape(faces.shape)


def _require_closed(path: Path, faces: np.ndarray) -> None:
    """Every edge must be met once in each direction for every time it is met."""
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = np.int64(faces.max()) + 1
    forward = starts < ends
    edges = np.where(forward, starts * count + ends, ends * count + starts)
    unique, which = np.unique(edges, return_inverse=True)
    balance = np.bincount(which, weights=np.where(forward, 1.0, -1.0), minlength=len(unique))
    uses = np.bincount(which, minlength=len(unique))
    odd = int(np.sum(uses % 2 == 1))
    if odd:
        raise InputError(
            f"{path}: the mesh is open: {odd} edges belong to an odd number of triangles; close "
            "the holes (a solid, not a surface, must be exported)."
        )
    twisted = int(np.sum(balance != 0))
    if twisted:
        raise InputError(
            f"{path}: the mesh is wound inconsistently along {twisted} edges: unify its normals "
            "and export it again."
        )


def _require_right_side_out(mesh: SolidMesh) -> None:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    volumes = _signed_volumes(mesh.vertices, mesh.faces)
    total = float(np.sum(volumes))
    if not total > 0:
        what = "has no volume" if total == 0 else "is inside out (its volume is negative)"
        raise InputError(f"{mesh.path}: the mesh {what}: turn its normals outwards.")
    ones = np.ones(2 * len(mesh.faces))
    pairs = np.concatenate([mesh.faces[:, :2], mesh.faces[:, 1:]])
    corners = len(mesh.vertices)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(corners, corners))
    bodies, body_of = connected_components(graph, directed=False)
    if bodies == 1:
        return
    body_of_face = body_of[mesh.faces[:, 0]]
    of_body = np.bincount(body_of_face, weights=volumes, minlength=bodies)
    low, high = np.full((bodies, 3), np.inf), np.full((bodies, 3), -np.inf)
    np.minimum.at(low, body_of, mesh.vertices)
    np.maximum.at(high, body_of, mesh.vertices)
    for body in np.flatnonzero(of_body < 0):
        around = (low <= low[body]).all(1) & (high >= high[body]).all(1) & (of_body > 0)
        # Inside another body it is that body's void; the slices say what becomes of it.
        if not around.any():
            raise InputError(
                f"{mesh.path}: body {body + 1} of {bodies} is inside out (its volume is "
                "negative): turn its normals outwards."
            )


def _signed_volumes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Volume of the tetrahedron between every triangle and the middle of the mesh."""
    a, b, c = (vertices[faces[:, i]] - vertices.mean(axis=0) for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0


def _require_travel(mesh: SolidMesh, travel: Sequence[float]) -> None:
    if len(travel) != 3 or not all(math.isfinite(t) and t > 0 for t in travel):
        raise InputError("travel must be three lengths in um above 0, along x, y and z.")
    size = (*mesh.extents[:2], mesh.depth)
    for axis, length, limit in zip("xyz", size, travel, strict=True):
        if length > limit:
            raise InputError(
                f"{mesh.path}: the part is {length:g} um long along {axis}, more than the travel "
                f"of {limit:g} um: check its unit, or make it in pieces."
            )
