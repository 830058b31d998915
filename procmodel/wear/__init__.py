"""Wear: layer depth in micro-EDM milling under electrode wear (Yu and Masuzawa).

Lengths in um, areas in um^2.
"""

from procmodel.wear.cavity import (
    LayeredCavity,
    StagedCavity,
    constant_step_half_widths,
    wall_depth,
)
from procmodel.wear.layers import (
    cavity_depths,
    continuous_wall_depth,
    electrode_wear,
    layer_depth,
    layer_feed,
    relative_wear,
    wear_ratio_of_layer,
)
from procmodel.wear.sections import (
    AnnulusSection,
    CircleSection,
    PolygonSection,
    Section,
    SquareSection,
)
from procmodel.wear.solids import (
    Hemisphere,
    Solid,
    TabulatedSolid,
    TaperedSolid,
    TargetLayers,
    cone,
    pyramid,
    slice_solid,
    split_for_finishing,
)

__all__ = [
    "AnnulusSection",
    "CircleSection",
    "Hemisphere",
    "LayeredCavity",
    "PolygonSection",
    "Section",
    "Solid",
    "SquareSection",
    "StagedCavity",
    "TabulatedSolid",
    "TaperedSolid",
    "TargetLayers",
    "cavity_depths",
    "cone",
    "constant_step_half_widths",
    "continuous_wall_depth",
    "electrode_wear",
    "layer_depth",
    "layer_feed",
    "pyramid",
    "relative_wear",
    "slice_solid",
    "split_for_finishing",
    "wall_depth",
    "wear_ratio_of_layer",
]
