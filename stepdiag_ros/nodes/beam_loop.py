"""The loop that holds a beam on the retroreflector, in the acquisition of the detector's node.

Blocks are short while it is closed, one a period; each ends in a command to the box that turns the beam.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.devices.base import SpotBlock, SteeredSpotSensor
from stepdiag_ros.devices.steering import Steering
from stepdiag_ros.model.regulation import DEADBAND, PERIOD_S, Aim, Regulator

NEWEST_S = 0.005
"""A command follows the mean over the last so many seconds of a block."""


class BeamLoop:
    """``aims`` of the setups that regulate their beam; ``length`` [m] of the detector's edge."""

    def __init__(self, aims: Mapping[str, Aim], steering: Steering, length: float, gain: float):
        self._aims, self._steering, self._length, self._gain = dict(aims), steering, length, gain
        self._regulator: Regulator | None = None
        self._commanded: np.ndarray | None = None

    @property
    def closed(self) -> bool:
        return self._regulator is not None

    @property
    def searching(self) -> bool:
        """Whether the beam has lost the retroreflector."""
        return self._regulator is not None and self._regulator.searching

    def select(self, setup: str, sensor: SteeredSpotSensor) -> None:
        """Close the loop at the aim of ``setup``, or open it where the setup has none."""
        aim = self._aims.get(setup)
        if aim is None:
            self._regulator = None
            return
        self._regulator = Regulator(aim, DEADBAND * self._steering.step_rad, 0.5 * self._length, self._gain)
        self._commanded = None
        self._command(sensor)

    def samples(self, usual: int, rate: float) -> int:
        """Samples of the next block: of one period while the loop is closed."""
        return min(usual, max(1, round(PERIOD_S * rate))) if self.closed else usual

    def act(self, block: SpotBlock, sensor: SteeredSpotSensor) -> None:
        """Command what follows from a block."""
        if self._regulator is None:
            return
        newest = max(1, round(NEWEST_S / block.period_s))
        spots = np.column_stack([block.x_m, block.y_m])[-newest:]
        lit = spots[np.isfinite(spots).all(axis=1)]
        self._regulator.next(lit.mean(axis=0) if len(lit) else None)
        self._command(sensor)

    def _command(self, sensor: SteeredSpotSensor) -> None:
        """Tell the mirrors, unless they stand there: a beam that is held is left alone."""
        taken = self._steering.commanded(self._steering.command_volts(self._regulator.command))
        if self._commanded is None or (taken != self._commanded).any():
            sensor.steer(taken)
            self._commanded = taken
