"""A parity space for tests: white data that no machine absorbs anything of."""

import numpy as np
from scipy import sparse

from stepdiag_ros.estimate.triangular import Full
from stepdiag_ros.gap.inference.parity import Parity
from stepdiag_ros.gap.inference.projection import Freed, Projection


def white_space(data: np.ndarray, of_spot: int = 0) -> Parity:
    """The space of ``data`` (n,), the last ``of_spot`` of which are of the spot."""
    n, nothing = len(data), np.zeros((1, 1))
    white = Freed(np.arange(n), Full(np.eye(n)), np.zeros((n, 0)))
    space = Projection(None, None, None, [white], 0.0, sparse.csr_array((n, 1)), np.zeros((0, 1)), np.eye(1))
    return Parity(data, n, (n, 0), np.repeat([0, 1], [n - of_spot, of_spot]), np.arange(n), 1.0, space,
                  nothing, nothing, np.zeros((n, 1, 3)))
