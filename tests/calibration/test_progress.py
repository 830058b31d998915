"""What long work tells of itself: counts that rise to the total, a bar, or nothing."""

import numpy as np
import pytest

from calibration import Parameter, Problem, sample
from calibration.progress import reporting

X = np.linspace(0.0, 4.0, 12)


@pytest.fixture(scope="module")
def told(models):
    """Everything a short run said."""
    said = []
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0)}
    problem = Problem.from_function(models.line, parameters, X, 1.0 + X, 0.3)
    sample(
        problem, draws=3200, warmup=70, ensembles=2, progress=lambda *report: said.append(report)
    )
    return said


def test_every_stage_compiles_before_it_runs(told):
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert stages == ["fit", "start", "warm-up", "sampling"]
    for stage in stages:
        counts = [done for name, done, _ in told if name == stage]
        assert counts[0] is None and None not in counts[1:]


@pytest.mark.parametrize(("stage", "total"), [("warm-up", 70), ("sampling", 200)])
def test_counts_rise_to_the_total(told, stage, total):
    runs = [report for report in told if report[0] == stage and report[1] is not None]
    counts = [done for _, done, _ in runs]
    assert len(counts) > 2 and counts == sorted(counts)
    assert 0 < counts[0] < counts[-1] == total
    assert {of for _, _, of in runs} == {total}


@pytest.mark.parametrize("progress", [None, False])
def test_silence(progress, capsys):
    with reporting(progress) as silent:
        silent.compiling("fit")
        silent.running("fit", 1, 1)
    assert capsys.readouterr() == ("", "")


def test_bar_on_what_is_no_terminal(capsys):
    with reporting(True) as bar:
        bar.compiling("sampling")
        for done in (0, 3, 7, 10):
            bar.running("sampling", done, 10)
        bar.running("straight away", 5, 5)
    out, err = capsys.readouterr()
    assert out == ""
    assert "sampling" in err and "10/10" in err and "5/5" in err
    assert "compiling" not in err  # it is over: the stage that is left runs


def test_bar_says_while_it_compiles(capsys):
    with reporting(True) as bar:
        bar.compiling("sampling")
    assert "sampling: compiling" in capsys.readouterr().err


def test_bar_ends_with_an_error_in_the_work(capsys):
    with pytest.raises(ZeroDivisionError), reporting(True) as bar:
        bar.running("sampling", 1, 2)
        raise ZeroDivisionError
    assert "sampling" in capsys.readouterr().err


def test_an_error_of_the_callers_function_is_not_swallowed():
    def fails(stage, done, total):
        raise LookupError(stage)

    with reporting(fails) as told, pytest.raises(LookupError, match="fit"):
        told.compiling("fit")
