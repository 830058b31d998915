"""Stability of milling: multipliers of a tooth's pitch, limits of the depth, chatter frequency.

The linear law of `procmodel.chatter.dynamics`, x' = A x + B(t) (u(t) - u(t - T)) with T the time
of a tooth's pitch and B(t + T) = B(t), takes the motion of one pitch to that of the next. The
largest magnitude among the eigenvalues mu of this map is the growth of a small vibration per
pitch: above 1 the cut chatters. SI units; spindle speed as rotation frequency [rev/s].

The map is made by collocation: pieces of the pitch between the instants at which teeth enter and
leave the cut, in each a polynomial that obeys the law at the Gauss points, which converges
exponentially with its degree.

References
----------
.. [1] T. Insperger, G. Stepan, Int. J. Numer. Meth. Engng 61, 117-141, 2004: the law, the case of
   one mode.
.. [2] E. A. Butcher, O. A. Bobrenkov, E. Bueler, P. Nindujarla, "Analysis of milling stability by
   the Chebyshev collocation method", J. Comput. Nonlinear Dyn. 4, 031003, 2009.
.. [3] T. Insperger, G. Stepan, P. V. Bayly, B. P. Mann, "Multiple chatter frequencies in milling
   processes", J. Sound Vib. 262, 333-345, 2003.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool, directional_stiffness
from procmodel.chatter.modes import Modes
from procmodel.errors import InputError
from procmodel.precision import require_float64

_DEGREE = 16
# Oscillations in a piece: a polynomial of degree 16 follows two to 10 digits.
_OSCILLATIONS = 2.0


class Stability(NamedTuple):
    """How a small vibration goes on.

    Attributes
    ----------
    multiplier : complex
        The eigenvalue mu of largest magnitude; on or above the real axis.
    growth : float [1/s]
        ln |mu| over the time of a tooth's pitch; positive where the cut chatters.
    frequency : float [Hz]
        At which the vibration is strongest.
    """

    multiplier: complex
    growth: float
    frequency: float

    @property
    def kind(self) -> str:
        """What kind of vibration it is, as a sentence."""
        if abs(self.multiplier) <= 1.0:
            return "stable: a vibration dies out"
        if abs(self.multiplier.imag) < 1e-9 * abs(self.multiplier):
            if self.multiplier.real < 0.0:
                return "period doubling: chatter at odd multiples of half the tooth passing"
            return "growth at multiples of the tooth passing"
        return "quasi-periodic chatter"


def largest_multiplier(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotation: ArrayLike,
    depth: ArrayLike,
    degree: int = _DEGREE,
    pieces: Sequence[float] | None = None,
) -> Array:
    """Growth of a small vibration per tooth's pitch.

    Parameters
    ----------
    modes, tool, cut, coefficients
        What cuts.
    rotation : array_like [rev/s]
        Spindle speed.
    depth : array_like [m]
        Axial depth a.
    degree : int
        Of the polynomials.
    pieces : sequence of float, optional
        Where the pieces of a pitch end, from 0 to 1, as of `pitch_pieces`; needed only where the
        arguments are traced.

    Returns
    -------
    Array
        |mu|; differentiable where one eigenvalue alone (or a pair) has it.

    Raises
    ------
    RuntimeError
        Without 64-bit floats.
    """
    step, _ = _pitch_map(modes, tool, cut, coefficients, rotation, depth, degree, pieces)
    return jnp.max(jnp.abs(jnp.linalg.eigvals(step)))


def stability(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotation: float,
    depth: float,
    degree: int = _DEGREE,
) -> Stability:
    """Growth and frequency of the vibration that grows most, or dies out last.

    Parameters
    ----------
    modes, tool, cut, coefficients, rotation, depth, degree
        As for `largest_multiplier`.

    Returns
    -------
    Stability
        Of the cut.
    """
    law = modes, tool, cut, coefficients
    mapped, motions = _pitch_map(*law, rotation, depth, degree, None)
    motion, nodes, weights = (np.asarray(v) for v in motions)
    values, vectors = np.linalg.eig(np.asarray(mapped))
    largest = np.max(np.abs(values))
    # Of a pair, the one above the axis.
    candidates = np.flatnonzero(np.abs(values) > largest * (1.0 - 1e-9))
    best = candidates[np.argmax(values[candidates].imag)]
    multiplier = complex(values[best])
    pitch = 1.0 / (float(rotation) * tool.teeth)
    tip = np.asarray(modes.direction).T @ (motion @ vectors[:, best])[..., None]
    tip = tip[..., 0]
    # exp(-i arg t / T) times the motion is periodic: its Fourier coefficients, [3]_.
    angle = np.angle(multiplier)
    most = math.ceil(3.0 * float(np.max(modes.frequency)) * pitch) + 2
    orders = np.arange(-most, most + 1)
    turning = np.exp(-1j * (angle + 2.0 * np.pi * orders[:, None]) * nodes)
    decay = np.exp(-math.log(max(largest, 1e-300)) * nodes)
    lines = np.einsum("kt,t,t,ti->ki", turning, weights, decay, tip)
    strongest = orders[np.argmax(np.sum(np.abs(lines) ** 2, axis=1))]
    frequency = abs(angle + 2.0 * np.pi * strongest) / (2.0 * np.pi * pitch)
    growth = math.log(largest) / pitch if largest > 0.0 else -math.inf
    return Stability(multiplier, growth, float(frequency))


def chatter_frequency(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotation: float,
    depth: float,
) -> float:
    """Frequency at which the vibration that grows most is strongest.

    Parameters
    ----------
    modes, tool, cut, coefficients, rotation, depth
        As for `largest_multiplier`.

    Returns
    -------
    float [Hz]
        The frequency.
    """
    return stability(modes, tool, cut, coefficients, rotation, depth).frequency


def depth_limit(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotation: float,
    deepest: float,
    samples: int = 40,
    tolerance: float = 1e-6,
) -> float:
    """First axial depth at which the cut chatters.

    Parameters
    ----------
    modes, tool, cut, coefficients, rotation
        As for `largest_multiplier`.
    deepest : float [m]
        Up to which depth to look.
    samples : int
        Depths tried, evenly, before the first change is narrowed down; a band of chatter thinner
        than deepest / samples may be missed.
    tolerance : float
        Relative to the limit.

    Returns
    -------
    float [m]
        The limit; infinite if the cut is stable at all depths tried.

    Raises
    ------
    InputError
        If the greatest depth is not above 0.
    """
    if not deepest > 0.0:
        raise InputError(f"deepest is {deepest:g} m, but must be above 0.")

    def chatters(depth: float) -> bool:
        found = largest_multiplier(modes, tool, cut, coefficients, rotation, depth)
        return float(found) > 1.0

    tried = deepest * np.arange(1, samples + 1) / samples
    above = next((depth for depth in tried if chatters(float(depth))), None)
    if above is None:
        return math.inf
    below, above = float(above) - deepest / samples, float(above)
    while above - below > tolerance * above:
        middle = 0.5 * (below + above)
        below, above = (below, middle) if chatters(middle) else (middle, above)
    return 0.5 * (below + above)


def depth_limits(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotations: ArrayLike,
    deepest: float,
    samples: int = 40,
    tolerance: float = 1e-4,
) -> np.ndarray:
    """First axial depth of chatter at several speeds: the stability lobes.

    Parameters
    ----------
    modes, tool, cut, coefficients, deepest, samples, tolerance
        As for `depth_limit`.
    rotations : array_like, shape (n,) [rev/s]
        Spindle speeds.

    Returns
    -------
    numpy.ndarray, shape (n,) [m]
        The limits.
    """
    speeds = np.ravel(np.asarray(rotations, float))
    rest = (deepest, samples, tolerance)
    return np.array([depth_limit(modes, tool, cut, coefficients, float(s), *rest) for s in speeds])


def pitch_pieces(
    modes: Modes, tool: Tool, cut: Cut, rotation: float, depth: float
) -> tuple[float, ...]:
    """Pieces of a pitch in which the law is smooth and the modes oscillate little.

    Parameters
    ----------
    modes, tool, cut
        What cuts.
    rotation : float [rev/s]
        Spindle speed.
    depth : float [m]
        Axial depth a.

    Returns
    -------
    tuple of float
        Ends of the pieces as shares of the pitch, from 0 to 1.
    """
    pitch = 2.0 * math.pi / tool.teeth
    lag = float(tool.lag) * float(depth)
    edges = np.array([float(cut.start), float(cut.exit)])
    inside = np.mod(np.concatenate([edges, edges + lag]) / pitch, 1.0)
    inside = np.sort(inside[(inside > 1e-9) & (inside < 1.0 - 1e-9)])
    ends = [0.0, *(x for i, x in enumerate(inside) if i == 0 or x - inside[i - 1] > 1e-9), 1.0]
    oscillations = float(np.max(modes.frequency)) / (float(rotation) * tool.teeth)
    found = [0.0]
    for a, b in pairwise(ends):
        parts = math.ceil((b - a) * oscillations / _OSCILLATIONS)
        found += [a + (b - a) * i / parts for i in range(1, parts)] + [b]
    return tuple(found)


def _pitch_map(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotation: ArrayLike,
    depth: ArrayLike,
    degree: int,
    pieces: Sequence[float] | None,
) -> tuple[Array, tuple[Array, Array, Array]]:
    """Map of the motion in one pitch to that in the next.

    Also the modal displacement at all nodes of the next pitch per what counts of the last one, and
    the nodes and their quadrature weights as shares of the pitch.
    """
    require_float64("the stability of milling")
    if pieces is None:
        if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((modes, rotation, depth))):
            raise InputError(
                "pieces is missing: give those of pitch_pieces where values are traced."
            )
        speed, deep = float(np.asarray(rotation)), float(np.asarray(depth))
        pieces = pitch_pieces(modes, tool, cut, speed, deep)
    # Arrays, not numbers, which would each be compiled for anew.
    rest = jnp.asarray(rotation, float), jnp.asarray(depth, float), degree, jnp.asarray(pieces)
    return _mapped(modes, tool, cut, coefficients, *rest)


@eqx.filter_jit
def _mapped(
    modes: Modes,
    tool: Tool,
    cut: Cut,
    coefficients: CuttingCoefficients,
    rotation: ArrayLike,
    depth: ArrayLike,
    degree: int,
    ends: Array,
) -> tuple[Array, tuple[Array, Array, Array]]:
    values, slopes, gauss, nodes, weights = _polynomial(degree)
    count, q = len(ends) - 1, len(modes.frequency)
    size, points = 2 * q, degree + 1
    lengths = jnp.diff(ends)
    at = ends[:-1, None] + lengths[:, None] * gauss
    pitch = 1.0 / (jnp.asarray(rotation) * tool.teeth)
    stiffness = directional_stiffness(tool, cut, coefficients, at / tool.teeth, depth)
    # State (q, v / w): of one size, which keeps the eigenvalues accurate.
    w = modes.angular
    push = modes.direction / (modes.mass * w)[:, None]
    drive = jnp.einsum("qi,...ij,rj->...qr", push, stiffness, modes.direction)
    none = jnp.zeros((q, q))
    free = jnp.block([[none, jnp.diag(w)], [-jnp.diag(w), -2.0 * jnp.diag(modes.damping * w)]])
    delayed = jnp.zeros((count, degree, size, size)).at[:, :, q:, :q].set(drive)
    span = pitch * lengths[:, None, None, None, None]
    # Law at the Gauss points: slope - span (free + delayed) value = - span delayed (old value).
    new = slopes[:, None, :, None] * jnp.eye(size)[:, None, :]
    both = jnp.einsum("egij,gp->egipj", free + delayed, values)
    law_new = new - span * both
    law_old = -span * jnp.einsum("egij,gp->egipj", delayed, values)
    rows = points * size
    total = count * rows
    left, right = (jnp.zeros((count, points, size, total)) for _ in range(2))
    for e in range(count):
        here = slice(e * rows, (e + 1) * rows)
        left = left.at[e, 1:, :, here].set(law_new[e].reshape(degree, size, rows))
        right = right.at[e, 1:, :, here].set(law_old[e].reshape(degree, size, rows))
        # The first value of a piece is the last one of the piece before.
        left = left.at[e, 0, :, here].set(jnp.eye(size, rows))
        last = slice((e or count) * rows - size, (e or count) * rows)
        if e:
            left = left.at[e, 0, :, last].set(-jnp.eye(size))
        else:
            right = right.at[e, 0, :, last].set(jnp.eye(size))
    # Of the pitch before, only displacements matter, and the whole state at its end.
    used = np.flatnonzero((np.arange(total) % size < q) | (np.arange(total) >= total - size))
    motion = jnp.linalg.solve(
        left.reshape(total, total), right.reshape(total, total)[:, used]
    ).reshape(count * points, size, len(used))
    mapped = motion.reshape(total, -1)[used]
    shares = (ends[:-1, None] + lengths[:, None] * nodes).ravel()
    return mapped, (motion[:, :q], shares, (lengths[:, None] * weights).ravel())


@lru_cache
def _polynomial(degree: int) -> tuple[np.ndarray, ...]:
    """Polynomial through its values at Chebyshev-Lobatto nodes on 0 to 1.

    Returns the matrices that give its values and slopes at the Gauss points, these points, the
    nodes and their quadrature weights.
    """
    nodes = 0.5 * (1.0 - np.cos(np.pi * np.arange(degree + 1) / degree))
    gauss = 0.5 * (np.polynomial.legendre.leggauss(degree)[0] + 1.0)
    # By way of Legendre polynomials, which are well conditioned.
    legendre = np.polynomial.legendre
    inverse = np.linalg.inv(legendre.legvander(2.0 * nodes - 1.0, degree))
    values = legendre.legvander(2.0 * gauss - 1.0, degree) @ inverse
    rates = np.stack(
        [legendre.legval(2.0 * gauss - 1.0, 2.0 * legendre.legder(c)) for c in np.eye(degree + 1)],
        axis=1,
    )
    # Only the first Legendre polynomial has an integral, 1 on 0 to 1.
    return values, rates @ inverse, gauss, nodes, inverse[0]
