"""The linear model of the residuals at a point, in two numerical forms behind one set of methods.

`Triangular` keeps the QR of the Jacobian: accurate to the last digits, for a single fit.
`Gram` keeps J'J: half the digits of the condition number, several times faster for many small fits.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

# Up to here the factorisation is written out; a library call costs more than it computes.
_WRITTEN_OUT = 8


class Triangular(NamedTuple):
    """Linear model held as R and Q'r of the Jacobian's QR.

    Attributes
    ----------
    triangle : Array, shape (p, p)
        R.
    projected : Array, shape (p,)
        Q' times the residuals.
    basis : Array, shape (n, p)
        Q.
    """

    triangle: Array
    projected: Array
    basis: Array

    @classmethod
    def of(cls, residuals: Array, jacobian: Array) -> "Triangular":
        """Linear model from residuals (n,) and Jacobian (n, p)."""
        count = jacobian.shape[1]
        padded = jnp.concatenate([jacobian, jnp.zeros((count, count))])
        q, triangle = jnp.linalg.qr(padded)
        basis = q[: residuals.shape[0]]
        return cls(triangle, basis.T @ residuals, basis)

    def against(self, residuals: Array, jacobian: Array) -> "Triangular":
        """The same Jacobian (n, p) with other residuals (n,)."""
        return self._replace(projected=self.basis.T @ residuals)

    def gradient(self) -> Array:
        """Gradient of half the sum of squares, shape (p,)."""
        return self.triangle.T @ self.projected

    def column_norms(self) -> Array:
        """Norm of each column of the Jacobian, shape (p,)."""
        return jnp.sqrt(jnp.sum(self.triangle**2, axis=0))

    def reduction(self, move: Array) -> Array:
        """Fall of half the sum of squares that the model expects of a move."""
        after = self.projected + self.triangle @ move
        return 0.5 * (jnp.sum(self.projected**2) - jnp.sum(after**2))

    def damped_move(self, free: Array, damping: Array, kept: Array) -> Array:
        """Move of the free parameters when the others make the move `kept`.

        Parameters
        ----------
        free : Array of bool, shape (p,)
            Which parameters are solved for.
        damping : Array, shape (p,)
            Damping of each, as a squared norm.
        kept : Array, shape (p,)
            Move of the others, 0 where free.

        Returns
        -------
        Array, shape (p,)
            The whole move.
        """
        right = -(self.projected + self.triangle @ kept)
        columns = jnp.where(free, self.triangle, 0.0)
        # A column that is not free keeps only its damping row: 1 keeps the system regular.
        rows = jnp.diag(jnp.where(free, jnp.sqrt(damping), 1.0))
        q, r = jnp.linalg.qr(jnp.concatenate([columns, rows]))
        solution = jax.scipy.linalg.solve_triangular(r, q[: free.shape[0]].T @ right)
        return jnp.where(free, solution, kept)


class Gram(NamedTuple):
    """Linear model held as J'J and J'r.

    Attributes
    ----------
    gram : Array, shape (p, p)
        J'J.
    slope : Array, shape (p,)
        J'r.
    """

    gram: Array
    slope: Array

    @classmethod
    def of(cls, residuals: Array, jacobian: Array) -> "Gram":
        """Linear model from residuals (n,) and Jacobian (n, p)."""
        return cls(jacobian.T @ jacobian, jacobian.T @ residuals)

    def against(self, residuals: Array, jacobian: Array) -> "Gram":
        """The same Jacobian (n, p) with other residuals (n,)."""
        return self._replace(slope=jacobian.T @ residuals)

    def gradient(self) -> Array:
        """Gradient of half the sum of squares, shape (p,)."""
        return self.slope

    def column_norms(self) -> Array:
        """Norm of each column of the Jacobian, shape (p,)."""
        return jnp.sqrt(jnp.diag(self.gram))

    def reduction(self, move: Array) -> Array:
        """Fall of half the sum of squares that the model expects of a move."""
        return -(self.slope @ move + 0.5 * move @ self.gram @ move)

    def damped_move(self, free: Array, damping: Array, kept: Array) -> Array:
        """Move of the free parameters; see `Triangular.damped_move`."""
        right = jnp.where(free, -(self.slope + self.gram @ kept), 0.0)
        matrix = jnp.where(free[:, None] & free[None, :], self.gram, 0.0)
        matrix = matrix + jnp.diag(jnp.where(free, damping, 1.0))
        return jnp.where(free, solve_positive(matrix, right), kept)


def solve_positive(matrix: Array, right: Array) -> Array:
    """Solve a small symmetric positive definite system.

    Parameters
    ----------
    matrix : Array, shape (p, p)
        The system.
    right : Array, shape (p,)
        Right-hand side.

    Returns
    -------
    Array, shape (p,)
        The solution; not finite where the matrix is not positive definite.
    """
    count = right.shape[0]
    if count > _WRITTEN_OUT:
        return jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), right)
    lower: list[list[Array]] = []
    forward: list[Array] = []
    for i in range(count):
        row: list[Array] = []
        for j in range(i):
            dot = sum((row[k] * lower[j][k] for k in range(j)), start=jnp.zeros(()))
            row.append((matrix[i, j] - dot) / lower[j][j])
        row.append(jnp.sqrt(matrix[i, i] - sum((v * v for v in row), start=jnp.zeros(()))))
        lower.append(row)
        dot = sum((row[k] * forward[k] for k in range(i)), start=jnp.zeros(()))
        forward.append((right[i] - dot) / row[i])
    solution: list[Array] = [jnp.zeros(())] * count
    for i in reversed(range(count)):
        dot = sum((lower[k][i] * solution[k] for k in range(i + 1, count)), start=jnp.zeros(()))
        solution[i] = (forward[i] - dot) / lower[i][i]
    return jnp.stack(solution)
