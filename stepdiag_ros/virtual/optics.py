"""What the base unit sees of a mirror pose: the virtual cell's only way into the optics.

Everything that simulates a sensor goes through :func:`sight`, so that the optical
model behind it can be exchanged in one place.  It is the ray-traced scene of
:mod:`stepdiag_ros.virtual.scene`; the estimators' closed form is not used.
"""

from functools import lru_cache

import numpy as np

from stepdiag_ros.model.description import Machine, Setup
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.virtual.scene import SensorScene


@lru_cache(maxsize=64)
def _scene(machine: Machine, setup: Setup) -> SensorScene:
    return SensorScene.of_setup(machine, setup)


def sight(machine: Machine, setup: Setup, misalignment: Misalignment, point: np.ndarray,
          attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n, beams) [m] and spots (n, 2) [m] for poses ``point`` (n, 3), ``attitude`` (n, 3, 3)."""
    return _scene(machine, setup).measure(point, attitude, beam_tilt=misalignment.laser,
                                          mirror_tilt=misalignment.mirror)
