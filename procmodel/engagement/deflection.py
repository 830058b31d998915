"""Deflection of an end mill under a force across it.

Lengths in mm, forces in N, heights count from the tool's end towards the clamp.

Notation: L overhang, E Young's modulus, I second moment of area, b and x distances of the load and
of the place asked for from the clamp.

References
----------
.. [1] L. Kops, D. T. Vo, "Determination of the equivalent diameter of an end mill based on its
   compliance", CIRP Annals 39(1), 93-96, 1990: a fluted tool bends like a cylinder of 0.8 times
   its diameter.
.. [2] S. P. Timoshenko, "Strength of Materials", part 1: bending of a cantilever.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

EFFECTIVE_DIAMETER = 0.8


def cantilever_deflection(
    force: ArrayLike,
    load_distance: ArrayLike,
    distance: ArrayLike,
    youngs_modulus: ArrayLike,
    second_moment: ArrayLike,
) -> Array:
    """Deflection of a cantilever under one load across it.

    Parameters
    ----------
    force : array_like [N]
        The load.
    load_distance : array_like [mm]
        Its distance b from the clamp; behind the clamp, below 0, it bends nothing.
    distance : array_like [mm]
        Distance x from the clamp of the place asked for.
    youngs_modulus : array_like [N/mm^2]
        Young's modulus E.
    second_moment : array_like [mm^4]
        Second moment of area I.

    Returns
    -------
    Array [mm]
        F m^2 (3 M - m) / (6 E I) with m the smaller and M the greater of b and x, so that load
        and place can be exchanged (Maxwell).
    """
    load, place = (jnp.maximum(jnp.asarray(d), 0.0) for d in (load_distance, distance))
    near, far = jnp.minimum(load, place), jnp.maximum(load, place)
    bent = near**2 * (3.0 * far - near)
    return jnp.asarray(force) * bent / (6.0 * jnp.asarray(youngs_modulus) * second_moment)


class ToolStiffness(eqx.Module):
    """How far a tool gives way; linear in the force."""

    @abc.abstractmethod
    def deflection(self, force: ArrayLike, load_height: ArrayLike, at_height: ArrayLike) -> Array:
        """Deflection in the direction of a force.

        Parameters
        ----------
        force : array_like [N]
            The load.
        load_height : array_like [mm]
            Height above the tool's end at which it acts.
        at_height : array_like [mm]
            Height above the tool's end of the place asked for.

        Returns
        -------
        Array [mm]
            Of the broadcast shape.
        """


class Cantilever(ToolStiffness):
    """Tool clamped at one end, bending alone: holder and spindle are rigid.

    Parameters
    ----------
    diameter : array_like [mm]
        Diameter D of the tool; a cylinder of 0.8 D bends in its stead.
    overhang : array_like [mm]
        Length L from the clamp to the tool's end.
    youngs_modulus : array_like [N/mm^2]
        Young's modulus E; about 6e5 for cemented carbide.
    """

    diameter: ArrayLike
    overhang: ArrayLike
    youngs_modulus: ArrayLike

    @property
    def second_moment(self) -> Array:
        """Second moment of area of the effective cylinder, pi (0.8 D)^4 / 64 [mm^4]."""
        return jnp.pi / 64.0 * (EFFECTIVE_DIAMETER * jnp.asarray(self.diameter)) ** 4

    @property
    def end_stiffness(self) -> Array:
        """Force per deflection, both at the tool's end, 3 E I / L^3 [N/mm]."""
        return (
            3.0
            * jnp.asarray(self.youngs_modulus)
            * self.second_moment
            / jnp.asarray(self.overhang) ** 3
        )

    def deflection(self, force: ArrayLike, load_height: ArrayLike, at_height: ArrayLike) -> Array:
        """Deflection in the direction of a force [mm]; see `ToolStiffness.deflection`."""
        overhang = jnp.asarray(self.overhang)
        load, place = overhang - jnp.asarray(load_height), overhang - jnp.asarray(at_height)
        return cantilever_deflection(force, load, place, self.youngs_modulus, self.second_moment)


class MeasuredStiffness(ToolStiffness):
    """Stiffness of tool, holder and spindle together, the same at every height of the cut.

    Parameters
    ----------
    stiffness : array_like [N/mm]
        Force across the tool per deflection of the tool in the cut.
    """

    stiffness: ArrayLike

    def deflection(self, force: ArrayLike, load_height: ArrayLike, at_height: ArrayLike) -> Array:
        """Deflection in the direction of a force [mm]; see `ToolStiffness.deflection`."""
        given_way = jnp.asarray(force) / jnp.asarray(self.stiffness)
        shape = jnp.broadcast_shapes(given_way.shape, jnp.shape(load_height), jnp.shape(at_height))
        return jnp.broadcast_to(given_way, shape)
