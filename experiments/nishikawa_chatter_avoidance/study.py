"""Policies on many simulated cuts that differ in modes, speed, depth, immersion and noise.

This is not the paper's: it has one policy and two cuts. A machine here is a tool of three teeth
with two modes, a programmed speed, and damping by the process that grows as the speed falls; on
each some cuts are made, from stable ones to such as chatter violently. Every policy makes every
cut, under the same noise. The paper's steps go from 100 to 50 % by 10 points; the other policies
have 50 to 120 % by 5 points.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.plans.avoidance import Run, Trial, air_baselines, closed_loops
from calibration.plans.avoidance_comparison import Paired, paired
from calibration.plans.avoidance_cost import LeastCost, probability_of
from calibration.plans.avoidance_loop import Loop, Spindle
from calibration.plans.avoidance_policies import (
    FixedSteps,
    FromFrequency,
    Hold,
    Policy,
)
from procmodel.chatter import AirCut, DetectorSettings, EngagementRule, Windowing
from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool, engaged_between
from procmodel.chatter.dynamics import Plant, ProcessNoise
from procmodel.chatter.modes import Modes, Sensors
from procmodel.chatter.recording import label_of_excess
from procmodel.chatter.sampling import Sampling
from procmodel.errors import InputError

TEETH, FEED = 3, 6e-5
RATE, LENGTH, HOP = 6400.0, 960, 480
SAMPLING = Sampling(RATE, 3, displacement_noise=1e-6)
WIDE = tuple(round(0.05 * n, 2) for n in range(10, 25))
SETTINGS = DetectorSettings(
    Windowing(RATE, LENGTH, HOP),
    band=(150.0, 2100.0),
    threshold=100.0,
    averaged_threshold=None,
    engagement=EngagementRule(1.3, 1.15),
)
HOLD, FIXED, FREQUENCY, COST = "no loop", "paper's steps", "frequency", "least cost"
CHATTER_COST, PHASE = 3.0, 0.15
_RANGE = (30.0, 135.0)
_STABLE, _CHATTER = "stable", "chatter"


@dataclass(frozen=True)
class Machine:
    """A tool in a spindle, its air cutting, and cuts to be made.

    Attributes
    ----------
    plants : tuple of Plant
        One for every cut.
    depths : tuple of float [m]
        Of the cuts.
    spindle : Spindle
        The spindle.
    air : dict of float to AirCut
        By override.
    damping : ndarray, shape (2,)
        Damping ratios of the tool.
    process : float
        Those that the process adds at the programmed speed, over the tool's.
    """

    plants: tuple[Plant, ...]
    depths: tuple[float, ...]
    spindle: Spindle
    air: dict[float, AirCut]
    damping: np.ndarray
    process: float

    def damping_at(self, rotation: float) -> np.ndarray:
        """Damping ratios while cutting at a speed."""
        return self.damping * (1.0 + self.process * self.spindle.rotation / rotation)


@dataclass(frozen=True)
class Study:
    """What came of it.

    Attributes
    ----------
    runs : dict of str to tuple of Run
        By policy, the cuts in one order.
    thresholds : ndarray, shape (m,)
        Samples of the threshold that least cost was given.
    """

    runs: dict[str, tuple[Run, ...]]
    thresholds: np.ndarray

    @property
    def chattering(self) -> np.ndarray:
        """Which cuts chatter without a loop, of bool."""
        return np.array([_label(r) == _CHATTER for r in self.runs[HOLD]])

    def energy(self, policy: str) -> np.ndarray:
        """Chatter energy of every cut [m^2 s]."""
        return np.array([r.energy for r in self.runs[policy]])

    def lost(self, policy: str) -> np.ndarray:
        """Time lost in every cut [s]."""
        return np.array([r.time_lost for r in self.runs[policy]])

    def against(
        self, policy: str, other: str, *, chattering: bool = False
    ) -> tuple[Paired, Paired]:
        """Differences of log10 of the energy, and of the time lost [s], of all cuts or of those
        that chatter without a loop."""
        of = self.chattering if chattering else np.ones(len(self.chattering), bool)
        return (
            paired(np.log10(self.energy(policy)[of]), np.log10(self.energy(other)[of])),
            paired(self.lost(policy)[of], self.lost(other)[of]),
        )


def studied(machines: int = 9, cuts: int = 6, work: float = 2.0, seed: int = 11) -> Study:
    """Every policy on every cut.

    Parameters
    ----------
    machines, cuts : int
        How many, and how many cuts on each.
    work : float [s]
        Time of each cut at the programmed speed.
    seed : int
        Of all that is drawn.

    Returns
    -------
    Study
        Of `machines` times `cuts` cuts.
    """
    park = [_machine(np.random.default_rng([seed, i]), 2 * cuts, i) for i in range(machines)]
    # The second half of the cuts is for learning the threshold.
    learnt = [(m, i) for m in park for i in range(cuts, min(2 * cuts, cuts + 2))]
    thresholds = _thresholds(_made(learnt, lambda m: Hold(), work, seed + 1), seed)
    probability = probability_of(thresholds)
    policies: dict[str, Callable[[Machine], Policy]] = {
        HOLD: lambda m: Hold(),
        FIXED: lambda m: FixedSteps(),
        FREQUENCY: lambda m: FromFrequency(TEETH, m.spindle.rotation, WIDE, phase=PHASE),
        COST: lambda m: LeastCost(
            probability, TEETH, m.spindle.rotation, CHATTER_COST, WIDE, PHASE
        ),
    }
    shown = [(m, i) for m in park for i in range(cuts)]
    return Study({n: _made(shown, p, work, seed + 2) for n, p in policies.items()}, thresholds)


def _machine(rng: np.random.Generator, cuts: int, number: int) -> Machine:
    frequency = np.array([rng.uniform(420.0, 700.0), rng.uniform(750.0, 1000.0)])
    damping, process = rng.uniform(0.015, 0.03, 2), rng.uniform(0.0, 1.5)
    stiffness = rng.uniform(3e6, 8e6, 2)
    angle = rng.uniform(0.0, np.pi)
    direction = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    modes = Modes(frequency, damping, stiffness / (2.0 * np.pi * frequency) ** 2, direction)
    cutting = rng.uniform(6e8, 1.1e9)
    coefficients = CuttingCoefficients(cutting, rng.uniform(0.2, 0.5) * cutting)
    spindle = Spindle(rng.uniform(62.0, 108.0), 60.0)
    # Of the depth at which cutting is as stiff as the dynamic stiffness of the softer mode.
    scale = 2.0 * np.min(stiffness * damping) * (1.0 + process) / cutting
    plants, depths = [], []
    for _ in range(cuts):
        start, leave = engaged_between(rng.uniform(0.15, 0.9), str(rng.choice(["down", "up"])))
        plants.append(
            Plant(
                modes,
                Tool(TEETH, imbalance=2e-6),
                Cut(start, leave, FEED),
                coefficients,
                step=SAMPLING.step,
                slowest=_RANGE[0],
                fastest=_RANGE[1],
                sensors=Sensors(modes.direction.T[:1], np.zeros((0, 2))),
                noise=ProcessNoise(1e-3, 0.02),
                revolutions=3,
            )
        )
        depths.append(float(scale * np.exp(rng.uniform(np.log(2.5), np.log(14.0)))))
    air = air_baselines(
        plants[0], SAMPLING, SETTINGS.windowing, spindle, WIDE, 30, number, block=HOP
    )
    return Machine(tuple(plants), tuple(depths), spindle, air, damping, process)


def _made(
    cuts: list[tuple[Machine, int]], policy: Callable[[Machine], Policy], work: float, seed: int
) -> tuple[Run, ...]:
    trials = [
        Trial(
            machine.plants[i],
            Loop(SETTINGS, machine.air, machine.spindle, policy(machine)),
            machine.depths[i],
            work,
            seed * 1000 + n,
            damping=machine.damping_at,
        )
        for n, (machine, i) in enumerate(cuts)
    ]
    return closed_loops(trials, SAMPLING, HOP)


def _label(run: Run) -> str:
    return label_of_excess(float(np.sqrt(np.mean(np.square(run.vibration)))) / FEED)


def _thresholds(runs: tuple[Run, ...], seed: int, draws: int = 400) -> np.ndarray:
    """Thresholds with the fewest wrong windows, in cuts resampled with replacement."""
    rng = np.random.default_rng(seed)
    each = []
    for run in runs:
        judged = [r.score for r in run.log if r.outcome]
        label = _label(run)
        if label in (_STABLE, _CHATTER) and judged:
            each.append((np.log1p(np.array(judged)), label == _CHATTER))
    grid = np.linspace(np.log(2.0), np.log(1e6), 400)
    # Share of the windows of every cut above every threshold.
    above = np.array([(scores[:, None] > grid).mean(axis=0) for scores, _ in each])
    bad = np.array([chatter for _, chatter in each])
    if bad.all() or not bad.any():
        raise InputError("the cuts to learn from are all alike; make more of them.")
    found: list[float] = []
    while len(found) < draws:
        picked = rng.integers(len(each), size=len(each))
        some = bad[picked]
        if some.all() or not some.any():
            continue
        wrong = above[picked][~some].mean(axis=0) + (1.0 - above[picked][some]).mean(axis=0)
        least = np.flatnonzero(wrong <= wrong.min() + 1e-9)
        found.append(float(np.expm1(grid[rng.choice(least)])))
    return np.array(found)
