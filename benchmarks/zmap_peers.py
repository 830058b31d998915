"""The simulation of electrode and cavity once more: in plain NumPy, and in loops for numba.

Both follow the same law as `procmodel.wear.zmap` but share none of its code. The electrode is
given by arrays: the share of every cell that the discharge reaches and that the section covers,
and the flat index of the cell of the bottom that every cell belongs to.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

_LEAST_SHARE = 1e-7


class Tool(NamedTuple):
    """An electrode in cells, shape (n, n) each."""

    reached: np.ndarray
    own: np.ndarray
    nearest: np.ndarray


class Case(NamedTuple):
    """Positions in cells of the map, shape (layers, steps); the map, in um."""

    x: np.ndarray
    y: np.ndarray
    feeds: np.ndarray
    valid: np.ndarray
    depth: np.ndarray
    wear_ratio: float
    bottom_gap: float = 0.0
    even: bool = False


def numpy_simulation(tool: Tool, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the map and loss of the electrode, step by step with whole windows."""
    n = len(tool.reached)
    area = np.bincount(tool.nearest.ravel(), tool.own.ravel(), n * n)
    total = tool.own.sum()

    def lost(volume: np.ndarray) -> np.ndarray:
        if case.even:
            return np.full((n, n), volume.sum() / total)
        summed = np.bincount(tool.nearest.ravel(), volume.ravel(), n * n)
        return (summed / np.where(area > 0, area, 1.0))[tool.nearest]

    ratio = case.wear_ratio
    removal = tool.reached / (1.0 + ratio * lost(tool.reached))
    loss, fed = np.zeros((n, n)), 0.0
    deep, rest, share = case.depth.copy(), case.depth.copy(), np.ones_like(case.depth)
    cover, ground = np.zeros_like(deep), np.zeros((0, 2))
    for x, y, feeds, valid in zip(case.x, case.y, case.feeds, case.valid, strict=True):
        before, ground = ground, _ground(x[valid], y[valid])
        places = [(*_window(a, n), *_window(b, n)) for a, b in zip(x[valid], y[valid], strict=True)]
        new_ground = not np.array_equal(ground, before)
        cover = np.zeros_like(deep) if new_ground else cover
        for row, across, column, along in places if new_ground else []:
            shadow = np.zeros((n + 1, n + 1))
            for i, j, weight in _pairs(across, along):
                shadow[i : i + n, j : j + n] += weight * tool.reached
            window = np.s_[row : row + n + 1, column : column + n + 1]
            cover[window] = np.maximum(cover[window], shadow)
        deep, rest, share = _opened(deep, rest, share, cover)
        open_ = cover > _LEAST_SHARE
        for (row, across, column, along), feed in zip(places, feeds[valid], strict=True):
            fed += feed
            bottom = fed - case.bottom_gap - loss
            window = np.s_[row : row + n + 1, column : column + n + 1]
            before, taken, volume = deep[window], np.zeros((n + 1, n + 1)), np.zeros((n, n))
            for i, j, weight in _pairs(across, along):
                part = np.s_[i : i + n, j : j + n]
                overlap = np.maximum(bottom - before[part], 0.0) * open_[window][part]
                cut = weight * removal * overlap
                taken[part] += cut
                volume += cut
            deep[window] = before + taken / np.where(open_[window], cover[window], 1.0)
            loss = loss + ratio * lost(volume)
    return share * deep + (1.0 - share) * rest, loss


def _ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Positions in no order: layers that have the same ones cover the same."""
    return np.unique(np.column_stack([x, y]).round(9), axis=0)


def _window(place: float, n: int) -> tuple[int, float]:
    first = int(np.floor(place - n / 2.0 + 1e-9))
    return first, max(place - n / 2.0 - first, 0.0)


def _pairs(across: float, along: float) -> list[tuple[int, int, float]]:
    return [
        (i, j, a * b)
        for i, a in ((0, 1.0 - across), (1, across))
        for j, b in ((0, 1.0 - along), (1, along))
        if a * b > 0.0
    ]


def _opened(
    deep: np.ndarray, rest: np.ndarray, share: np.ndarray, cover: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    deep, rest, share = deep.copy(), rest.copy(), share.copy()
    for at in zip(*np.nonzero((cover > _LEAST_SHARE) & (cover != share)), strict=True):
        d, r, s, c = deep[at], rest[at], share[at], cover[at]
        if c > s:
            deep[at] = (s * d + (c - s) * r) / c
        else:
            rest[at] = ((1.0 - s) * r + (s - c) * d) / (1.0 - c)
        share[at] = c
    return deep, rest, share


def numba_simulation() -> Callable[[Tool, Case], tuple[np.ndarray, np.ndarray]]:
    """The same in loops over cells, compiled by numba; numba must be installed."""
    import numba

    layer = numba.njit(_layer_in_loops)

    def simulation(tool: Tool, case: Case) -> tuple[np.ndarray, np.ndarray]:
        n = len(tool.reached)
        area = np.bincount(tool.nearest.ravel(), tool.own.ravel(), n * n)
        reached = np.bincount(tool.nearest.ravel(), tool.reached.ravel(), n * n)
        rate = (reached / np.where(area > 0, area, 1.0))[tool.nearest]
        if case.even:
            rate = np.full((n, n), tool.reached.sum() / tool.own.sum())
        removal = tool.reached / (1.0 + case.wear_ratio * rate)
        outside = np.flatnonzero(tool.nearest.ravel() != np.arange(n * n))
        loss, fed = np.zeros((n, n)), 0.0
        deep, rest, share = case.depth.copy(), case.depth.copy(), np.ones_like(case.depth)
        cover, ground = np.zeros_like(deep), np.zeros((0, 2))
        for x, y, feeds, valid in zip(case.x, case.y, case.feeds, case.valid, strict=True):
            count = int(valid.sum())
            before, ground = ground, _ground(x[valid], y[valid])
            new_ground = not np.array_equal(ground, before)
            fed = layer(
                x[:count], y[:count], feeds[:count], tool.reached, removal, area, outside,
                tool.nearest.ravel(), deep, rest, share, cover, loss, fed, case.wear_ratio,
                case.bottom_gap, case.even, tool.own.sum(), new_ground,
            )  # fmt: skip
        return share * deep + (1.0 - share) * rest, loss

    return simulation


def _layer_in_loops(
    x: Any, y: Any, feeds: Any, reached: Any, removal: Any, area: Any, outside: Any, nearest: Any,
    deep: Any, rest: Any, share: Any, cover: Any, loss: Any, fed: float, ratio: float,
    bottom_gap: float, even: bool, total: float, new_ground: bool,
) -> float:  # fmt: skip
    n = reached.shape[0]
    shadow = np.zeros((n + 1, n + 1))
    volume = np.zeros((n, n))
    flat_volume, flat_loss = volume.reshape(-1), loss.reshape(-1)
    if new_ground:
        cover[:] = 0.0
    for step in range(len(x) if new_ground else 0):
        r, c = int(np.floor(x[step] - n / 2 + 1e-9)), int(np.floor(y[step] - n / 2 + 1e-9))
        fx, fy = max(x[step] - n / 2 - r, 0.0), max(y[step] - n / 2 - c, 0.0)
        wide, high = 1 + (fx > 0.0), 1 + (fy > 0.0)
        shadow[:] = 0.0
        for i in range(wide):
            for j in range(high):
                w = (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
                for a in range(n):
                    for b in range(n):
                        shadow[a + i, b + j] += w * reached[a, b]
        for a in range(n + wide - 1):
            for b in range(n + high - 1):
                cover[r + a, c + b] = max(cover[r + a, c + b], shadow[a, b])
    for a in range(deep.shape[0]):
        for b in range(deep.shape[1]):
            now, old = cover[a, b], share[a, b]
            if now <= 1e-7:
                continue
            if now > old:
                deep[a, b] = (old * deep[a, b] + (now - old) * rest[a, b]) / now
            elif now < old:
                rest[a, b] = ((1.0 - old) * rest[a, b] + (old - now) * deep[a, b]) / (1.0 - now)
            share[a, b] = now
    for step in range(len(x)):
        fed += feeds[step]
        r, c = int(np.floor(x[step] - n / 2 + 1e-9)), int(np.floor(y[step] - n / 2 + 1e-9))
        fx, fy = max(x[step] - n / 2 - r, 0.0), max(y[step] - n / 2 - c, 0.0)
        wide, high = 1 + (fx > 0.0), 1 + (fy > 0.0)
        taken = shadow
        taken[:] = 0.0
        volume[:] = 0.0
        for i in range(wide):
            for j in range(high):
                w = (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
                for a in range(n):
                    for b in range(n):
                        over = fed - bottom_gap - loss[a, b] - deep[r + a + i, c + b + j]
                        if over > 0.0 and cover[r + a + i, c + b + j] > 1e-7:
                            cut = w * removal[a, b] * over
                            taken[a + i, b + j] += cut
                            volume[a, b] += cut
        for a in range(n + wide - 1):
            for b in range(n + high - 1):
                if taken[a, b] > 0.0:
                    deep[r + a, c + b] += taken[a, b] / cover[r + a, c + b]
        if even:
            loss += ratio * volume.sum() / total
            continue
        for k in outside:
            flat_volume[nearest[k]] += flat_volume[k]
        for k in range(n * n):
            if nearest[k] == k and area[k] > 0.0:
                flat_loss[k] += ratio * flat_volume[k] / area[k]
        for k in outside:
            flat_loss[k] = flat_loss[nearest[k]]
    return fed
