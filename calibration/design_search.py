"""Choice of rows by the information that they bring: greedy, then exchange.

Directions that no row sees yet are kept apart from the inverse on those that are seen. A row that
sees one of them raises the rank, which goes before everything else; among such rows the
pseudo-determinant decides, in coordinates in which every column of the rows so far has length 1.

References
----------
.. [1] C. D. Meyer, "Generalized inversion of modified matrices", SIAM J. Appl. Math. 24(3), 1973:
   the pseudo-inverse after a rank-one change.
"""

from dataclasses import dataclass

import numpy as np

from calibration.identify import RANK_TOLERANCE

# A quantity is open, and a reading sees an open direction, from this share of its length on.
_OPEN = 1e-6
# Exchanges that gain less than this (of a logarithm or of the criterion) are rounding.
_GAINS = 1e-9
_MOST_EXCHANGES = 100


@dataclass(frozen=True)
class Information:
    """Information of some rows: what they see, and what they do not.

    Attributes
    ----------
    inverse : ndarray, shape (p, p)
        Inverse of the information on the seen directions, 0 on the others.
    unseen : ndarray, shape (p, k)
        Orthonormal unseen directions.
    log_determinant : float
        Logarithm of the determinant on the seen directions.
    """

    inverse: np.ndarray
    unseen: np.ndarray
    log_determinant: float

    @classmethod
    def of(cls, rows: np.ndarray) -> "Information":
        """Information of rows, shape (n, p)."""
        count = rows.shape[1]
        _, singular, right = np.linalg.svd(np.concatenate([rows, np.zeros((count, count))]))
        rank = int(np.sum(singular > RANK_TOLERANCE * max(singular[0], 1e-300)))
        seen = right[:rank] / singular[:rank, None]
        return cls(seen.T @ seen, right[rank:].T, 2.0 * float(np.sum(np.log(singular[:rank]))))

    @property
    def rank(self) -> int:
        """Number of seen directions."""
        return len(self.inverse) - self.unseen.shape[1]

    @property
    def open(self) -> np.ndarray:
        """Which parameters move along an unseen direction, shape (p,)."""
        return np.linalg.norm(self.unseen, axis=1) > _OPEN


@dataclass(frozen=True)
class Scores:
    """What adding each candidate alone leads to.

    Attributes
    ----------
    first, second : ndarray, shape (m,)
        Value, better when greater: the first decides, the second among equals.
    variances : ndarray, shape (m, p)
        Of each parameter; NaN where open.
    open : ndarray of bool, shape (m, p)
        Which parameters stay open.
    """

    first: np.ndarray
    second: np.ndarray
    variances: np.ndarray
    open: np.ndarray


@dataclass(frozen=True)
class Search:
    """Greedy choice and exchange.

    Attributes
    ----------
    base : ndarray, shape (k, p)
        Rows so far, with columns of length 1.
    rows : ndarray, shape (m, p)
        Candidates.
    weights : ndarray, shape (p,), or None
        Of the variances in their sum; None for the determinant.
    target : int or None
        The parameter whose variance counts alone.
    repeats : bool
        Whether a candidate may be taken more than once.
    """

    base: np.ndarray
    rows: np.ndarray
    weights: np.ndarray | None
    target: int | None
    repeats: bool

    def state(self, picked: list[int]) -> Information:
        """Information of the rows so far and the picked ones."""
        return Information.of(np.concatenate([self.base, self.rows[picked]]))

    def value(self, state: Information) -> tuple[float, float]:
        """Value of a set, better when greater: rank (or what replaces it) first."""
        variances = np.where(state.open, np.nan, np.diag(state.inverse))
        first, second = self._compare(
            np.array([state.rank]),
            np.array([state.log_determinant]),
            variances[None],
            state.open[None],
        )
        return float(first[0]), float(second[0])

    def score(self, state: Information) -> Scores:
        """Value of the set with each candidate added, by rank-one updates."""
        reach = self.rows @ state.inverse
        spread = np.einsum("ij,ij->i", reach, self.rows)
        hidden = self.rows @ state.unseen
        square = np.sum(hidden**2, axis=1)
        sees = square > (_OPEN * np.linalg.norm(self.rows, axis=1)) ** 2
        safe = np.where(sees, square, 1.0)
        away = (hidden @ state.unseen.T) / safe[:, None]
        variances = np.diag(state.inverse) + np.where(
            sees[:, None],
            -2.0 * reach * away + (1.0 + spread)[:, None] * away**2,
            -(reach**2) / (1.0 + spread)[:, None],
        )
        # What stays unseen of each parameter once the row's own direction is seen.
        own = np.where(sees[:, None], away * np.sqrt(safe)[:, None], 0.0)
        left = np.sum(state.unseen**2, axis=1) - own**2
        still_open = left > _OPEN**2
        variances = np.where(still_open, np.nan, np.maximum(variances, 0.0))
        rise = np.where(sees, np.log(safe), np.log1p(spread))
        first, second = self._compare(
            state.rank + sees, state.log_determinant + rise, variances, still_open
        )
        return Scores(first, second, variances, still_open)

    def _compare(
        self,
        rank: np.ndarray,
        log_determinant: np.ndarray,
        variances: np.ndarray,
        is_open: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        if self.target is not None:
            closed = ~is_open[:, self.target]
            most = self.rows.shape[1] + 1.0
            second = np.where(closed, -variances[:, self.target], log_determinant)
            return np.where(closed, most, rank), second
        if self.weights is None:
            return rank.astype(float), log_determinant
        return rank.astype(float), -np.nansum(variances * self.weights, axis=1)

    def greedy(self, n: int) -> list[int]:
        """Add the best row n times."""
        picked: list[int] = []
        for _ in range(n):
            picked.append(self._best(self.state(picked), picked))
        return picked

    def exchanged(self, picked: list[int]) -> list[int]:
        """Exchange one row for another until no exchange makes the set better."""
        best = self.value(self.state(picked))
        for _ in range(_MOST_EXCHANGES):
            improved = False
            for i in sorted(set(picked)):
                others = list(picked)
                others.remove(i)
                other = self._best(self.state(others), others)
                value = self.value(self.state([*others, other]))
                if value[0] > best[0] or (
                    value[0] == best[0] and value[1] > best[1] + _GAINS * max(abs(best[1]), 1e-300)
                ):
                    picked, best, improved = [*others, other], value, True
            if not improved:
                break
        return picked

    def _best(self, state: Information, picked: list[int]) -> int:
        scores = self.score(state)
        first, second = scores.first.copy(), scores.second
        if not self.repeats:
            first[picked] = -np.inf
        top = np.flatnonzero(first == np.max(first))
        return int(top[np.argmax(second[top])])
