"""What was cut with what: the paper's conditions, and what is chosen or fitted where it gives none.

The paper gives the tools (ball end mills of 2 mm, 2 flutes, 25 and 35 mm long), speeds, feeds, the
depth of 0.1 mm and the pick feed of 0.1 mm, the natural frequency 3.88 kHz of the shorter tool, the
sampling, and the rule of the detector. It gives no stiffness, damping, coefficient or noise.

A ball that cuts on a slope is taken for a straight cylinder of the tool's radius, cutting up, whose
width of cut and immersion depend on the slope. The tip gives way alike in both directions; the
sensors see the feed direction, as in the paper. SI units; spindle speeds as rotation frequency.

Chosen:

- stiffness 8e4 N/m of the shorter tool, about that of a carbide beam of 2 mm and 25 mm; of the
  longer one (25/35)^3 of it;
- tangential coefficient 2.9e9 N/m^2: only its product with the width matters;
- damping by the process: every tooth in the cut brakes the motion by C b / v, b its width and v the
  cutting speed. It is taken as its mean over a revolution and both directions, a damping ratio that
  falls with the speed. Without it the fitted tool chatters at low speeds as well.

Fitted, for nothing else tells them:

- damping ratio, C, width, normal coefficient and immersion on 60 degrees: stable to 16000 1/min
  and chatter from 18000 on, near 3.85 kHz;
- natural frequency of the longer tool (1980 Hz by its length), its width and immersion on either
  slope: chatter at 15000 and none at 13500 1/min on 60 degrees, none below 9000 on 85 degrees;
- gains of the sensors: the paper's powers at the chatter frequency at 18000 1/min;
- noise of the sensors and of the process: see `Noise`.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from procmodel.chatter import DetectorSettings, EngagementRule, Windowing
from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool, engaged_between
from procmodel.chatter.dynamics import Plant, ProcessNoise
from procmodel.chatter.modes import Modes, Sensors
from procmodel.chatter.sampling import Sampling

TEETH, RADIUS = 2, 0.001
RATE, LENGTH, BAND = 25600.0, 4096, (500.0, 8500.0)
SENSORS = ("displacement", "acceleration")
SWEEP = tuple(1000.0 * n for n in range(6, 29, 2))
OVERRIDES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
_GAIN = (6.2e-3, 2.93e-5)


@dataclass(frozen=True)
class Paper:
    """What the paper reports of distances, both sensors, and of speeds [1/min]."""

    worst_good: tuple[float, float] = (23.27, 13.64)
    least_bad: tuple[float, float] = (71.07, 30.58)
    worst_good_at: tuple[float, float] = (8000.0, 6000.0)
    least_bad_at: tuple[float, float] = (22000.0, 20000.0)
    ratio: tuple[float, float] = (3.05, 2.24)
    reached: tuple[tuple[int, float], ...] = ((85, 7500.0), (60, 13500.0))


@dataclass(frozen=True)
class Noise:
    """Fitted noise.

    Attributes
    ----------
    displacement : float [m]
        Standard deviation in each sample: the paper's least distance under chatter.
    acceleration : float [m/s^2]
        The same.
    hardness : float [1/sqrt(Hz)]
        Of the cutting force: the displacement's largest distance without chatter.
    force : float [N/sqrt(Hz)]
        Of a force on the tip, in air as well; chosen small.
    """

    displacement: float = 1.35e-7
    acceleration: float = 0.63
    hardness: float = 4.4e-3
    force: float = 1e-5


@dataclass(frozen=True)
class Mill:
    """A tool on a slope.

    Attributes
    ----------
    frequency : float [Hz]
        Natural frequency.
    stiffness : float [N/m]
        At the tip.
    width : float [m]
        Of the cut, in axial direction.
    immersion : float
        Radial depth over diameter.
    feed : float [m]
        Per tooth.
    damping : float
        Damping ratio of the tool.
    process : float [N/m]
        C.
    tangential : float [N/m^2]
        Cutting coefficient.
    normal : float
        Its normal part, over the tangential.
    gain : tuple of float
        Of the displacement and the acceleration sensor.
    noise : Noise
        Of sensors and process.
    """

    frequency: float = 3880.0
    stiffness: float = 8e4
    width: float = 1e-5
    immersion: float = 0.594
    feed: float = 5e-5
    damping: float = 0.0087
    process: float = 2.32e5
    tangential: float = 2.9e9
    normal: float = 0.217
    gain: tuple[float, float] = _GAIN
    noise: Noise = field(default_factory=Noise)

    @property
    def mass(self) -> float:
        """Modal mass [kg]."""
        return self.stiffness / (2.0 * math.pi * self.frequency) ** 2

    @property
    def law(self) -> tuple[Tool, Cut, CuttingCoefficients]:
        """Tool, cut and coefficients."""
        start, leave = engaged_between(self.immersion, "up")
        return (
            Tool(TEETH, RADIUS),
            Cut(start, leave, self.feed),
            CuttingCoefficients(self.tangential, self.normal * self.tangential),
        )

    def damping_at(self, rotation: float) -> float:
        """Damping ratio at a speed of the spindle, with that of the process."""
        start, leave = (float(a) for a in engaged_between(self.immersion, "up"))
        teeth = TEETH * (leave - start) / (2.0 * math.pi)
        brake = self.process * self.width / (2.0 * math.pi * RADIUS * rotation)
        # Half of it in either direction: the mean of the squares of sine and cosine.
        over = 0.5 * teeth * brake / (2.0 * self.mass * 2.0 * math.pi * self.frequency)
        return self.damping + over

    def modes(self, rotation: float) -> Modes:
        """The tip's modes while cutting at a speed, one along the feed and one across."""
        return self._pair(self.damping_at(rotation))

    def _pair(self, ratio: float) -> Modes:
        two = np.ones(2)
        return Modes(self.frequency * two, ratio * two, self.mass * two, np.eye(2))

    def plant(
        self, speeds: tuple[float, float], sampling: Sampling, *, acceleration: bool = True
    ) -> Plant:
        """The simulated mill in air, between two speeds, with or without the second sensor."""
        seen = np.array([[self.gain[1], 0.0]] if acceleration else np.zeros((0, 2)))
        noise = ProcessNoise(self.noise.hardness, self.noise.force)
        return Plant(
            self._pair(self.damping),
            *self.law,
            step=sampling.step,
            slowest=speeds[0],
            fastest=speeds[1],
            sensors=Sensors(np.array([[self.gain[0], 0.0]]), seen),
            noise=noise,
            revolutions=3,
        )

    def sampling(self, oversampling: int = 2) -> Sampling:
        """How it is recorded."""
        return Sampling(RATE, oversampling, self.noise.displacement, self.noise.acceleration)


SHORT_60 = Mill()
_SOFTER = (25.0 / 35.0) ** 3
_LONGER: dict[str, Any] = {
    "frequency": 1880.0,
    "stiffness": _SOFTER * 8e4,
    "feed": 1e-4,
    # The holder moves with the force: less for the same motion of a softer tip.
    "gain": (_SOFTER * _GAIN[0], _SOFTER * _GAIN[1]),
}
LONG_60 = Mill(width=1.2e-5, immersion=0.23, **_LONGER)
LONG_85 = Mill(width=0.7e-5, immersion=0.8, **_LONGER)


def papers_settings(**changes: Any) -> DetectorSettings:
    """The paper's detector: 4096 samples without overlap, 2 of 5 above 100, one statistic."""
    chosen: dict[str, Any] = {
        "band": BAND,
        "averaged_threshold": None,
        "threshold": 100.0,
        "engagement": EngagementRule(1.3, 1.15),
    }
    return DetectorSettings(Windowing(RATE, LENGTH, LENGTH), **{**chosen, **changes})
