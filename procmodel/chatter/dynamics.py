"""The plant: milling with regeneration in the time domain.

A few modes of the tool, each along a direction of the plane across its axis, are driven by the
cutting force; the chip depends on what the teeth left standing in earlier passes, so that the
present motion depends on that of a tooth's pitch before, and of several pitches where the tool
leaves the cut. SI units, angles in rad; spindle speed as rotation frequency [rev/s].

Notation: q modal displacement, u = sum d q displacement of the tool's tip with d the direction of
a mode, w = 2 pi f, zeta damping ratio, m modal mass, F force on the tip, N teeth, c feed per tooth,
n direction off the tool's centre, r_j runout of the tooth j.

Law: q'' + 2 zeta w q' + w^2 q = d . F / m for every mode; a piece of a tooth has the chip
max(0, n . u + r_j - max over k of (n . (u_k - k c e_x) + r_(j+k))) with u_k the displacement k
pitches of *rotation* before, whatever the spindle's speed was in between.

References
----------
.. [1] T. Insperger, G. Stepan, Int. J. Numer. Meth. Engng 61, 117-141, 2004.
.. [2] T. L. Schmitz, K. S. Smith, "Machining Dynamics", 2nd ed., 2019, chapter 4.
.. [3] J. Tlusty, F. Ismail, "Basic non-linearity in machining chatter", CIRP Annals 30, 299-304,
   1981: the tool leaves the cut.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.chatter.cutting import (
    Cut,
    CuttingCoefficients,
    Tool,
    as_float,
    imbalance_force,
    left_surface,
    pieces,
    tooth_reach,
)
from procmodel.chatter.modes import Modes, Sensors, mode_propagator
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

REGENERATION = ("several", "last", "linear", "none")
# Steps computed together need the motion up to here before a pitch's delay, for the interpolation.
_STENCIL = 3
_MOST_TOGETHER = 64


class ProcessNoise(eqx.Module):
    """White noise of the process.

    Parameters
    ----------
    hardness : array_like [1/sqrt(Hz)]
        Amplitude density, one-sided, of the relative fluctuation of the cutting force.
    force : array_like [N/sqrt(Hz)]
        Amplitude density, one-sided, of a force on the tip in each direction, in air as well.
    """

    hardness: Array
    force: Array

    def __init__(self, hardness: ArrayLike = 0.0, force: ArrayLike = 0.0) -> None:
        self.hardness = as_float("hardness noise", hardness, least=0.0, unit="1/sqrt(Hz)")
        self.force = as_float("force noise", force, least=0.0, unit="N/sqrt(Hz)")


class Plant(eqx.Module):
    """Tool, modes, cut and the settings of the simulation.

    Parameters
    ----------
    modes : Modes
        Of the tool's tip.
    tool : Tool
        The end mill.
    cut : Cut
        Engagement and feed.
    coefficients : CuttingCoefficients
        Of the material.
    step : float [s]
        Step of time.
    slowest, fastest : float [rev/s]
        Between which the spindle may turn; they set how much of the past is kept, and how many
        steps are computed together.
    sensors : Sensors, optional
        Displacement and acceleration of the tip in x and y when left out.
    noise : ProcessNoise, optional
        None when left out.
    slices : int
        Pieces into which the depth is cut; 1 is exact for straight teeth.
    revolutions : int
        How many revolutions of surfaces are kept.
    regeneration : {"several", "last", "linear", "none"}
        Chip against the surfaces of several passes, none where the tool is out of the cut; against
        that of the last pass alone, as if it had always cut; the same with negative chips, which is
        the linear law of `procmodel.chatter.lobes`; against a surface without waves, which is
        forced vibration alone.

    Raises
    ------
    InputError
        If a setting is out of its range.
    """

    modes: Modes
    tool: Tool
    cut: Cut
    coefficients: CuttingCoefficients
    sensors: Sensors
    noise: ProcessNoise | None
    step: float = eqx.field(static=True)
    slowest: float = eqx.field(static=True)
    fastest: float = eqx.field(static=True)
    slices: int = eqx.field(static=True)
    revolutions: int = eqx.field(static=True)
    regeneration: str = eqx.field(static=True)

    def __init__(
        self,
        modes: Modes,
        tool: Tool,
        cut: Cut,
        coefficients: CuttingCoefficients,
        *,
        step: float,
        slowest: float,
        fastest: float,
        sensors: Sensors | None = None,
        noise: ProcessNoise | None = None,
        slices: int = 1,
        revolutions: int = 3,
        regeneration: str = "several",
    ) -> None:
        self.modes, self.tool, self.cut, self.coefficients = modes, tool, cut, coefficients
        tip = modes.direction.T
        self.sensors = Sensors(tip, tip) if sensors is None else sensors
        self.noise = noise
        self.step, self.slowest, self.fastest = float(step), float(slowest), float(fastest)
        self.slices, self.revolutions, self.regeneration = slices, revolutions, regeneration
        if regeneration not in REGENERATION:
            hint = nearest(str(regeneration), REGENERATION)
            raise InputError(f"regeneration {regeneration!r} is unknown{hint}.")
        for name, number in (("slices", slices), ("revolutions", revolutions)):
            if isinstance(number, bool) or not isinstance(number, int) or number < 1:
                raise InputError(f"{name} is {number!r}, but must be a whole number, 1 or more.")
        if not (math.isfinite(self.step) and self.step > 0.0):
            raise InputError(f"step is {step:g} s, but must be above 0.")
        if not 0.0 < self.slowest <= self.fastest < math.inf:
            raise InputError(
                f"slowest is {slowest:g} rev/s and fastest {fastest:g} rev/s, but they must be "
                "above 0 and in this order."
            )
        if self._together < 1:
            longest = 1.0 / (self.fastest * tool.teeth * (_STENCIL + 1))
            raise InputError(
                f"step is {step:g} s, but at {fastest:g} rev/s a tooth passes within fewer than "
                f"{_STENCIL + 1} of them; make it {longest:.3g} s or shorter."
            )
        for name in ("displacement_gain", "acceleration_gain"):
            found, count = getattr(self.sensors, name).shape[-1], len(modes.frequency)
            if found != count:
                raise InputError(
                    f"{name.replace('_', ' ')} has {found} columns, but there are {count} modes."
                )

    @property
    def passes(self) -> int:
        """Earlier passes against which the chip is measured."""
        return 1 if self.regeneration in ("last", "linear") else self.revolutions * self.tool.teeth

    @property
    def history(self) -> int:
        """Past steps that are kept."""
        pitches = self.passes / self.tool.teeth
        return math.ceil(pitches / (self.slowest * self.step)) + _STENCIL + 1

    @property
    def _together(self) -> int:
        """Steps so few that none of them needs the motion of another by the delay."""
        pitch = 1.0 / (self.fastest * self.tool.teeth * self.step)
        return min(_MOST_TOGETHER, math.floor(pitch * (1.0 - 1e-9)) - _STENCIL)


class PlantState(NamedTuple):
    """Where a simulation stands; what `advance` takes and gives.

    Attributes
    ----------
    rotation : Array, shape (h,) [rev]
        Rotation at the past steps, the last one now; whole revolutions are taken off at times.
    tip : Array, shape (h, 2) [m]
        Displacement u of the tip at these.
    displacement, velocity : Array, shape (q,) [m], [m/s]
        Of the modes.
    force : Array, shape (2,) [N]
        On the tip, during the last step.
    steps : Array of int
        Steps done.
    key : Array
        Key of the process noise.
    """

    rotation: Array
    tip: Array
    displacement: Array
    velocity: Array
    force: Array
    steps: Array
    key: Array


class Signals(NamedTuple):
    """What happens during a block; all of it in the middle of the steps.

    Attributes
    ----------
    tip : Array, shape (n, 2) [m]
        Displacement u of the tip.
    force : Array, shape (n, 2) [N]
        On the tip.
    displacement : Array, shape (n, d) [m]
        At the displacement sensors, without their noise.
    acceleration : Array, shape (n, a) [m/s^2]
        At the acceleration sensors, without their noise.
    rotation : Array, shape (n,) [rev]
        Rotation; a block goes on from the fraction of a revolution at which the last one ended.
    """

    tip: Array
    force: Array
    displacement: Array
    acceleration: Array
    rotation: Array


def start(plant: Plant, rotation: float, key: Array | int = 0) -> PlantState:
    """The tool at rest in the air, the spindle at a constant speed.

    Parameters
    ----------
    plant : Plant
        The plant.
    rotation : float [rev/s]
        The spindle's speed until now.
    key : Array or int
        Key of the process noise, as of `jax.random.key`, or its seed.

    Returns
    -------
    PlantState
        To advance from.

    Raises
    ------
    InputError
        If the speed is not between the plant's.
    RuntimeError
        Without 64-bit floats.
    """
    require_float64("the simulation of milling")
    _require_speed(plant, rotation)
    held, modes = plant.history, len(plant.modes.frequency)
    key = jax.random.key(key) if isinstance(key, int) else key
    return PlantState(
        rotation=jnp.arange(1 - held, 1) * jnp.asarray(rotation * plant.step, float),
        tip=jnp.zeros((held, 2)),
        displacement=jnp.zeros(modes),
        velocity=jnp.zeros(modes),
        force=jnp.zeros(2),
        steps=jnp.zeros((), int),
        key=key,
    )


def advance(
    plant: Plant, state: PlantState, rotation: ArrayLike, depth: ArrayLike
) -> tuple[PlantState, Signals]:
    """Simulate a block of steps.

    Parameters
    ----------
    plant : Plant
        The plant.
    state : PlantState
        Where it stands.
    rotation : array_like, shape (n,) [rev/s]
        The spindle's speed during each step; a limit of its acceleration is the caller's.
    depth : array_like, shape (n,) or () [m]
        Axial depth of cut during each step; 0 in air. Earlier passes count as if they had cut at
        the present depth, so it should change little from a tooth to the next.

    Returns
    -------
    state : PlantState
        After the block.
    signals : Signals
        During the block.

    Raises
    ------
    InputError
        If a speed is not between the plant's, or a depth is negative.

    Notes
    -----
    The modes move exactly under a force that is constant in a step; the force is that of the
    step's middle, which makes the error one of second order. Blocks of one length share a
    compilation, and two blocks give what one of their joint length gives. Differentiable in every
    leaf of the plant and in speed and depth, but where a tooth enters or leaves the cut.
    """
    _require_speed(plant, rotation)
    as_float("depth", depth, least=0.0, unit="m")
    speed = jnp.asarray(rotation, float)
    return _advance(plant, state, speed, jnp.broadcast_to(jnp.asarray(depth, float), speed.shape))


@eqx.filter_jit
def _advance(
    plant: Plant, state: PlantState, speed: Array, depth: Array
) -> tuple[PlantState, Signals]:
    count, held, together = len(speed), plant.history, plant._together
    after = state.rotation[-1] + jnp.cumsum(speed * plant.step)
    rotation = jnp.concatenate([state.rotation, after])
    tip = jnp.concatenate([state.tip, jnp.zeros((count, 2))])
    relative, background = _noise(plant, state, count)
    middle = 0.5 * (rotation[held - 1 : -1] + rotation[held:])
    background = background + imbalance_force(plant.tool, middle, speed)
    inputs = (depth, relative, background)

    def chunk(carry: tuple, first: Array, steps: int) -> tuple[tuple, tuple]:
        tip, motion = carry
        here = [jax.lax.dynamic_slice_in_dim(v, first, steps) for v in inputs]
        motion, record = _together(plant, rotation, tip, motion, held - 1 + first, steps, *here)
        tip = jax.lax.dynamic_update_slice_in_dim(tip, record[0], held + first, 0)
        return (tip, motion), record[1:]

    whole, rest = divmod(count, together)
    carry = (tip, (state.displacement, state.velocity, state.force))
    firsts = together * jnp.arange(whole)
    records = []
    if whole:
        carry, some = jax.lax.scan(lambda c, f: chunk(c, f, together), carry, firsts)
        records.append([v.reshape(whole * together, *v.shape[2:]) for v in some])
    if rest:
        carry, some = chunk(carry, jnp.asarray(whole * together), rest)
        records.append(list(some))
    tip, (displacement, velocity, force) = carry
    kept = rotation[count:]
    state = PlantState(
        kept - jnp.floor(kept[-1]),
        tip[count:],
        displacement,
        velocity,
        force,
        state.steps + count,
        state.key,
    )
    q, v, driving = (jnp.concatenate(parts) for parts in zip(*records, strict=True))
    return state, _signals(plant, q, v, driving, middle)


def _together(
    plant: Plant,
    rotation: Array,
    tip: Array,
    motion: tuple[Array, Array, Array],
    first: Array,
    steps: int,
    depth: Array,
    relative: Array,
    background: Array,
) -> tuple[tuple[Array, Array, Array], tuple[Array, ...]]:
    """Steps within a pitch's delay: all but the motion of the modes is known beforehand."""
    modes, tool, slices = plant.modes, plant.tool, plant.slices
    turned = jax.lax.dynamic_slice_in_dim(rotation, first, steps + 1)
    middle, turn = 0.5 * (turned[1:] + turned[:-1]), turned[1:] - turned[:-1]
    cutting = pieces(tool, plant.cut, plant.coefficients, middle, turn, depth, slices)
    if plant.regeneration == "none":
        earlier = jnp.zeros((steps, plant.passes, 2))
    else:
        earlier = _earlier(rotation, tip, middle, plant.passes, tool.teeth)
    surface = left_surface(tool, plant.cut, cutting.outwards, earlier, slices)
    standing = tooth_reach(tool, slices) - surface
    strength = (1.0 + relative)[:, None, None]
    follows = 0.0 if plant.regeneration == "none" else 1.0

    w, step = modes.angular, plant.step
    half, full = (mode_propagator(w, modes.damping, t) for t in (0.5 * step, step))
    push = modes.direction / modes.mass[:, None]
    bend_half, bend_full = (1.0 - half[0]) / w**2, (1.0 - full[0]) / w**2

    def one(motion: tuple, now: tuple) -> tuple[tuple, tuple]:
        q, v, before = motion
        outwards, per_chip, at_edge, standing, background = now
        # The force of the step before serves for the displacement in the middle of this one: what
        # it is off by moves the tip in half a step by the third power of the step.
        guess = push @ before
        q_half = half[0] * q + half[1] * v + bend_half * guess
        v_half = half[2] * q + half[3] * v + half[1] * guess
        at = q_half @ modes.direction
        chip = standing + follows * (outwards[:, 0] * at[0] + outwards[:, 1] * at[1])
        if plant.regeneration != "linear":
            chip = jnp.maximum(chip, 0.0)
        in_cut = jnp.where(chip > 0.0, 1.0, 0.0)
        force = background + jnp.sum(chip[:, None] * per_chip + in_cut[:, None] * at_edge, axis=0)
        drive = push @ force
        q_next = full[0] * q + full[1] * v + bend_full * drive
        v_next = full[2] * q + full[3] * v + full[1] * drive
        return (q_next, v_next, force), (q_next, q_half, v_half, force)

    known = (
        cutting.outwards,
        strength * cutting.per_chip,
        strength * cutting.at_edge,
        standing,
        background,
    )
    motion, (q_next, q_half, v_half, force) = jax.lax.scan(one, motion, known, unroll=4)
    return motion, (q_next @ modes.direction, q_half, v_half, force)


def _earlier(rotation: Array, tip: Array, middle: Array, passes: int, teeth: int) -> Array:
    """Displacement 1 to k pitches of rotation before, by cubic interpolation, shape (m, k, 2)."""
    wanted = middle[:, None] - jnp.arange(1, passes + 1) / teeth
    cell = jnp.searchsorted(rotation, wanted, side="right", method="scan") - 1
    cell = jnp.clip(cell, 1, len(rotation) - 3)
    below, above = rotation[cell], rotation[cell + 1]
    s = ((wanted - below) / (above - below))[..., None]
    return (
        -s * (s - 1.0) * (s - 2.0) / 6.0 * tip[cell - 1]
        + (s + 1.0) * (s - 1.0) * (s - 2.0) / 2.0 * tip[cell]
        - (s + 1.0) * s * (s - 2.0) / 2.0 * tip[cell + 1]
        + (s + 1.0) * s * (s - 1.0) / 6.0 * tip[cell + 2]
    )


def _noise(plant: Plant, state: PlantState, count: int) -> tuple[Array, Array]:
    """Relative fluctuation of the cutting force and background force of every step."""
    if plant.noise is None:
        return jnp.zeros(count), jnp.zeros((count, 2))
    # By the number of the step, so that it does not depend on how a run is cut into blocks.
    keys = jax.vmap(lambda i: jax.random.fold_in(state.key, i))(state.steps + jnp.arange(count))
    draws = jax.vmap(lambda key: jax.random.normal(key, (3,)))(keys)
    spread = math.sqrt(0.5 / plant.step)
    return spread * plant.noise.hardness * draws[:, 0], spread * plant.noise.force * draws[:, 1:]


def _signals(plant: Plant, q: Array, v: Array, force: Array, rotation: Array) -> Signals:
    modes, sensors = plant.modes, plant.sensors
    w = modes.angular
    acceleration = force @ (modes.direction / modes.mass[:, None]).T
    acceleration = acceleration - 2.0 * modes.damping * w * v - w**2 * q
    return Signals(
        q @ modes.direction,
        force,
        q @ sensors.displacement_gain.T,
        acceleration @ sensors.acceleration_gain.T,
        rotation,
    )


def _require_speed(plant: Plant, rotation: ArrayLike) -> None:
    if isinstance(rotation, jax.core.Tracer):
        return
    given = np.ravel(np.asarray(rotation))
    # A ramp that ends at the limit may round beyond it.
    low, high = plant.slowest * (1.0 - 1e-9), plant.fastest * (1.0 + 1e-9)
    outside = ~((given >= low) & (given <= high))
    if np.any(outside):
        raise InputError(
            f"the rotation is {given[outside][0]:g} rev/s, but the plant was made for "
            f"{plant.slowest:g} to {plant.fastest:g}; widen slowest and fastest."
        )
