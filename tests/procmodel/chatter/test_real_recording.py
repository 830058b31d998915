"""The measured slot cut: when the detector speaks, at which frequency, and that air is silent."""

import numpy as np
import pytest
import scipy.io

from procmodel.chatter import CHATTER, DetectorSettings, Windowing, air_cut, detect, prepare, scores
from tests.measured import MILLING_CUT, needs

RATE, ROTATION, BAND = 10000.0, 5000.0 / 60.0, (0.0, 2400.0)

pytestmark = needs(MILLING_CUT)


@pytest.fixture(scope="module")
def record():
    return scipy.io.loadmat(MILLING_CUT)["data"].astype(float)


def made(record, length, kind):
    windowing = Windowing(RATE, length, None, kind)
    quiet = air_cut(record[round(0.5 * RATE) : round(3.0 * RATE)], windowing, ROTATION)
    return DetectorSettings(windowing, BAND, teeth=4), quiet


@pytest.mark.parametrize("kind", ["hann", "rectangular"])
@pytest.mark.parametrize("length", [1024, 2048, 4096])
def test_two_of_five_above_100(record, length, kind):
    settings, quiet = made(record, length, kind)
    found = detect(prepare(settings, quiet), record)
    assert 3.8 <= found.events[0].time_s <= 4.1
    assert found.events[0].state == CHATTER
    # The cut ends at 5.05 s; a window that began in it may still end later.
    assert all(3.8 <= e.time_s <= 5.05 + length / RATE for e in found.events)
    outside = [o for o in found.observations if o.time < 3.6 or o.time > 5.6 + length / RATE]
    assert len(outside) > 20
    assert {o.engagement for o in outside} == {"air"}
    assert max(o.score for o in outside) < 0.5 * settings.threshold
    assert sum(found.state.bad) == 0


@pytest.mark.parametrize("length", [1024, 2048, 4096])
def test_the_frequency_of_full_chatter(record, length):
    settings, quiet = made(record, length, "hann")
    found = scores(record, quiet, settings)
    full = (found.time - length / RATE > 4.2) & (found.time < 4.95)
    # A bin of the shortest window is 9.8 Hz wide; the line falls from 693 to 683.5 Hz.
    assert full.any()
    assert ((found.frequency[full] > 683.0) & (found.frequency[full] < 693.0)).all()
    events = detect(prepare(settings, quiet), record).events
    assert 683.0 < events[-1].frequency_hz < 693.0


def test_energy_above_the_true_bandwidth_is_an_image(record):
    # Every value stands twice, so that a line at f has its image at 5000 Hz - f.
    settings, quiet = made(record, 4096, "hann")
    wide = DetectorSettings(settings.windowing, (2600.0, 4900.0))
    low = scores(record, quiet, settings)
    high = scores(record, quiet, wide)
    full = (low.time > 4.7) & (low.time < 5.0)
    np.testing.assert_allclose(low.frequency[full] + high.frequency[full], 5000.0, atol=3.0)
