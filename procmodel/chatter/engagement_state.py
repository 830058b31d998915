"""Whether the tool cuts, from the signal itself: air, entry, cutting, exit.

The level of a window is the mean over the band of its power over that of air cutting. It is 1 in
air (n / (n - 1) of noise with a baseline of n spectra) and rises with the cut, forced lines and
all. Two levels and a hold keep the state from chattering itself.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from procmodel.errors import InputError

AIR, ENTRY, CUTTING, EXIT = "air", "entry", "cutting", "exit"

STATES = {
    AIR: "air: the level is that of air cutting",
    ENTRY: "entry: the level has risen, and the cut is not yet whole",
    CUTTING: "cutting: the level is that of a cut",
    EXIT: "exit: the level has fallen, and may rise again",
}


class Engagement(NamedTuple):
    """State of engagement.

    Attributes
    ----------
    name : str
        Key into `STATES`.
    windows : int
        How many windows it has held.
    """

    name: str = AIR
    windows: int = 0


class EngagementRule(NamedTuple):
    """When the state changes.

    Attributes
    ----------
    enter : float
        Level from which on the tool cuts.
    leave : float
        Level below which it does not, at most `enter`.
    entry_windows : int
        Windows of entry before the cut counts as whole.
    exit_windows : int
        Windows below `leave` before it counts as air.
    """

    enter: float = 2.0
    leave: float = 1.5
    entry_windows: int = 1
    exit_windows: int = 2


def require_rule(rule: EngagementRule) -> None:
    """Refuse a rule that cannot work.

    Parameters
    ----------
    rule : EngagementRule
        What is to be checked.

    Raises
    ------
    InputError
        If the levels are not 0 < leave <= enter, or a number of windows is negative.
    """
    if not 0.0 < rule.leave <= rule.enter:
        raise InputError(
            f"the tool enters at the level {rule.enter:g} and leaves at {rule.leave:g}, but the "
            "second must be positive and not above the first."
        )
    if min(rule.entry_windows, rule.exit_windows) < 0:
        raise InputError("the windows of entry and exit cannot be fewer than 0.")


def level(spectrum: Any, mean: Any, counted: Any, xp: Any = jnp) -> Any:
    """Power over that of air cutting.

    Parameters
    ----------
    spectrum : array, shape (..., c, bins) [unit^2]
        Power of windows.
    mean : array, shape (c, bins) [unit^2]
        Mean power of air cutting.
    counted : array, shape (bins,) or (c, bins) of bool
        Bins that count, one at least.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (...)
        Mean of X / a over channels and bins that count and whose a is not 0.
    """
    alive = counted & (mean > 0.0)
    ratio = xp.where(alive, spectrum / xp.where(alive, mean, 1.0), 0.0)
    return xp.sum(ratio, axis=(-2, -1)) / xp.sum(alive)


def engaged(state: Engagement, level: float, rule: EngagementRule) -> Engagement:
    """State of engagement after one more window.

    Parameters
    ----------
    state : Engagement
        Before the window.
    level : float
        Of the window.
    rule : EngagementRule
        When the state changes.

    Returns
    -------
    Engagement
        After it.
    """
    name = state.name
    if name == AIR:
        rises = level >= rule.enter
        after = (ENTRY if rule.entry_windows else CUTTING) if rises else AIR
    elif name == ENTRY:
        whole = state.windows >= rule.entry_windows
        after = AIR if level < rule.leave else CUTTING if whole else ENTRY
    elif name == CUTTING:
        after = CUTTING if level >= rule.leave else EXIT if rule.exit_windows else AIR
    elif level >= rule.enter:
        after = CUTTING
    else:
        gone = level < rule.leave and state.windows >= rule.exit_windows
        after = AIR if gone else EXIT
    if after != name:
        return Engagement(after, 1)
    return Engagement(name, state.windows + 1)
