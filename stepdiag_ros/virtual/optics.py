"""What the base unit sees of a mirror pose: the virtual cell's only way into the optics.

Everything that simulates a sensor goes through :func:`sight`, so that the optical
model behind it can be exchanged in one place.
"""

import numpy as np

from stepdiag_ros.model.description import Machine, Setup
from stepdiag_ros.model.sensor import Misalignment, measure


def sight(machine: Machine, setup: Setup, misalignment: Misalignment, point: np.ndarray,
          attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n, beams) [m] and spots (n, 2) [m] for poses ``point`` (n, 3), ``attitude`` (n, 3, 3)."""
    return measure(machine, setup, misalignment, point, attitude)
