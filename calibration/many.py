"""`fit_many` and `fit_stream`: thousands of small fits of one model, each to its own readings."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.black_box import failures_explained
from calibration.identify import Identifiability, analyse
from calibration.many_readings import NOT_FINITE, SOUND, TOO_FEW, Readings, in_groups
from calibration.many_result import (
    CONVERGED,
    FEW_READINGS,
    NO_NOISE,
    NO_READINGS,
    OPEN,
    ManyFits,
)
from calibration.parameters import Parameter, ParameterLayout, as_parameter
from calibration.progress import Progress, ProgressOption, reporting
from calibration.solvers import box_lm, lanes
from calibration.solvers.lane_pool import Box, solve_all, usable_cores
from calibration.solvers.lanes import OneFit, State
from calibration.solvers.outcome import AT_BOUND, held_at_bounds
from procmodel.errors import InputError
from procmodel.precision import require_float64

# Squared condition number of J from which on J'J has lost too many digits for a covariance.
_ILL_CONDITIONED = 1e10

Model = Callable[[dict[str, Any], Any], Any]


def fit_many(
    function: Model,
    parameters: Mapping[str, Parameter | float],
    xs: Any,
    ys: Any,
    sigmas: Any = None,
    *,
    starts: Any = None,
    progress: ProgressOption = None,
) -> ManyFits:
    """Fit one model to many sets of readings, each by itself.

    Parameters
    ----------
    function : callable
        ``function(params, x)`` with ``params`` a dictionary of scalars: the model of one fit.
        Written with jax.numpy, it returns one value for each reading.
    parameters : mapping of str to Parameter or float
        The parameters by name; a plain number is a fixed one.
    xs : array_like, list of array_like, or dict or tuple of them
        x of shape (m,) shared by all fits, of shape (n, ...) with one row for each, or a list of n
        arrays. In a dict or tuple that holds for each entry; a number for each fit goes in as
        shape (n, 1).
    ys : array_like, shape (n, m), or list of n array_like
        Readings. Their number may differ from fit to fit in a list, as then in `xs`; the model
        must then take each reading from its own x alone.
    sigmas : float, array_like of shape (m,) or (n, m), or list, optional
        Standard deviation of the readings. Left out, each fit estimates its own noise level from
        its residuals.
    starts : array_like, shape (n, p), optional
        Start of each fit, in the order of the free parameters; their values when left out.
    progress : bool or callable, optional
        True for a bar on stderr, or a function of (stage, done, total), called from
        any thread but one at a time.

    Returns
    -------
    ManyFits
        All results. What does not converge, or has readings that are not finite, is there too and
        says so in its status.

    Raises
    ------
    InputError
        If inputs are empty or do not go together, no fit has readings that can be used, or a
        parameter has an informative prior and sigmas are left out.
    RuntimeError
        If JAX makes 32-bit floats.

    Notes
    -----
    Fits run side by side in lanes of one compiled loop, on J'J; see
    `calibration.solvers.lanes`. One that is ill-conditioned or does not converge there is made
    again as `calibration.fit` makes it. Several devices share the lanes. What is compiled belongs
    to the function object and the shapes: hand over the same function each time, not a new lambda.
    """
    with reporting(progress) as told:
        told.compiling("fits")
        return _fit_all(function, parameters, (xs, ys, sigmas), starts, told, need_some=True)


def _fit_all(
    function: Model,
    parameters: Mapping[str, Parameter | float],
    data: tuple[Any, Any, Any],
    starts: Any = None,
    progress: Progress | None = None,
    need_some: bool = False,
) -> ManyFits:
    require_float64("Fitting many")
    xs, ys, sigmas = data
    model = _Model.of(function, parameters, known_noise=sigmas is not None)
    groups = in_groups(xs, ys, sigmas, model.least_readings)
    if need_some and not any(np.any(group.state == SOUND) for group in groups):
        raise InputError(
            "no fit has enough readings that are all finite: remove NaN and infinite ones."
        )
    total = sum(len(group.index) for group in groups)
    internal = model.starts(starts, total)
    done = sum(int(np.count_nonzero(group.state)) for group in groups)

    def report(more: int) -> None:
        nonlocal done
        done += more
        if progress is not None and more:
            progress.running("fits", done, total)

    parts = []
    for group in groups:
        own = internal if internal.shape[1] == 1 else internal[:, group.index]
        parts.append(_fit_group(model, group, own, report))
    if len(parts) == 1:
        return ManyFits(names=model.layout.free, **parts[0])
    order = np.argsort(np.concatenate([group.index for group in groups]))
    joined = {key: np.concatenate([part[key] for part in parts])[order] for key in parts[0]}
    return ManyFits(names=model.layout.free, **joined)


def fit_stream(
    function: Model,
    parameters: Mapping[str, Parameter | float],
    blocks: Iterable[tuple],
    *,
    progress: ProgressOption = None,
) -> Iterator[ManyFits]:
    """Fit blocks of readings as they come, holding one block at a time.

    Parameters
    ----------
    function, parameters
        As for `fit_many`.
    blocks : iterable of (xs, ys) or (xs, ys, sigmas)
        Each as for `fit_many`; some thousand fits each make good use of the machine, and blocks
        of the same shape are compiled once.
    progress : bool or callable, optional
        True for a bar on stderr, or a function of (stage, done, total); the total
        is 0, for a stream does not tell its length.

    Yields
    ------
    ManyFits
        One for each block, in order, even if no fit of a block has readings that can be used.

    Raises
    ------
    InputError
        As `fit_many`, and if a block is not a tuple of two or three; the text names the block.
    RuntimeError
        If JAX makes 32-bit floats.
    """
    done = 0
    with reporting(progress) as told:
        told.compiling("fits")
        for i, block in enumerate(blocks):
            if not isinstance(block, tuple) or len(block) not in (2, 3):
                raise InputError(f"block {i + 1}: give a tuple (xs, ys) or (xs, ys, sigmas).")
            try:
                fits = _fit_all(function, parameters, (*block, None)[:3])
            except InputError as error:
                raise InputError(f"block {i + 1}: {error}") from None
            done += len(fits)
            told.running("fits", done, 0)
            yield fits


@dataclass(frozen=True)
class _Model:
    """What all fits share."""

    function: Model
    layout: ParameterLayout
    box: Box
    start: np.ndarray
    noise_known: bool

    @classmethod
    def of(
        cls, function: Model, parameters: Mapping[str, Parameter | float], known_noise: bool
    ) -> "_Model":
        given = {name: as_parameter(name, value) for name, value in parameters.items()}
        layout = ParameterLayout.of(given)
        if not known_noise:
            for name, prior in layout.priors:
                if prior.informs:
                    raise InputError(
                        f"parameter {name!r} has an informative prior, which needs the noise to "
                        "weigh it against: give sigmas or drop the prior."
                    )
        fixed = np.array([given[name].value for name in layout.fixed])
        start = np.array([given[name].value for name in layout.free])
        return cls(function, layout, Box(fixed, *layout.internal_bounds()), start, known_noise)

    @property
    def informing(self) -> int:
        """Priors that count like a reading each."""
        return sum(prior.informs for _, prior in self.layout.priors)

    @property
    def least_readings(self) -> int:
        """Readings that a fit needs."""
        return max(len(self.layout.free) - self.informing, 1)

    def starts(self, starts: Any, total: int) -> np.ndarray:
        """Internal starts, shape (p, n) or (p, 1)."""
        free = self.layout.free
        if starts is None:
            return self.layout.internal(self.start)[:, None]
        values = np.asarray(starts, float)
        if values.shape != (total, len(free)):
            raise InputError(
                f"starts has shape {values.shape}: give ({total}, {len(free)}), one row for each "
                f"fit and one column for each of {', '.join(free)}."
            )
        lower, upper = self.layout.natural_bounds()
        open_ended = np.array([kind != "identity" for kind in self.layout.transforms])
        inside = (values >= lower) & (values <= upper) & np.isfinite(values)
        # The ends of a logarithm or logit lie at infinity.
        inside &= ~open_ended | ((values > lower) & (values < upper))
        if not np.all(inside):
            i, j = np.unravel_index(int(np.argmin(inside)), inside.shape)
            raise InputError(
                f"starts[{i}]: {free[j]} starts at {values[i, j]:g}, outside its bounds "
                f"({lower[j]:g}, {upper[j]:g}): move it."
            )
        return self.layout.internal(values.T)


def _fit_group(
    model: _Model, readings: Readings, starts: np.ndarray, report: Callable[[int], None]
) -> dict[str, np.ndarray]:
    """Everything that `ManyFits` holds, for one group."""
    fit = OneFit(model.function, model.layout, readings.x_tree)
    with np.errstate(all="ignore"):
        with failures_explained([model.function]):
            ends = solve_all(fit, model.box, readings, starts, report)
        found = _Found.of(model, readings, ends)
    starts = np.broadcast_to(starts, ends.vector.shape)
    hard = [int(i) for i in np.flatnonzero(found.hard)]
    # The first alone, so that it is compiled once.
    for some in (hard[:1], hard[1:]):
        with ThreadPoolExecutor(usable_cores()) as executor:
            list(executor.map(lambda i: _refit(model, fit, readings, starts[:, i], found, i), some))
    return found.finished(model, readings)


@dataclass(frozen=True)
class _Found:
    """Results with the parameters first and the covariance in units of the noise."""

    value: np.ndarray
    inverse: np.ndarray
    held: np.ndarray
    status: np.ndarray
    steps: np.ndarray
    chi2: np.ndarray
    rank: np.ndarray
    hard: np.ndarray

    @classmethod
    def of(cls, model: _Model, readings: Readings, ends: State) -> "_Found":
        count, n = ends.vector.shape
        status = ends.status[0].astype(int)
        norms = np.sqrt(ends.gram[[i * (i + 3) // 2 for i in range(count)]])
        rms = np.sqrt(ends.misfit / readings.count)
        near = np.where(norms > 0, AT_BOUND * rms / norms, 0.0)
        lower, upper = model.box.lower[:, None], model.box.upper[:, None]
        held = (ends.vector - lower <= near) & (ends.slope >= 0)
        held |= (upper - ends.vector <= near) & (ends.slope <= 0)
        scaled = [
            ends.gram[i * (i + 1) // 2 + j] / (norms[i] * norms[j])
            for i in range(count)
            for j in range(i + 1)
        ]
        matrix = lanes.reduced(scaled, held, np.zeros(count), np)
        factor = lanes.factorised(matrix, np)
        slopes = model.layout.slopes(ends.vector)
        inverse = np.empty((n, count, count))
        condition = np.zeros(n)
        for i in range(count):
            column = lanes.solved(factor, [np.full(n, float(k == i)) for k in range(count)])
            condition += count * column[i]
            for j in range(count):
                blocked = held[i] | held[j]
                per_unit = slopes[i] / norms[i] * (slopes[j] / norms[j])
                inverse[:, i, j] = np.where(blocked, np.nan, column[j] * per_unit)
        hard = (status == lanes.HARD) | ~(condition < _ILL_CONDITIONED)
        return cls(
            value=model.layout.free_values(ends.vector),
            inverse=inverse,
            held=held,
            status=status,
            steps=ends.steps[0].astype(int),
            chi2=ends.misfit[0].copy(),
            rank=count - np.sum(held, axis=0),
            hard=hard & (readings.state == SOUND),
        )

    def finished(self, model: _Model, readings: Readings) -> dict[str, np.ndarray]:
        started = readings.state == SOUND
        freedom = readings.count + model.informing - self.rank
        status = self.status.copy()
        status[readings.state == NOT_FINITE] = NO_READINGS
        status[readings.state == TOO_FEW] = FEW_READINGS
        covariance, noise = self.inverse, np.full(len(started), np.nan)
        if not model.noise_known:
            with np.errstate(all="ignore"):
                size = np.max(np.abs(readings.y), axis=1)
                floor = np.finfo(float).eps * np.where(size > 0, size, 1.0)
                noise = np.maximum(np.sqrt(self.chi2 / freedom), floor)
            noise[(freedom <= 0) | ~started | ~np.isfinite(noise)] = np.nan
            covariance = covariance * (noise**2)[:, None, None]
            status[started & (freedom <= 0) & np.isin(status, CONVERGED)] = NO_NOISE
        covariance[~started] = np.nan
        diagonal = np.diagonal(covariance, axis1=1, axis2=2)
        return {
            "value": np.where(started, self.value, np.nan).T,
            "std": np.sqrt(diagonal),
            "covariance": covariance,
            "held": (self.held & started).T,
            "status": status,
            "steps": np.where(started, self.steps, 0),
            "chi2": np.where(started, self.chi2, np.nan),
            "readings": readings.count,
            "degrees_of_freedom": np.where(started, freedom, 0),
            "noise": noise,
            "refitted": self.hard,
        }


def _refit(
    model: _Model, fit: OneFit, readings: Readings, start: np.ndarray, found: _Found, i: int
) -> None:
    """Make one fit again with QR, and put its results into `found`."""
    data = (readings.x_of(i), readings.y[i], readings.inverse_sigma_of(i))
    box = model.box
    end = box_lm.solve_compiled(
        fit, start, box.lower, box.upper, (box.fixed, *data), box_lm.BoxLMOptions()
    )
    vector, residuals = np.asarray(end.vector), np.asarray(end.residuals)
    jacobian = np.asarray(end.jacobian)
    sound = bool(np.all(np.isfinite(jacobian)) and np.all(np.isfinite(residuals)))
    slopes = model.layout.slopes(vector)
    held = np.zeros(len(vector), bool)
    if sound:
        count = int(readings.count[i])
        held = held_at_bounds(vector, residuals, jacobian, box.lower, box.upper, count)
    else:
        jacobian = np.zeros_like(jacobian)
    natural = np.divide(jacobian, slopes, out=np.zeros_like(jacobian), where=slopes > 0)
    analysis = analyse(np.where(held, 0.0, natural))
    status = int(end.status)
    found.value[:, i] = np.nan if status == box_lm.BAD_START else model.layout.free_values(vector)
    found.held[:, i] = held
    found.inverse[i] = _seen_covariance(analysis, held) if sound else np.nan
    found.rank[i] = analysis.rank
    found.chi2[i] = np.sum(residuals**2)
    found.steps[i] = int(end.steps)
    open_directions = analysis.rank < len(vector) - np.count_nonzero(held)
    found.status[i] = OPEN if open_directions and status in box_lm.CONVERGED else status


def _seen_covariance(analysis: Identifiability, held: np.ndarray) -> np.ndarray:
    covariance = analysis.covariance.copy()
    without = held | np.array([analysis.is_flat(row) for row in np.eye(len(held))])
    covariance[without, :] = covariance[:, without] = np.nan
    return covariance
