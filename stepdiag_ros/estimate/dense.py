"""The normal equations of the enhanced method as one dense matrix.

Units differ by many decades: the matrix is scaled to a unit diagonal before it is factored.
"""

import numpy as np
from scipy import linalg, sparse

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.noise import Whitener

LOADING, LOADING_LIMIT = 1e-15, 1e-8
"""What is added to the unit diagonal of normal equations that rounding made indefinite: first, last."""


def weighted(residual: np.ndarray, white: list[Whitener]) -> np.ndarray:
    """``WᵀW r`` (n·c,)."""
    out = np.zeros_like(residual)
    for whitener in white:
        out[whitener.rows] = linalg.cho_solve((whitener.factor, True), residual[whitener.rows],
                                              check_finite=False)
    return out


def normal_equations(jacobian: sparse.csr_array, white: list[Whitener]) -> np.ndarray:
    """``JᵀWᵀWJ`` (size, size), one run after the other, only on the columns a run meets."""
    size = jacobian.shape[1]
    normal = np.zeros((size, size))
    for whitener in white:
        block = jacobian[whitener.rows]
        columns = np.unique(block.indices)
        dense = np.asfortranarray(block[:, columns].toarray())
        part = linalg.solve_triangular(whitener.factor, dense, lower=True, overwrite_b=True,
                                       check_finite=False)
        normal[np.ix_(columns, columns)] += part.T @ part
    return normal


def dense_operations(jacobian: sparse.csr_array, white: list[Whitener]) -> float:
    """How many multiplications :func:`normal_equations` and :func:`factored` take."""
    total = jacobian.shape[1]**3 / 3.0
    for whitener in white:
        rows, columns = len(whitener.rows), len(np.unique(jacobian[whitener.rows].indices))
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
    return scale * linalg.cho_solve((factor, True), scale * right, check_finite=False)


def inverse(factor: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Inverse (size, size) of the matrix that :func:`factored` took."""
    half, _ = linalg.lapack.dpotri(factor, lower=1)
    return (np.tril(half) + np.tril(half, -1).T) * scale[:, None] * scale
