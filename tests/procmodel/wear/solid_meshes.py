"""Closed meshes of cavities, depths counted downwards, built without the library."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    vertices: np.ndarray
    faces: np.ndarray

    @property
    def volume(self):
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c)))) / 6.0


def box(low, high):
    """Box between two corners."""
    x, y, z = np.transpose([low, high])
    vertices = np.array([[a, b, c] for c in z for b in y for a in x], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(vertices, np.array(faces))


def lathe(radii, depths, corners=64):
    """Solid of revolution about z through (radius, depth) pairs, closed by discs at both ends."""
    angle = 2 * np.pi * np.arange(corners) / corners
    round_about = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [
        np.column_stack([r * round_about, np.full(corners, z)])
        for r, z in zip(radii, depths, strict=True)
    ]
    ends = np.array([[0, 0, depths[0]], [0, 0, depths[-1]]])
    i = np.arange(corners)
    j = (i + 1) % corners
    faces = []
    for k in range(len(radii) - 1):
        a, b = k * corners + i, k * corners + j
        c, d = a + corners, b + corners
        faces += [np.column_stack([a, b, d]), np.column_stack([a, d, c])]
    top, bottom = len(radii) * corners, len(radii) * corners + 1
    last = (len(radii) - 1) * corners
    faces += [np.column_stack([j, i, np.full(corners, top)])]
    faces += [np.column_stack([last + i, last + j, np.full(corners, bottom)])]
    return Mesh(np.vstack([*rings, ends]), np.vstack(faces))


def hemisphere(radius, corners=64, rings=64):
    """Hemispherical bowl; its lowest ring is very small, so that no triangle collapses."""
    angle = np.linspace(0.0, np.pi / 2, rings + 1)
    radii = radius * np.cos(angle)
    radii[-1] = 1e-6 * radius
    return lathe(radii, radius * np.sin(angle), corners)


def together(*meshes):
    """Several meshes as one, turned inside out where a mesh is given as (mesh, -1)."""
    vertices, faces, count = [], [], 0
    for mesh in meshes:
        mesh, turn = mesh if isinstance(mesh, tuple) else (mesh, 1)
        vertices.append(mesh.vertices)
        faces.append(mesh.faces[:, ::turn] + count)
        count += len(mesh.vertices)
    return Mesh(np.vstack(vertices), np.vstack(faces))
