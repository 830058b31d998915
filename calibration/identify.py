"""What the data can tell: rank, condition, and the directions they cannot see, in words."""

from dataclasses import dataclass

import numpy as np

# Directions whose singular value (of the column-normalised Jacobian) is below this share of the
# greatest are taken as exactly unseen; an autodiff Jacobian is good to about 1e-14.
RANK_TOLERANCE = 1e-10
STRONG_CORRELATION = 0.95


@dataclass(frozen=True)
class Identifiability:
    """Rank analysis of a Jacobian at the optimum.

    Attributes
    ----------
    rank : int
        Number of directions that the data see.
    condition : float
        Condition number of the column-normalised Jacobian; infinite when rank-deficient.
    covariance : ndarray, shape (p, p)
        Inverse of J'J on the seen directions.
    unseen : ndarray, shape (p, k)
        Orthonormal unseen directions in column-normalised coordinates.
    column_norms : ndarray, shape (p,)
        Norm of each column; 0 where a parameter has no effect at all.
    leverage : ndarray, shape (n,)
        Share of each residual that the parameters absorb; sums to the rank.
    """

    rank: int
    condition: float
    covariance: np.ndarray
    unseen: np.ndarray
    column_norms: np.ndarray
    leverage: np.ndarray

    def is_flat(self, gradient: np.ndarray) -> bool:
        """Whether a quantity with this derivative moves along an unseen direction.

        Parameters
        ----------
        gradient : ndarray, shape (p,)
            Derivative of the quantity by each parameter.

        Returns
        -------
        bool
            True when the data leave the quantity open.
        """
        if self.unseen.shape[1] == 0:
            return False
        scaled = gradient / np.where(self.column_norms > 0, self.column_norms, 1.0)
        size = np.linalg.norm(scaled)
        return bool(size > 0 and np.linalg.norm(scaled @ self.unseen) > 1e-6 * size)


def analyse(jacobian: np.ndarray) -> Identifiability:
    """Rank, condition and covariance from a Jacobian of standardised residuals.

    Parameters
    ----------
    jacobian : ndarray, shape (n, p)
        Derivative of the residuals, each in units of its noise.

    Returns
    -------
    Identifiability
        The analysis.
    """
    count = jacobian.shape[1]
    norms = np.linalg.norm(jacobian, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    if len(singular) < count:
        right = np.linalg.svd(jacobian / scale, full_matrices=True)[2]
    top = singular[0] if len(singular) and singular[0] > 0 else 1.0
    rank = int(np.sum(singular > RANK_TOLERANCE * top))
    seen = right[:rank] / scale
    inverse = 1.0 / singular[:rank]
    covariance = (seen.T * inverse**2) @ seen
    return Identifiability(
        rank=rank,
        condition=float(top / singular[rank - 1]) if rank == count else float("inf"),
        covariance=covariance,
        unseen=right[rank:].T,
        column_norms=norms,
        leverage=np.sum(left[:, :rank] ** 2, axis=1),
    )


def unseen_in_words(
    analysis: Identifiability, names: tuple[str, ...], values: np.ndarray
) -> tuple[str, ...]:
    """One sentence for each direction that the data cannot see.

    Parameters
    ----------
    analysis : Identifiability
        From `analyse`.
    names : tuple of str
        Names of the parameters.
    values : ndarray, shape (p,)
        Their values, to speak of changes in per cent.

    Returns
    -------
    tuple of str
        Such as "wear_ratio and electrode_area cannot be told apart: ...".
    """
    sentences = [
        f"{name} has no effect on any reading"
        for name, norm in zip(names, analysis.column_norms, strict=True)
        if norm == 0
    ]
    seen = np.flatnonzero(analysis.column_norms > 0)
    if len(seen) == 0:
        return tuple(sentences)
    size = np.where(values != 0, np.abs(values), 1.0)
    # Relative changes along the unseen directions; columns without effect are said above.
    effective = np.flatnonzero(np.linalg.norm(analysis.unseen[seen], axis=0) > 1e-6)
    changes = analysis.unseen[np.ix_(seen, effective)].T
    changes = changes / analysis.column_norms[seen] / size[seen]
    for change in _few_at_a_time(changes):
        order = np.argsort(-np.abs(change))
        part = sorted(i for i in order if np.abs(change[i]) > 1e-3 * np.abs(change[order[0]]))
        relative = change / change[part[0]]
        moves = " with ".join(
            f"{_signed(relative[i], values[seen[i]] != 0)} in {names[seen[i]]}" for i in part
        )
        sentences.append(
            f"{_listed([names[seen[i]] for i in part])} cannot be told apart: "
            f"{moves} changes no reading"
        )
    return tuple(sentences)


def _few_at_a_time(directions: np.ndarray) -> np.ndarray:
    """The same directions (k, p) in another basis, each with as few parameters as possible.

    An SVD mixes directions that belong to different parameters; row echelon form parts them.
    """
    rows = directions.copy()
    for k in range(len(rows)):
        # The greatest entry left decides the pivot; its column is cleared from all other rows.
        rest = np.abs(rows[k:])
        i, j = divmod(int(np.argmax(rest)), rest.shape[1])
        rows[[k, k + i]] = rows[[k + i, k]]
        rows[k] /= rows[k, j]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, j] * rows[k]
    return np.where(np.abs(rows) > 1e-7, rows, 0.0)


def trades_in_words(correlation: np.ndarray, names: tuple[str, ...]) -> tuple[str, ...]:
    """One sentence for each strongly correlated pair.

    Parameters
    ----------
    correlation : ndarray, shape (p, p)
        Correlation matrix.
    names : tuple of str
        Names of the parameters.

    Returns
    -------
    tuple of str
        Such as "gap trades off against wear_ratio: correlation -0.987, ...".
    """
    sentences = []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            r = correlation[i, j]
            if np.isfinite(r) and abs(r) > STRONG_CORRELATION:
                shrink = 1.0 / np.sqrt(max(1.0 - r**2, 1e-16))
                sentences.append(
                    f"{names[i]} and {names[j]} trade off: correlation {r:+.3f}; knowing one from "
                    f"elsewhere would shrink the other's interval about {shrink:.1f} times"
                )
    return tuple(sentences)


def _signed(share: float, relative: bool) -> str:
    return f"{share:+.3g} %" if relative else f"{0.01 * share:+.3g}"


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
