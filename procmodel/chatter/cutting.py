"""Tool, cut and cutting force of milling with regeneration.

SI units, angles in rad, the spindle's rotation in revolutions. A point of the rim at the angle phi
is in the direction (sin(phi), cos(phi)) from the tool's centre, x along the feed; phi grows as the
tool turns. Up milling enters at phi = 0, down milling leaves at phi = pi. Forces act on the tool.

Notation: phi angle of a tooth, N teeth, a axial depth, c feed per tooth, K_t and K_n tangential and
normal cutting coefficients per area of the chip, n = (sin(phi), cos(phi)) direction off the tool's
centre, t = (cos(phi), -sin(phi)) direction in which the tooth moves.

References
----------
.. [1] T. Insperger, G. Stepan, "Updated semi-discretization method for periodic delay-differential
   equations with discrete delay", Int. J. Numer. Meth. Engng 61, 117-141, 2004: the case of one
   mode, and the directional coefficients.
.. [2] T. L. Schmitz, K. S. Smith, "Machining Dynamics", 2nd ed., 2019, chapter 4: simulation of
   milling by pieces of teeth, the chip against the surfaces of several earlier passes.
"""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.errors import InputError, nearest

MILLING = ("down", "up")


class Tool(eqx.Module):
    """End mill with evenly spaced teeth.

    Parameters
    ----------
    teeth : int
        Number of teeth N.
    radius : array_like [m]
        Radius; it matters only with a helix.
    helix : array_like [rad]
        Helix angle, 0 for straight teeth, at most 1.5.
    runout : array_like, shape (N,) [m], optional
        How much farther than the nominal radius every tooth reaches; 0 when left out.
    imbalance : array_like [kg m]
        Unbalanced mass times its distance from the axis, in the direction of the first tooth; it
        gives a line at the rotation in air as well.

    Raises
    ------
    InputError
        If a number is out of its range, or there is not one runout for every tooth.
    """

    teeth: int = eqx.field(static=True)
    radius: Array
    helix: Array
    runout: Array
    imbalance: Array

    def __init__(
        self,
        teeth: int,
        radius: ArrayLike = 0.005,
        helix: ArrayLike = 0.0,
        runout: ArrayLike | None = None,
        imbalance: ArrayLike = 0.0,
    ) -> None:
        if isinstance(teeth, bool) or not isinstance(teeth, int) or teeth < 1:
            raise InputError(f"teeth is {teeth!r}, but must be a whole number, 1 or more.")
        self.teeth = teeth
        self.radius = as_float("radius", radius, above=0.0, unit="m")
        self.helix = as_float("helix", helix, least=0.0, most=1.5, unit="rad")
        self.runout = as_float("runout", jnp.zeros(teeth) if runout is None else runout, unit="m")
        self.imbalance = as_float("imbalance", imbalance, least=0.0, unit="kg m")
        if self.runout.shape != (teeth,):
            raise InputError(
                f"runout has the shape {self.runout.shape}, but must be one number for each of the "
                f"{teeth} teeth."
            )

    @property
    def lag(self) -> Array:
        """Angle by which a tooth lags per height, tan(helix) / radius [rad/m]."""
        return jnp.tan(self.helix) / self.radius


class Cut(eqx.Module):
    """Where the teeth are engaged, and the feed.

    Parameters
    ----------
    start, exit : array_like [rad]
        Angles at which a tooth enters and leaves the stock, 0 <= start < exit <= pi.
    feed_per_tooth : array_like [m]
        Feed per tooth c; spindle speed and feed change together.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    start: Array
    exit: Array
    feed_per_tooth: Array

    def __init__(self, start: ArrayLike, exit: ArrayLike, feed_per_tooth: ArrayLike) -> None:
        self.start = as_float("start", start, least=0.0, unit="rad")
        self.exit = as_float("exit", exit, most=math.pi, unit="rad")
        self.feed_per_tooth = as_float("feed per tooth", feed_per_tooth, least=0.0, unit="m")
        if not _traced(self.start, self.exit) and bool(np.any(self.start >= self.exit)):
            raise InputError(
                f"start is {self.start} rad and exit {self.exit} rad, but a tooth must enter "
                "before it leaves."
            )


class CuttingCoefficients(eqx.Module):
    """Mechanistic coefficients of a material.

    Parameters
    ----------
    tangential, normal : array_like [N/m^2]
        K_t and K_n, per area of the chip.
    tangential_edge, normal_edge : array_like [N/m]
        Per length of the edge that is in the cut.

    Raises
    ------
    InputError
        If one of them is not a finite number.
    """

    tangential: Array
    normal: Array
    tangential_edge: Array
    normal_edge: Array

    def __init__(
        self,
        tangential: ArrayLike,
        normal: ArrayLike,
        tangential_edge: ArrayLike = 0.0,
        normal_edge: ArrayLike = 0.0,
    ) -> None:
        self.tangential = as_float("tangential", tangential, unit="N/m^2")
        self.normal = as_float("normal", normal, unit="N/m^2")
        self.tangential_edge = as_float("tangential edge", tangential_edge, unit="N/m")
        self.normal_edge = as_float("normal edge", normal_edge, unit="N/m")


class Pieces(NamedTuple):
    """Pieces of the teeth during steps of time, p = N times slices of them.

    Attributes
    ----------
    outwards : Array, shape (m, p, 2)
        Direction n at the middle of what of the piece is engaged.
    per_chip : Array, shape (m, p, 2) [N/m]
        Force on the tool per thickness of the chip; 0 where the piece is not engaged.
    at_edge : Array, shape (m, p, 2) [N]
        Force on the tool by the edge while there is a chip.
    """

    outwards: Array
    per_chip: Array
    at_edge: Array


def engaged_between(immersion: ArrayLike, milling: str = "down") -> tuple[Array, Array]:
    """Where a tooth enters and leaves the stock.

    Parameters
    ----------
    immersion : array_like
        Radial depth over the tool's diameter, 0 to 1; 1 is a slot.
    milling : {"down", "up"}
        Whether a tooth leaves or enters at the wall.

    Returns
    -------
    start, exit : Array [rad]
        acos(2 immersion - 1) to pi in down milling, 0 to acos(1 - 2 immersion) in up milling.

    Raises
    ------
    InputError
        If the direction is neither of the two, or the immersion out of its range.
    """
    if milling not in MILLING:
        raise InputError(f"milling {milling!r} is unknown{nearest(str(milling), MILLING)}.")
    share = as_float("immersion", immersion, above=0.0, most=1.0)
    if milling == "down":
        return jnp.arccos(2.0 * share - 1.0), jnp.full_like(share, jnp.pi)
    return jnp.zeros_like(share), jnp.arccos(1.0 - 2.0 * share)


def force_directions(coefficients: CuttingCoefficients, angle: ArrayLike) -> tuple[Array, Array]:
    """Force of a tooth on the tool, per length of its edge.

    Parameters
    ----------
    coefficients : CuttingCoefficients
        Of the material.
    angle : array_like, shape (...) [rad]
        Angle phi of the tooth.

    Returns
    -------
    per_chip : Array, shape (..., 2) [N/m^2]
        -K_t t - K_n n, per thickness of the chip.
    at_edge : Array, shape (..., 2) [N/m]
        The same of the edge's coefficients.
    """
    k, outwards, ahead = coefficients, *_directions(jnp.asarray(angle))
    return (
        -k.tangential * ahead - k.normal * outwards,
        -k.tangential_edge * ahead - k.normal_edge * outwards,
    )


def directional_stiffness(
    tool: Tool, cut: Cut, coefficients: CuttingCoefficients, turned: ArrayLike, depth: ArrayLike
) -> Array:
    """Force on the tool per regenerative displacement, integrated along all teeth.

    Parameters
    ----------
    tool, cut, coefficients
        What cuts.
    turned : array_like, shape (...) [rev]
        Rotation; at 0 the first tooth's end is at phi = 0.
    depth : array_like [m]
        Axial depth a.

    Returns
    -------
    Array, shape (..., 2, 2) [N/m]
        Sum over the teeth of the integral of (-K_t t - K_n n) n^T over the height. In the case of
        one mode along the feed the entry (x, x) is -a h(t) of [1]_.

    Notes
    -----
    By Gauss-Legendre over that part of each tooth which is engaged, exact to rounding as long as
    the part spans no more than pi; a tooth that winds around the tool is counted in every turn of
    up to 4.
    """
    rev = jnp.mod(jnp.asarray(turned)[..., None, None] + jnp.arange(tool.teeth) / tool.teeth, 1.0)
    ends = 2.0 * jnp.pi * (rev + jnp.arange(4)[:, None])
    deep = jnp.asarray(depth)
    straight = tool.lag == 0.0
    slope = jnp.where(straight, 1.0, tool.lag)
    inside = (ends >= cut.start) & (ends <= cut.exit)
    lower = jnp.where(straight, 0.0, jnp.clip((ends - cut.exit) / slope, 0.0, deep))
    upper = jnp.clip((ends - cut.start) / slope, 0.0, deep)
    upper = jnp.where(straight, jnp.where(inside, deep, 0.0), upper)
    height = lower[..., None] + (upper - lower)[..., None] * _NODES
    outwards, _ = _directions(angle := ends[..., None] - tool.lag * height)
    per_chip, _ = force_directions(coefficients, angle)
    weight = (upper - lower)[..., None] * _WEIGHTS
    return jnp.einsum("...tnz,...tnzi,...tnzj->...ij", weight, per_chip, outwards)


def pieces(
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    turned: Array,
    turn: Array,
    depth: Array,
    slices: int,
) -> Pieces:
    """Pieces of the teeth as they are engaged during steps of time.

    Parameters
    ----------
    tool, cut, coefficients
        What cuts.
    turned : Array, shape (m,) [rev]
        Rotation in the middle of every step.
    turn : Array, shape (m,) [rev]
        How far the tool turns during the step, > 0.
    depth : Array, shape (m,) [m]
        Axial depth a.
    slices : int
        Pieces into which the depth is cut.

    Returns
    -------
    Pieces
        Each weighted by the share that is engaged of the angle which the piece sweeps during the
        step. So a tooth that enters within a step counts for what it cut, and the error falls with
        the square of the step although the force jumps; that of the slices with their square.
    """
    lag = tool.lag * depth / slices
    first = 2.0 * jnp.pi * (turned[:, None] + jnp.arange(tool.teeth) / tool.teeth)
    angle = first[..., None] - lag[:, None, None] * (jnp.arange(slices) + 0.5)
    # From -pi/2 on, so that a piece that straddles phi = 0 is in one part.
    angle = jnp.mod(angle + 0.5 * jnp.pi, 2.0 * jnp.pi) - 0.5 * jnp.pi
    half = 0.5 * (2.0 * jnp.pi * turn + lag)[:, None, None]
    lowest = jnp.clip(angle - half, cut.start, cut.exit)
    highest = jnp.clip(angle + half, cut.start, cut.exit)
    length = (highest - lowest) / (2.0 * half) * (depth / slices)[:, None, None]
    middle = 0.5 * (lowest + highest)
    outwards, _ = _directions(middle)
    per_chip, at_edge = force_directions(coefficients, middle)
    flat = (len(turned), tool.teeth * slices, 2)
    return Pieces(
        outwards.reshape(flat),
        (length[..., None] * per_chip).reshape(flat),
        (length[..., None] * at_edge).reshape(flat),
    )


def left_surface(tool: Tool, cut: Cut, outwards: Array, earlier: Array, slices: int) -> Array:
    """What earlier passes left standing in front of the pieces.

    Parameters
    ----------
    tool, cut
        What cuts.
    outwards : Array, shape (m, p, 2)
        Directions n of the pieces.
    earlier : Array, shape (m, k, 2) [m]
        Displacement of the tool 1, 2, ... k pitches of rotation before.
    slices : int
        Pieces of every tooth.

    Returns
    -------
    Array, shape (m, p) [m]
        Position of the surface along n, from the tool's centre without displacement, less the
        tool's radius: the farthest that one of the k passes reached. A tooth that was out of the
        cut then reached less far than those before it, and the surface of these counts.
    """
    passes = earlier.shape[1]
    back = jnp.arange(1, passes + 1)
    # The tooth that passes an angle k pitches of rotation earlier is the k-th ahead.
    which = jnp.mod(jnp.arange(tool.teeth)[:, None] + back, tool.teeth)
    longer = jnp.repeat(tool.runout[which], slices, axis=0)
    along = outwards[..., None, 0] * (earlier[:, None, :, 0] - back * cut.feed_per_tooth)
    across = outwards[..., None, 1] * earlier[:, None, :, 1]
    # Not jnp.max: the derivative of that looks for what equals the maximum, which rounds otherwise
    # where the compiler computes the two apart, and is then wrong without a sign of it.
    return functools.reduce(jnp.maximum, jnp.moveaxis(along + across + longer, -1, 0))


def imbalance_force(tool: Tool, turned: Array, rotation: Array) -> Array:
    """Force of the imbalance on the tip.

    Parameters
    ----------
    tool : Tool
        The tool.
    turned : Array, shape (m,) [rev]
        Rotation.
    rotation : Array, shape (m,) [rev/s]
        Spindle speed.

    Returns
    -------
    Array, shape (m, 2) [N]
        (2 pi rotation)^2 times the imbalance, in the direction of the first tooth.
    """
    outwards, _ = _directions(2.0 * jnp.pi * turned)
    return (tool.imbalance * (2.0 * jnp.pi * rotation) ** 2)[:, None] * outwards


def tooth_reach(tool: Tool, slices: int) -> Array:
    """How far beyond the radius every piece reaches, shape (p,) [m]."""
    return jnp.repeat(tool.runout, slices)


def as_float(
    name: str,
    value: ArrayLike,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    unit: str = "",
) -> Array:
    """A parameter as an array, refused if it is out of its range.

    Parameters
    ----------
    name : str
        What it is, for the message.
    value : array_like
        The number or numbers; traced ones are not looked at.
    above, least, most : float
        Limits, the first excluded, the others included.
    unit : str
        For the message.

    Returns
    -------
    Array
        Of floats.

    Raises
    ------
    InputError
        If a number is not finite, or beyond a limit.
    """
    array = jnp.asarray(value, float)
    if not _traced(array):
        limits = (("above", above), ("at least", least), ("at most", most))
        wanted = " and ".join(f"{word} {x:.6g}" for word, x in limits if math.isfinite(x))
        for number in np.ravel(np.asarray(array)):
            if not (math.isfinite(number) and number > above and least <= number <= most):
                given = f"{name} is {number:g} {unit}".rstrip()
                raise InputError(f"{given}, but must be {wanted or 'a finite number'}.")
    return array


def _traced(*values: Any) -> bool:
    return any(isinstance(value, jax.core.Tracer) for value in values)


def _directions(angle: Array) -> tuple[Array, Array]:
    """Directions n and t at angles, shape (..., 2)."""
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    return jnp.stack([sine, cosine], axis=-1), jnp.stack([cosine, -sine], axis=-1)


# Gauss-Legendre on (0, 1): over the longest engagement, pi, products of two sines to 1e-15.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
