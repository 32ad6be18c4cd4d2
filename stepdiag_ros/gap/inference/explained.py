"""What a set of effects explains, grown member by member.

Coefficients a of columns Z (M, k), in units of the sizes that they are allowed, are normal with variance one.  Freed of
them the white data have the covariance 1 + ZZᵀ, and products are taken with its inverse W = 1 − BBᵀ.  With further
columns Y it is

    W − U (1 + YᵀU)⁻¹ Uᵀ,   U = W Y,

so that B grows by U V (1 + λ)^(−½), V and λ the eigenvectors and eigenvalues of YᵀU: nothing that is known is worked
out again.  Without growing, the coefficients of Y have the mean (1 + YᵀU)⁻¹ Uᵀz and the covariance (1 + YᵀU)⁻¹.
Those of columns Z that are among what was grown have the mean ZᵀWz.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stepdiag_ros.estimate.eigen import eigen

LEAST_EXPLAINED = 0.02
"""Directions of a set with less variance than this against the noise's are left out."""


@dataclass(frozen=True)
class Explained:
    """``data`` z (M,), ``blocks`` (M, r) whose columns side by side are B, one for each time it grew, and ``taken``
    Bᵀz.  Sets that begin alike share blocks."""

    data: np.ndarray
    blocks: tuple[np.ndarray, ...]
    taken: np.ndarray

    @classmethod
    def nothing(cls, data: np.ndarray) -> 'Explained':
        """By no effect."""
        return cls(data, (), np.zeros(0))

    @property
    def basis(self) -> np.ndarray:
        """B (M, r), written out."""
        return np.concatenate([self.data[:, None][:, :0], *self.blocks], axis=1)

    @property
    def total(self) -> float:
        """``zᵀWz``: what is left of the data, squared."""
        return float(self.data @ self.data - self.taken @ self.taken)

    @cached_property
    def left(self) -> np.ndarray:
        """``Wz`` (M,): what is left of the data."""
        result, begin = self.data.copy(), 0
        for block in self.blocks:
            result -= block @ self.taken[begin:(begin := begin + block.shape[1])]
        return result

    def along(self, columns: np.ndarray) -> np.ndarray:
        """``Bᵀ`` times columns (M, k)."""
        return np.concatenate([np.zeros((0, columns.shape[1])), *(block.T @ columns for block in self.blocks)])

    def freed(self, columns: np.ndarray) -> np.ndarray:
        """``W`` times columns (M, k)."""
        result = columns.copy()
        for block in self.blocks:
            result -= block @ (block.T @ columns)
        return result

    def spent(self, size: int) -> float:
        """Dimensions among the first ``size`` of the data that are explained."""
        return sum(float(np.vdot(block[:size], block[:size])) for block in self.blocks)

    def and_then(self, columns: np.ndarray, free: np.ndarray | None = None) -> 'Explained':
        """With the effect of further columns (M, k), in units of the sizes that they are allowed; ``free``: ``W`` times
        them, where it is known."""
        free = self.freed(columns) if free is None else free
        value, vector = eigen(columns.T @ free)
        keep = value > LEAST_EXPLAINED
        more = free @ (vector[:, keep] / np.sqrt(1.0 + value[keep]))
        return Explained(self.data, (*self.blocks, more), np.concatenate([self.taken, more.T @ self.data]))

    def coefficients(self, columns: np.ndarray, free: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Mean (k,) of the coefficients that further columns (M, k) would have, and their covariance (k, k)."""
        free = self.freed(columns) if free is None else free
        covariance = np.linalg.inv(columns.T @ free + np.eye(columns.shape[1]))
        return covariance @ (free.T @ self.data), covariance

    def within(self, columns: np.ndarray) -> np.ndarray:
        """Mean (k,) of the coefficients of columns (M, k) that are among what is explained."""
        return columns.T @ self.left
