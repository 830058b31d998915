"""What was cut with what: the paper's conditions, and what is assumed where it gives none.

The paper gives the 50 um x 50 um electrode, the 45 degree wall of the square cavity, the shapes
of figs 17 to 22 and the rule that finishing must take off more than half the electrode's size.
It gives neither the wear ratio nor feeds, layer depths or sizes of the cavities. Those below are
assumptions, chosen once and used throughout:

- wear ratio 0.17 in roughing and 0.26 in finishing: the length wear measured at 1000 pF and
  330 pF, 120 V, tungsten carbide on stainless steel (SUS304), in the report of KAKENHI 02452105,
  taken here as the volumetric ratio;
- openings of 300 um, six electrode widths;
- layers of 1 um for compensated cavities and 2 um x 2 um steps for the test cavity;
- a round finishing electrode of 40 um that takes off a ring of 25 um;
- a feed axis that steps by 0.1 um, and no side gap.

Lengths in um, areas in um^2, angles in rad.
"""

import math
from dataclasses import dataclass, field, replace

from procmodel.wear import CircleSection, Hemisphere, Section, Solid, SquareSection, cone, pyramid


@dataclass(frozen=True)
class Electrode:
    """Size (width or diameter) [um], cross-section [um^2] and wear ratio of one stage."""

    size: float
    area: float
    wear_ratio: float

    @property
    def radius(self) -> float:
        """Radius of the circle of the electrode's area: it clears no smaller circle [um]."""
        return math.sqrt(self.area / math.pi)


@dataclass(frozen=True)
class KnownCase:
    """A case of section 1 of the wear notes, whose answers are known."""

    half_width: float
    wear_ratio: float
    electrode_area: float


@dataclass(frozen=True)
class Instrument:
    """How the simulated profile of the test cavity is measured.

    The instrument's origin is off by `centre` and `zero`, its axis by `tilt`, and every reading
    by normal noise; none of this is told to the fit.
    """

    spacing: float = 2.0
    reach: float = 190.0
    noise: float = 0.5
    centre: float = 1.7
    zero: float = 0.8
    tilt: float = 0.002


@dataclass(frozen=True)
class Conditions:
    """Everything that is chosen; see the module's text for what the paper says of it."""

    roughing: Electrode = Electrode(size=50.0, area=50.0**2, wear_ratio=0.17)
    finishing: Electrode = Electrode(size=40.0, area=math.pi * 20.0**2, wear_ratio=0.26)
    opening: float = 150.0
    test_step: float = 2.0
    test_feed: float = 2.0
    test_layers: int = 55
    layer_depth: float = 1.0
    resolution: float = 0.1
    ring: float = 25.0
    instrument: Instrument = Instrument()
    known_square: KnownCase = KnownCase(100.0, 0.2, 1e4)
    known_round_electrode: KnownCase = field(
        default_factory=lambda: KnownCase(250.0, 0.3, math.pi * 50.0**2)
    )

    def with_wear_scaled(self, factor: float) -> "Conditions":
        """The same conditions with every wear ratio times `factor`."""
        changed = {
            name: replace(part, wear_ratio=factor * part.wear_ratio)
            for name in ("roughing", "finishing", "known_square", "known_round_electrode")
            for part in (getattr(self, name),)
        }
        return replace(self, **changed)


ASSUMED = Conditions()


@dataclass(frozen=True)
class Wanted:
    """A cavity to be made."""

    name: str
    figure: str
    solid: Solid
    section: Section
    depth: float


def pyramid_frustum(conditions: Conditions) -> Wanted:
    """Fig. 17: 45 degree walls down to a floor of 80 um."""
    solid = pyramid(conditions.opening, math.pi / 4)
    return Wanted("pyramid frustum", "17", solid, SquareSection(), conditions.opening - 40.0)


def cone_frustum(conditions: Conditions) -> Wanted:
    """Figs 19 and 21: the paper gives no angle; 60 degrees, as deep as the opening's radius."""
    solid = cone(conditions.opening, math.pi / 3)
    return Wanted("cone frustum", "19", solid, CircleSection(), conditions.opening)


def hemisphere(conditions: Conditions, electrode: Electrode) -> Wanted:
    """Figs 20 and 22: down to the last layer that the electrode does not overcut."""
    solid = Hemisphere(conditions.opening)
    reachable = math.sqrt(conditions.opening**2 - electrode.radius**2)
    depth = conditions.layer_depth * math.floor(reachable / conditions.layer_depth)
    return Wanted("hemisphere", "20", solid, CircleSection(), depth)
