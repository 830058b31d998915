"""Readings of the discharge gap, and the problem that the engine solves for it."""

import math

import numpy as np
import pytest
import scipy.stats

from calibration import fit, sample, simulation_check
from calibration.electrode import (
    GapData,
    GapPrior,
    GapScatter,
    gap_problem,
    measured_std,
    read_electrodes,
    read_holes,
)
from calibration.electrode_gap import fit_gap
from procmodel.errors import InputError
from procmodel.io import write_table

HOLES = [130.0, 128.0, 134.0]
ELECTRODES = [100.0, 101.0, 99.0]


def table(tmp_path, **columns):
    path = tmp_path / "holes.csv"
    write_table(path, {f"{name.replace('_', ' ')} [um]": v for name, v in columns.items()})
    return path


def test_gaps_of_holes_are_half_the_difference_and_know_their_error():
    data = GapData.from_holes(HOLES, ELECTRODES, diameter_error=1.0)
    np.testing.assert_allclose(data.gap, [15.0, 13.5, 17.5], rtol=1e-15)
    # Uniform within +-1 um: 1 / sqrt(3); half the difference of two: over sqrt(2).
    errors = np.random.default_rng(0).uniform(-1, 1, (2, 200_000))
    assert data.sigma[0] == pytest.approx(1 / math.sqrt(6), rel=1e-15)
    assert np.std(0.5 * (errors[0] - errors[1])) == pytest.approx(data.sigma[0], rel=0.01)


def test_repeated_measurements_shrink_the_error():
    assert measured_std(1.0, repeats=4) == pytest.approx(0.5 * measured_std(1.0))


def test_gaps_of_electrodes_are_what_path_wire_and_radius_leave():
    data = GapData.from_electrodes([165.0, 166.0], [100.0, 98.0], wire_radius=100.0, passes=2)
    np.testing.assert_allclose(data.gap, [15.0, 17.0], rtol=1e-15)
    assert data.sigma[0] == pytest.approx(0.5 / math.sqrt(3), rel=1e-15)
    assert data.passes.tolist() == [2, 2]


def test_joined_readings_keep_their_kinds():
    holes = GapData.from_holes(HOLES, ELECTRODES)
    both = holes.joined(GapData.from_electrodes([165.0], [100.0], 100.0, passes=2))
    assert len(both) == 4 and both.passes.tolist() == [1, 1, 1, 2]
    assert both.sigma[3] == 0.5 * measured_std(1.0) and both.sigma[0] == holes.sigma[0]


def test_tables_are_read_in_any_unit_of_length(tmp_path):
    path = tmp_path / "mixed.csv"
    path.write_text("hole diameter [mm], electrode diameter [um]\n0.130,100\n0.128,101\n")
    np.testing.assert_allclose(read_holes(path).gap, [15.0, 13.5], atol=1e-9)
    path.write_text("path radius [um], electrode diameter [um]\n165,100\n")
    assert read_electrodes(path, 100.0).gap.tolist() == [15.0]


def test_a_hole_smaller_than_its_electrode_names_file_and_row(tmp_path):
    path = table(tmp_path, hole_diameter=[130.0, 95.0], electrode_diameter=[100.0, 100.0])
    with pytest.raises(InputError, match=r"holes\.csv, row 3: the hole of 95 um is smaller"):
        read_holes(path)


def test_an_electrode_thicker_than_its_path_names_file_and_row(tmp_path):
    path = table(tmp_path, path_radius=[165.0, 140.0], electrode_diameter=[100.0, 100.0])
    with pytest.raises(InputError, match=r"holes\.csv, row 3: the electrode of 100 um is thicker"):
        read_electrodes(path, 100.0)


def test_a_missing_column_and_one_without_unit_are_named(tmp_path):
    path = table(tmp_path, hole_diameter=[130.0], tool=[100.0])
    with pytest.raises(InputError, match="no column 'electrode diameter'"):
        read_holes(path)
    path.write_text("hole diameter, electrode diameter [um]\n130,100\n")
    with pytest.raises(InputError, match=r"'hole diameter' has no unit: write 'hole diameter \["):
        read_holes(path)


def test_a_single_reading_is_refused_where_the_spread_is_wanted(tmp_path):
    path = table(tmp_path, hole_diameter=[130.0], electrode_diameter=[100.0])
    for use in (gap_problem, fit_gap):
        with pytest.raises(InputError, match=r"row 2: a single gap of 15 um tells nothing"):
            use(read_holes(path))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"gap": [15.0, -0.5]}, "reading 2: the gap is negative"),
        ({"gap": [15.0, math.nan]}, "reading 2: the gap is not a finite number"),
        ({"sigma": 0.0}, "reading 1: sigma is not above 0"),
        ({"sigma": [0.4, math.inf]}, "reading 2: sigma is not above 0"),
        ({"sigma": [0.4, 0.4, 0.4]}, r"sigma has shape \(3,\) for 2 gaps"),
        ({"passes": 1.5}, "reading 1: passes is not a whole number"),
        ({"gap": np.zeros((2, 2))}, "list of readings"),
    ],
)
def test_faulty_readings_are_named(changed, said):
    with pytest.raises(InputError, match=said):
        GapData(**{"gap": [15.0, 14.0], "sigma": 0.4} | changed)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: GapData.from_holes([130.0], [100.0, 99.0]), "one electrode diameter for each"),
        (lambda: GapData.from_electrodes([165.0], [1.0, 2.0], 50.0), "one diameter for each path"),
        (lambda: GapData.from_electrodes([165.0], [100.0], 0.0), "wire radius 0 um"),
        (lambda: measured_std(0.0), "error of a measured diameter is 0 um"),
        (lambda: measured_std(1.0, 0), "repeats is 0"),
        (lambda: GapPrior(spread=0.0), "prior spread of the gap is 0"),
        (lambda: GapPrior(mean=math.nan), "prior mean of the gap is nan"),
    ],
)
def test_faulty_numbers_are_named(call, said):
    with pytest.raises(InputError, match=said):
        call()


def test_scatter_and_measuring_error_add_as_squares():
    noise = GapScatter(passes=2)
    values = {"gap_spread": 2.0}
    found = noise.log_likelihood(np.array([15.0]), np.array([17.0]), np.array([0.5]), values)
    expected = scipy.stats.norm.logpdf(17.0, 15.0, math.sqrt(0.25 + 4.0 / 2))
    assert float(found[0]) == pytest.approx(expected, rel=1e-13)


@pytest.fixture(scope="module")
def ten():
    gaps = np.random.default_rng(7).normal(14.75, 2.3, 10)
    holes = GapData(gaps, measured_std(1.0) / math.sqrt(2.0))
    return holes.joined(GapData([13.0, 15.5], 0.5 * measured_std(1.0), 2))


def test_the_fit_is_where_plain_minimisation_finds_the_mode(ten):
    def cost(at):
        mean, log_spread = at
        scale = np.sqrt(ten.sigma**2 + np.exp(2 * log_spread) / ten.passes)
        logs = scipy.stats.norm.logpdf(ten.gap, mean, scale).sum()
        logs += scipy.stats.norm.logpdf(mean, 20.0, 10.0)
        return -logs - scipy.stats.norm.logpdf(log_spread, math.log(2.0), 1.0)

    best = scipy.optimize.minimize(cost, [15.0, 0.7], method="BFGS", options={"gtol": 1e-9})
    result = fit(gap_problem(ten))
    assert result.converged
    assert result.parameters["gap_mean"].value == pytest.approx(best.x[0], abs=1e-5)
    assert result.parameters["gap_spread"].value == pytest.approx(math.exp(best.x[1]), abs=1e-5)


def test_the_sampler_and_the_exact_form_agree(ten):
    tree = sample(gap_problem(ten), seed=3, draws=48_000)
    assert tree.attrs["converged"], tree.attrs["status"]
    exact = fit_gap(ten)
    levels = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    effective = min(tree.attrs["ess_bulk"], tree.attrs["ess_tail"])
    for name, below, quantile in (
        ("gap_mean", exact.mean.below, exact.mean.quantile),
        ("gap_spread", exact.spread_below, exact.spread_quantile),
    ):
        draws = np.asarray(tree["posterior"][name]).ravel()
        shares = np.mean(draws[:, None] < quantile(levels), axis=0)
        # Four standard errors of a share among so many effective draws.
        error = 4.0 * np.sqrt(levels * (1 - levels) / effective)
        assert np.all(np.abs(shares - levels) < error)
        assert float(below(np.quantile(draws, 0.5))) == pytest.approx(0.5, abs=2.0 / effective**0.5)


@pytest.mark.slow
@pytest.mark.parametrize("passed", [True, False])
def test_the_engine_passes_its_own_check_unless_the_measuring_error_is_ignored(passed):
    sigma = measured_std(6.0) / math.sqrt(2.0)
    data = GapData(np.full(10, 30.0), sigma if passed else 1e-3)
    prior = GapPrior(mean=40.0, mean_std=5.0)

    def simulate(rng, values):
        gaps = rng.normal(values["gap_mean"], values["gap_spread"], 10)
        errors = rng.uniform(-6.0, 6.0, (2, 10))
        return {"gaps": gaps + 0.5 * (errors[0] - errors[1])}

    check = simulation_check(
        gap_problem(data, prior), 100, 2, simulate=simulate, steps=200, warmup=100
    )
    assert check.passed == passed, check.report()
    assert check.failed <= 2
