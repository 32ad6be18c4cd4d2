"""Triangular equations straight from LAPACK.

A fit solves some ten thousand small ones: SciPy's own functions spend four fifths of their time on checks.
Noise that is forgotten with the next moves has a factor that is zero but for a band: a large one is solved some rows at
a time, with no more of the rows before these than they meet.
"""

import numpy as np
from scipy import linalg

ROWS_AT_A_TIME = 64
"""Rows of a band that are solved together; fewer take longer to call than to solve."""


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``L⁻¹ b`` of a lower factor (n, n) for ``right`` (n,) or (n, k), best laid out column by column; it is kept."""
    return _solved(linalg.lapack.dtrtrs, factor, right)


def backward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``L⁻ᵀ b`` of a lower factor (n, n) for ``right`` (n, k)."""
    return _solved(linalg.lapack.dtrtrs, factor, right, trans=1)


def whole(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``(LLᵀ)⁻¹ b`` of a lower Cholesky factor (n, n) for ``right`` (n,) or (n, k)."""
    return _solved(linalg.lapack.dpotrs, factor, right)


class Banded:
    """A large lower ``factor`` (n, n) that is zero but for a band, some rows at a time: ``steps``, their first row, the
    one behind them, and the first of the columns that they meet."""

    def __init__(self, factor: np.ndarray, steps: list[tuple[int, int, int]]):
        self._factor, self._steps = factor, steps

    @classmethod
    def of(cls, factor: np.ndarray) -> 'Banded | None':
        """The same; None where that would save less than half."""
        size, steps = len(factor), []
        for begin in range(0, size, ROWS_AT_A_TIME):
            met = np.flatnonzero(factor[begin:begin + ROWS_AT_A_TIME, :begin].any(axis=0))
            steps.append((begin, min(begin + ROWS_AT_A_TIME, size), int(met[0]) if len(met) else begin))
        done = sum((end - begin) * (end - first) for begin, end, first in steps)
        return cls(factor, steps) if done < size**2 / 4 else None

    def forward(self, right: np.ndarray) -> np.ndarray:
        """As :func:`forward`."""
        result = np.array(right, float, order='F')
        for begin, end, first in self._steps:
            result[begin:end] -= self._factor[begin:end, first:begin] @ result[first:begin]
            result[begin:end] = forward(self._factor[begin:end, begin:end], result[begin:end])
        return result

    def backward(self, right: np.ndarray) -> np.ndarray:
        """As :func:`backward`."""
        result = np.array(right, float, order='F')
        for begin, end, first in reversed(self._steps):
            result[begin:end] = backward(self._factor[begin:end, begin:end], result[begin:end])
            result[first:begin] -= self._factor[begin:end, first:begin].T @ result[begin:end]
        return result


def _solved(solve, factor: np.ndarray, right: np.ndarray, **options: int) -> np.ndarray:
    if not right.size:
        return np.zeros(right.shape)
    result, info = solve(factor, right if right.ndim > 1 else right[:, None], lower=1, **options)
    if info:
        raise linalg.LinAlgError(f'singular matrix: element {info} of the diagonal is zero')
    return result if right.ndim > 1 else result[:, 0]
