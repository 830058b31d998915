"""The loop closed on the plant: what is conserved, the twin, lanes side by side, what helps."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.plans.avoidance import Trial, air_baselines, closed_loops
from calibration.plans.avoidance_comparison import summary
from calibration.plans.avoidance_loop import Loop, Spindle
from calibration.plans.avoidance_policies import Decision, FixedSteps, Hold
from procmodel.chatter import DetectorSettings, EngagementRule, Windowing
from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool
from procmodel.chatter.dynamics import Plant, ProcessNoise
from procmodel.chatter.modes import Modes, Sensors
from procmodel.chatter.recording import replace_regeneration
from procmodel.chatter.sampling import Sampling
from procmodel.errors import InputError

RATE, LENGTH = 6400.0, 480
SAMPLING = Sampling(RATE, 2, displacement_noise=5e-7)
# A mode like that of the reference case, in a slot: at 0.9 mm it chatters at 6000 1/min.
DAMPING, SPINDLE = 0.011, Spindle(100.0, 80.0, 0.03)
OVERRIDES = (1.0, 0.8, 0.6)
SETTINGS = DetectorSettings(
    Windowing(RATE, LENGTH, LENGTH),
    (150.0, 2100.0),
    averaged_threshold=None,
    engagement=EngagementRule(1.3, 1.15),
)


def plant(regeneration="several", frequency=700.0):
    modes = Modes(frequency, DAMPING, 0.05)
    return Plant(
        modes,
        Tool(2, imbalance=2e-6),
        Cut(0.0, np.pi, 1e-4),
        CuttingCoefficients(6e8, 2e8),
        step=SAMPLING.step,
        slowest=55.0,
        fastest=105.0,
        sensors=Sensors([[1.0]], np.zeros((0, 1))),
        noise=ProcessNoise(5e-4, 0.005),
        regeneration=regeneration,
    )


def process(rotation):
    """Damping of a process that brakes the more the slower it is."""
    return np.array([DAMPING + 0.06 * (100.0 / rotation - 1.0) / 0.25])


class AtOnce:
    """Down to 60 % with the first window."""

    def start(self):
        return None

    def decide(self, state, seen):
        return state, Decision(0.6, "down.")


@pytest.fixture(scope="module")
def air():
    return air_baselines(plant(), SAMPLING, SETTINGS.windowing, SPINDLE, OVERRIDES, 25, 5)


@pytest.fixture(scope="module")
def trials(air):
    def one(policy, depth=0.9e-3, **rest):
        loop = Loop(SETTINGS, air, SPINDLE, policy)
        return Trial(plant(), loop, depth, 1.2, 3, air=0.2, **rest)

    return {
        "chatter": one(Hold()),
        "stable": one(Hold(), 0.05e-3),
        "at once": one(AtOnce(), 0.05e-3),
        "loop": one(FixedSteps(OVERRIDES), damping=process),
        "no loop": one(Hold(), damping=process),
    }


@pytest.fixture(scope="module")
def runs(trials):
    found = closed_loops(list(trials.values()), SAMPLING, LENGTH)
    return dict(zip(trials, found, strict=True))


def test_air_is_that_of_the_overrides(air):
    for override, each in air.items():
        assert each.rotation == pytest.approx(100.0 * override)
        assert each.baseline.count == 25 and each.windowing == SETTINGS.windowing


def test_without_a_change_no_time_is_lost(runs):
    for name in ("chatter", "stable", "no loop"):
        assert runs[name].changes == 0
        assert runs[name].time_lost == pytest.approx(0.0, abs=SAMPLING.step)
        assert set(runs[name].override) == {1.0}


def test_time_lost_of_a_change_in_closed_form(runs):
    # The first window ends within the second block, in the air; the speed then falls by 40 rev/s.
    found = runs["at once"]
    assert found.changes == 1
    block = LENGTH / RATE
    change = next(r.time for r in found.log if r.decision)
    begin = np.ceil(change / block - 1e-9) * block
    ramp = 40.0 / 80.0
    # Of the ramp only what lies in the cut, from 0.2 s on, is work.
    passed = 0.2 - begin
    worked = ramp - passed - 0.5 * 80.0 / 100.0 * (ramp**2 - passed**2)
    expected = (ramp - passed) + (1.2 - worked) / 0.6 - 1.2
    assert 0.0 < passed < ramp
    assert found.time_lost == pytest.approx(expected, abs=3.0 * SAMPLING.step)


def test_speed_keeps_to_the_limit_of_its_acceleration(runs):
    speed = runs["at once"].rotation
    assert speed[-1] == pytest.approx(60.0)
    assert np.max(np.abs(np.diff(speed))) <= 80.0 * LENGTH / RATE * (1.0 + 1e-9)


def test_chatter_energy_tells_chatter_from_forced_vibration(runs):
    assert runs["chatter"].energy > 1e3 * runs["stable"].energy > 0.0
    # The sum over the blocks, but for what of the cut's last block is beyond its end.
    found = runs["chatter"]
    each = np.diff(found.time, prepend=found.time[0] - LENGTH / RATE)
    assert np.sum(found.vibration**2 * each) == pytest.approx(found.energy, rel=0.1)
    assert {r.outcome for r in found.log if r.time > 0.6} == {"chatter"}
    assert "chatter" not in {r.outcome for r in runs["stable"].log}


def test_forced_vibration_alone_has_no_chatter_energy(air):
    loop = Loop(SETTINGS, air, SPINDLE, Hold())
    forced = Trial(plant("none"), loop, 0.9e-3, 0.3, 3)
    assert closed_loops([forced], SAMPLING, LENGTH)[0].energy == 0.0


def test_what_comes_of_a_trial_does_not_depend_on_the_others(trials, runs):
    alone = closed_loops([trials["loop"]], SAMPLING, LENGTH)[0]
    beside = runs["loop"]
    # Chaos of the tool leaving the cut magnifies rounding, so that only the beginning is compared.
    first = beside.time < 0.45
    np.testing.assert_allclose(
        alone.vibration[: first.sum()], beside.vibration[first], rtol=1e-4, atol=1e-12
    )
    assert alone.override.tolist() == beside.override.tolist()


def test_the_loop_ends_the_chatter_where_slower_is_better(runs):
    with_loop, without = runs["loop"], runs["no loop"]
    assert 1 <= with_loop.changes <= 2 and with_loop.events
    late = with_loop.time > with_loop.time[-1] - 0.3
    assert with_loop.vibration[late].max() < 0.1 * without.vibration[-4:].min()
    assert with_loop.energy < without.energy
    assert with_loop.time_lost > 0.1


def test_the_summary_names_every_policy(runs):
    two = {
        "none": [runs["no loop"], runs["chatter"]],
        "steps": [runs["loop"], runs["chatter"]],
    }
    text = summary(two, "none")
    assert [line.split()[0] for line in text.splitlines()] == ["policy", "none", "steps"]
    less = 0.5 * np.log10(runs["loop"].energy / runs["no loop"].energy)
    assert f"{less:+.3f}" in text.splitlines()[2]


def test_plants_that_do_not_go_together_are_refused(trials):
    first = trials["chatter"]
    other = replace(first, plant=replace_regeneration(first.plant, "last"))
    with pytest.raises(InputError, match="plants that run side by side"):
        closed_loops([first, other], SAMPLING)
    with pytest.raises(InputError, match="no trial is given"):
        closed_loops([], SAMPLING)


def test_rates_must_agree(trials, air):
    with pytest.raises(
        InputError, match="the detector is for 6400 Hz, but the sampling is of 3200"
    ):
        closed_loops([trials["chatter"]], Sampling(3200.0, 4))
    with pytest.raises(InputError, match="the windows are of 3200 Hz"):
        air_baselines(plant(), SAMPLING, Windowing(3200.0, LENGTH), SPINDLE, (1.0,))


@pytest.mark.parametrize("wrong", ["depth", "work", "air", "entry"])
def test_a_trial_needs_positive_numbers(trials, wrong):
    with pytest.raises(InputError, match=f"{wrong} of a trial is 0"):
        replace(trials["chatter"], **{wrong: 0.0})


def test_frequency_of_the_events_is_near_the_mode(runs):
    assert all(650.0 < e.frequency_hz < 1500.0 for e in runs["chatter"].events)
