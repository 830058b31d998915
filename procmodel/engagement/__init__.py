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
from procmodel.engagement.force import ForceCoefficients, instantaneous_force, mean_force

__all__ = [
    "AIR",
    "CORNER_TOO_SMALL",
    "ENGAGED",
    "SLOT",
    "STATUS",
    "ForceCoefficients",
    "area_rate",
    "engagement_angle_constant_curvature",
    "engagement_angle_entering_arc",
    "engagement_status",
    "instantaneous_force",
    "mean_force",
    "radial_depth_for_angle",
    "sharp_corner_angle",
    "surface_kink",
]
