"""Triangular equations straight from LAPACK.

A fit solves some ten thousand small ones: SciPy's own functions spend four fifths of their time on checks.
"""

import numpy as np
from scipy import linalg


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``L⁻¹ b`` of a lower factor (n, n) for ``right`` (n,) or (n, k), best laid out column by column; it is kept."""
    return _solved(linalg.lapack.dtrtrs, factor, right)


def backward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``L⁻ᵀ b`` of a lower factor (n, n) for ``right`` (n, k)."""
    return _solved(linalg.lapack.dtrtrs, factor, right, trans=1)


def whole(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``(LLᵀ)⁻¹ b`` of a lower Cholesky factor (n, n) for ``right`` (n,) or (n, k)."""
    return _solved(linalg.lapack.dpotrs, factor, right)


def _solved(solve, factor: np.ndarray, right: np.ndarray, **options: int) -> np.ndarray:
    if not right.size:
        return np.zeros(right.shape)
    result, info = solve(factor, right if right.ndim > 1 else right[:, None], lower=1, **options)
    if info:
        raise linalg.LinAlgError(f'singular matrix: element {info} of the diagonal is zero')
    return result if right.ndim > 1 else result[:, 0]
