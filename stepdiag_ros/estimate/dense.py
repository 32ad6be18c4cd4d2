"""The normal equations of the enhanced method as one dense matrix.

Units differ by many decades: the matrix is scaled to a unit diagonal before it is factored.
"""

import numpy as np
from scipy import linalg, sparse

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.noise import Whitener
from stepdiag_ros.estimate.triangular import whole

LOADING, LOADING_LIMIT = 1e-15, 1e-8
"""What is added to the unit diagonal of normal equations that rounding made indefinite: first, last."""


def weighted(residual: np.ndarray, white: list[Whitener]) -> np.ndarray:
    """``WᵀW r`` (n·c,)."""
    out = np.zeros_like(residual)
    for whitener in white:
        out[whitener.rows] = whitener.weighted(residual[whitener.rows])
    return out


def normal_equations(jacobian: sparse.csr_array, white: list[Whitener]) -> np.ndarray:
    """``JᵀWᵀWJ`` (size, size), one run after the other, only on the columns a run meets."""
    size = jacobian.shape[1]
    normal = np.zeros((size, size))
    for whitener in white:
        columns, dense = block_of(jacobian, whitener.rows)
        part = whitener.solve(dense)
        normal[np.ix_(columns, columns)] += part.T @ part
    return normal


def block_of(jacobian: sparse.csr_array, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The columns (k,) that some rows (m,) meet, and these rows there (m, k), column by column.

    By hand: slicing sparse arrays twice for every run and step took a third of a fit.
    """
    begin = jacobian.indptr[rows]
    count = jacobian.indptr[rows + 1] - begin
    before = np.cumsum(count) - count
    entries = np.repeat(begin - before, count) + np.arange(count.sum())
    columns, place = np.unique(jacobian.indices[entries], return_inverse=True)
    dense = np.zeros((len(rows), len(columns)), order='F')
    dense[np.repeat(np.arange(len(rows)), count), place] = jacobian.data[entries]
    return columns, dense


def dense_operations(jacobian: sparse.csr_array, white: list[Whitener]) -> float:
    """How many multiplications :func:`normal_equations` and :func:`factored` take."""
    total = jacobian.shape[1]**3 / 3.0
    for whitener in white:
        rows, columns = len(whitener.rows), len(block_of(jacobian, whitener.rows)[0])
        total += rows**2 * columns + rows * columns**2
    return float(total)


def factored(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cholesky factor of the matrix scaled to a unit diagonal (units differ by many decades)."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    scaled = matrix * scale[:, None] * scale
    loading = 0.0
    while True:
        try:
            return linalg.cholesky(scaled, lower=True, check_finite=False), scale
        except linalg.LinAlgError:
            # Nearly noise-free data narrow some directions 1e16 times more than others are left
            # open: rounding may hide the open ones' prior.  The steps only get shorter by this.
            if loading > LOADING_LIMIT:
                raise StepdiagError('the normal equations cannot be solved; check the cell '
                                    'description against the readings') from None
            loading = 16.0 * loading or LOADING
            scaled[np.diag_indices(len(scaled))] = 1.0 + loading


def solved(factor: np.ndarray, scale: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Unknowns (size,) of the equations that :func:`factored` took, for a right side (size,)."""
    return scale * whole(factor, scale * right)


def inverse(factor: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Inverse (size, size) of the matrix that :func:`factored` took."""
    # Above the diagonal both hold zeros.
    half, _ = linalg.lapack.dpotri(factor, lower=1)
    half += np.tril(half, -1).T
    half *= scale[:, None]
    half *= scale
    return half
