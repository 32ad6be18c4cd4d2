"""How the machine came to its first stops: what no log tells.

A log begins, and goes on after each mounting, at a stop to which the axes came from somewhere.  Until each has moved
again it stands where that left it, by as much as a reversal either way.
"""

import numpy as np

from stepdiag_ros.effects.base import StopView
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.parity import Parity
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.preprocess.observe import Observation

REACH_M = 1e-4
"""No axis is farther off by how it came to its first stops [m]."""
SURE = 5.0
"""Standard deviations by which noise must be exceeded."""


def unknown_starts(view: StopView) -> np.ndarray:
    """Shifts (k, n, c) of each axis, setup by setup, until it has moved [m of reading per m]."""
    columns = [((view.approach[:, axis] == 0.0) & (view.setup == setup))[:, None] * view.by_shift[axis]
               for setup in np.unique(view.setup) for axis in range(3)]
    return np.array([column for column in columns if column.any()]).reshape(-1, *view.reading.shape)


def basis_of(columns: np.ndarray, space: Parity) -> np.ndarray:
    """Orthonormal (N, r): what columns (k, n, c) can be in parity space."""
    projected = np.zeros((space.size, len(columns)))
    projected[:space.stops] = space.stop_part(columns)
    vectors, sizes, _ = np.linalg.svd(projected, full_matrices=False)
    return vectors[:, sizes > 1e-9 * sizes.max(initial=1e-300)]


def starts_in(observation: Observation, reach: float) -> np.ndarray | None:
    """What the readings at the stops (n, c) [m] say of how the machine came to its first stops, each axis off by some
    ``reach`` [m]; None where they say nothing."""
    columns = unknown_starts(observation.view)
    space = fit_jointly(observation, [], noise_of(observation)).parity
    design, data = space.stop_part(columns), space.data[:space.stops]
    sizes = _sizes(design, data, reach)
    gain = float(data @ data - np.sum((data - design @ sizes) ** 2))
    if gain < len(columns) + SURE * np.sqrt(2.0 * len(columns)):
        return None
    return np.tensordot(sizes, columns, axes=1)


def started(columns: np.ndarray, space: Parity, apart: np.ndarray) -> np.ndarray:
    """What of ``apart`` (n, c) [m] the ``columns`` (k, n, c) of :func:`unknown_starts` do: as much as the readings
    show, and nothing along what the machine could do as well."""
    sizes = _sizes(space.stop_part(columns), space.stop_part(apart[None])[:, 0], REACH_M)
    return np.tensordot(sizes, columns, axes=1)


def _sizes(design: np.ndarray, data: np.ndarray, reach: float) -> np.ndarray:
    """Coefficients (k,) [m] of white columns (N, k), some ``reach`` [m] each."""
    return np.linalg.solve(design.T @ design + np.eye(design.shape[1]) / reach**2, design.T @ data)
