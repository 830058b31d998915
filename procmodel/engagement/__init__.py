"""Engagement: how far round an end mill touches the stock, and the force that follows.

Lengths in mm, forces in N, coefficients in N/mm^2 and N/mm, angles in rad.
"""

from procmodel.engagement.angle import (
    AIR,
    CORNER_TOO_SMALL,
    ENGAGED,
    SLOT,
    STATUS,
    area_rate,
    engagement_angle_constant_curvature,
    engagement_angle_entering_arc,
    engagement_status,
    radial_depth_for_angle,
    sharp_corner_angle,
    surface_kink,
)
from procmodel.engagement.deflection import (
    Cantilever,
    MeasuredStiffness,
    ToolStiffness,
    cantilever_deflection,
)
from procmodel.engagement.force import (
    ForceCoefficients,
    instantaneous_force,
    mean_force,
    peak_force,
)
from procmodel.engagement.form_error import Cut, engaged_between, form_error, wall_force
from procmodel.engagement.materials import PublishedCoefficients, published_coefficients

__all__ = [
    "AIR",
    "CORNER_TOO_SMALL",
    "ENGAGED",
    "SLOT",
    "STATUS",
    "Cantilever",
    "Cut",
    "ForceCoefficients",
    "MeasuredStiffness",
    "PublishedCoefficients",
    "ToolStiffness",
    "area_rate",
    "cantilever_deflection",
    "engaged_between",
    "engagement_angle_constant_curvature",
    "engagement_angle_entering_arc",
    "engagement_status",
    "form_error",
    "instantaneous_force",
    "mean_force",
    "peak_force",
    "published_coefficients",
    "radial_depth_for_angle",
    "sharp_corner_angle",
    "surface_kink",
    "wall_force",
]
