"""What was cut with what: the paper's conditions, and what is assumed where it gives none.

The paper gives the tool (diameter 10 mm, 4 flutes), 4775 rpm, 0.04 mm/tooth, down cutting, 5 mm
axial and 0.1 mm radial depth, SKD61 of HRC53; 11.5 degrees on its lines and 19 in its arc. Its
drawing of the path is lost. Inferred or assumed, chosen once and used throughout:

- the wall's corner radius 8 mm, inferred: it makes 18.7 degrees, and 7.87 mm would make 19.0;
- a quarter circle between lines of 20 mm; a pocket of 60 mm x 40 mm with four such corners;
- a helix of 30 degrees;
- coefficients of Al7075-T6, for nobody has published any for SKD61 of HRC53. Forces in N are
  therefore those of aluminium. The stiffness is fitted to the paper's wall error on top of them, so
  that what is wrong by a common factor in the coefficients is wrong by that factor in the stiffness
  and drops out of every wall error.

Lengths in mm, forces in N, angles in rad.
"""

import math
from dataclasses import dataclass, field

from procmodel.engagement import Contour, Cut, contour

# Bulge of a quarter circle.
_QUARTER = math.tan(math.pi / 8)


@dataclass(frozen=True)
class Paper:
    """What the paper measured [rad, mm, N]."""

    angle_on_line: float = math.radians(11.5)
    angle_in_arc: float = math.radians(19.0)
    left_in_arc: float = 0.014
    left_at_junction: float = 0.0045
    steady_variation: float = 17.0


@dataclass(frozen=True)
class Conditions:
    """Everything that is chosen; see the module's text for what the paper says of it."""

    radius: float = 5.0
    radial_depth: float = 0.1
    corner: float = 8.0
    line: float = 20.0
    pocket: tuple[float, float] = (60.0, 40.0)
    cut: Cut = field(default_factory=lambda: Cut(4, 5.0, 0.04, 5.0, math.radians(30.0), "down"))
    material: str = "Al7075-T6"
    reading_height: float = 1.0
    reading_sigma: float = 0.001
    forward_passes: int = 3
    paper: Paper = Paper()

    @property
    def path_arc(self) -> float:
        """Radius of the tool centre's arc [mm]."""
        return self.corner - self.radius

    @property
    def path_turn(self) -> float:
        """Length of the tool centre's arc [mm]."""
        return 0.5 * math.pi * self.path_arc


PAPERS_CUT = Conditions()


def open_wall(conditions: Conditions, allowance: float = 0.0) -> Contour:
    """Line, concave quarter circle, line; less an allowance on the tool's side.

    Parameters
    ----------
    conditions : Conditions
        The cut. The arc begins at (0, 0) and its centre is at (0, corner).
    allowance : float [mm]
        Distance of the contour from the wall.

    Returns
    -------
    Contour
        The wall, free side to the left.
    """
    bend, line, a = conditions.corner, conditions.line, allowance
    points = [[-line, a], [0.0, a], [bend - a, bend], [bend - a, bend + line]]
    return contour(points, [0.0, _QUARTER, 0.0], closed=False, name="wall")


def closed_pocket(conditions: Conditions) -> Contour:
    """Rounded rectangle.

    Parameters
    ----------
    conditions : Conditions
        The cut.

    Returns
    -------
    Contour
        The wall, free side to the left.
    """
    a, b = 0.5 * conditions.pocket[0], 0.5 * conditions.pocket[1]
    c, d = a - conditions.corner, b - conditions.corner
    points = [[-c, -b], [c, -b], [a, -d], [a, d], [c, b], [-c, b], [-a, d], [-a, -d]]
    return contour(points, [0.0, _QUARTER] * 4, name="pocket")
