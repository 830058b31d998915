"""What the paper gives, and what is chosen where its tables and figures are missing.

The paper gives: steps of 0.3 um on axes of 0.1 um, ten drilled holes with gaps from 11.2 to
18.3 um, diameters measured within +-1 um, three shapes (cone frustum, square frustum, curved)
within 2 % of the drawing. Its text has neither the drawing's sizes nor the ten gaps nor the wire.
Chosen here, once:

- sizes of 60 and 120 um for both frustums, 80 and 120 um for the curved electrode with a hollow
  arc of 150 um radius;
- a wire of 100 um diameter;
- ten gaps simulated with the paper's lowest and highest (see `gaps.simulated_gaps`);
- +-1 um read as: every error inside is equally likely;
- for the link to wear: a round electrode of 100 um, wear ratio 0.17, a test cavity of 55 layers.

Lengths in um, areas in um^2, angles in rad.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from procmodel.electrode import Profile, cone_frustum, curved, square_frustum
from procmodel.electrode.profile import directions


@dataclass(frozen=True)
class Shape:
    """An electrode to be ground: its profile, and heights at which its size is looked at.

    A width across flats goes over two gaps (`passes`), of which a square has two.
    """

    name: str
    profile: Profile
    heights: tuple[float, ...]
    sizes: tuple[float, ...]
    passes: int = 1

    @property
    def widths(self) -> int:
        """How many independent widths there are at a height."""
        return self.passes

    @property
    def slopes(self) -> list[float]:
        """Angle between surface and axis at tip and base."""
        first, last = directions(self.profile.pieces[0])
        return [math.atan2(float(way[0]), float(way[1])) for way in (first, last)]


@dataclass(frozen=True)
class Conditions:
    """Everything that is given or chosen; see the module's text for which is which."""

    lowest_gap: float = 11.2
    highest_gap: float = 18.3
    holes: int = 10
    diameter_error: float = 1.0
    tolerance: float = 0.02
    step: float = 0.3
    resolution: float = 0.1
    wire_radius: float = 50.0
    length: float = 150.0
    arc_radius: float = 150.0
    seed: int = 1
    blind_diameter: float = 100.0
    wear_ratio: float = 0.17

    @property
    def blind_area(self) -> float:
        """Cross-section of the round electrode that is meant to come out."""
        return math.pi * self.blind_diameter**2 / 4.0

    @property
    def shapes(self) -> tuple[Shape, Shape, Shape]:
        """The three electrodes."""
        low, high = 0.0, self.length
        return (
            Shape("cone frustum", cone_frustum(30.0, 60.0, high), (low, high), (60.0, 120.0)),
            Shape("square frustum", square_frustum(30.0, 60.0, high), (low, high), (60, 120), 2),
            Shape(
                "curved",
                curved(40.0, 60.0, high, self.arc_radius),
                (low, high),
                (80.0, 120.0),
            ),
        )

    @property
    def range_constant(self) -> float:
        """Mean range of so many standard normal readings (3.078 for ten)."""
        x = np.linspace(-9.0, 9.0, 20_001)
        inside = 1.0 - ndtr(x) ** self.holes - ndtr(-x) ** self.holes
        return float(np.trapezoid(inside, x))


PAPER = Conditions()
