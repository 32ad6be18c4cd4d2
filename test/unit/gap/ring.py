"""An effect for tests that no list has."""

import numpy as np

from stepdiag_ros.effects.base import Effect


class Ring(Effect):
    """The mirror's arm rings after each move and dies away."""

    name = 'ring'
    swing_rad = 4e-5

    def before_light(self, moment):
        since = np.maximum(moment.since_arrival, 0.0)
        swing = self.swing_rad * np.exp(-since / 0.28) * np.sin(2.0 * np.pi * 5.13 * since)
        moment.mirror = moment.mirror + swing[:, None] * np.array([0.8, -0.6])


class FaintRing(Ring):
    """So faint that no dwell's mean shows it."""

    swing_rad = 4e-7
