"""Published cutting force coefficients, with their source.

They serve to begin with, and to plan a measurement: sources differ by a factor of five for the same
alloy, for tool, coating, wear and speed are in the coefficients too. Fit your own.

References
----------
.. [1] Chinese Journal of Mechanical Engineering 34, 2021, doi 10.1186/s10033-021-00536-9, table 5.
"""

from dataclasses import dataclass

from procmodel.engagement.force import ForceCoefficients
from procmodel.errors import InputError, nearest


@dataclass(frozen=True)
class PublishedCoefficients:
    """Coefficients as printed.

    Attributes
    ----------
    coefficients : ForceCoefficients
        In N/mm^2 and N/mm.
    source : str
        Where they are printed.
    """

    coefficients: ForceCoefficients
    source: str


_CJME_2021 = "Chin. J. Mech. Eng. 34, 2021, doi 10.1186/s10033-021-00536-9, table 5"
# That table's Al6061-T6 is not here: it has no axial coefficients.
_SETS = {
    "Al6082-T6": ((631.0, 99.0, 273.0, 13.0, 10.0, 2.8), _CJME_2021),
    "Al7075-T6": ((767.01, 168.8, 222.0, 27.7, 26.6, 0.7), _CJME_2021),
}


def published_coefficients(material: str) -> PublishedCoefficients:
    """Coefficients printed for a material.

    Parameters
    ----------
    material : str
        Such as "Al7075-T6".

    Returns
    -------
    PublishedCoefficients
        The six coefficients and their source.

    Raises
    ------
    InputError
        If there are none for it.
    """
    if material not in _SETS:
        raise InputError(
            f"no coefficients are stored for {material!r}{nearest(material, tuple(_SETS))}."
        )
    values, source = _SETS[material]
    return PublishedCoefficients(ForceCoefficients(*values), source)
