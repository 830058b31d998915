"""Readings of many fits: checked once, brought to one shape, padded where lengths differ."""

import numbers
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from procmodel.errors import InputError

SOUND, NOT_FINITE, TOO_FEW = range(3)


@dataclass(frozen=True)
class Readings:
    """Readings of k fits with room for m each.

    Attributes
    ----------
    index : ndarray of int, shape (k,)
        Which of all fits these are.
    x : tuple of ndarray
        Leaves of x, shape (k, ...) or one for all.
    x_axes : tuple of (0 or None)
        For every leaf, whether each fit has its own.
    x_tree : PyTreeDef
        How the leaves make x.
    y : ndarray, shape (k, m)
        Readings; 0 where padded.
    inverse_sigma : ndarray, shape (), (m,) or (k, m)
        1/sigma, 1 where sigma is unknown; 0 where padded.
    count : ndarray of int, shape (k,)
        Readings of each fit.
    state : ndarray of int, shape (k,)
        `SOUND`, `NOT_FINITE` or `TOO_FEW`; only the first can be fitted.
    """

    index: np.ndarray
    x: tuple[np.ndarray, ...]
    x_axes: tuple[int | None, ...]
    x_tree: Any
    y: np.ndarray
    inverse_sigma: np.ndarray
    count: np.ndarray
    state: np.ndarray

    @property
    def sigma_axis(self) -> int | None:
        """Whether each fit has its own 1/sigma, as an axis for `jax.vmap`."""
        return 0 if self.inverse_sigma.ndim == 2 else None

    def x_of(self, lanes: Any) -> tuple[np.ndarray, ...]:
        """Leaves of x of some fits."""
        pairs = zip(self.x, self.x_axes, strict=True)
        return tuple(leaf if axis is None else leaf[lanes] for leaf, axis in pairs)

    def inverse_sigma_of(self, lanes: Any) -> np.ndarray:
        """1/sigma of some fits."""
        return self.inverse_sigma if self.sigma_axis is None else self.inverse_sigma[lanes]


def in_groups(xs: Any, ys: Any, sigmas: Any, least: int) -> list[Readings]:
    """Check the readings and group fits of about the same number of them.

    Parameters
    ----------
    xs, ys, sigmas : array_like, list or pytree
        As `calibration.many.fit_many` takes them.
    least : int
        Readings that a fit needs.

    Returns
    -------
    list of Readings
        The groups; there is one alone if all fits have equally many readings.

    Raises
    ------
    InputError
        If something is empty, shapes do not go together, or a sigma is not above 0.
    """
    ys = _stacked("ys", ys)
    lengths = np.array([len(y) for y in ys]) if isinstance(ys, list) else None
    n = len(ys)
    if isinstance(xs, tuple) and all(isinstance(v, numbers.Real) for v in xs):
        xs = list(xs)
    leaves, tree = jax.tree.flatten(xs, is_leaf=lambda node: isinstance(node, list))
    x = [_x_leaf(leaf, n, lengths) for leaf in leaves]
    if lengths is None:
        if any(isinstance(leaf, list) for leaf in x):
            raise InputError("xs has fits of different lengths, ys has not: give both the same.")
        if jax.tree_util.treedef_is_leaf(tree) and x[0].shape[-1:] != ys.shape[1:]:
            given = x[0].shape[-1] if x[0].ndim else 1
            raise InputError(
                f"xs has {given} values for {ys.shape[1]} readings of each fit: give one for each "
                "reading."
            )
        if ys.shape[1] < least:
            raise InputError(
                f"{ys.shape[1]} readings cannot fit {least} free parameters: add readings or fix "
                "parameters."
            )
        return [_uniform(x, tree, ys, _sigma(sigmas, n, ys.shape[1]))]
    else:
        if any(isinstance(leaf, np.ndarray) and leaf.ndim for leaf in x):
            raise InputError(
                "ys has fits of different lengths, xs has not: give xs as a list of arrays as long "
                "as those of ys."
            )
        return list(_ragged(x, tree, ys, lengths, _sigmas_ragged(sigmas, lengths), least))


def _stacked(name: str, values: Any) -> Any:
    """An array (n, m), or a list of n arrays (length,) where the lengths differ."""
    if isinstance(values, list | tuple):
        rows = [np.asarray(row, float) for row in values]
        for i, row in enumerate(rows):
            if row.ndim != 1:
                raise InputError(
                    f"{name}[{i}] has shape {row.shape}: give every fit a list of readings."
                )
        if len({len(row) for row in rows}) > 1:
            return rows
        values = np.array(rows)
    values = np.asarray(values, float)
    if values.ndim != 2:
        raise InputError(
            f"{name} has shape {values.shape}: give (fits, readings), or a list with one array for "
            "each fit."
        )
    if values.size == 0:
        raise InputError(f"{name} is empty: give at least one fit with readings.")
    return values


def _x_leaf(leaf: Any, n: int, lengths: np.ndarray | None) -> Any:
    """Shared (...), own (n, ...), or a list of n arrays."""
    if isinstance(leaf, list) and not all(isinstance(v, numbers.Real) for v in leaf):
        rows = [np.asarray(row, float) for row in leaf]
        if len(rows) != n:
            raise InputError(f"xs has {len(rows)} arrays for {n} fits: give one for each.")
        if lengths is None and len({row.shape for row in rows}) == 1:
            return np.array(rows)
        for i, row in enumerate(rows):
            if lengths is not None and row.shape != (lengths[i],):
                raise InputError(
                    f"xs[{i}] has shape {row.shape} for {lengths[i]} readings of that fit: "
                    "give one value for each reading."
                )
        return rows
    array = np.asarray(leaf)
    if array.dtype.kind not in "biuf":
        raise InputError("xs holds something that is not a number: give arrays of numbers.")
    if array.ndim >= 2 and array.shape[0] != n:
        raise InputError(
            f"xs has {array.shape[0]} rows for {n} fits: give one for each, or one array (m,) for "
            "all of them."
        )
    if array.ndim < 2 and not np.all(np.isfinite(array)):
        where = int(np.argmin(np.isfinite(np.ravel(array))))
        raise InputError(f"xs is NaN or infinite at reading {where + 1}: correct it.")
    return array


def _sigma(sigmas: Any, n: int, m: int) -> np.ndarray | None:
    if sigmas is None:
        return None
    if isinstance(sigmas, list | tuple):
        if len({np.shape(row) for row in sigmas}) != 1:
            raise InputError(
                f"sigmas has {len(sigmas)} entries of no common length for {n} fits of {m} "
                "readings: give as many as there are readings."
            )
        sigmas = np.array([np.asarray(row, float) for row in sigmas])
    array = np.asarray(sigmas, float)
    if array.shape not in ((), (m,), (n, m)):
        raise InputError(
            f"sigmas has shape {array.shape} for {n} fits of {m} readings: give one number, one "
            f"for each reading ({m},), or one for each of every fit ({n}, {m})."
        )
    _require_positive(array)
    return array


def _sigmas_ragged(sigmas: Any, lengths: np.ndarray) -> list[np.ndarray] | None:
    if sigmas is None:
        return None
    if not isinstance(sigmas, list | tuple) and np.ndim(sigmas) == 0:
        sigmas = [sigmas] * len(lengths)
    if len(sigmas) != len(lengths):
        raise InputError(f"sigmas has {len(sigmas)} entries for {len(lengths)} fits: give as many.")
    rows = []
    for i, (sigma, length) in enumerate(zip(sigmas, lengths, strict=True)):
        row = np.asarray(sigma, float)
        if row.shape not in ((), (length,)):
            raise InputError(
                f"sigmas[{i}] has {row.size} values for {length} readings: give one, or one each."
            )
        _require_positive(row, i)
        rows.append(np.broadcast_to(row, (length,)))
    return rows


def _require_positive(sigma: np.ndarray, fit: int | None = None) -> None:
    good = (sigma > 0) & np.isfinite(sigma)
    if np.all(good):
        return
    place = np.unravel_index(int(np.argmin(good)), good.shape)
    places = [*([] if fit is None else [fit]), *(int(i) for i in place)]
    where = "".join(f"[{i}]" for i in places)
    raise InputError(
        f"sigmas{where} is {float(sigma[place]):g}, not a number above 0: correct it, or leave "
        "sigmas out to have the noise estimated."
    )


def _uniform(x: list[np.ndarray], tree: Any, y: np.ndarray, sigma: np.ndarray | None) -> Readings:
    n, m = y.shape
    finite = np.isfinite(y).all(axis=1)
    for leaf in x:
        if leaf.ndim >= 2 and np.issubdtype(leaf.dtype, np.floating):
            finite &= np.isfinite(leaf).reshape(n, -1).all(axis=1)
    return Readings(
        index=np.arange(n),
        x=tuple(x),
        x_axes=tuple(0 if leaf.ndim >= 2 else None for leaf in x),
        x_tree=tree,
        y=y,
        inverse_sigma=np.asarray(1.0 if sigma is None else 1.0 / sigma),
        count=np.full(n, m),
        state=np.where(finite, SOUND, NOT_FINITE),
    )


def _ragged(
    x: Sequence[Any],
    tree: Any,
    ys: list[np.ndarray],
    lengths: np.ndarray,
    sigmas: list[np.ndarray] | None,
    least: int,
) -> Iterator[Readings]:
    rooms = np.array([_room(length) for length in lengths])
    for room in np.unique(rooms):
        index = np.flatnonzero(rooms == room)
        k, count = len(index), lengths[index]
        y, inverse = np.zeros((k, room)), np.zeros((k, room))
        leaves = [np.zeros((k, room)) if isinstance(leaf, list) else np.asarray(leaf) for leaf in x]
        for row, i in enumerate(index):
            own = lengths[i]
            y[row, :own] = ys[i]
            inverse[row, :own] = 1.0 if sigmas is None else 1.0 / sigmas[i]
            for leaf, given in zip(leaves, x, strict=True):
                if isinstance(given, list) and own:
                    # A real value in the padding keeps the model finite there.
                    leaf[row, :own], leaf[row, own:] = given[i], given[i][-1]
        finite = np.isfinite(y).all(axis=1)
        for leaf in leaves:
            finite &= np.isfinite(leaf).all(axis=1) if leaf.ndim else True
        state = np.where(finite, SOUND, NOT_FINITE)
        yield Readings(
            index=index,
            x=tuple(leaves),
            x_axes=tuple(0 if leaf.ndim else None for leaf in leaves),
            x_tree=tree,
            y=y,
            inverse_sigma=inverse,
            count=count,
            state=np.where(count < least, TOO_FEW, state),
        )


def _room(length: int) -> int:
    """Next of 8, 12, 16, 24, 32, 48, ...: few shapes to compile, little padding."""
    power = 8
    while power < length:
        power *= 2
    return 3 * power // 4 if power > 8 and length <= 3 * power // 4 else power
