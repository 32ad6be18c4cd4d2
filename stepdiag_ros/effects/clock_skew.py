"""A sensor's stamps are offset from the sequencer's.

Each sensor stamps with a clock of its own, or when its samples arrive.  A sample with stamp ``t`` then
was taken at ``t − offset``: a late stamp puts the end of a move into the dwell, an early one the
beginning of the next.  The motion in the samples tells the offset; a mean of a still dwell does not.
"""

import numpy as np

from stepdiag_ros.effects.base import Effect, Parameter
from stepdiag_ros.effects.patterns import Drawn, drawn_size


class ClockSkew(Effect):
    name = 'clock_skew'
    short = "A sensor's clock is off"
    title = "A sensor's clock is not the control's: its samples are stamped too late or too early."
    parameters = (Parameter('interferometer', 's', -0.2, 0.2, meaning='its stamps are late by this much'),
                  Parameter('psd', 's', -0.2, 0.2, meaning='its stamps are late by this much'))
    sources = ('IEEE 1588; ROS 2 design, clock and time',)
    remedy = 'Synchronise the clocks (PTP), stamp at the source, or enter the measured latency.'
    signature = 'Samples stamped into a dwell still show the move before, or already the next.'
    neighbours = 'servo_settling dies away exponentially after the move; a late clock cuts the move itself off.'

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        late = drawn_size(rng, 0.005, 0.2, 2)
        which = int(rng.integers(3))
        return {'interferometer': late[0] if which != 1 else 0.0, 'psd': late[1] if which != 0 else 0.0}

    def clock_offset(self, sensor: str) -> float:
        return {'interferometer': self.interferometer, 'psd': self.psd}.get(sensor, 0.0)
