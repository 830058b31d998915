"""The cavity that `wear plan` plans: a shape, a table or map, or a solid; and its layers."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.cli import console
from procmodel.errors import InputError, nearest

if TYPE_CHECKING:
    import numpy as np

    from procmodel.wear import Solid
    from procmodel.wear.slicing import Slices
    from procmodel.wear.slicing_layers import WallSlopes

# Meshes come in single precision, and plans with six decimals.
_SAME_DEPTH = 1e-6
# How far from the end of a layer a level floor may lie [um].
_NEAR_FLOOR = 0.05
SHAPES = ("pyramid", "cone", "hemisphere", "slot", "table", "map")


@dataclass(frozen=True)
class Cavity:
    """What is wanted.

    Attributes
    ----------
    name : str
        What it is called in a program.
    full_depth : float [um]
        Its own depth; infinite when that has to be given.
    solid : Solid or None
        A shape whose layers have areas by formula.
    cut : callable or None
        Slices of given bottoms and level; None for a table of areas, which has no outline.
    slopes : callable or None
        Slopes of the wall down to a depth.
    target : Solid, SolidMesh, DepthMap or None
        The wanted surface; None where only layers tell it.
    flats : tuple of float [um]
        Depths of level floors, where a mesh tells them.
    """

    name: str
    full_depth: float
    solid: "Solid | None"
    cut: "Callable[[np.ndarray, str], Slices] | None"
    slopes: "Callable[[float], WallSlopes] | None"
    target: Any = None
    flats: tuple[float, ...] = ()

    def slices(
        self, layer_depth: float, depth: float | None, level: str, scallop: float | None,
        least: float,
    ) -> "Slices":  # fmt: skip
        """The cavity in layers.

        Parameters
        ----------
        layer_depth : float [um]
            Depth of a layer; the greatest with a scallop.
        depth : float, optional [um]
            Depth of the cavity.
        level : str
            Where a layer takes its section.
        scallop : float, optional [um]
            Greatest height of the stairs.
        least : float [um]
            Least depth of a layer with a scallop.

        Returns
        -------
        Slices
            The layers.

        Raises
        ------
        InputError
            If the cavity has no outline, or cannot be cut into such layers.
        """
        from procmodel.wear.layer_bottoms import uniform_bottoms
        from procmodel.wear.slicing_layers import layer_bottoms_by_tolerance

        if self.cut is None or self.slopes is None:
            raise InputError(
                "a table of areas has no outline to scan: give a shape, a --solid, or the shape "
                "'map', or leave out the options of paths and of --scallop."
            )
        depth = self.full_depth if depth is None else depth
        if math.isfinite(depth) and depth > self.full_depth * (1 + _SAME_DEPTH):
            raise InputError(
                f"depth {depth:g} um must be above 0 and at most {self.full_depth:g} um, the "
                f"{self.name}'s own."
            )
        depth = min(depth, self.full_depth)
        if scallop is None:
            bottoms = uniform_bottoms(depth, layer_depth)
        else:
            bottoms = layer_bottoms_by_tolerance(
                self.slopes(depth), scallop, layer_depth, min(least, layer_depth)
            )
        return self.cut(bottoms, level)

    def missed_floors(self, bottoms: list[float]) -> list[str]:
        """What to note of level floors at which no layer ends, bottoms in um."""
        missed = [
            z
            for z in self.flats
            if z < bottoms[-1] and min(abs(z - b) for b in bottoms) > _NEAR_FLOOR
        ]
        if not missed:
            return []
        near = min(bottoms, key=lambda b: abs(b - missed[0]))
        return [
            f"the part has a level floor at {missed[0]:g} um, where no layer ends: it comes out "
            f"near {near:g} um; choose a layer depth that divides it"
        ]

    def planned(self, bottoms: "np.ndarray", level: str, name: str) -> "Slices":
        """The cavity in the layers of a written plan.

        Parameters
        ----------
        bottoms : ndarray, shape (n,) [um]
            Depth of the bottom of every layer.
        level : str
            Where a layer takes its section.
        name : str
            Of the plan's file, for the errors.

        Returns
        -------
        Slices
            The layers.

        Raises
        ------
        InputError
            If the cavity has no outline or is not as deep.
        """
        if self.cut is None:
            raise InputError("a table of areas has no outline to scan: give a shape or a --solid.")
        if bottoms[-1] > self.full_depth * (1 + _SAME_DEPTH):
            raise InputError(
                f"{name} plans a depth of {bottoms[-1]:g} um, but the {self.name} is "
                f"{self.full_depth:g} um deep: give the cavity that was planned."
            )
        import numpy as np

        return self.cut(np.minimum(bottoms, self.full_depth), level)


def cavity_of_solid(
    path: Path, unit: str, undercut: str, travel: tuple[float, float, float] | None
) -> Cavity:
    """The cavity of a mesh file.

    Parameters
    ----------
    path : Path
        The file.
    unit : str
        Unit of its numbers.
    undercut : {"refuse", "clip"}
        What becomes of undercuts.
    travel : tuple of three floats, optional [um]
        Travel of the machine.

    Returns
    -------
    Cavity
        The cavity; level "paper" is the middle of the layer.

    Raises
    ------
    InputError
        As `procmodel.io.read_solid`.
    """
    from procmodel.io import read_solid
    from procmodel.wear.slicing import slice_mesh
    from procmodel.wear.slicing_layers import level_floors, mesh_slopes

    mesh = read_solid(path, unit, travel=travel)

    def cut(bottoms: "np.ndarray", level: str) -> "Slices":
        try:
            return slice_mesh(mesh, bottoms, _level(level), undercut)  # type: ignore[arg-type]
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from None

    return Cavity("solid", mesh.depth, None, cut, lambda depth: mesh_slopes(mesh, depth), mesh,
                  level_floors(mesh))  # fmt: skip


def cavity_of_shape(
    shape: str,
    radius: float | None,
    half_width: float | None,
    wall_angle: float | None,
    table: Path | None,
    length: float | None,
    width: float | None,
) -> Cavity:
    """The cavity of `--shape` and its options.

    Parameters
    ----------
    shape : str
        One of `SHAPES`.
    radius, half_width, length, width : float, optional [um]
        Sizes.
    wall_angle : float, optional [deg]
        Between wall and surface.
    table : Path, optional
        Table of areas, or depth map.

    Returns
    -------
    Cavity
        The cavity.

    Raises
    ------
    InputError
        If the shape is unknown, or what it needs is missing or wrong.
    """
    from procmodel.io import read_area_table
    from procmodel.wear import Hemisphere, TabulatedSolid, cone, pyramid
    from procmodel.wear.slicing import slices_of_solid
    from procmodel.wear.slicing_layers import solid_slopes

    def angle(reason: str) -> float:
        return math.radians(console.required(wall_angle, "--wall-angle", reason))

    if shape == "slot":
        return _slot(length, width)
    if shape == "map":
        return _map(console.required(table, "--table", "the shape 'map'"))
    if shape == "table":
        areas = read_area_table(console.required(table, "--table", "the shape 'table'"))
        tabulated = TabulatedSolid(areas.z, areas.area)
        return Cavity("table", tabulated.full_depth, tabulated, None, None)
    solid: Solid
    if shape == "pyramid":
        wide = console.required(half_width, "--half-width", "a pyramid")
        solid = pyramid(wide, angle("a pyramid"))
    elif shape == "cone":
        solid = cone(console.required(radius, "--radius", "a cone"), angle("a cone"))
    elif shape == "hemisphere":
        solid = Hemisphere(console.required(radius, "--radius", "a hemisphere"))
    else:
        raise InputError(f"--shape is {shape!r}, which is unknown{nearest(shape, SHAPES)}.")
    return Cavity(
        shape,
        solid.full_depth,
        solid,
        lambda bottoms, level: slices_of_solid(solid, bottoms, level),
        lambda depth: solid_slopes(solid, depth),
        solid,
    )


def _slot(length: float | None, width: float | None) -> Cavity:
    import numpy as np

    from procmodel.wear.slicing import slices_of_slot
    from procmodel.wear.slicing_layers import WallSlopes

    long = console.required(length, "--length", "a slot")
    wide = console.required(width, "--width", "a slot")
    return Cavity(
        "slot",
        math.inf,
        None,
        lambda bottoms, _: slices_of_slot(long, wide, bottoms),
        lambda depth: WallSlopes(depth, np.zeros(1), np.empty(0)),
    )


def _map(table: Path) -> Cavity:
    import numpy as np

    from procmodel.io import read_depth_map
    from procmodel.wear.slicing import map_surface, slices_of_depth_map
    from procmodel.wear.slicing_layers import mesh_slopes

    depth_map = read_depth_map(table)

    def cut(bottoms: "np.ndarray", level: str) -> "Slices":
        try:
            return slices_of_depth_map(depth_map, bottoms, _level(level))
        except InputError as error:
            raise InputError(f"{table.name}: {error}") from None

    return Cavity(
        "map",
        float(np.max(depth_map.depth)),
        None,
        cut,
        lambda depth: mesh_slopes(map_surface(depth_map), depth),
        depth_map,
    )


def _level(level: str) -> str:
    """A mesh has no equation of the paper to follow: the level with the least volume error."""
    return "middle" if level == "paper" else level
