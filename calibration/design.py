"""`next_measurement`: which reading to take next, by Fisher information.

The information of readings taken together is the sum of ``g g' / sigma^2`` over them, with g the
derivative of the model by the free parameters. To that of the fit so far, readings are added one
by one where they help most, then exchanged one by one until no exchange helps. The model is taken
as straight around the best values (a locally optimal design): measure, fit again, ask again.

A reading that sees a direction which the data so far cannot see is better than any that does not.

References
----------
.. [1] A. C. Atkinson, A. N. Donev, R. D. Tobias, "Optimum Experimental Designs, with SAS", 2007,
   chapters 9 to 12.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.design_search import Information, Search
from calibration.noise import NORMAL, Robust
from calibration.problem import Dataset
from calibration.result import FitResult
from calibration.solvers.outcome import jacobian_at
from calibration.structure import ProblemStructure
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

_ROWS_SHOWN = 10


@dataclass(frozen=True)
class Design:
    """What `next_measurement` recommends.

    Attributes
    ----------
    criterion : str
        "D", "A" or the name of a parameter.
    dataset : str
        Data set whose model the candidates were put into.
    candidates : pytree of ndarray, leading axis m
        The settings to choose from.
    gain : ndarray, shape (m,)
        What measuring a candidate once gains: for "D" the rise of the log determinant, for "A" the
        fall of the sum of (std/value)^2, for a parameter the fall of its variance; infinite where
        it makes something identifiable that was open.
    shrinks : dict of str to ndarray, shape (m,)
        Factor by which each parameter's standard deviation falls if a candidate is measured once:
        1 when not at all, infinite when it becomes identifiable, NaN when it stays open.
    ranking : ndarray of int, shape (m,)
        Indices of the candidates from the best to the worst single one.
    chosen : dict of int to int
        The recommended set: index of the candidate and how often to measure it.
    std_before, std_after : dict of str to float or None
        Standard deviation of each free parameter now, and expected with the chosen set; None where
        it is open or a bound holds it.
    units : dict of str to str
        Their units.
    notes : tuple of str
        What the recommendation rests on, as sentences.
    """

    criterion: str
    dataset: str
    candidates: Any
    gain: np.ndarray
    shrinks: dict[str, np.ndarray]
    ranking: np.ndarray
    chosen: dict[int, int]
    std_before: dict[str, float | None]
    std_after: dict[str, float | None]
    units: dict[str, str]
    notes: tuple[str, ...] = ()

    def setting(self, index: int) -> str:
        """A candidate as text, such as ``x = 3.5``."""
        leaves = jax.tree_util.tree_flatten_with_path(self.candidates)[0]
        words = []
        for path, leaf in leaves:
            if np.shape(leaf)[:1] != np.shape(self.gain):
                continue  # the same for all
            key = jax.tree_util.keystr(path, simple=True, separator=".") or "x"
            words.append(f"{key} = {np.array2string(leaf[index], precision=6)}")
        return ", ".join(words)

    def report(self) -> str:
        """The recommendation as text.

        Returns
        -------
        str
            Several lines.
        """
        lines = [f"measure next ({_CRITERIA.get(self.criterion, _BY_NAME)}{self._target})"]
        for i, times in self.chosen.items():
            lines.append(f"  {times} x {self.setting(i)}  (index {i})")
        lines += ["", "expected standard deviations"]
        width = max(len(name) for name in self.std_before)
        for name, before in self.std_before.items():
            after, unit = self.std_after[name], self.units[name]
            words = f"{_number(before)} -> {_number(after)}" + (f" {unit}" if unit else "")
            if before is not None and after:
                words += f"  ({before / after:.3g} times smaller)"
            lines.append(f"  {name:<{width}}  {words}")
        lines += ["", f"single candidates, best {min(_ROWS_SHOWN, len(self.gain))} of "]
        lines[-1] += f"{len(self.gain)}: gain, and how many times smaller each std becomes"
        for i in self.ranking[:_ROWS_SHOWN]:
            falls = ", ".join(f"{n} {_number(float(s[i]))}" for n, s in self.shrinks.items())
            lines.append(f"  {self.setting(i)}  {_number(float(self.gain[i]))}  {falls}")
        if self.notes:
            lines += ["", "notes", *(f"  {note}." for note in self.notes)]
        return "\n".join(lines)

    @property
    def _target(self) -> str:
        return "" if self.criterion in _CRITERIA else self.criterion

    def as_dict(self) -> dict[str, Any]:
        """The design as plain JSON types; null for what is infinite or open."""
        return {
            "criterion": self.criterion,
            "dataset": self.dataset,
            "chosen": [
                {"candidate": i, "setting": self.setting(i), "times": times}
                for i, times in self.chosen.items()
            ],
            "std_before": self.std_before,
            "std_after": self.std_after,
            "ranking": [
                {
                    "candidate": int(i),
                    "setting": self.setting(i),
                    "gain": _plain(self.gain[i]),
                    "shrinks": {name: _plain(s[i]) for name, s in self.shrinks.items()},
                }
                for i in self.ranking
            ],
            "notes": list(self.notes),
        }


_CRITERIA = {"D": "D: volume of the joint uncertainty", "A": "A: sum of (std/value)^2"}
_BY_NAME = "smallest variance of "


def next_measurement(
    result: FitResult,
    candidates: Any,
    n: int = 1,
    sigma: Any = None,
    criterion: str = "D",
    dataset: str | None = None,
    repeats: bool = True,
) -> Design:
    """Which of the candidate settings to measure next.

    Parameters
    ----------
    result : FitResult
        The fit so far.
    candidates : array_like, shape (m,), or nested dict, tuple, list of array_like
        The settings to choose from, like the x of the data set with one entry for each candidate.
        The model must take each reading from its own x alone.
    n : int
        How many readings to choose, >= 1.
    sigma : float or array_like, shape (m,), optional
        Standard deviation of a reading at each candidate, in the unit of the readings; that of the
        data set's readings when left out.
    criterion : {"D", "A"} or str
        "D" makes the joint uncertainty small (the determinant of the covariance), "A" the sum of
        (std/value)^2 (a value of 0 counts as 1), the name of a free parameter its variance.
    dataset : str, optional
        Data set that the readings would join; may be left out where there is one only.
    repeats : bool
        Whether a setting may be chosen more than once.

    Returns
    -------
    Design
        The chosen set, and what every single candidate would gain.

    Raises
    ------
    InputError
        If a name is unknown, the model is not finite at a candidate, or sigma is needed.
    RuntimeError
        If JAX makes 32-bit floats.

    Notes
    -----
    Cost grows with m n p^2 for each round of exchanges. What new readings tell of the noise itself
    is left out, and so are correlations between them.
    """
    require_float64("A design")
    problem = result.problem
    name = _dataset_of(result, dataset)
    held = tuple(f for f in result.free if result.parameters[f].reason.startswith("held at"))
    names = tuple(f for f in result.free if f not in held)
    if criterion not in (*_CRITERIA, *names):
        if criterion in held:
            raise InputError(f"parameter {criterion!r} is held at a bound: name another criterion.")
        hint = nearest(str(criterion), (*_CRITERIA, *names))
        raise InputError(f"criterion {criterion!r} is unknown{hint}.")
    if not names:
        raise InputError("every free parameter is held at a bound: widen the bounds and fit again.")
    moving = np.array([f in names for f in result.free])
    so_far = _rows_so_far(result)[:, moving]
    trial = _trial(result, name, candidates)
    prediction, slopes = _candidate_slopes(result, name, trial)
    count = len(prediction)
    if n < 1 or (not repeats and n > count):
        raise InputError(f"n is {n}, but must be 1 or more, without repeats {count} at most.")
    rows = slopes[:, moving] / _sigma_of(result, name, sigma, prediction)[:, None]

    lengths = np.linalg.norm(so_far, axis=0)
    lengths = np.where(lengths > 0, lengths, np.max(np.abs(rows), axis=0))
    lengths = np.where(lengths > 0, lengths, 1.0)
    values = np.array([result.parameters[f].value for f in names])
    weights = 1.0 / (lengths * np.where(values != 0, np.abs(values), 1.0)) ** 2
    target = names.index(criterion) if criterion in names else None
    search = Search(
        base=np.linalg.qr(so_far / lengths, mode="r"),
        rows=rows / lengths,
        weights=weights if criterion == "A" else None,
        target=target,
        repeats=repeats,
    )
    picked = search.exchanged(search.greedy(n))
    before, after = Information.of(search.base), search.state(picked)

    single = search.score(before)
    order = np.lexsort((np.arange(count), -single.second, -single.first))
    deviation = np.sqrt(single.variances)
    now = np.sqrt(np.where(before.open, np.nan, np.diag(before.inverse)))
    with np.errstate(invalid="ignore"):
        falls = np.where(before.open & ~single.open, np.inf, now / deviation)
    if target is None:
        rank, value = search.value(before)
        gain = np.where(single.first > rank, np.inf, single.second - value)
    else:
        gain = (now**2 - single.variances)[:, target] / lengths[target] ** 2
        if before.open[target]:
            gain = np.where(single.open[:, target], 0.0, np.inf)

    def stds(state: Information) -> dict[str, float | None]:
        found = np.sqrt(np.diag(state.inverse)) / lengths
        by_name = dict(zip(names, found, strict=True))
        left_open = dict(zip(names, state.open, strict=True))
        return {f: None if left_open.get(f, True) else float(by_name[f]) for f in result.free}

    return Design(
        criterion=criterion,
        dataset=name,
        candidates=trial.x,
        gain=gain,
        shrinks={f: falls[:, j] for j, f in enumerate(names)},
        ranking=order,
        chosen={int(i): picked.count(i) for i in sorted(set(picked))},
        std_before=stds(before),
        std_after=stds(after),
        units={f: problem.parameters[f].unit for f in result.free},
        notes=_notes(result, name, held, names, before, after, single.open),
    )


def _dataset_of(result: FitResult, dataset: str | None) -> str:
    known = tuple(result.problem.datasets)
    if dataset is None and len(known) == 1:
        return known[0]
    if dataset is None:
        raise InputError(f"the fit has several data sets: name one as dataset, of {known}.")
    if dataset not in known:
        raise InputError(f"data set {dataset!r} is unknown{nearest(dataset, known)}.")
    return dataset


def _rows_so_far(result: FitResult) -> np.ndarray:
    """Derivative of the standardised residuals by the natural free parameters, shape (n, p)."""
    problem = result.problem
    levels = tuple(level or 1.0 for level in result.noise.values())
    arguments = (problem.fixed_values, problem.data(levels))
    jacobian = np.array(jacobian_at(problem.structure, result.vector, arguments))
    for part, (name, data), level in zip(
        problem.slices, problem.datasets.items(), levels, strict=True
    ):
        if isinstance(data.noise, Robust):
            spread = level if data.sigma is None else data.sigma
            jacobian[part] *= data.noise.information(result.residuals[name] / spread)[:, None]
    slopes = problem.layout.slopes(result.vector)
    natural = np.divide(jacobian, slopes, out=np.zeros_like(jacobian), where=slopes > 0)
    if not np.all(np.isfinite(natural)):
        raise InputError("the model is not finite at the fit's values: fit again from elsewhere.")
    return natural


def _trial(result: FitResult, name: str, candidates: Any) -> Dataset:
    """The candidates as a data set of the same model."""
    own = result.problem.datasets[name].own
    leaves = jax.tree.leaves(candidates)
    plain = isinstance(candidates, list | tuple) and all(np.ndim(v) == 0 for v in leaves)
    lengths = [len(leaves)] if plain else [np.shape(v)[0] for v in leaves if np.ndim(v)]
    count = lengths[0] if lengths else 0
    if count == 0:
        raise InputError("candidates is empty or a single number: give an array of settings.")
    return Dataset(candidates, np.zeros(count), 1.0, own=own)


def _candidate_slopes(
    result: FitResult, name: str, trial: Dataset
) -> tuple[np.ndarray, np.ndarray]:
    """Predictions (m,) and their derivative by the natural free parameters (m, p)."""
    problem = result.problem
    index = list(problem.datasets).index(name)
    structure = ProblemStructure(
        layout=problem.layout,
        functions=(problem.structure.functions[index],),
        own=(problem.structure.own[index],),
        noises=(NORMAL,),
        sigmas=(True,),
    ).in_natural_coordinates()
    vector = problem.layout.free_values(result.vector)
    data = ((trial.x, trial.y, trial.y + 1.0, None),)
    prediction, slopes = (
        np.asarray(a) for a in _value_and_slopes(structure, vector, problem.fixed_values, data)
    )
    finite = np.isfinite(prediction) & np.all(np.isfinite(slopes), axis=1)
    if not np.all(finite):
        raise InputError(
            f"the model or its derivative is not finite at the candidate of index "
            f"{int(np.argmin(finite))}: leave it out."
        )
    return prediction, slopes


@functools.partial(jax.jit, static_argnames="structure")
def _value_and_slopes(
    structure: ProblemStructure, vector: Array, fixed: Array, data: tuple
) -> tuple[Array, Array]:
    def value(moved: Array) -> tuple[Array, Array]:
        prediction = structure.predictions(moved, fixed, data)[0]
        return prediction, prediction

    slopes, prediction = jax.jacfwd(value, has_aux=True)(vector)
    return prediction, slopes


def _sigma_of(result: FitResult, name: str, sigma: Any, prediction: np.ndarray) -> np.ndarray:
    """Standard deviation of a reading at each candidate, shape (m,)."""
    data, count = result.problem.datasets[name], len(prediction)
    if sigma is not None:
        given = np.asarray(sigma, float)
        if given.shape not in ((), (count,)):
            raise InputError(
                f"sigma has {given.size} values for {count} candidates: give one, or one each."
            )
        if not np.all(np.isfinite(given) & (given > 0)):
            raise InputError("sigma must be finite and above 0 at every candidate.")
        return np.broadcast_to(given, (count,))
    values = {n: p.value for n, p in result.parameters.items()}
    values |= {inner: values[outer] for inner, outer in data.own.items()}
    if data.sigma_kind == "given" and np.ptp(data.sigma) > 0:
        raise InputError(
            f"sigma of data set {name!r} differs from reading to reading: give the sigma of the "
            "candidates."
        )
    level = {
        "given": lambda: float(data.sigma[0]),
        "parameter": lambda: values[data.sigma],
        "estimated": lambda: result.noise[name],
    }[data.sigma_kind]()
    scale = data.noise.scale(prediction, level, {n: jnp.asarray(v) for n, v in values.items()})
    return np.broadcast_to(np.asarray(scale, float), (count,))


def _notes(
    result: FitResult,
    name: str,
    held: tuple[str, ...],
    names: tuple[str, ...],
    before: Information,
    after: Information,
    single_open: np.ndarray,
) -> tuple[str, ...]:
    notes = []
    if not result.converged:
        notes.append("the fit did not converge: the recommendation holds for its last values only")
    for parameter in held:
        notes.append(f"{parameter} is held at a bound and taken as fixed")
    if result.problem.datasets[name].noise != NORMAL:
        notes.append("each new reading counts as a normal one of its standard deviation")
    for j, parameter in enumerate(names):
        if not before.open[j]:
            continue
        able = np.flatnonzero(~single_open[:, j])
        words = f"{parameter} is open so far; "
        if len(able):
            words += f"{len(able)} of {len(single_open)} candidates make it identifiable"
            words += f", such as index {able[0]}, and are better than any that does not"
        elif after.open[j]:
            words += "neither a single candidate nor the chosen set makes it identifiable"
        else:
            words += "no single candidate makes it identifiable, but the chosen set does"
        notes.append(words)
    return tuple(notes)


def _number(value: float | None) -> str:
    if value is None or np.isnan(value):
        return "open"
    return "identified" if np.isinf(value) else f"{value:.4g}"


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
