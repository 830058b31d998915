"""Where layers of equal depth end. Lengths in um."""

import math

import numpy as np

from procmodel.errors import InputError

# Share of a layer up to which a remainder deepens the last layer instead of being one.
_THIN_REMAINDER = 0.1
# More layers than this are a wrong unit.
MOST_LAYERS = 20_000


def uniform_bottoms(depth: float, layer_depth: float) -> np.ndarray:
    """Bottoms of layers of equal depth; the last takes what does not divide.

    A remainder of more than a tenth of a layer is a thinner layer, a smaller one deepens the last.

    Parameters
    ----------
    depth : float [um]
        Depth of the cavity, > 0.
    layer_depth : float [um]
        Depth of a layer, > 0.

    Returns
    -------
    ndarray, shape (n,) [um]
        Depth of the bottom of every layer.

    Raises
    ------
    InputError
        If there would be no layer: the depth or layer depth is not above 0, or the layer depth is
        greater than the depth.
    """
    require_depth(depth)
    if not (math.isfinite(layer_depth) and 0 < layer_depth <= depth * (1 + 1e-9)):
        raise InputError(
            f"layer depth {layer_depth:g} um gives no layer: it must be above 0 and at most the "
            f"depth {depth:g} um."
        )
    if depth > MOST_LAYERS * layer_depth:
        raise InputError(
            f"a depth of {depth:.6g} um makes {depth / layer_depth:.6g} layers of {layer_depth:g} "
            f"um, more than {MOST_LAYERS}: check the unit of the part, or take thicker layers."
        )
    count = max(1, math.ceil(depth / layer_depth - _THIN_REMAINDER))
    bottoms = np.minimum(np.arange(1, count + 1) * layer_depth, depth)
    bottoms[-1] = depth
    return bottoms


def require_depth(depth: float) -> None:
    """Refuse a depth [um] that is not given or not above 0.

    Raises
    ------
    InputError
        If it is not a finite number above 0.
    """
    if not math.isfinite(depth):
        raise InputError("depth is missing: a cavity with vertical walls needs one.")
    if not depth > 0:
        raise InputError(f"depth {depth:g} um gives no layer: it must be above 0.")
