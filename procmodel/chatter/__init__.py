"""Chatter: spectra, their distance from air cutting, and the detector that follows a recording.

Laws in `spectrum`, `baseline`, `rotation`, `mask`, `distance`, `engagement_state` and
`subharmonic`; `scoring` does the same at speed for whole records; `detector` puts them together,
with its settings in `detector_setup`, its rules in `detector_rules`, its state in `detector_state`.

SI units: frequencies in Hz, the spindle speed as rotation frequency in Hz.
"""

from procmodel.chatter.baseline import AirCut, Baseline, air_cut, deviation, merged, updated
from procmodel.chatter.detector import detect, observed, restarted, scores, start, step
from procmodel.chatter.detector_rules import (
    CHATTER,
    FAULTS,
    MARGINAL,
    OUTCOMES,
    STABLE,
    BadWindows,
    growth_rate,
)
from procmodel.chatter.detector_setup import Detector, DetectorSettings, prepare, require_matching
from procmodel.chatter.detector_state import Detection, DetectorState, Event, Observation
from procmodel.chatter.distance import distance, null_threshold, score, soft_score
from procmodel.chatter.engagement_state import (
    AIR,
    CUTTING,
    ENTRY,
    EXIT,
    Engagement,
    EngagementRule,
    engaged,
    level,
)
from procmodel.chatter.mask import free_bins, soft_band
from procmodel.chatter.rotation import Rotation, refined_rotation, rotation_of
from procmodel.chatter.scoring import Scores
from procmodel.chatter.spectrum import (
    Windowing,
    averaged,
    frequencies,
    power_spectra,
    taper,
    windows_of,
)

__all__ = [
    "AIR",
    "CHATTER",
    "CUTTING",
    "ENTRY",
    "EXIT",
    "FAULTS",
    "MARGINAL",
    "OUTCOMES",
    "STABLE",
    "AirCut",
    "BadWindows",
    "Baseline",
    "Detection",
    "Detector",
    "DetectorSettings",
    "DetectorState",
    "Engagement",
    "EngagementRule",
    "Event",
    "Observation",
    "Rotation",
    "Scores",
    "Windowing",
    "air_cut",
    "averaged",
    "detect",
    "deviation",
    "distance",
    "engaged",
    "free_bins",
    "frequencies",
    "growth_rate",
    "level",
    "merged",
    "null_threshold",
    "observed",
    "power_spectra",
    "prepare",
    "refined_rotation",
    "require_matching",
    "restarted",
    "rotation_of",
    "score",
    "scores",
    "soft_band",
    "soft_score",
    "start",
    "step",
    "taper",
    "updated",
    "windows_of",
]
