"""Windows of new cuts: the law that a posterior of scores gives them.

A new cut has its own level v about that of its tool and speed, and windows that scatter about v by
Student's t and follow each other; see `calibration.chatter_scores`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.special

from calibration.chatter_scores import ScorePosterior
from calibration.plans.alarm_rule import exceedance
from procmodel.chatter import STABLE
from procmodel.errors import InputError

# Draws that a plan works on, nodes over the level of a new cut, and speeds at most.
_DRAWS, _NODES, _SPEEDS = 300, 5, 6


@dataclass(frozen=True)
class WindowLaw:
    """Windows of new cuts of one label.

    Attributes
    ----------
    level : ndarray, shape (m, q)
        v, for every draw at nodes over new cuts.
    weight : ndarray, shape (q,)
        Of the nodes, of sum 1.
    spread, freedom, correlation : ndarray, shape (m, 1)
        s, nu, phi.
    """

    level: np.ndarray
    weight: np.ndarray
    spread: np.ndarray
    freedom: np.ndarray
    correlation: np.ndarray

    def above(self, threshold: np.ndarray) -> np.ndarray:
        """P(y > threshold) for every draw.

        Parameters
        ----------
        threshold : ndarray, shape (k,) or (m, k)
            Of y.

        Returns
        -------
        ndarray, shape (m, k)
            Over new cuts.
        """
        return self._mean_of(
            lambda far: scipy.special.stdtr(self.freedom, -far / self.spread), threshold
        )

    def density(self, y: np.ndarray) -> np.ndarray:
        """Density of y, shape (k,), averaged over draws."""
        nu, s = self.freedom, self.spread
        at_zero = scipy.special.gammaln(0.5 * (nu + 1.0)) - scipy.special.gammaln(0.5 * nu)
        at_zero = np.exp(at_zero) / (np.sqrt(nu * np.pi) * s)
        return self._mean_of(
            lambda far: at_zero * (1.0 + (far / s) ** 2 / nu) ** (-0.5 * (nu + 1.0)), y
        ).mean(axis=0)

    def together(self, threshold: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities p and r of `exceedance` at a threshold (or one a draw), shape (m, q)."""
        at = np.reshape(threshold, (-1, 1))
        return exceedance(at, self.level, self.spread, self.freedom, self.correlation)

    def thinned(self, draws: int) -> "WindowLaw":
        """The same on fewer draws."""
        step = max(1, len(self.level) // draws)
        parts = (self.spread, self.freedom, self.correlation)
        return WindowLaw(self.level[::step], self.weight, *(part[::step] for part in parts))

    def _mean_of(self, law: Any, y: np.ndarray) -> np.ndarray:
        y = np.broadcast_to(y, (len(self.level), np.shape(y)[-1]))
        pairs = zip(self.level.T, self.weight, strict=True)
        total = np.zeros(y.shape)
        for level, weight in pairs:
            total += weight * law(y - level[:, None])
        return total


def windows_in_common(posterior: ScorePosterior) -> tuple[float, float]:
    """Step and length of the windows of all cuts [s].

    Raises
    ------
    InputError
        If cuts differ in them.
    """
    first = posterior.cuts[0]
    for cut in posterior.cuts:
        if not np.allclose((cut.step, cut.length), (first.step, first.length), rtol=1e-6):
            raise InputError(
                f"{cut.name}: a window lasts {cut.length:g} s and the next begins {cut.step:g} s "
                f"later, but {first.length:g} and {first.step:g} s in {first.name}; score all cuts "
                "with the same windows."
            )
    return first.step, first.length


def window_law(
    posterior: ScorePosterior, label: str, tool: str | Sequence[str] | None, seed: int = 0
) -> WindowLaw:
    """Windows of new cuts of a tool, at the speeds at which it was seen.

    Parameters
    ----------
    posterior : ScorePosterior
        What is known.
    label : str
        "stable", "marginal" or "chatter".
    tool : str or sequence of str, optional
        One of its tools, or one of several at random; one that was never seen when left out.
    seed : int
        Of what is drawn for an unseen tool.

    Returns
    -------
    WindowLaw
        At some hundred draws.
    """
    count = len(posterior.levels)
    picked = np.unique(np.linspace(0, count - 1, min(count, _DRAWS)).round().astype(int))
    kind = "stable" if label == STABLE else "chatter"

    def drawn(name: str) -> np.ndarray:
        return posterior.draws(name)[picked, None]

    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    cut, shares = drawn(f"{kind}_cut_spread") * nodes, weights / weights.sum()
    tools: Sequence[str | None] = (tool,) if tool is None or isinstance(tool, str) else tool
    levels, weight = [], []
    for each in tools:
        seen = sorted({cut.spindle_speed for cut in posterior.learnt_from(None, each)})
        speeds: list[float | None] = list(seen) or [None]
        most = max(1, _SPEEDS // len(tools))
        chosen = np.unique(np.linspace(0, len(speeds) - 1, min(len(speeds), most)).round())
        for i in chosen:
            level = posterior.level(label, each, speeds[int(i)], seed)[picked]
            levels.append(level[:, None] + cut)
            weight.append(shares / (len(chosen) * len(tools)))
    return WindowLaw(
        level=np.concatenate(levels, axis=1),
        weight=np.concatenate(weight),
        spread=drawn(f"{kind}_spread"),
        freedom=drawn("freedom"),
        correlation=drawn(f"{kind}_correlation"),
    )
