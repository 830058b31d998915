"""The plant of chatter beside a loop in Python, on the reference case of Insperger and Stepan."""

import math
from functools import partial

import jax
import numpy as np

from benchmarks import measure
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool
from procmodel.chatter.dynamics import Plant, advance, start
from procmodel.chatter.modes import Modes

FREQUENCY, DAMPING, MASS = 922.0, 0.011, 0.03993
TANGENTIAL, NORMAL, FEED = 6e8, 2e8, 1e-4
TEETH, ROTATION, DEPTH = 2, 5000.0 / 60.0, 0.2e-3
STEPS_PER_PITCH = 404
AGREEMENT = 0.02


def by_loop(step: float, count: int) -> np.ndarray:
    """Tip along the feed, step by step as a user would write it (semi-implicit Euler)."""
    angular = 2 * math.pi * FREQUENCY
    x, v, lag = 0.0, 0.0, STEPS_PER_PITCH
    tip = [0.0] * (count + 1)
    for i in range(count):
        turned = 2 * math.pi * ROTATION * (i + 0.5) * step
        before = tip[i - lag] if i >= lag else 0.0
        force = 0.0
        for tooth in range(TEETH):
            phi = (turned + 2 * math.pi * tooth / TEETH) % (2 * math.pi)
            if phi < math.pi:
                s, c = math.sin(phi), math.cos(phi)
                chip = max(0.0, (FEED + x - before) * s)
                force -= DEPTH * chip * (TANGENTIAL * c + NORMAL * s)
        v += step * (force / MASS - 2 * DAMPING * angular * v - angular**2 * x)
        x += step * v
        tip[i + 1] = x
    return np.array(tip[1:])


def run(section: Section, sizes: Sizes) -> None:
    section.heading("The plant")
    step = 1.0 / (ROTATION * TEETH * STEPS_PER_PITCH)
    count = round(sizes.plant_seconds / step)
    plant = Plant(
        Modes(FREQUENCY, DAMPING, MASS), Tool(TEETH), Cut(0.0, math.pi, FEED),
        CuttingCoefficients(TANGENTIAL, NORMAL),
        step=step, slowest=ROTATION, fastest=ROTATION, regeneration="last",
    )  # fmt: skip
    state, speed = start(plant, ROTATION), np.full(count, ROTATION)

    def ours() -> np.ndarray:
        _, signals = advance(plant, state, speed, DEPTH)
        return np.asarray(jax.block_until_ready(signals.tip))[:, 0]

    compile_time, _ = measure.first_call(ours)
    turns = measure.interleaved(
        {"procmodel": ours, "Python, step by step": partial(by_loop, step, count)},
        sizes.chatter_repeats,
    )
    mine = turns.seconds["procmodel"]
    rows = [
        [name, measure.time_spread(seconds), f"{sizes.plant_seconds / np.median(seconds):.3g}",
         measure.ratio(seconds, mine)]
        for name, seconds in turns.seconds.items()
    ]  # fmt: skip
    section.text(
        f"One mode, two teeth, slot of {1e3 * DEPTH:g} mm at 5000 1/min, {sizes.plant_seconds:g} s "
        f"at {1e-3 / step:.0f} kHz. First call of ours, compilation in it: {compile_time:.2f} s."
    )
    section.table(["contestant", "time", "simulated seconds per second", "time / ours"], rows)
    settled = count // 2
    one, other = (turns.outcomes[name][settled:] for name in turns.seconds)
    apart = float(np.sqrt(np.mean((one - other) ** 2) / np.mean(other**2)))
    section.target(
        "settled motion of the plant as the loop has it", f"at most {AGREEMENT:g} apart (rms)",
        f"{apart:.2g}", apart <= AGREEMENT,
    )  # fmt: skip
