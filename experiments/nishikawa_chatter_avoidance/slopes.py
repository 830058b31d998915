"""The paper's application: contour milling of two slopes, with and without the system."""

from dataclasses import dataclass

import numpy as np

from calibration.plans.avoidance import Run, Trial, air_baselines, closed_loops
from calibration.plans.avoidance_loop import Loop, Spindle
from calibration.plans.avoidance_policies import FixedSteps, Hold, Policy
from experiments.nishikawa_chatter_avoidance.conditions import (
    LENGTH,
    LONG_60,
    LONG_85,
    OVERRIDES,
    papers_settings,
)

# 6000 1/min in a second.
SPINDLE = Spindle(250.0, 100.0)
AIR_WINDOWS = 100
_RANGE = (120.0, 255.0)


@dataclass(frozen=True)
class Slopes:
    """Runs on the two slopes.

    Attributes
    ----------
    on, off : dict of int to Run
        With and without the loop, by slope [deg].
    """

    on: dict[int, Run]
    off: dict[int, Run]

    def reached(self, slope: int) -> float:
        """Speed at the end of a run with the loop [1/min]."""
        return 60.0 * float(self.on[slope].rotation[-1])

    def first_alarm(self, slope: int) -> float:
        """Time from the start of the cut to the first chatter of the detector [s]."""
        run = self.on[slope]
        return next((e.time_s for e in run.events), np.nan) - _entry(run)

    def vibration(self, slope: int, on: bool) -> float:
        """Root mean square beyond the forced vibration in the last half second [m]."""
        run = (self.on if on else self.off)[slope]
        last = run.time > run.time[-1] - 0.5
        return float(np.sqrt(np.mean(np.square(run.vibration[last]))))


def both_slopes(
    work: float = 4.0, windows: int = AIR_WINDOWS, overrides: tuple[float, ...] = OVERRIDES
) -> Slopes:
    """Cuts on both slopes.

    Parameters
    ----------
    work : float [s]
        Time of each cut at the programmed speed.
    windows : int
        Spectra of the baselines of air cutting.
    overrides : tuple of float
        Those allowed.

    Returns
    -------
    Slopes
        Of the paper's policy, and of none.
    """
    mills = {85: LONG_85, 60: LONG_60}
    settings, sampling = papers_settings(), LONG_85.sampling()
    plants = {a: m.plant(_RANGE, sampling, acceleration=False) for a, m in mills.items()}
    # In the air both are the same tool.
    air = air_baselines(
        plants[85], sampling, settings.windowing, SPINDLE, overrides, windows, key=7
    )
    policies: tuple[Policy, ...] = (FixedSteps(overrides), Hold())
    loops = [Loop(settings, air, SPINDLE, policy) for policy in policies]
    trials = [
        Trial(plants[a], loop, mill.width, work, a, damping=mill.damping_at)
        for loop in loops
        for a, mill in mills.items()
    ]
    runs = closed_loops(trials, sampling, LENGTH // 4)
    count = len(mills)
    on, off = runs[:count], runs[count:]
    return Slopes(dict(zip(mills, on, strict=True)), dict(zip(mills, off, strict=True)))


def _entry(run: Run) -> float:
    """When the cut began [s]."""
    return float(run.time[-1] - run.cutting_time)
