"""The paper's detector on a measured cut, from the file to the alarm."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.chatter import (
    AIR,
    CHATTER,
    DetectorSettings,
    Event,
    Observation,
    Windowing,
    air_cut,
    detect,
    prepare,
)
from procmodel.io.records import read_record

DATA = Path(os.environ.get("PROCMODEL_DATA", Path(__file__).parents[3] / "shared" / "data"))
FILE = DATA / "milling_chatter" / "data.mat"
# As the data's own description has it: 5000 1/min; every value stands twice, so that only the band
# below a quarter of the rate is measured; air until 3.4 s.
RATE, ROTATION, BAND, QUIET = 10000.0, 5000.0 / 60.0, (0.0, 2400.0), (0.5, 3.0)
LENGTH, THRESHOLD = 2048, 100.0
# In the air before the cut and after it, windows that began in it included.
_BEFORE, _AFTER = 3.6, 5.6


@dataclass(frozen=True)
class Recording:
    """What the detector made of the measured cut.

    Attributes
    ----------
    observations : tuple of Observation
        One for each window.
    events : tuple of Event
        What was said.
    """

    observations: tuple[Observation, ...]
    events: tuple[Event, ...]

    @property
    def first_alarm(self) -> float:
        """When chatter is known [s]."""
        return next(e.time_s for e in self.events if e.state == CHATTER)

    @property
    def frequency(self) -> float:
        """Of the windows in full chatter, median [Hz]."""
        full = [o.frequency for o in self.observations if 4.4 < o.time < 4.95]
        return float(np.median(full))

    @property
    def windows_in_air_judged(self) -> int:
        """Windows in the air before and after the cut that were not taken for air."""
        outside = [o for o in self.observations if o.time < _BEFORE or o.time > _AFTER + 0.2]
        return sum(o.engagement != AIR for o in outside)


def detected() -> Recording | None:
    """The detector over the measured cut.

    Returns
    -------
    Recording or None
        None if the file is not there; the environment variable PROCMODEL_DATA names its folder.
    """
    if not FILE.is_file():
        return None
    record = read_record(FILE, rate=RATE)
    windowing = Windowing(RATE, LENGTH)
    first, last = (round(t * RATE) for t in QUIET)
    quiet = air_cut(record.samples[first:last], windowing, ROTATION, record.channels)
    settings = DetectorSettings(
        windowing, BAND, threshold=THRESHOLD, averaged_threshold=None, teeth=None
    )
    found = detect(prepare(settings, quiet), record.samples)
    return Recording(found.observations, found.events)
