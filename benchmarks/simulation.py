"""Simulation-based calibration of the wear model: five hundred posteriors."""

from benchmarks import measure
from benchmarks.posteriors import posteriors
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from calibration import LogNormal, Normal, Parameter, Problem, simulation_check

WANTED = 60.0


def run(section: Section, sizes: Sizes) -> None:
    given = posteriors()[0].problem
    data = given.datasets["data"]
    parameters = {
        "wear_ratio": Parameter(0.3, bounds=(0.0, 1e3), prior=LogNormal(0.3, 0.2)),
        "gap": Parameter(3.0, bounds=(0.0, 250.0), prior=Normal(3.0, 1.0)),
        "zero": Parameter(0.0, bounds=(-50.0, 50.0), prior=Normal(0.0, 1.0)),
    }
    problem = Problem.from_function(
        given.structure.functions[0], parameters, data.x, data.y, data.sigma
    )
    compiling, _ = measure.first_call(lambda: simulation_check(problem, repeats=2))
    seconds, check = measure.timed(lambda: simulation_check(problem, repeats=sizes.simulated))
    section.text(
        f"{sizes.simulated} sets of readings simulated from the priors of a wear curve, each "
        f"fitted and sampled anew. First call, nothing compiled: {compiling:.1f} s."
    )
    section.text("```", check.report(), "```")
    section.target(
        f"{sizes.simulated} simulated calibrations",
        f"under {WANTED:g} s",
        f"{seconds:.1f} s",
        seconds < WANTED,
    )
    section.target(
        "ranks of the true values", "uniform", check.report().splitlines()[-1], check.passed
    )
