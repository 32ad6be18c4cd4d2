"""What a set of effects explains, grown member by member.

Coefficients a of columns Z (M, k), in units of the sizes that they are allowed, are normal with variance one.  Freed of
them the white data have the covariance 1 + ZZᵀ, and products are taken with its inverse W = 1 − BBᵀ.  With further
columns Y it is

    W − U (1 + YᵀU)⁻¹ Uᵀ,   U = W Y,

so that B grows by U V (1 + λ)^(−½), V and λ the eigenvectors and eigenvalues of YᵀU: nothing that is known is worked
out again.  Without growing, the coefficients of Y have the mean (1 + YᵀU)⁻¹ Uᵀz and the covariance (1 + YᵀU)⁻¹.
Those of columns Z that are among what was grown have the mean ZᵀWz and the covariance 1 − ZᵀWZ.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.eigen import eigen

LEAST_EXPLAINED = 0.02
"""Directions of a set with less variance than this against the noise's are left out."""


@dataclass(frozen=True)
class Explained:
    """``data`` z (M,), ``basis`` B (M, r) and ``taken`` Bᵀz (r,)."""

    data: np.ndarray
    basis: np.ndarray
    taken: np.ndarray

    @classmethod
    def nothing(cls, data: np.ndarray) -> 'Explained':
        """By no effect."""
        return cls(data, np.zeros((len(data), 0)), np.zeros(0))

    @property
    def total(self) -> float:
        """``zᵀWz``: what is left of the data, squared."""
        return float(self.data @ self.data - self.taken @ self.taken)

    def freed(self, columns: np.ndarray) -> np.ndarray:
        """``W`` times columns (M, k)."""
        return columns - self.basis @ (self.basis.T @ columns)

    def and_then(self, columns: np.ndarray) -> 'Explained':
        """With the effect of further columns (M, k), in units of the sizes that they are allowed."""
        free = self.freed(columns)
        value, vector = eigen(columns.T @ free)
        keep = value > LEAST_EXPLAINED
        more = free @ (vector[:, keep] / np.sqrt(1.0 + value[keep]))
        return Explained(self.data, np.concatenate([self.basis, more], axis=1),
                         np.concatenate([self.taken, more.T @ self.data]))

    def coefficients(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (k,) of the coefficients that further columns (M, k) would have, and their covariance (k, k)."""
        free = self.freed(columns)
        covariance = np.linalg.inv(columns.T @ free + np.eye(columns.shape[1]))
        return covariance @ (free.T @ self.data), covariance

    def within(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (k,) of the coefficients of columns (M, k) that are among what is explained, and their covariance."""
        along = self.basis.T @ columns
        return columns.T @ self.data - along.T @ self.taken, \
            np.eye(columns.shape[1]) - columns.T @ columns + along.T @ along
