"""Target solids: the cavity that is wanted, cut into horizontal layers.

Lengths in um, areas in um^2, angles in rad between the wall and the workpiece surface
(pi/2 is a vertical wall).
"""

import abc
import math
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.errors import InputError, nearest
from procmodel.numerics import safe_sqrt
from procmodel.wear.layer_bottoms import uniform_bottoms
from procmodel.wear.sections import AnnulusSection, CircleSection, Section, SquareSection

_LEVELS = {"top": 0.0, "middle": 0.5, "bottom": 1.0}


class Solid(eqx.Module):
    """A cavity to be made: a section whose half width depends on the depth."""

    @property
    @abc.abstractmethod
    def full_depth(self) -> float:
        """Greatest depth of the solid [um]."""

    @property
    @abc.abstractmethod
    def paper_level(self) -> Literal["top", "bottom"]:
        """Where in a layer the paper takes its section: eq. (5) at the top, (6) at the bottom."""

    @abc.abstractmethod
    def half_width(self, depth: ArrayLike) -> Array:
        """Half width of the solid at a depth.

        Parameters
        ----------
        depth : array_like [um]
            Depth below the workpiece surface.

        Returns
        -------
        Array [um]
            Half width, 0 at and below the full depth.
        """

    @abc.abstractmethod
    def area(self, depth: ArrayLike) -> Array:
        """Area of the solid's section at a depth.

        Parameters
        ----------
        depth : array_like [um]
            Depth below the workpiece surface.

        Returns
        -------
        Array [um^2]
            Section area.
        """


class TaperedSolid(Solid):
    """Solid with straight walls: pyramid or cone, or their frustum when cut short.

    Parameters
    ----------
    opening : float [um]
        Half width at the workpiece surface, > 0.
    wall_angle : float [rad]
        Angle between wall and surface, 0 < angle <= pi/2.
    section : Section
        Square for a pyramid, circle for a cone, or any other.

    Raises
    ------
    InputError
        If a dimension is out of its range.
    """

    opening: float
    wall_angle: float
    section: Section

    def __check_init__(self) -> None:
        if not (math.isfinite(self.opening) and self.opening > 0):
            raise InputError(f"half width {self.opening:g} um must be above 0.")
        if not 0 < self.wall_angle <= math.pi / 2:
            degrees = math.degrees(self.wall_angle)
            raise InputError(
                f"wall angle {degrees:g} deg must be above 0 and at most 90, a vertical wall."
            )

    @property
    def full_depth(self) -> float:
        """Depth of the apex [um]; infinite for a vertical wall."""
        if self.wall_angle == math.pi / 2:
            return math.inf
        return self.opening * math.tan(self.wall_angle)

    @property
    def paper_level(self) -> Literal["top", "bottom"]:
        """Eq. (5): the first layer has the half width of the opening."""
        return "top"

    def half_width(self, depth: ArrayLike) -> Array:
        """Half width at a depth [um]; see `Solid.half_width`."""
        cotangent = 0.0 if self.wall_angle == math.pi / 2 else 1.0 / math.tan(self.wall_angle)
        return jnp.maximum(self.opening - jnp.asarray(depth) * cotangent, 0.0)

    def area(self, depth: ArrayLike) -> Array:
        """Section area at a depth [um^2]; see `Solid.area`."""
        return self.section.area(self.half_width(depth))


class Hemisphere(Solid):
    """Hemispherical cavity, eq. (6) of Yu and Masuzawa: X^2 + Z^2 = r^2.

    Parameters
    ----------
    radius : float [um]
        Radius r > 0.

    Raises
    ------
    InputError
        If the radius is not above 0.
    """

    radius: float

    def __check_init__(self) -> None:
        if not (math.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"radius {self.radius:g} um must be above 0.")

    @property
    def full_depth(self) -> float:
        """The radius [um]."""
        return self.radius

    @property
    def paper_level(self) -> Literal["top", "bottom"]:
        """Eq. (6): X_n belongs to the bottom Z_n of the layer."""
        return "bottom"

    def half_width(self, depth: ArrayLike) -> Array:
        """Half width at a depth [um]; see `Solid.half_width`."""
        return safe_sqrt(self.radius**2 - jnp.asarray(depth) ** 2)

    def area(self, depth: ArrayLike) -> Array:
        """Section area at a depth [um^2]; see `Solid.area`."""
        return CircleSection().area(self.half_width(depth))


class TabulatedSolid(Solid):
    """Any solid, given by its section area at a few depths, linear in between.

    Parameters
    ----------
    depths : array_like, shape (m,) [um]
        Strictly increasing depths, from 0 or below the surface down.
    areas : array_like, shape (m,) [um^2]
        Section area at each depth, >= 0.

    Raises
    ------
    InputError
        If the table is too short, not sorted, or has a negative area.
    """

    depths: Array
    areas: Array

    def __init__(self, depths: ArrayLike, areas: ArrayLike):
        z, a = np.asarray(depths, float), np.asarray(areas, float)
        if z.ndim != 1 or z.shape != a.shape or len(z) < 2:
            raise InputError("depths and areas must be two lists of the same length, 2 or more.")
        if not (np.all(np.isfinite(z)) and np.all(np.diff(z) > 0) and z[0] >= 0):
            raise InputError("depths must be >= 0 and increase from entry to entry: sort them.")
        if not np.all(a >= 0):
            raise InputError(f"areas entry {int(np.argmin(a >= 0)) + 1} is below 0: correct it.")
        self.depths, self.areas = jnp.asarray(z), jnp.asarray(a)

    @property
    def full_depth(self) -> float:
        """Last depth of the table [um]."""
        return float(self.depths[-1])

    @property
    def paper_level(self) -> Literal["top", "bottom"]:
        """The section at the top of the layer, as eq. (5)."""
        return "top"

    def half_width(self, depth: ArrayLike) -> Array:
        """Half width of the square of equal area [um]; see `Solid.half_width`."""
        return safe_sqrt(self.area(depth)) / 2.0

    def area(self, depth: ArrayLike) -> Array:
        """Section area at a depth [um^2]; see `Solid.area`."""
        return jnp.interp(jnp.asarray(depth), self.depths, self.areas)


def pyramid(half_width: float, wall_angle: float) -> TaperedSolid:
    """Square pyramid with its base at the surface.

    Parameters
    ----------
    half_width : float [um]
        Half width at the surface.
    wall_angle : float [rad]
        Angle between wall and surface.

    Returns
    -------
    TaperedSolid
        The solid.
    """
    return TaperedSolid(half_width, wall_angle, SquareSection())


def cone(radius: float, wall_angle: float) -> TaperedSolid:
    """Circular cone with its base at the surface.

    Parameters
    ----------
    radius : float [um]
        Radius at the surface.
    wall_angle : float [rad]
        Angle between wall and surface.

    Returns
    -------
    TaperedSolid
        The solid.
    """
    return TaperedSolid(radius, wall_angle, CircleSection())


class TargetLayers(eqx.Module):
    """The layers of a wanted cavity, from the surface down.

    Attributes
    ----------
    bottom : Array, shape (n,) [um]
        Wanted depth of the bottom of every layer.
    thickness : Array, shape (n,) [um]
        Wanted depth of every layer alone.
    half_width : Array, shape (n,) [um]
        Half width cleared in every layer.
    area : Array, shape (n,) [um^2]
        Area cleared in every layer.
    """

    bottom: Array
    thickness: Array
    half_width: Array
    area: Array

    @property
    def volume(self) -> Array:
        """Volume of the staircase [um^3]."""
        return jnp.sum(self.thickness * self.area)


def split_for_finishing(
    layers: TargetLayers, section: Section, thickness: float
) -> tuple[TargetLayers, TargetLayers]:
    """Leave a ring on the wall for a finishing stage (section 3.4 of Yu and Masuzawa).

    Parameters
    ----------
    layers : TargetLayers
        The finished cavity.
    section : Section
        Its section.
    thickness : float [um]
        Radial thickness left for finishing, > 0.

    Returns
    -------
    (TargetLayers, TargetLayers)
        Roughing, without the layers that are all ring, and finishing. Together they remove the
        volume of `layers`.

    Raises
    ------
    InputError
        If the thickness is not above 0, or leaves nothing to rough.
    """
    widest = float(layers.half_width[0])
    if not 0 < thickness < widest:
        raise InputError(
            f"finishing thickness {thickness:g} um must be above 0 and below the half width "
            f"{widest:g} um."
        )
    inside = np.asarray(layers.half_width) - thickness
    roughed = np.flatnonzero(inside > 0)
    narrower = jnp.asarray(inside[roughed])
    roughing = TargetLayers(
        bottom=layers.bottom[roughed],
        thickness=layers.thickness[roughed],
        half_width=narrower,
        area=section.area(narrower),
    )
    ring = AnnulusSection(section, thickness).area(layers.half_width)
    return roughing, TargetLayers(layers.bottom, layers.thickness, layers.half_width, ring)


def slice_solid(
    solid: Solid, layer_depth: float, depth: float | None = None, level: str = "paper"
) -> TargetLayers:
    """Cut a solid into layers of equal depth; the last takes what does not divide.

    A remainder of more than a tenth of a layer is a thinner layer, a smaller one deepens the last.

    Parameters
    ----------
    solid : Solid
        The wanted cavity.
    layer_depth : float [um]
        Depth of a layer, > 0.
    depth : float, optional [um]
        Depth of the cavity; the solid's full depth when left out.
    level : {"paper", "top", "middle", "bottom"}
        Height within the layer at which its section is taken. "paper" is the top for straight
        walls and tables (eq. 5) and the bottom for the hemisphere (eq. 6); "middle" has the
        least volume error.

    Returns
    -------
    TargetLayers
        The layers.

    Raises
    ------
    InputError
        If the level is unknown, or the depth is missing, not above 0, or greater than the solid's.
    """
    known = ("paper", *_LEVELS)
    if level not in known:
        raise InputError(f"level {level!r} is unknown{nearest(level, known)}.")
    full = solid.full_depth
    if depth is None:
        depth = full
    if not math.isfinite(depth):
        raise InputError("depth is missing: a cavity with vertical walls needs one.")
    if not 0 < depth <= full * (1 + 1e-9):
        raise InputError(
            f"depth {depth:g} um must be above 0 and at most {full:g} um, the solid's own."
        )
    bottom = uniform_bottoms(depth, layer_depth)
    thickness = np.diff(bottom, prepend=0.0)
    share = _LEVELS[solid.paper_level if level == "paper" else level]
    height = jnp.asarray(bottom - (1.0 - share) * thickness)
    return TargetLayers(
        bottom=jnp.asarray(bottom),
        thickness=jnp.asarray(thickness),
        half_width=solid.half_width(height),
        area=solid.area(height),
    )
