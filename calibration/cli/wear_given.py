"""What several wear commands are given alike: the electrode's section, and written paths."""

import math
from typing import TYPE_CHECKING

from calibration.cli import console
from procmodel.errors import InputError

if TYPE_CHECKING:
    from procmodel.io import WrittenPath
    from procmodel.wear.layer_path import ElectrodeSection, LayerPath


def section_of(
    diameter: float | None, area: float | None, side: float | None
) -> "ElectrodeSection":
    """The electrode's section from the one of three options that was given.

    Parameters
    ----------
    diameter, area : float, optional [um, um^2]
        Of a round electrode.
    side : float, optional [um]
        Of a square one.

    Returns
    -------
    ElectrodeSection
        The section.

    Raises
    ------
    InputError
        If not exactly one is given, or it is not above 0.
    """
    from procmodel.wear.layer_path import ElectrodeSection

    if side is None:
        round_area = console.electrode_area(diameter, area)
        return ElectrodeSection("round", 2.0 * math.sqrt(round_area / math.pi))
    if diameter is not None or area is not None:
        raise InputError("--electrode-side is given with another size of the electrode: give one.")
    if not (math.isfinite(side) and side > 0):
        raise InputError(f"--electrode-side is {side:g}, but must be above 0.")
    return ElectrodeSection("square", side)


def require_spread(wear_mode: str, spread_width: float | None) -> None:
    """Refuse a wear mode and a spread width [um] that do not go together.

    Raises
    ------
    InputError
        If one of mode spread and its width is given without the other.
    """
    if (wear_mode == "spread") != (spread_width is not None):
        raise InputError("--wear-mode spread and --spread-width go together: give both or none.")


def ways_of(written: "list[WrittenPath]") -> "list[LayerPath]":
    """Written paths as the processes take them.

    Parameters
    ----------
    written : list of WrittenPath
        From `procmodel.io.read_paths`.

    Returns
    -------
    list of LayerPath
        The same.
    """
    from procmodel.wear.layer_path import LayerPath

    return [LayerPath(way.points, way.cutting, way.quarter_turns) for way in written]
