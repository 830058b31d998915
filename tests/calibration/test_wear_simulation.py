"""A plan cut in simulation: feed laws, the belief's ends, stopping and going on, the file."""

import dataclasses

import numpy as np
import pytest
import xarray

from calibration import wear_simulation
from calibration.wear_simulation import CavityTask, cut_cavity, planned_feeds, save_cavity
from procmodel.errors import InputError
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.path_steps import path_steps
from procmodel.wear.zmap import simulate
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap

LAYERS = 6


def line(layer):
    """A groove of 40 um, to and fro."""
    path = LayerPath(np.array([[0.0, 0.0], [40.0, 0.0]]), np.array([True]))
    return path.reversed() if layer % 2 else path


@pytest.fixture(scope="module")
def task():
    steps = path_steps([line(n) for n in range(LAYERS)], 2.0)
    electrode = ElectrodeMap(ElectrodeSection("round", 16.0), 2.0)
    feeds = planned_feeds(steps, np.full(LAYERS, 3.0))
    return CavityTask(steps, feeds, electrode, WorkpieceMap.around(steps, electrode))


@pytest.fixture(scope="module")
def whole(task):
    return cut_cavity(task, 0.2)


def test_it_is_the_simulation_itself(task, whole):
    at_once = simulate(task.steps, task.feeds, task.electrode, task.workpiece, 0.2)
    np.testing.assert_array_equal(whole.depth, at_once.depth)
    np.testing.assert_allclose(whole.simulated.removed, at_once.removed, rtol=1e-13)
    assert whole.simulated.status == f"all {LAYERS} layers are cut."
    assert whole.wear_ratios == (0.2,)
    assert whole.low is None and whole.high is None


@pytest.mark.parametrize(
    ("law", "length"), [("layer", None), ("linear", None), ("fixed-length", 10.0)]
)
def test_every_law_gives_the_same_feed_in_sum(task, law, length):
    wanted = np.linspace(1.0, 3.0, LAYERS)
    feeds = planned_feeds(task.steps, wanted, law, length)
    np.testing.assert_allclose(feeds.sum(axis=1), wanted, rtol=1e-12)
    assert not np.any(feeds[~task.steps.valid])
    given = (feeds > 0).sum(axis=1)
    if law == "layer":
        assert np.all(given == 1)
    elif law == "linear":
        np.testing.assert_allclose(feeds[0, 1:21], wanted[0] / 20, rtol=1e-12)
    else:
        # After 10, 20, 30 and 40 um of the way.
        np.testing.assert_array_equal(np.flatnonzero(feeds[0]), [5, 10, 15, 20])


def test_a_plunge_is_fed_at_once_by_every_law():
    steps = path_steps([LayerPath(np.zeros((1, 2)), np.zeros(0, bool))], 2.0)
    for law, length in (("layer", None), ("linear", None), ("fixed-length", 10.0)):
        assert planned_feeds(steps, np.array([2.0]), law, length)[0, 0] == 2.0


def test_the_ends_of_the_belief_lie_around_the_middle(task):
    draws = np.random.default_rng(4).normal(0.3, 0.03, 500)
    cut = cut_cavity(task, draws)
    middle, low, high = cut.wear_ratios
    assert low < middle < high
    assert middle == pytest.approx(0.3, abs=0.005)
    assert high - low == pytest.approx(2 * 1.96 * 0.03, rel=0.1)
    deep = cut.depth > 1.0
    # A greater wear ratio cuts less deep.
    assert np.all(cut.low[deep] < cut.depth[deep]) and np.all(cut.depth[deep] < cut.high[deep])
    alone = cut_cavity(task, high)
    np.testing.assert_allclose(alone.depth, cut.low, rtol=1e-12)


def test_a_stopped_run_goes_on_from_its_checkpoint(task, whole, tmp_path, monkeypatch):
    real, calls = wear_simulation.simulate_layers, []

    def stopping(*arguments, **options):
        calls.append(1)
        if len(calls) == 4:  # as an interrupt leaves it: no further layer
            return dataclasses.replace(options["resume"], stopped="stopped by hand.")
        return real(*arguments, **options)

    file = tmp_path / "run.h5"
    monkeypatch.setattr(wear_simulation, "simulate_layers", stopping)
    first = cut_cavity(task, 0.2, checkpoint=file)
    assert first.simulated.status == "stopped after layer 3 of 6; run again with --resume."
    monkeypatch.setattr(wear_simulation, "simulate_layers", real)
    told = []
    rest = cut_cavity(
        task, 0.2, checkpoint=file, resume=True, progress=lambda *report: told.append(report[1])
    )
    assert [done for done in told if done] == [4, 5, 6]
    np.testing.assert_array_equal(rest.depth, whole.depth)
    np.testing.assert_array_equal(rest.simulated.worn, whole.simulated.worn)
    with pytest.raises(
        InputError, match=r"belongs to a run with wear ratio 0\.2, this one has 0\.3"
    ):
        cut_cavity(task, 0.3, checkpoint=file, resume=True)
    with pytest.raises(InputError, match=r"run\.h5 exists"):
        cut_cavity(task, 0.2, checkpoint=file)


def test_an_electrode_that_is_used_up_ends_the_run(task):
    short = ElectrodeMap(task.electrode.section, task.electrode.cell, usable_length=3.0)
    cut = cut_cavity(dataclasses.replace(task, electrode=short), 1.0)
    assert cut.simulated.status.startswith("the electrode is used up in layer ")
    assert len(cut.simulated.removed) < LAYERS


def test_the_file_holds_everything(task, tmp_path):
    cut = cut_cavity(task, np.array([0.18, 0.2, 0.22]))
    target = np.full(cut.depth.shape, 5.0)
    save_cavity(tmp_path / "cavity.nc", cut, target)
    data = xarray.load_dataset(tmp_path / "cavity.nc", engine="h5netcdf")
    np.testing.assert_array_equal(data.depth, cut.depth)
    np.testing.assert_array_equal(data.target, target)
    np.testing.assert_array_equal(data.depth_low, cut.low)
    np.testing.assert_array_equal(data.x, task.workpiece.x)
    assert data.depth.attrs["units"] == "um"
    assert data.attrs["volume_ratio"] == pytest.approx(cut.wear_ratios[0], rel=1e-12)
    # The balance of the file itself: volumes of layers against the maps.
    volume = float(data.depth.sum()) * task.workpiece.cell**2
    assert float(data.removed_volume.sum()) == pytest.approx(volume, rel=1e-12)


@pytest.mark.parametrize(
    ("law", "length", "words"),
    [
        ("layers", None, "feed law 'layers' is unknown; did you mean 'layer'"),
        ("linear", 5.0, "needs a length between feeds, and no other does"),
        ("fixed-length", None, "needs a length between feeds"),
    ],
)
def test_refused_laws(task, law, length, words):
    with pytest.raises(InputError, match=words):
        planned_feeds(task.steps, np.ones(LAYERS), law, length)


def test_other_refusals(task):
    with pytest.raises(InputError, match="the plan has 2 layers, the path 6"):
        planned_feeds(task.steps, np.ones(2))
    with pytest.raises(InputError, match="resume needs a checkpoint"):
        cut_cavity(task, 0.2, resume=True)
