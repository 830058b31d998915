"""Solids cut into layers: ours beside trimesh, and how the time grows; reading and scanning."""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import shapely
import trimesh

from benchmarks import measure
from benchmarks.report import Section
from benchmarks.sizes import QUICK, Sizes
from procmodel.io import read_solid
from procmodel.wear.layer_bottoms import uniform_bottoms
from procmodel.wear.layer_path import ElectrodeSection
from procmodel.wear.scanning import scan_layers
from procmodel.wear.slicing import Slices, slice_mesh

RADIUS = 100.0
TRIANGLES, LAYERS = 100_000, 200
WANTED_SECONDS = 2.0
AGREEMENT = 1e-9
ELECTRODE, GAP = ElectrodeSection("round", 20.0), 1.0


def run(section: Section, sizes: Sizes) -> None:
    quick = sizes is QUICK
    triangles, layers = (TRIANGLES // 100, LAYERS // 20) if quick else (TRIANGLES, LAYERS)
    solid = bowl(triangles)
    section.text(
        f"A hemispherical cavity of r = {RADIUS:g} µm as a mesh of {len(solid.faces):,} triangles, "
        f"cut in {layers} planes, each in the middle of its layer. Ours also looks for undercuts, "
        "overlapping bodies and empty layers. trimesh cuts all planes at once "
        "(`intersections.mesh_multiplane`) and shapely links the pieces (`polygonize`). trimesh's "
        "own `section_multiplane` makes curves; their polygons and areas need networkx, which is "
        "not installed, so that it is timed without them. All are handed the mesh in memory; the "
        "peers do not check what they are given."
    )
    bottoms = uniform_bottoms(0.95 * RADIUS, 0.95 * RADIUS / layers)
    heights = bottoms - np.diff(bottoms, prepend=0.0) / 2.0
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    turns = measure.interleaved(
        {"ours": lambda: slice_mesh(solid, bottoms).areas,
         "trimesh + shapely": lambda: peer_areas(mesh, heights),
         "trimesh, curves alone": lambda: curves(mesh, heights)},
        sizes.path_repeats,
    )  # fmt: skip
    seconds, areas = turns.seconds, turns.outcomes
    exact = math.pi * (RADIUS**2 - heights**2)
    section.heading(f"{len(solid.faces):,} triangles in {layers} layers")
    section.table(
        ["contestant", "time", "time / ours", "greatest error of an area against the sphere"],
        [
            [name, measure.time_spread(taken), measure.ratio(taken, seconds["ours"]),
             f"{np.max(np.abs(areas[name] / exact - 1)):.1e}" if areas[name] is not None
             else "not computed"]
            for name, taken in seconds.items()
        ],
    )  # fmt: skip
    ours = float(np.median(seconds["ours"]))
    section.target(
        f"{len(solid.faces):,} triangles in {layers} layers", f"under {WANTED_SECONDS:g} s",
        f"{ours:.3g} s", ours < WANTED_SECONDS,
    )  # fmt: skip
    apart = float(np.max(np.abs(areas["ours"] / areas["trimesh + shapely"] - 1)))
    section.target(
        "same areas as trimesh", f"within {AGREEMENT:g}", f"{apart:.1e}", apart <= AGREEMENT
    )
    _growth(section, sizes, triangles, layers)
    _whole_way(section, sizes, solid, bottoms)


def bowl(triangles: int) -> SimpleNamespace:
    """Closed mesh of a hemisphere, depths downwards, of about so many triangles."""
    rings = max(4, round(math.sqrt(triangles / 6.4)))
    corners = round(triangles / (2 * rings))
    polar = np.linspace(0.0, np.pi / 2, rings + 1)[:-1]
    angle = 2 * np.pi * np.arange(corners) / corners
    points = [
        np.column_stack([
            RADIUS * math.cos(t) * np.cos(angle), RADIUS * math.cos(t) * np.sin(angle),
            np.full(corners, RADIUS * math.sin(t)),
        ])
        for t in polar
    ]  # fmt: skip
    vertices = np.vstack([*points, [[0.0, 0.0, RADIUS], [0.0, 0.0, 0.0]]])
    i = np.arange(corners)
    j = (i + 1) % corners
    faces = []
    for k in range(rings - 1):
        a, b = k * corners + i, k * corners + j
        faces += [np.column_stack([a, b, b + corners])]
        faces += [np.column_stack([a, b + corners, a + corners])]
    pole, middle, last = rings * corners, rings * corners + 1, (rings - 1) * corners
    faces += [np.column_stack([last + i, last + j, np.full(corners, pole)])]
    faces += [np.column_stack([j, i, np.full(corners, middle)])]
    return SimpleNamespace(vertices=vertices, faces=np.vstack(faces))


def peer_areas(mesh: trimesh.Trimesh, heights: np.ndarray) -> np.ndarray:
    """Areas of the sections by trimesh and shapely, as a user would write it."""
    pieces, _, _ = trimesh.intersections.mesh_multiplane(mesh, [0, 0, 0], [0, 0, 1], heights)
    # The two ends of neighbouring pieces differ in their last digits.
    return np.array(
        [
            shapely.polygonize(shapely.linestrings(np.round(lines, 9))).area
            if len(lines) else 0.0
            for lines in pieces
        ]
    )  # fmt: skip


def curves(mesh: trimesh.Trimesh, heights: np.ndarray) -> None:
    """Sections as trimesh's own curves, which is as far as it goes here."""
    mesh.section_multiplane([0, 0, 0], [0, 0, 1], heights)


def _growth(section: Section, sizes: Sizes, triangles: int, layers: int) -> None:
    cases = {
        f"{triangles:,} triangles, {layers} layers": (triangles, layers),
        f"{10 * triangles:,} triangles, {layers} layers": (10 * triangles, layers),
        f"{triangles:,} triangles, {10 * layers} layers": (triangles, 10 * layers),
    }
    calls: dict[str, Callable[[], Slices]] = {}
    for name, (some, many) in cases.items():
        solid, bottoms = bowl(some), uniform_bottoms(0.95 * RADIUS, 0.95 * RADIUS / many)
        calls[name] = lambda solid=solid, bottoms=bottoms: slice_mesh(solid, bottoms)
    seconds = measure.interleaved(calls, max(2, sizes.path_repeats // 2)).seconds
    base = seconds[next(iter(cases))]
    section.heading("Growth")
    section.table(
        ["size", "time", "time / smallest"],
        [[name, measure.time_spread(t), measure.ratio(t, base)] for name, t in seconds.items()],
    )


def _whole_way(section: Section, sizes: Sizes, solid: SimpleNamespace, bottoms: np.ndarray) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bowl.stl"
        upwards = np.column_stack([solid.vertices[:, :2], -solid.vertices[:, 2]])
        trimesh.Trimesh(upwards, solid.faces[:, ::-1], process=False).export(path)
        slices = slice_mesh(solid, bottoms)
        reach = slices.reach(ELECTRODE, GAP)
        seconds = measure.interleaved(
            {
                "read and check the STL": lambda: read_solid(path),
                "slice": lambda: slice_mesh(solid, bottoms),
                "reachable regions and areas": lambda: slices.reach(ELECTRODE, GAP),
                "paths along contours": lambda: scan_layers(
                    slices, ELECTRODE, GAP, pattern="contour", reach=reach
                ),
                "paths along lines": lambda: scan_layers(
                    slices, ELECTRODE, GAP, pattern="raster", reach=reach
                ),
            },
            max(2, sizes.path_repeats // 2),
        ).seconds
    section.heading(f"From the file to the paths, electrode of {ELECTRODE.size:g} µm")
    section.table(
        ["step", "time"], [[name, measure.time_spread(taken)] for name, taken in seconds.items()]
    )
