"""95 % intervals cover the truth in 95 % of simulated cavities."""

import numpy as np
import pytest

from calibration import Problem, fit

CAVITIES = 1000


def coverage(wear, sigma_known):
    """Share of cavities whose 95 % and one-deviation intervals hold the truth."""
    rng = np.random.default_rng(20260)
    covered = narrow = 0
    for _ in range(CAVITIES):
        truth = rng.uniform(0.05, 0.6)
        half_widths = rng.uniform(210.0, 400.0) - 2.0 * np.arange(100)
        noise = rng.uniform(0.3, 3.0)
        area = 4.0 * half_widths**2
        exact = np.cumsum(2.0 / (1.0 + truth * area / wear.electrode_area))
        readings = exact + noise * rng.normal(size=100)
        problem = Problem.from_function(
            wear.depths,
            wear.parameters("wear_ratio"),
            half_widths,
            readings,
            noise if sigma_known else None,
        )
        estimate = fit(problem).parameters["wear_ratio"]
        low, high = estimate.interval95
        covered += low <= truth <= high
        narrow += abs(estimate.value - truth) <= estimate.std
    return covered / CAVITIES, narrow / CAVITIES


@pytest.mark.slow
@pytest.mark.parametrize("sigma_known", [True, False], ids=["known noise", "estimated noise"])
def test_intervals_of_the_wear_ratio_cover(wear, sigma_known):
    covered, narrow = coverage(wear, sigma_known)
    assert covered == pytest.approx(0.95, abs=0.02)
    # Negative control: intervals of one standard deviation are not mistaken for it.
    assert narrow != pytest.approx(0.95, abs=0.02)
    assert narrow == pytest.approx(0.683, abs=0.05)
