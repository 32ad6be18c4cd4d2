"""Eigenvalues and eigenvectors of symmetric matrices, whatever LAPACK thinks of them.

NumPy asks LAPACK for divide and conquer, which gives up on one sound matrix in some thousand logs; the slower QR
iteration does not.
"""

import numpy as np
from scipy import linalg


def eigen(symmetric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (…, k), rising, and eigenvectors in columns (…, k, k) of one matrix or of many (…, k, k)."""
    try:
        return np.linalg.eigh(symmetric)
    except np.linalg.LinAlgError:
        if not np.isfinite(symmetric).all():
            raise
        size = symmetric.shape[-1]
        found = [linalg.eigh(one, driver='ev') for one in symmetric.reshape(-1, size, size)]
        return (np.array([value for value, _ in found]).reshape(symmetric.shape[:-1]),
                np.array([vector for _, vector in found]).reshape(symmetric.shape))
