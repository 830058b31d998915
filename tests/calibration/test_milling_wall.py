"""Stiffness and form error: against closed forms, simulated readings, and what is confounded."""

import math

import numpy as np
import pytest

from calibration import LogNormal, Parameter, sample
from calibration.milling import AXES, fit_force_coefficients
from calibration.milling_wall import PUBLISHED_SPREAD, fit_form_error, fit_stiffness
from procmodel.engagement import (
    Cantilever,
    Cut,
    ForceCoefficients,
    MeasuredStiffness,
    mean_force,
)
from procmodel.errors import InputError
from procmodel.io import ForceReadings

TRUTH = ForceCoefficients(796.0, 168.8, 222.0, 27.7, 30.8, 1.4)
CUT = Cut(flutes=4, axial_depth=5.0, feed_per_tooth=0.04, radius=5.0, helix=math.radians(30.0))
LINE, ARC = np.radians([11.478340954533579, 18.7375])
POSITIVE = {"transform": "log", "bounds": (0.0, math.inf)}


def test_stiffness_is_a_slope():
    rng = np.random.default_rng(1)
    force = np.linspace(10.0, 200.0, 12)
    deflection = force / 6000.0 + rng.normal(0.0, 1e-3, 12)
    found = fit_stiffness(force, deflection, 1e-3).parameters["stiffness"]
    slope = float(force @ deflection / (force @ force))
    assert found.value == pytest.approx(1.0 / slope, rel=1e-9)
    std = 1e-3 / math.sqrt(force @ force) / slope**2
    assert found.std == pytest.approx(std, rel=1e-6)


def test_stiffness_with_a_zero_is_a_regression_line():
    rng = np.random.default_rng(2)
    force = np.linspace(10.0, 200.0, 12)
    deflection = force / 6000.0 + 0.02 + rng.normal(0.0, 1e-3, 12)
    found = fit_stiffness(force, deflection, fit_zero=True).parameters
    slope, zero = np.polyfit(force, deflection, 1)
    assert found["stiffness"].value == pytest.approx(1.0 / slope, rel=1e-8)
    assert found["zero"].value == pytest.approx(zero, rel=1e-8)


def test_stiffness_intervals_cover():
    rng = np.random.default_rng(3)
    force = np.linspace(10.0, 100.0, 6)
    covered = narrow = 0
    for _ in range(400):
        deflection = force / 6000.0 + rng.normal(0.0, 1e-3, 6)
        estimate = fit_stiffness(force, deflection).parameters["stiffness"]
        covered += estimate.interval95[0] <= 6000.0 <= estimate.interval95[1]
        narrow += abs(estimate.value - 6000.0) <= estimate.std
    assert covered / 400 == pytest.approx(0.95, abs=0.03)
    # Negative control: one standard deviation is not mistaken for 95 %.
    assert narrow / 400 < 0.8


@pytest.mark.parametrize(
    ("force", "deflection", "options", "message"),
    [
        ([1.0, 2.0], [1.0], {}, r"^there are 2 forces for 1 deflections: give one each\.$"),
        ([1.0, 2.0], [-1.0, -2.0], {}, r"^the deflections do not grow with the force"),
        ([1.0, 1.0], [1.0, 1.0], {"fit_zero": True}, r"more than one force where the zero"),
    ],
)
def test_faulty_deflections(force, deflection, options, message):
    with pytest.raises(InputError, match=message):
        fit_stiffness(force, deflection, 0.1, **options)


def test_one_wall_error_gives_the_stiffness_for_given_forces_and_says_so():
    force = float(CUT.wall_force(TRUTH, ARC, [1.0])[0, 1])
    found = fit_form_error([ARC], [0.014], CUT, TRUTH, heights=1.0, sigma=0.001)
    stiffness = found.result.parameters["stiffness"]
    assert stiffness.value == pytest.approx(force / 0.014, rel=1e-8)
    assert stiffness.std == pytest.approx(force / 0.014 / 14.0, rel=1e-6)
    assert "stiffness and the force coefficients cannot be told apart" in found.notes[0]
    assert found.as_dict()["warnings"][-1] == found.notes[0]


def test_one_wall_error_cannot_part_stiffness_from_forces():
    scale = Parameter(1.0, prior=PUBLISHED_SPREAD, **POSITIVE)
    found = fit_form_error(
        [ARC], [0.014], CUT, TRUTH, heights=1.0, sigma=0.001, force_scale=scale
    ).result
    for name in ("stiffness", "force_scale"):
        assert found.parameters[name].verdict == "flat"
        assert found.parameters[name].reason == "its interval comes from the prior alone"
    assert "force_scale and stiffness cannot be told apart" in found.directions[0]
    quotient = found.parameters["scale_per_stiffness"]
    force = float(CUT.wall_force(TRUTH, ARC, [1.0])[0, 1])
    assert quotient.verdict == "identified"
    assert quotient.value == pytest.approx(0.014 / force, rel=1e-8)
    free = Parameter(1.0, **POSITIVE)
    with pytest.raises(InputError, match=r"^stiffness and force_scale cannot be told apart, and"):
        fit_form_error([ARC], [0.014], CUT, TRUTH, heights=1.0, sigma=0.001, force_scale=free)


def test_nor_can_many_wall_errors():
    angles, heights = np.linspace(0.15, 0.5, 8), np.linspace(0.0, 4.0, 8)
    errors = 1e-3 * np.arange(10, 18)
    free = Parameter(1.0, **POSITIVE)
    found = fit_form_error(angles, errors, CUT, TRUTH, heights=heights, force_scale=free).result
    verdicts = {name: found.parameters[name].verdict for name in ("stiffness", "force_scale")}
    assert set(verdicts.values()) == {"flat"}
    assert "force_scale and stiffness cannot be told apart: +1 %" in found.directions[0]
    assert found.parameters["scale_per_stiffness"].verdict == "identified"


def walls(rng, cut, tool, sigma):
    angles = np.repeat(np.linspace(0.1, 0.6, 6), 3)
    heights = np.tile([0.2, 2.0, 3.5], 6)
    exact = [
        float(cut.form_error(TRUTH, a, tool, [h])[0]) for a, h in zip(angles, heights, strict=True)
    ]
    return angles, heights, np.array(exact) + rng.normal(0.0, sigma, 18)


@pytest.mark.parametrize("milling", ["down", "up"])
def test_stiffness_is_recovered_from_walls(milling):
    cut = Cut(4, 5.0, 0.04, 5.0, CUT.helix, milling)
    angles, heights, errors = walls(np.random.default_rng(5), cut, MeasuredStiffness(6000.0), 5e-4)
    found = fit_form_error(angles, errors, cut, TRUTH, heights=heights).result
    stiffness = found.parameters["stiffness"]
    assert stiffness.value == pytest.approx(6000.0, abs=4 * stiffness.std)
    assert stiffness.verdict == "identified"
    assert found.noise["wall"] == pytest.approx(5e-4, rel=0.6)


def test_force_scale_is_recovered_for_a_known_tool():
    tool = Cantilever(10.0, 40.0, 6e5)
    angles, heights, errors = walls(np.random.default_rng(6), CUT, tool, 5e-4)
    found = fit_form_error(angles, 3.0 * errors, CUT, TRUTH, heights=heights, tool=tool)
    scale = found.result.parameters["force_scale"]
    assert scale.value == pytest.approx(3.0, abs=4 * scale.std)
    assert "stiffness" not in found.result.parameters
    assert "force_scale takes up what the tool was given" in found.notes[0]


def test_an_error_of_the_datum_is_fitted():
    angles, heights, errors = walls(np.random.default_rng(7), CUT, MeasuredStiffness(6000.0), 5e-4)
    found = fit_form_error(
        angles, errors - 0.01, CUT, TRUTH, heights=heights, fit_zero=True
    ).result.parameters
    assert found["zero"].value == pytest.approx(-0.01, abs=4 * found["zero"].std)
    assert found["stiffness"].value == pytest.approx(6000.0, abs=4 * found["stiffness"].std)


def measured_forces(rng):
    feed, start = (g.ravel() for g in np.meshgrid([0.02, 0.04, 0.08], [1.6, 2.6, 2.9]))
    exact = np.asarray(mean_force(TRUTH, start, np.full(9, np.pi), 4, np.full(9, 5.0), feed))
    noisy = exact + rng.normal(0.0, 1.0, exact.shape)
    forces = dict(zip(AXES, noisy.T, strict=True))
    return fit_force_coefficients(ForceReadings(feed, 5.0, start, np.pi, forces), 4, sigma=1.0)


def test_forces_and_walls_together_part_stiffness_from_coefficients():
    rng = np.random.default_rng(8)
    forces = measured_forces(rng)
    angles, heights, errors = walls(rng, CUT, MeasuredStiffness(6000.0), 5e-4)
    joint = fit_form_error(angles, errors, CUT, forces, heights=heights, sigma=5e-4)
    found = joint.result
    assert joint.notes == ()
    assert set(found.residuals) == {"Fx", "Fy", "Fz", "wall"}
    for name, truth in (("stiffness", 6000.0), ("radial_edge", 30.8)):
        estimate = found.parameters[name]
        assert estimate.verdict == "identified"
        assert estimate.value == pytest.approx(truth, abs=4 * estimate.std)
    # Uncertain forces widen the stiffness beyond what the walls alone would say.
    alone = fit_form_error(
        angles, errors, CUT, forces.coefficients, heights=heights, sigma=5e-4
    ).result
    assert found.parameters["stiffness"].std > alone.parameters["stiffness"].std
    with pytest.raises(InputError, match=r"^force_scale has no place where the forces"):
        fit_form_error(angles, errors, CUT, forces, heights=heights, force_scale=2.0)


def test_posterior_of_one_wall_error_knows_the_quotient_alone():
    scale = Parameter(1.0, prior=PUBLISHED_SPREAD, **POSITIVE)
    stiffness = Parameter(6000.0, "N/mm", prior=LogNormal(6000.0, 0.5), **POSITIVE)
    found = fit_form_error(
        [ARC],
        [0.014],
        CUT,
        TRUTH,
        heights=1.0,
        sigma=0.001,
        force_scale=scale,
        stiffness=stiffness,
    ).result
    tree = sample(found.problem, seed=2, start=found)
    assert tree.attrs["converged"]
    posterior = {name: np.log(np.ravel(draws)) for name, draws in tree["posterior"].items()}
    quotient = posterior["force_scale"] - posterior["stiffness"]
    # Two log-normal priors and one reading: the standard deviations in closed form, with the
    # reading's taken as constant in the logarithm.
    wide, narrow = PUBLISHED_SPREAD.log_std**2, 0.5**2
    reading = (1.0 / 14.0) ** 2
    expected = math.sqrt(wide * (narrow + reading) / (wide + narrow + reading))
    assert float(posterior["force_scale"].std()) == pytest.approx(expected, rel=0.1)
    assert float(quotient.std()) == pytest.approx(1.0 / 14.0, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"errors": [-0.01, -0.02]}, r"^the wall errors do not follow the force on the wall"),
        ({"angles": [0.1, 0.2, 0.3]}, r"^angle has shape \(3,\) for 2 wall errors"),
        ({"angles": [0.1, 4.0]}, r"^angle of wall error 2 is 4 rad, but must be between 0 and"),
        ({"heights": 6.0}, r"^height of wall error 1 is 6 mm, but must be between 0 and 5\.$"),
        ({"heights": math.nan}, r"^height of wall error 1 is nan mm"),
        ({"tool": MeasuredStiffness(1.0), "stiffness": 1.0}, r"^tool and stiffness are both given"),
        ({"coefficients": {"tangential_shear": 1.0}}, r"^coefficient 'radial_shear' is missing"),
        ({"coefficients": {"radial_sheer": 1.0}}, r"'radial_sheer' is unknown; did you mean"),
    ],
)
def test_faulty_walls(change, message):
    given = {
        "angles": [0.2, 0.3],
        "errors": [0.01, 0.02],
        "cut": CUT,
        "coefficients": TRUTH,
        "heights": 1.0,
        "sigma": 0.001,
    }
    with pytest.raises(InputError, match=message):
        fit_form_error(**(given | change))
