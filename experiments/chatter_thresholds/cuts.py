"""Simulated cuts of known truth, from a tool to learn from and from tools that differ."""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from calibration.chatter_cuts import CutScores
from procmodel.chatter import (
    CUTTING,
    AirCut,
    Detector,
    DetectorSettings,
    Windowing,
    air_cut,
    detect,
    prepare,
)
from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool, engaged_between
from procmodel.chatter.dynamics import Plant, ProcessNoise
from procmodel.chatter.lobes import depth_limit
from procmodel.chatter.modes import Modes
from procmodel.chatter.recording import Schedule, air_cut_air, labelled_recording
from procmodel.chatter.sampling import Sampling

# The literature's mode, in slotting and half immersion; speeds [rev/s].
RATE, OVERSAMPLING, LENGTH = 12_800.0, 8, 1024
SPEEDS = (5000.0 / 60.0, 7000.0 / 60.0, 10_000.0 / 60.0)
BAND = (300.0, 5000.0)
COEFFICIENTS = CuttingCoefficients(6e8, 2e8)
DEEPEST = 4e-3


@dataclass(frozen=True, eq=False)
class Generator:
    """A tool on a machine, as it is simulated.

    Attributes
    ----------
    name : str
        What tables call it.
    modes : Modes
        Of the tool's tip.
    tool : Tool
        Teeth, helix, runout.
    slices : int
        Pieces of the depth for the helix.
    hardness : float [1/sqrt(Hz)]
        Fluctuation of the cutting force.
    """

    name: str
    modes: Modes = field(default_factory=lambda: Modes(922.0, 0.011, 0.03993))
    tool: Tool = field(default_factory=lambda: Tool(2))
    slices: int = 1
    hardness: float = 1e-3

    def plant(self, rotation: float) -> Plant:
        """The plant at one spindle speed."""
        return Plant(
            self.modes, self.tool, Cut(*engaged_between(0.5, "down"), 1e-4), COEFFICIENTS,
            step=SAMPLING.step, slowest=rotation, fastest=rotation, slices=self.slices,
            noise=ProcessNoise(self.hardness, 0.01),
        )  # fmt: skip


SAMPLING = Sampling(RATE, OVERSAMPLING, 1e-7, 1.0)
LEARNT = Generator("the tool learnt from")
# What a shop would call the same tool: another helix, runout, a second mode.
OTHERS = (
    replace(LEARNT, name="helix of 30 degrees", tool=Tool(2, helix=np.pi / 6), slices=3),
    replace(LEARNT, name="runout of 20 um", tool=Tool(2, runout=np.array([2e-5, 0.0]))),
    replace(
        LEARNT,
        name="a second mode",
        modes=Modes([922.0, 1730.0], [0.011, 0.015], [0.03993, 0.06], [[1.0, 0.0], [0.0, 1.0]]),
    ),
    replace(
        LEARNT,
        name="all three",
        modes=Modes([922.0, 1730.0], [0.011, 0.015], [0.03993, 0.06], [[1.0, 0.0], [0.0, 1.0]]),
        tool=Tool(2, helix=np.pi / 6, runout=np.array([2e-5, 0.0])),
        slices=3,
    ),
)


@lru_cache(maxsize=64)
def limit(generator: Generator, rotation: float) -> float:
    """Depth at which chatter begins [m]."""
    plant = generator.plant(rotation)
    return depth_limit(
        plant.modes, plant.tool, plant.cut, plant.coefficients, rotation, DEEPEST, samples=20
    )


@lru_cache(maxsize=64)
def air(generator: Generator, rotation: float, seed: int) -> AirCut:
    """Air cutting of 4 s."""
    schedule = Schedule(np.array([0.0, 4.0]), np.full(2, rotation), np.zeros(2))
    found = labelled_recording(generator.plant(rotation), schedule, SAMPLING, seed)
    return air_cut(acceleration(found.samples), Windowing(RATE, LENGTH), rotation)


def acceleration(samples: np.ndarray) -> np.ndarray:
    """The acceleration along the feed."""
    return samples[:, 2:3]


def detector(generator: Generator, rotation: float, seed: int) -> Detector:
    """What scores the cuts of a tool at a speed."""
    baseline = air(generator, rotation, seed)
    return prepare(DetectorSettings(baseline.windowing, BAND, teeth=2), baseline)


def scored(
    generator: Generator, share: float, rotation: float, seconds: float, seed: int
) -> CutScores | None:
    """Scores of a cut at a share of the depth at which chatter begins; None if nothing is cut."""
    schedule = air_cut_air(
        rotation, share * limit(generator, rotation), before=0.3, cutting=seconds, after=0.2
    )
    plant = generator.plant(rotation)
    found = labelled_recording(plant, schedule, SAMPLING, 1000 + seed, labelled_by="lobes")
    seen = detect(detector(generator, rotation, 7), acceleration(found.samples)).observations
    scores = [o.score for o in seen if o.engagement == CUTTING and not o.fault]
    if not scores:
        return None
    windowing = Windowing(RATE, LENGTH)
    return CutScores(
        found.truth.label, generator.name, 60.0 * rotation, np.array(scores),
        windowing.step / RATE, LENGTH / RATE, f"{generator.name}, cut {seed}",
    )  # fmt: skip


def campaign(
    generator: Generator, shares: np.ndarray, seconds: float, seed: int
) -> list[CutScores]:
    """One cut for every share of the limit, speeds in turns."""
    found = [
        scored(generator, float(share), SPEEDS[i % len(SPEEDS)], seconds, seed + i)
        for i, share in enumerate(shares)
    ]
    return [cut for cut in found if cut is not None]


def shares(stable: int, marginal: int, chatter: int, seed: int) -> np.ndarray:
    """Depths over the limit: stable 0.3 to 0.85, marginal around 1, chatter 1.15 to 1.8."""
    random = np.random.default_rng(seed)
    return np.concatenate(
        [
            random.uniform(0.3, 0.85, stable),
            random.uniform(0.98, 1.02, marginal),
            random.uniform(1.15, 1.8, chatter),
        ]
    )
