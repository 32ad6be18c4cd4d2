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


class Full:
    """A lower ``factor`` (n, n)."""

    def __init__(self, factor: np.ndarray):
        self.factor = factor

    @property
    def diagonal(self) -> np.ndarray:
        """Its diagonal (n,)."""
        return np.diag(self.factor)

    def forward(self, right: np.ndarray) -> np.ndarray:
        """As :func:`forward`."""
        return forward(self.factor, right)

    def backward(self, right: np.ndarray) -> np.ndarray:
        """As :func:`backward`."""
        return backward(self.factor, right)


class Banded:
    """A large lower factor (n, n) that is zero but for a band, some rows at a time: ``steps``, each the first of its
    rows, the first of the columns that they meet, and what stands there."""

    def __init__(self, steps: list[tuple[int, int, np.ndarray]]):
        self._steps = steps

    @property
    def factor(self) -> np.ndarray:
        """The same written out (n, n)."""
        begin, _, part = self._steps[-1]
        full = np.zeros((begin + len(part),) * 2)
        for begin, first, part in self._steps:
            full[begin:begin + len(part), first:first + part.shape[1]] = part
        return full

    @property
    def diagonal(self) -> np.ndarray:
        """Its diagonal (n,)."""
        return np.concatenate([np.diag(part[:, begin - first:]) for begin, first, part in self._steps])

    def forward(self, right: np.ndarray) -> np.ndarray:
        """As :func:`forward`."""
        result = np.array(right, float, order='F')
        for begin, first, part in self._steps:
            mine, met = slice(begin, begin + len(part)), begin - first
            result[mine] -= part[:, :met] @ result[first:begin]
            result[mine] = forward(part[:, met:], result[mine])
        return result

    def backward(self, right: np.ndarray) -> np.ndarray:
        """As :func:`backward`."""
        result = np.array(right, float, order='F')
        for begin, first, part in reversed(self._steps):
            mine, met = slice(begin, begin + len(part)), begin - first
            result[mine] = backward(part[:, met:], result[mine])
            result[first:begin] -= part[:, :met].T @ result[mine]
        return result


def kept(factor: np.ndarray) -> Full | Banded:
    """A lower factor (n, n) as it is kept: by its band where that is less than half of it."""
    size, steps = len(factor), []
    for begin in range(0, size, ROWS_AT_A_TIME):
        end = min(begin + ROWS_AT_A_TIME, size)
        met = np.flatnonzero(factor[begin:end, :begin].any(axis=0))
        steps.append((begin, end, int(met[0]) if len(met) else begin))
    if sum((end - begin) * (end - first) for begin, end, first in steps) >= size**2 / 4:
        return Full(factor)
    return Banded([(begin, first, factor[begin:end, first:end].copy(order='F')) for begin, end, first in steps])


def _solved(solve, factor: np.ndarray, right: np.ndarray, **options: int) -> np.ndarray:
    if not right.size:
        return np.zeros(right.shape)
    result, info = solve(factor, right if right.ndim > 1 else right[:, None], lower=1, **options)
    if info:
        raise linalg.LinAlgError(f'singular matrix: element {info} of the diagonal is zero')
    return result if right.ndim > 1 else result[:, 0]
