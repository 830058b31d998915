"""Engagement: how far round an end mill touches the stock, and the force that follows.

Closed forms in `angle`; contours of lines and arcs in `contour`, moved sideways exactly in
`offset`; the stock and what the rim meets in `surface` and `contact`; paths of constant engagement
in `backward` and `forward`, what they cannot avoid in `floor`; then `force`, `deflection` and
`form_error`.

Lengths in mm, forces in N, coefficients in N/mm^2 and N/mm, angles in rad.
"""

from procmodel.engagement.angle import (
    AIR,
    CORNER_TOO_SMALL,
    DETACHED,
    ENGAGED,
    MULTIPLE,
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
from procmodel.engagement.backward import previous_pass, wanted_surface
from procmodel.engagement.contact import Contact, contact
from procmodel.engagement.contour import Contour, contour, oriented, stations
from procmodel.engagement.deflection import (
    Cantilever,
    MeasuredStiffness,
    ToolStiffness,
    cantilever_deflection,
)
from procmodel.engagement.floor import unavoidable_angle
from procmodel.engagement.force import (
    ForceCoefficients,
    instantaneous_force,
    mean_force,
    peak_force,
)
from procmodel.engagement.form_error import Cut, engaged_between, form_error, wall_force
from procmodel.engagement.forward import forward_pass
from procmodel.engagement.materials import PublishedCoefficients, published_coefficients
from procmodel.engagement.moving import move_places
from procmodel.engagement.offset import offset
from procmodel.engagement.surface import Surface, cleared_by, previous_surface, traced_surface

__all__ = [
    "AIR",
    "CORNER_TOO_SMALL",
    "DETACHED",
    "ENGAGED",
    "MULTIPLE",
    "SLOT",
    "STATUS",
    "Cantilever",
    "Contact",
    "Contour",
    "Cut",
    "ForceCoefficients",
    "MeasuredStiffness",
    "PublishedCoefficients",
    "Surface",
    "ToolStiffness",
    "area_rate",
    "cantilever_deflection",
    "cleared_by",
    "contact",
    "contour",
    "engaged_between",
    "engagement_angle_constant_curvature",
    "engagement_angle_entering_arc",
    "engagement_status",
    "form_error",
    "forward_pass",
    "instantaneous_force",
    "mean_force",
    "move_places",
    "offset",
    "oriented",
    "peak_force",
    "previous_pass",
    "previous_surface",
    "published_coefficients",
    "radial_depth_for_angle",
    "sharp_corner_angle",
    "stations",
    "surface_kink",
    "traced_surface",
    "unavoidable_angle",
    "wall_force",
    "wanted_surface",
]
