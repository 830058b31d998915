"""From the signals of the simulation to the samples of a rig.

A signal passes a filter against aliasing and is sampled, and the sensor's noise is added; block
after block, as the simulation goes on.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from procmodel.chatter.dynamics import Plant, Signals
from procmodel.errors import InputError

# Samples before and after the one that the filter gives, and where it ends, over the rate.
_HALF_WIDTH, _CUTOFF = 16, 0.42


@dataclass(frozen=True)
class Sampling:
    """How signals are recorded.

    Parameters
    ----------
    rate : float [Hz]
        Sampling rate.
    oversampling : int
        Steps of the simulation per sample; the plant's step is 1 / (rate oversampling).
    displacement_noise : float [m]
        Standard deviation of the noise in each sample of a displacement.
    acceleration_noise : float [m/s^2]
        The same of an acceleration.

    Raises
    ------
    InputError
        If a setting is out of its range.
    """

    rate: float
    oversampling: int = 4
    displacement_noise: float = 0.0
    acceleration_noise: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise InputError(f"rate is {self.rate:g} Hz, but must be above 0.")
        if isinstance(self.oversampling, bool) or not isinstance(self.oversampling, int):
            raise InputError(f"oversampling is {self.oversampling!r}, but must be a whole number.")
        if self.oversampling < 1:
            raise InputError(f"oversampling is {self.oversampling}, but must be 1 or more.")
        for name in ("displacement_noise", "acceleration_noise"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name.replace('_', ' ')} is {value:g}, but must be 0 or more.")

    @property
    def step(self) -> float:
        """Step of the simulation [s]."""
        return 1.0 / (self.rate * self.oversampling)

    @property
    def delay(self) -> int:
        """Samples by which what `sample` gives lags behind the simulation."""
        return _HALF_WIDTH - 1


class SamplerState(NamedTuple):
    """Where a recording stands; what `sample` takes and gives.

    Attributes
    ----------
    tail : Array, shape (l, c)
        Signals that the filter still needs.
    samples : Array of int
        Samples given.
    key : Array
        Key of the sensors' noise.
    """

    tail: Array
    samples: Array
    key: Array


def start_sampling(plant: Plant, sampling: Sampling, key: Array | int = 0) -> SamplerState:
    """The rig before its first sample, after silence.

    Parameters
    ----------
    plant : Plant
        The plant that is recorded.
    sampling : Sampling
        How.
    key : Array or int
        Key of the sensors' noise, as of `jax.random.key`, or its seed.

    Returns
    -------
    SamplerState
        For `sample`.

    Raises
    ------
    InputError
        If the plant's step is not the sampling's.
    """
    if not math.isclose(plant.step, sampling.step, rel_tol=1e-9):
        raise InputError(
            f"the plant's step is {plant.step:g} s, but {sampling.rate:g} Hz at an oversampling of "
            f"{sampling.oversampling} needs {sampling.step:g}."
        )
    channels = sum(sensor_counts(plant))
    held = (2 * _HALF_WIDTH - 1) * sampling.oversampling
    key = jax.random.key(key) if isinstance(key, int) else key
    return SamplerState(jnp.zeros((held, channels)), jnp.zeros((), int), key)


def sample(sampling: Sampling, state: SamplerState, signals: Signals) -> tuple[SamplerState, Array]:
    """Record a block of signals.

    Parameters
    ----------
    sampling : Sampling
        How.
    state : SamplerState
        Where the recording stands.
    signals : Signals
        Of `advance`, a multiple of the oversampling of steps.

    Returns
    -------
    state : SamplerState
        After the block.
    samples : Array, shape (n, c)
        Displacements, then accelerations. They lag by `Sampling.delay` samples: the first one of a
        recording is of the instant -delay / rate.

    Raises
    ------
    InputError
        If the last sample would be incomplete.
    """
    steps, each = len(signals.tip), sampling.oversampling
    if steps % each:
        raise InputError(
            f"a block of {steps} steps does not end with a sample: make it a multiple of {each}."
        )
    spread = np.repeat(
        [sampling.displacement_noise, sampling.acceleration_noise],
        [signals.displacement.shape[1], signals.acceleration.shape[1]],
    )
    together = jnp.concatenate([signals.displacement, signals.acceleration], axis=1)
    return _sample(state, together, jnp.asarray(antialias_taps(each).reshape(-1, each)), spread)


def antialias_taps(oversampling: int) -> np.ndarray:
    """Filter that a signal passes before it is sampled.

    Parameters
    ----------
    oversampling : int
        Steps per sample.

    Returns
    -------
    numpy.ndarray, shape (2 * 16 * oversampling,)
        Symmetric, of sum 1: a sinc that ends at 0.42 of the sampling rate under a Kaiser window;
        flat to 1e-3 up to 0.34, and 75 dB down from 0.5 on.
    """
    count = 2 * _HALF_WIDTH * oversampling
    away = (np.arange(count) - 0.5 * (count - 1)) / oversampling
    taps = np.sinc(2.0 * _CUTOFF * away) * np.kaiser(count, 8.0)
    return taps / np.sum(taps)


def sensor_counts(plant: Plant) -> tuple[int, int]:
    """Displacement and acceleration sensors of a plant.

    Parameters
    ----------
    plant : Plant
        The plant.

    Returns
    -------
    displacements, accelerations : int
        How many of each.
    """
    return len(plant.sensors.displacement_gain), len(plant.sensors.acceleration_gain)


@jax.jit
def _sample(
    state: SamplerState, signals: Array, taps: Array, spread: Array
) -> tuple[SamplerState, Array]:
    each, channels = taps.shape[1], signals.shape[1]
    count = len(signals) // each
    together = jnp.concatenate([state.tail, signals])
    groups = together.reshape(-1, each, channels)
    samples = jnp.zeros((count, channels))
    for first, weights in enumerate(taps):
        samples = samples + jnp.einsum("nmc,m->nc", groups[first : first + count], weights)
    # By the number of the sample, so that it does not depend on how a run is cut into blocks.
    keys = jax.vmap(lambda i: jax.random.fold_in(state.key, i))(state.samples + jnp.arange(count))
    noise = jax.vmap(lambda key: jax.random.normal(key, (channels,)))(keys)
    after = SamplerState(together[len(signals) :], state.samples + count, state.key)
    return after, samples + spread * noise
