"""Picture of an electrode's profile, the path of the wire and how far its steps are off."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, two_panels
from procmodel.electrode.profile import Profile
from procmodel.electrode.profile_steps import deviations, interpolate_profile, normals

# Steps drawn: more cannot be told apart.
_DRAWN = 6000
# Share of the picture's width that the greatest deviation shall take.
_VISIBLE = 0.06


def draw_wire_path(
    profile: Profile, path: Profile, step: float, resolution: float | None, reach: float
) -> Figure:
    """Profile and path with the deviation magnified, and the deviation along the way.

    Parameters
    ----------
    profile : Profile
        The wanted electrode.
    path : Profile
        Path of the wire's centre.
    step : float [um]
        Step of the interpolation.
    resolution : float or None [um]
        Resolution of the axes.
    reach : float [um]
        Wire radius and gap together.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    points, piece = interpolate_profile(path, step, resolution)
    exact, _ = interpolate_profile(path, step)
    at_points, at_middles = deviations(path, points, piece)
    figure, (section, along) = two_panels()
    _draw_section(section, profile, step)
    section.plot(*exact[_some(len(exact))].T, color=GREY, lw=0.9, label="centre of the wire")
    factor = _magnification(float(np.max(np.abs(at_points))), float(np.max(exact[:, 0])))
    chosen = _some(len(exact), at_points)
    shifted = exact + factor * at_points[:, None] * normals(path, exact, piece)
    section.plot(
        *shifted[chosen].T, color=ORANGE, lw=0.8, label=f"its steps, deviation × {factor:g}"
    )
    if reach > 0.0:
        angles = np.linspace(0.0, 2.0 * math.pi, 181)
        round_wire = reach * np.column_stack([np.cos(angles), np.sin(angles)])
        section.plot(*(exact[0] + round_wire).T, color=GREEN, lw=0.9, label="wire and gap")
    section.set_aspect("equal")
    section.set_xlabel("x [µm]")
    section.set_ylabel("z [µm]")
    section.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(exact, axis=0).T))])
    middle = 0.5 * (way[1:] + way[:-1])
    for place, off, colour, label in (
        (way, at_points, ORANGE, "at the positions"),
        (middle, at_middles, BLUE, "between them"),
    ):
        shown = _some(len(place), off)
        along.plot(place[shown], 1e3 * off[shown], ".", color=colour, ms=1.5, label=label)
    along.set_xlabel("way along the path [µm]")
    along.set_ylabel("deviation [nm]")
    along.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return figure


def _draw_section(axes: Axes, profile: Profile, step: float) -> None:
    outline, _ = interpolate_profile(profile, step)
    outline = outline[_some(len(outline))]
    mirrored = outline[::-1] * [-1.0, 1.0]
    axes.fill(*np.concatenate([outline, mirrored]).T, color="0.88", label="electrode")
    axes.plot(*outline.T, color="0.3", lw=1.2)


def _magnification(greatest: float, width: float) -> float:
    """A round factor that makes the greatest deviation visible."""
    if greatest < 1e-9:
        return 1.0
    wanted = _VISIBLE * width / greatest
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, power * max(f for f in (1.0, 2.0, 5.0) if f * power <= wanted))


def _some(count: int, values: np.ndarray | None = None) -> np.ndarray:
    """Numbers of the positions to draw: evenly, and the extremes between them."""
    if count <= _DRAWN:
        return np.arange(count)
    blocks = np.array_split(np.arange(count), _DRAWN // 3)
    chosen = [[b[0]] for b in blocks] if values is None else [
        [b[0], b[np.argmin(values[b])], b[np.argmax(values[b])]] for b in blocks
    ]  # fmt: skip
    return np.unique(np.concatenate([*chosen, [count - 1]]))
