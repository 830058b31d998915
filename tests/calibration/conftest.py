"""Models that several files share, so that each is compiled once in a test process."""

import math
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import Parameter
from procmodel.wear import LayeredCavity, SquareSection, constant_step_half_widths


def line(params, x):
    """Straight line a + b x."""
    return params["a"] + params["b"] * x


def cavity_depths(params, x):
    """Depth of a square test cavity after every layer."""
    ratio, area = params["wear_ratio"], params["electrode_area"]
    return LayeredCavity(x, 2.0, SquareSection(), ratio, area, params["gap"]).depths


def cavity_walls(params, x):
    """Where the wall of every layer stands."""
    return x + params["gap"]


def wear_per_area(params):
    """R / S_e."""
    return params["wear_ratio"] / params["electrode_area"]


class WearCase:
    """100 layers of 2 um, step 2 um, from 250 um half width, R = 0.3, electrode 100 um thick."""

    depths = staticmethod(cavity_depths)
    walls = staticmethod(cavity_walls)
    wear_ratio = 0.3
    electrode_area = math.pi * 50.0**2

    def __init__(self):
        self.half_widths = np.asarray(constant_step_half_widths(250.0, 2.0, 100))

    def parameters(self, *free, start=0.1, gap=0.0, gap_bounds=(-20.0, 50.0)):
        """The parameters, those named being free."""
        area = self.electrode_area
        return {
            "wear_ratio": Parameter(start, "", (0.0, 1e3), fixed="wear_ratio" not in free),
            "electrode_area": Parameter(
                area, "um^2", (1e-3 * area, 1e3 * area), fixed="electrode_area" not in free
            ),
            "gap": Parameter(gap, "um", gap_bounds, fixed="gap" not in free),
            "wear_per_area": Parameter(start / area, "1/um^2", tied=wear_per_area),
        }

    def readings(self, seed=None, gap=0.0, noise=1.0):
        """Depth after every layer, with noise when a seed is given."""
        values = {"wear_ratio": 0.3, "electrode_area": self.electrode_area, "gap": gap}
        exact = np.asarray(self.depths(values, jnp.asarray(self.half_widths)))
        return exact + (
            0.0 if seed is None else noise * np.random.default_rng(seed).normal(size=100)
        )


@pytest.fixture(scope="session")
def wear():
    return WearCase()


@pytest.fixture(scope="session")
def models():
    return SimpleNamespace(line=line)
