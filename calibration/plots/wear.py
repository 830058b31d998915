"""Pictures of the wear process: a fitted wall, a predicted wall, a planned cavity.

Depth points downwards; lengths in um.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plans.schedule import Schedule
from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, two_panels
from calibration.result import student_quantile
from calibration.wear import CavityFit


def draw_fit(found: CavityFit) -> Figure:
    """Readings, fitted wall with its 95 % band, and residuals.

    Parameters
    ----------
    found : CavityFit
        From `calibration.wear.fit_cavity`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure, (wall, left) = two_panels()
    curve_x = np.linspace(found.position[0], found.position[-1], 600)
    curve = found.predict(curve_x)
    residuals = found.result.residuals["data"]
    noise = float(np.std(residuals))
    band = band_of(found, curve_x)
    wall.plot(found.position, found.depth, ".", color=GREY, ms=4, label="readings")
    wall.plot(curve_x, curve, color=BLUE, lw=1.8, label="fit")
    wall.fill_between(
        curve_x, curve - band, curve + band, color=BLUE, alpha=0.35, lw=0, label="95 % of the wall"
    )
    estimate = found.result.parameters["wear_ratio"]
    title = f"wear ratio {estimate.value:.4g}"
    if estimate.std is not None:
        title += f" ± {estimate.std:.2g}"
    wall.set_title(title + f"   ({found.result.problem.name})", fontsize=10, loc="left")
    _depth_axis(wall)
    left.axhline(0.0, color=GREY, lw=0.8)
    left.axhspan(-1.96 * noise, 1.96 * noise, color=GREY, alpha=0.15, lw=0)
    left.plot(found.position, residuals, ".", color=ORANGE, ms=4)
    left.set_ylabel("reading − fit [µm]")
    left.set_xlabel("x [µm]")
    return figure


def band_of(found: CavityFit, position: np.ndarray) -> np.ndarray:
    """Half width of the 95 % band of the fitted wall, by the delta method.

    Parameters
    ----------
    found : CavityFit
        The fit.
    position : ndarray, shape (m,) [um]
        Where.

    Returns
    -------
    ndarray, shape (m,) [um]
        Quantile times the standard deviation of the wall, on the directions that the data see.
    """
    result = found.result
    values = {name: p.value for name, p in result.parameters.items()}
    covariance = result.seen_covariance
    middle = found.predict(position)
    jacobian = np.zeros((len(position), len(result.free)))
    for i, name in enumerate(result.free):
        step = 1e-3 * float(np.sqrt(covariance[i, i]))
        if step > 0:
            moved = found.predict(position, values | {name: values[name] + step})
            jacobian[:, i] = (moved - middle) / step
    std = np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))
    freedom = np.inf if result.problem.noise_known else result.degrees_of_freedom
    return student_quantile(0.975, freedom) * std


def draw_prediction(walls: np.ndarray, depths: np.ndarray, feeds: np.ndarray) -> Figure:
    """Predicted wall, and the feed and wear of every layer.

    Parameters
    ----------
    walls, depths : ndarray, shape (n,) [um]
        Distance of the wall from the centre, and depth, of every layer.
    feeds : ndarray, shape (n,) [um]
        Feed of every layer.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure, (wall, layers) = two_panels()
    _draw_wall(wall, walls, depths, BLUE, "predicted wall")
    wall.set_title(f"{len(depths)} layers, {depths[-1]:.1f} µm deep", fontsize=10, loc="left")
    _depth_axis(wall)
    wall.set_xlabel("x [µm]")
    _draw_feeds(layers, feeds, feeds - np.diff(depths, prepend=0.0), "")
    return figure


def draw_plan(stages: Sequence[Schedule]) -> Figure:
    """Wanted and expected wall with its 95 % range, and the feed of every layer.

    Parameters
    ----------
    stages : sequence of Schedule
        Roughing, and finishing if there is one.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure, (wall, layers) = two_panels()
    for schedule, colour, name in zip(
        stages, (BLUE, ORANGE), ("roughing", "finishing"), strict=False
    ):
        prefix = f"{name}: " if len(stages) > 1 else ""
        x, z = np.asarray(schedule.layers.half_width), schedule.depths
        wanted = np.asarray(schedule.layers.bottom)
        wall.plot([*x, *-x[::-1]], [*wanted, *wanted[::-1]], color=GREY, lw=3.5, alpha=0.5)
        _draw_wall(wall, x, z, colour, f"{prefix}expected wall")
        if np.max(schedule.depth_spread) > 0:
            for side in (x, -x):
                low, high = z - schedule.depth_spread, z + schedule.depth_spread
                wall.fill_between(side, low, high, color=colour, alpha=0.25, lw=0)
        _draw_feeds(layers, schedule.feeds, schedule.wear, prefix)
        for n in schedule.touch_off_after:
            layers.axvline(n + 0.5, color=GREEN, lw=0.8, ls=":")
    wall.plot([], [], color=GREY, lw=3.5, alpha=0.5, label="wanted wall")
    last = stages[-1]
    wall.set_aspect("equal", adjustable="datalim")
    wall.set_title(
        f"{sum(len(s.feeds) for s in stages)} layers, wall error at most "
        f"{last.max_wall_error:.2f} µm (rms expected {last.expected_wall_error:.2f} µm)",
        fontsize=10,
        loc="left",
    )
    _depth_axis(wall)
    wall.set_xlabel("x [µm]")
    return figure


def _depth_axis(axes: Axes) -> None:
    axes.invert_yaxis()
    axes.set_ylabel("depth z [µm]")
    axes.legend(frameon=False, fontsize=9)


def _draw_wall(axes: Axes, x: np.ndarray, z: np.ndarray, colour: str, label: str) -> None:
    right_x, right_z = [x[0], *x], [0.0, *z]
    axes.plot(
        [*right_x, *(-v for v in right_x[::-1])], [*right_z, *right_z[::-1]], color=colour,
        lw=1.5, label=label,
    )  # fmt: skip


def _draw_feeds(axes: Axes, feeds: np.ndarray, wear: np.ndarray, prefix: str) -> None:
    number = np.arange(1, len(feeds) + 1)
    style = "--" if prefix.startswith("finishing") else "-"
    axes.step(number, feeds, where="mid", color=BLUE, ls=style, label=f"{prefix}feed")
    axes.step(number, wear, where="mid", color=ORANGE, ls=style, label=f"{prefix}electrode wear")
    axes.set_xlabel("layer")
    axes.set_ylabel("per layer [µm]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, fontsize=9)
