"""Two mirrors on the analogue lines of the input box that turn a beam: angles to volts and back.

The box's two outputs command the angles, 0 to 5 V for the whole range in 12 bits; a mirror's position sensor, where
it has one, answers ±5 V on an input that is streamed beside the photocurrents.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.devices import t7


@dataclass(frozen=True)
class Steering:
    """``range_rad``: each angle goes from minus this to this; ``inputs`` of both position sensors, empty: none."""

    range_rad: float = 0.5
    inputs: tuple[int, ...] = ()

    @property
    def step_rad(self) -> float:
        """The smallest change of a commanded angle."""
        return 2.0 * self.range_rad / (t7.DAC_CODES - 1)

    def command_volts(self, angles: np.ndarray) -> np.ndarray:
        """Outputs [V] for ``angles`` (…, 2) [rad], within the range."""
        share = np.clip(np.asarray(angles, float) / self.range_rad, -1.0, 1.0)
        return 0.5 * t7.DAC_VOLTS * (1.0 + share)

    def commanded(self, volts: np.ndarray) -> np.ndarray:
        """Angles (…, 2) [rad] that the mirrors take for outputs [V], in steps of the converter."""
        codes = np.clip(np.rint(np.asarray(volts, float) / t7.DAC_VOLTS * (t7.DAC_CODES - 1)), 0, t7.DAC_CODES - 1)
        return (2.0 * codes / (t7.DAC_CODES - 1) - 1.0) * self.range_rad

    def sensed_volts(self, angles: np.ndarray) -> np.ndarray:
        """What the position sensors show [V] at ``angles`` (…, 2) [rad]."""
        return 5.0 * np.asarray(angles, float) / self.range_rad

    def sensed(self, volts: np.ndarray) -> np.ndarray:
        """Angles (…, 2) [rad] from the position sensors' ``volts``."""
        return np.asarray(volts, float) / 5.0 * self.range_rad
