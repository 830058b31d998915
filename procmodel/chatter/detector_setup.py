"""What a detector is made of: checked settings, baselines that fit, masks for the stream."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from procmodel.chatter import subharmonic
from procmodel.chatter.baseline import AirCut
from procmodel.chatter.engagement_state import EngagementRule, require_rule
from procmodel.chatter.mask import free_bins, in_band, listed_lines, mains_lines
from procmodel.chatter.rotation import Rotation, refined_rotation
from procmodel.chatter.scoring import Scorer, scorer_for
from procmodel.chatter.spectrum import Windowing
from procmodel.chatter.subharmonic import CuttingReference, Lines
from procmodel.errors import InputError


@dataclass(frozen=True)
class DetectorSettings:
    """What is searched for, and when the detector speaks.

    Attributes
    ----------
    windowing : Windowing
        How the record is cut into windows.
    band : tuple of float [Hz]
        Lowest and highest frequency of the search.
    threshold : float
        Of the distance.
    votes, of : int
        Chatter when the threshold is exceeded in at least so many of so many windows.
    averaged : int
        Spectra averaged for the second rule.
    averaged_threshold : float or None
        Of the distance of the averaged spectrum; None leaves the rule out.
    margin : float
        Fraction of a threshold from which on a cut is marginal, 0 to 1.
    teeth : int or None
        Teeth of the tool, for the search for period doubling; None leaves it out.
    subharmonic_threshold : float
        Power of a line of period doubling over what a stable cut explains.
    reference_windows : int
        First windows of a cut taken for stable, at least 4, where no stable cut is given.
    line_width : float [bins]
        Half width of a forced line; the main lobe of the Hann taper is 2 bins to either side. A
        window so short that lines would take more than a third of the band has them cut down to
        that, and then strong ones show beside their mask.
    slip : float
        What the rotation may differ by between air and cut, as a fraction.
    ignored : tuple of float [Hz]
        Lines of the machine that mean nothing.
    mains : float or None [Hz]
        Mains frequency, whose multiples are left out.
    mask : bool
        Whether the multiples of the rotation are left out; without it forced lines give alarms.
    engagement : EngagementRule
        When the tool counts as cutting.
    entry_votes : bool
        Whether windows of the entry count among the votes, though nothing is said before the cut.
    growth_windows : int
        Windows over which the growth rate is taken, at least 3.
    again : float
        An event is repeated when the statistic has grown by this factor since the last, > 1.
    report_marginal : bool
        Whether a cut that becomes marginal makes an event.
    stuck : int or None
        Equal samples in a row from which on a sensor counts as stuck; None for an eighth of the
        window.
    limit : float or None [unit]
        Range of the sensor, at which it clips; without it flat tops tell.

    Raises
    ------
    InputError
        If one of them is out of its range.
    """

    windowing: Windowing
    band: tuple[float, float] = (0.0, math.inf)
    threshold: float = 100.0
    votes: int = 2
    of: int = 5
    averaged: int = 5
    averaged_threshold: float | None = 50.0
    margin: float = 0.5
    teeth: int | None = None
    subharmonic_threshold: float = 10.0
    reference_windows: int = 8
    line_width: float = 2.0
    slip: float = 0.001
    ignored: tuple[float, ...] = ()
    mains: float | None = None
    mask: bool = True
    engagement: EngagementRule = field(default_factory=EngagementRule)
    entry_votes: bool = True
    growth_windows: int = 8
    again: float = 10.0
    report_marginal: bool = False
    stuck: int | None = None
    limit: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.band[0] < self.band[1]:
            raise InputError(
                f"the band is {self.band[0]:g} to {self.band[1]:g} Hz, but must rise from 0 or "
                "more."
            )
        positive = {
            "threshold": self.threshold,
            "threshold of the averaged spectrum": self.averaged_threshold,
            "threshold of period doubling": self.subharmonic_threshold,
            "width of a line": self.line_width,
            "mains frequency": self.mains,
            "range of the sensor": self.limit,
        }
        for name, value in positive.items():
            if value is not None and not value > 0.0:
                raise InputError(f"the {name} is {value:g}, but must be positive.")
        if not 1 <= self.votes <= self.of:
            raise InputError(
                f"chatter takes {self.votes} of {self.of} windows, but must take at least 1 and "
                "not more than there are."
            )
        least = {
            "averaged spectra": (self.averaged, 1),
            "reference windows": (self.reference_windows, 4),
            "windows of the growth rate": (self.growth_windows, 3),
            "teeth": (self.teeth, 1),
            "equal samples of a stuck sensor": (self.stuck, 2),
        }
        for name, (number, few) in least.items():
            if number is not None and number < few:
                raise InputError(f"the number of {name} is {number}, but must be at least {few}.")
        if not 0.0 < self.margin <= 1.0:
            raise InputError(f"the margin is {self.margin:g}, but must be above 0 and at most 1.")
        if not 0.0 <= self.slip < 0.1:
            raise InputError(f"the slip is {self.slip:g}, but must be from 0 to 0.1.")
        if not self.again > 1.0:
            raise InputError(f"an event is repeated after growing {self.again:g} times; take > 1.")
        require_rule(self.engagement)


class Doubling(NamedTuple):
    """The lines of period doubling.

    Attributes
    ----------
    half, tooth : Lines
        At odd multiples of half the tooth-passing frequency, and at its multiples; bins of the
        band.
    floor : ndarray, shape (c, l)
        Raw power of the first in air.
    stable : CuttingReference or None
        Raw powers in a stable cut, if one is given.
    """

    half: Lines
    tooth: Lines
    floor: np.ndarray
    stable: CuttingReference | None


@dataclass(frozen=True)
class Detector:
    """Settings and baseline, ready for the stream.

    Attributes
    ----------
    settings : DetectorSettings
        What is searched for.
    channels : tuple of str
        Names of the channels.
    rotation : Rotation
        Rotation of the spindle, refined.
    free : ndarray, shape (bins,) of bool
        Bins in which chatter is searched for.
    scorer : Scorer
        Distances on them.
    air : ndarray, shape (c, bins of the band)
        Raw power of air cutting.
    doubling : Doubling or None
        Lines of period doubling; None if the teeth are not given or no such line is in the band.
    stuck : int
        Equal samples in a row from which on a sensor counts as stuck.
    """

    settings: DetectorSettings
    channels: tuple[str, ...]
    rotation: Rotation
    free: np.ndarray
    scorer: Scorer
    air: np.ndarray
    doubling: Doubling | None
    stuck: int


def require_matching(
    baseline: AirCut,
    windowing: Windowing,
    *,
    rotation: float | None = None,
    channels: Sequence[str] | None = None,
    tolerance: float = 0.02,
) -> None:
    """Refuse a baseline that was made under other conditions.

    Parameters
    ----------
    baseline : AirCut
        Air cutting.
    windowing : Windowing
        Of the record; the hop may differ.
    rotation : float, optional [Hz]
        Rotation frequency of the record.
    channels : sequence of str, optional
        Channels of the record.
    tolerance : float
        Largest difference of the rotations, as a fraction.

    Raises
    ------
    InputError
        If rate, window length, taper, rotation or channels differ, which is named.
    """
    made = baseline.windowing
    again = "; record air cutting again under the conditions of the cut, or take its baseline."
    if not math.isclose(made.rate, windowing.rate, rel_tol=1e-6):
        raise InputError(
            f"the baseline was made at the rate {made.rate:g} Hz, the record has "
            f"{windowing.rate:g} Hz{again}"
        )
    if made.length != windowing.length:
        raise InputError(
            f"the baseline was made with the window length {made.length}, not "
            f"{windowing.length}; take that length or make the baseline again."
        )
    if made.taper != windowing.taper:
        raise InputError(
            f"the baseline was made with the taper {made.taper!r}, not {windowing.taper!r}; "
            "take that taper or make the baseline again."
        )
    if rotation is not None and abs(rotation / baseline.rotation - 1.0) > tolerance:
        raise InputError(
            f"the baseline was made at the spindle speed {60.0 * baseline.rotation:g} 1/min, the "
            f"record has {60.0 * rotation:g} 1/min{again}"
        )
    if channels is not None and len(channels) != len(baseline.channels):
        raise InputError(
            f"the baseline has {len(baseline.channels)} channels "
            f"({', '.join(baseline.channels)}), the record has {len(channels)} "
            f"({', '.join(channels)}); choose the same channels."
        )
    if channels is not None and tuple(channels) != baseline.channels:
        raise InputError(
            f"the baseline is of the channels {', '.join(baseline.channels)}, the record of "
            f"{', '.join(channels)}; choose the same channels in the same order."
        )


def prepare(
    settings: DetectorSettings,
    baseline: AirCut,
    rotation: Rotation | None = None,
    *,
    stable: AirCut | None = None,
) -> Detector:
    """A detector for one spindle speed.

    Parameters
    ----------
    settings : DetectorSettings
        What is searched for.
    baseline : AirCut
        Air cutting at that speed.
    rotation : Rotation, optional
        Its rotation; by default refined from the baseline's own lines.
    stable : AirCut, optional
        Moments of a stable cut at that speed, against which period doubling is told; by default
        the first windows of every cut are taken for stable.

    Returns
    -------
    Detector
        Ready for `detector.step`.

    Raises
    ------
    InputError
        If a baseline was made under other conditions, or no bin is free for the search.
    """
    windowing = settings.windowing
    require_matching(baseline, windowing)
    if stable is not None:
        require_matching(stable, windowing, rotation=baseline.rotation, channels=baseline.channels)
    if rotation is None:
        mean = np.asarray(baseline.baseline.mean)
        rotation = refined_rotation(mean, windowing, baseline.rotation)
    else:
        require_matching(baseline, windowing, rotation=rotation.frequency)
    frequencies = windowing.frequencies
    half_width = min(settings.line_width * windowing.resolution, rotation.frequency / 6.0)
    uncertainty = rotation.uncertainty + settings.slip * rotation.frequency
    band = (settings.band[0], min(settings.band[1], 0.5 * windowing.rate))
    # Without the mask only the constant part is left out: no order lies below twice the rate.
    free = free_bins(
        frequencies,
        band,
        rotation.frequency if settings.mask else 2.0 * windowing.rate,
        half_width,
        uncertainty=uncertainty,
        ignored=settings.ignored,
        mains=settings.mains,
    )
    lines = list(settings.ignored)
    lines += [] if settings.mains is None else list(mains_lines(settings.mains, band[1]))
    counted = in_band(frequencies, *band) & ~listed_lines(frequencies, lines, half_width)
    counted &= frequencies > half_width
    scorer = scorer_for(baseline, free, counted)
    inner = slice(scorer.low, scorer.low + scorer.bins)
    air = np.asarray(baseline.baseline.mean)[:, inner] / scorer.scale
    doubling = None
    if settings.teeth is not None:
        doubling = _doubling(settings, rotation, uncertainty, counted[inner], scorer, air, stable)
    stuck = settings.stuck or max(16, windowing.length // 8)
    return Detector(settings, baseline.channels, rotation, free, scorer, air, doubling, stuck)


def _doubling(
    settings: DetectorSettings,
    rotation: Rotation,
    uncertainty: float,
    usable: np.ndarray,
    scorer: Scorer,
    air: np.ndarray,
    stable: AirCut | None,
) -> Doubling | None:
    """The lines of period doubling in the band of a scorer."""
    windowing, teeth = settings.windowing, settings.teeth or 1
    inner = slice(scorer.low, scorer.low + scorer.bins)
    frequencies = windowing.frequencies[inner]
    # Half of it, so that a line holds its main lobe and not the feet, which are noise.
    width = max(1.0, 0.5 * settings.line_width) * windowing.resolution
    ends, off = (frequencies[0], frequencies[-1]), uncertainty / rotation.frequency
    half = subharmonic.half_tooth_frequencies(rotation.frequency, teeth, *ends)
    tooth = subharmonic.tooth_frequencies(rotation.frequency, teeth, *ends)
    half_lines = subharmonic.lines_in(frequencies, half, width, off, usable)
    tooth_lines = subharmonic.lines_in(frequencies, tooth, width, off, usable)
    if not len(half_lines.frequencies):
        return None
    reference = None
    if stable is not None:
        raw = np.asarray(stable.baseline.mean)[:, inner] / scorer.scale
        reference = CuttingReference(
            int(stable.baseline.count),
            subharmonic.line_powers(raw, half_lines, np),
            subharmonic.line_powers(raw, tooth_lines, np).sum(axis=-1),
        )
    return Doubling(
        half_lines, tooth_lines, subharmonic.line_powers(air, half_lines, np), reference
    )
