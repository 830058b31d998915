"""Pictures of a fit of any model: readings, curve, residuals, and each parameter."""

import math

import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from calibration.plots.figures import BLUE, GREEN, GREY, ORANGE, plain
from calibration.profiling import ProfileLikelihood
from calibration.result import FitResult, student_quantile

_MOST_SHOWN = 12


def draw_result(
    result: FitResult,
    profile: ProfileLikelihood | None = None,
    posterior: xarray.DataTree | None = None,
) -> Figure:
    """Readings and curve above, residuals below, and beside them every parameter's distribution.

    Parameters
    ----------
    result : FitResult
        The fit.
    profile : ProfileLikelihood, optional
        Drawn as relative likelihood.
    posterior : xarray.DataTree, optional
        Drawn as density; with predictions, the band that holds 95 % of new readings is drawn too.

    Returns
    -------
    matplotlib.figure.Figure
        The figure. Of more than twelve free parameters the first twelve are shown.
    """
    free = [name for name in result.free if result.parameters[name].std is not None]
    if profile is not None or posterior is not None:
        free = list(result.free)
    free = free[:_MOST_SHOWN]
    columns = 1 if len(free) <= 4 else 2
    rows = max(1, math.ceil(len(free) / columns))
    sets = list(result.problem.datasets)
    figure = Figure(figsize=(8.0 + 2.6 * columns, max(5.6, 1.7 * rows)), layout="constrained")
    left, right = np.ravel(np.asarray(figure.subfigures(1, 2, width_ratios=(2.4, columns))))
    panels = left.subplots(2, len(sets), height_ratios=(2.4, 1), squeeze=False)
    for name, upper, lower in zip(sets, panels[0], panels[1], strict=True):
        _draw_data(result, posterior, name, upper, lower)
    if free:
        grid = right.subplots(rows, columns, squeeze=False).ravel()
        for name, axes in zip(free, grid, strict=False):
            _draw_parameter(result, profile, posterior, name, axes)
        for axes in grid[len(free) :]:
            axes.set_visible(False)
    return figure


def _draw_data(
    result: FitResult, posterior: xarray.DataTree | None, name: str, upper: Axes, lower: Axes
) -> None:
    dataset = result.problem.datasets[name]
    residual = result.residuals[name]
    plain_x = isinstance(dataset.x, np.ndarray) and dataset.x.shape == dataset.y.shape
    x = dataset.x if plain_x else np.arange(1, len(dataset.y) + 1)
    order = np.argsort(x, kind="stable")
    upper.plot(x, dataset.y, ".", color=GREY, ms=4, label="readings")
    upper.plot(x[order], (dataset.y - residual)[order], color=BLUE, lw=1.6, label="fit")
    if posterior is not None and "posterior_predictive" in posterior.children:
        drawn = np.asarray(posterior["posterior_predictive"].dataset[name])
        low, high = np.quantile(drawn.reshape(-1, len(x)), [0.025, 0.975], axis=0)
        upper.fill_between(
            x[order],
            low[order],
            high[order],
            color=BLUE,
            alpha=0.15,
            lw=0,
            label="95 % of new readings",
        )
    upper.set_title(f"{result.problem.name}: {name}" if name != "data" else result.problem.name)
    upper.set_ylabel("reading")
    upper.legend(frameon=False, fontsize=9)
    lower.axhline(0.0, color=BLUE, lw=1.2)
    lower.plot(x, residual, ".", color=GREY, ms=4)
    lower.set_ylabel("reading less fit")
    lower.set_xlabel("x" if plain_x else "number of the reading")
    plain(upper)
    plain(lower)


def _draw_parameter(
    result: FitResult,
    profile: ProfileLikelihood | None,
    posterior: xarray.DataTree | None,
    name: str,
    axes: Axes,
) -> None:
    """Relative likelihoods of one parameter, each 1 at its top."""
    estimate = result.parameters[name]
    if estimate.std is not None:
        levels = np.linspace(0.0005, 0.9995, 401)
        values = result.quantiles(name, levels)
        standard = student_quantile(levels, estimate.freedom)
        axes.plot(values, np.exp(-0.5 * standard**2), color=BLUE, lw=1.4, label="Wald")
    curve = None if profile is None else profile.parameters.get(name)
    if curve is not None and len(curve.values) > 1:
        dense = np.linspace(curve.values[0], curve.values[-1], 200)
        zeta = PchipInterpolator(curve.values, curve.zeta)(dense)
        axes.plot(dense, np.exp(-0.5 * zeta**2), color=ORANGE, lw=1.4, label="profile")
    if posterior is not None and name in posterior["posterior"].dataset:
        drawn = np.ravel(np.asarray(posterior["posterior"].dataset[name]))
        inside = np.quantile(drawn, [0.0005, 0.9995])
        height, edges = np.histogram(drawn, bins=60, range=(inside[0], inside[1]))
        axes.stairs(
            height / height.max(), edges, fill=True, color=GREEN, alpha=0.3, label="posterior"
        )
    axes.axvline(estimate.value, color=GREY, lw=0.8)
    axes.set_xlabel(f"{name} [{estimate.unit}]" if estimate.unit else name)
    axes.set_yticks([])
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8)
    plain(axes)
