"""What is cut with what. The paper gives the electrode and the rules; the rest is chosen.

The pocket and the gap are chosen so that the electrode's centre stays on whole cells and so that
lines 40 um apart (overlap of a fifth) and 50 um apart (none) both fit the pocket's width evenly:
then a ridge is the path's, not the grid's.

Lengths in um, areas in um^2, speeds in um/s.
"""

from dataclasses import dataclass

from procmodel.wear.layer_path import ElectrodeSection


@dataclass(frozen=True)
class Conditions:
    """Everything that is chosen.

    `wear_spread` is how far around its place a discharge wears a fixed electrode: without it the
    rounding of the rim by side discharges is as wide as a cell, whatever that is.
    `width` is the electrode's side (the paper's 50 um) or diameter. The pocket is square, with
    vertical walls; `layers` are cut into it, the last `watched` of which are measured one by one.
    """

    width: float = 50.0
    wear_ratio: float = 0.2
    side_gap: float = 2.5
    wear_spread: float = 5.0
    pocket: float = 255.0
    slot: float = 255.0
    feed: float = 4.0
    layers: int = 40
    watched: int = 8
    overlap: float = 0.2
    cell: float = 1.25
    coarse_cell: float = 2.5
    # Known answers: a groove fed in proportion to its length, and the cone's finest cells.
    groove: float = 800.0
    feed_per_length: float = 0.01
    fine_cell: float = 0.625
    # Start-up and levelling: also with so little wear that u is 1 in the pocket.
    gentle_wear_ratio: float = 0.04
    passes: int = 4
    many_passes: int = 12
    # Compensation: the same depth by three feed laws, and how wrong the wear ratio is assumed.
    depth_per_layer: float = 1.0
    fixed_length: float = 100.0
    wrong: float = 1.1
    scan_speed: float = 100.0
    # Hemisphere.
    radius: float = 100.0
    hemisphere_depth: float = 96.0
    hemisphere_layer: float = 2.0
    spread: float = 0.05
    draws: int = 16
    evaluations: int = 40

    @property
    def square(self) -> ElectrodeSection:
        """The paper's electrode."""
        return ElectrodeSection("square", self.width)

    @property
    def round(self) -> ElectrodeSection:
        """An electrode that may rotate."""
        return ElectrodeSection("round", self.width)


CHOSEN = Conditions()
