"""Time of a layer's moves."""

import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.scanning_coverage import Rates, path_time


def test_time_is_the_sum_of_its_moves():
    path = LayerPath(
        np.array([[0, 0], [100, 0], [100, 400], [300, 400]], float), np.array([True, False, True])
    )
    rates = Rates(scan=50.0, plunge=2.0, rapid=1000.0, lift=500.0)
    # 300 um of cut, two plunges of 6 um, 400 um above, up and down twice.
    wanted = 300 / 50 + 2 * 6 / 2 + (400 + 4 * 500) / 1000
    assert path_time(path, 6.0, rates) == pytest.approx(wanted)


@pytest.mark.parametrize("name", ["scan", "plunge", "rapid", "lift"])
def test_rates_are_above_0(name):
    with pytest.raises(InputError, match=f"{name} rate or height 0"):
        Rates(**({"scan": 1.0, "plunge": 1.0} | {name: 0.0}))
