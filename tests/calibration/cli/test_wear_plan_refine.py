"""`wear plan --refine`: feeds searched through the simulation, and what `wear simulate` says."""

import numpy as np
import pytest

SHAPE = ["--shape", "hemisphere", "--radius", 40]
ELECTRODE = ["--electrode-diameter", 20]
PLAN = ("wear", "plan", *SHAPE, *ELECTRODE, "--depth", 30, "--layer-depth", 3, "--wear-ratio", 0.2)
UNIFORM = ["--wear-mode", "uniform"]


@pytest.mark.slow
def test_refined_feeds_leave_less_error_in_an_independent_run(tmp_path, run_json):
    errors = {}
    for name, options in (("exact", []), ("refined", ["--refine", 2, *UNIFORM])):
        out, paths = tmp_path / f"{name}.csv", tmp_path / f"{name}-paths.csv"
        found = run_json(*PLAN, *options, "--out", out, "--paths", paths)
        cut = run_json("wear", "simulate", "--plan", out, "--paths", paths, *SHAPE, *ELECTRODE,
                       "--cell", 2, "--wear-ratio", 0.2, *UNIFORM)  # fmt: skip
        errors[name] = cut["error_rms"]
    assert errors["refined"] < 0.8 * errors["exact"]
    simulated = found["simulated"]
    assert simulated["after"]["error_rms"] == pytest.approx(errors["refined"], rel=0.02)
    assert simulated["before"]["error_rms"] == pytest.approx(errors["exact"], rel=0.02)
    table = np.genfromtxt(out, delimiter=",", names=True)
    feeds = table[table.dtype.names[6]]
    first = 3.0 * (1.0 + 0.2 * np.pi * (40.0**2 - 3.0**2) / (np.pi * 10.0**2))
    assert np.max(feeds) <= 1.5 * first + 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--refine", 2, "--levelling", 2], "--refine is for one stage without --levelling"),
        (UNIFORM, "belong to --refine"),
        (["--refine", 0], "--refine is 0, but must be above 0"),
        (["--refine", 2, "--wear-mode", "turning"], "turning"),
    ],
)
def test_refusals(tmp_path, run, options, words):
    out = tmp_path / "never.csv"
    code, _, err = run(*PLAN, *options, "--out", out)
    assert code == 2 and words in err
    assert not out.exists()
