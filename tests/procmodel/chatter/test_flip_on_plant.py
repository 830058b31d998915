"""Period doubling of the plant: hidden from the distance, found by the second statistic.

The reference case at 12,500 1/min, whose slot is stable up to 2.71 mm and doubles its period above,
with runout on the same lines; the chip is that of the last pass, for which the line stands exactly
on a multiple of the rotation.
"""

import numpy as np
import pytest

from procmodel.chatter import DetectorSettings, Windowing, air_cut, detect, prepare
from procmodel.chatter.cutting import Tool
from procmodel.chatter.dynamics import Plant
from procmodel.chatter.recording import Schedule, labelled_recording
from procmodel.chatter.sampling import Sampling
from tests.procmodel.chatter.shapes_plant import COEFFICIENTS, FLIP_SPEED, MODE, SLOT

RATE, LENGTH = 12800.0, 4096
AIR, DEEPENS, DEEPER, END = 1.5, 3.6, 4.1, 5.6
# Runout between the two teeth [m], and the noise of the sensor [m].
RUNOUT, NOISE = 3e-6, 1e-6
SAMPLING = Sampling(RATE, 4, displacement_noise=NOISE)
WINDOWING = Windowing(RATE, LENGTH, LENGTH // 2)
PLANT = Plant(
    MODE, Tool(2, runout=np.array([0.0, RUNOUT])), SLOT, COEFFICIENTS,
    step=SAMPLING.step, slowest=FLIP_SPEED, fastest=FLIP_SPEED, regeneration="last",
)  # fmt: skip

pytestmark = pytest.mark.slow


def recorded(deeper):
    """Air, then 2.0 mm, then deeper [m]."""
    times = np.array([0.0, AIR, AIR + 0.5, DEEPENS, DEEPER, END])
    depth = np.array([0.0, 0.0, 2e-3, 2e-3, deeper, deeper])
    return labelled_recording(PLANT, Schedule(times, np.full(6, FLIP_SPEED), depth), SAMPLING, 5)


@pytest.fixture(scope="module")
def doubling():
    return recorded(3.0e-3)


def found(recording, teeth):
    # Lines 85 dB above the noise show beyond the main lobe of the taper: a wide mask.
    # The paper's rule alone: for one window the onset itself spreads the lines past the mask, which
    # 2 of 5 pass over and an averaged spectrum would not.
    settings = DetectorSettings(
        WINDOWING, (200.0, 5000.0), averaged_threshold=None, teeth=teeth, line_width=8.0
    )
    samples = recording.samples[:, :1]
    baseline = air_cut(samples[: round((AIR - 0.1) * RATE)], WINDOWING, FLIP_SPEED)
    return detect(prepare(settings, baseline), samples)


def test_the_plant_doubles_its_period(doubling):
    assert doubling.truth.label == "chatter"
    assert doubling.truth.stability.multiplier.real < -1.1
    assert doubling.truth.chatter_frequency == pytest.approx(5.0 * FLIP_SPEED)
    # Every second tooth passes at another place: the same, turned over, after one tooth.
    chatters = doubling.samples[round((DEEPER + 0.5) * RATE) :, 0]
    power = np.abs(np.fft.rfft((chatters - chatters.mean()) * np.hanning(len(chatters))))
    frequency = np.arange(len(power)) * RATE / len(chatters)
    odd = np.abs(frequency / FLIP_SPEED % 2.0 - 1.0) < 0.1
    highest = frequency[odd][np.argmax(power[odd])]
    assert highest == pytest.approx(5.0 * FLIP_SPEED, abs=2.0 * RATE / len(chatters))


def test_the_distance_misses_it(doubling):
    without = found(doubling, None)
    assert without.events == ()
    deeper = [o.score for o in without.observations if o.time > DEEPER + LENGTH / RATE]
    assert max(deeper) < 50.0


def test_the_second_statistic_catches_it(doubling):
    (event,) = found(doubling, 2).events
    assert (event.statistic, event.state) == ("subharmonic", "chatter")
    assert DEEPENS < event.time_s < DEEPER + 2 * LENGTH / RATE
    odd = event.frequency_hz / FLIP_SPEED
    assert odd == pytest.approx(round(odd)) and round(odd) % 2 == 1
    assert event.growth_rate > 0.0


def test_runout_in_a_deeper_stable_cut_is_not_taken_for_it():
    stable = recorded(2.3e-3)
    assert stable.truth.label == "stable"
    assert found(stable, 2).events == ()
