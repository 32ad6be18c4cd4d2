"""What every instrument offers the nodes, whatever protocol stands behind it.

Three small Protocol classes and the two value types that cross the seam.  A
client blocks for at most the time it was told (``timeout_s`` and the length of
a block) and complains with :class:`DeviceError`, never with a bare socket
error and never by hanging; after a :class:`DeviceError` the client is closed
and :meth:`connect` may be called again.

Clients are not thread safe: one thread talks to one instrument.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stepdiag_ros.devices.timing import Accuracy
from stepdiag_ros.errors import StepdiagError


class DeviceError(StepdiagError):
    """An instrument dropped the connection, answered nonsense, stalled or refused.

    One line: which instrument at which address, what happened, what to do.
    """


@dataclass(frozen=True)
class DisplacementBlock:
    """Samples of one interferometer, oldest first.

    ``stamp_ns``: host's clock (ns since the epoch, :data:`hostclock.HOST`) at the first sample; sample i was
    taken at ``stamp_ns + i * period_s``.  ``displacement_m`` (n, beams), positive away
    from the source, zero at the last reset.  ``quality`` (n,) uint8, 0..100, 0: no
    signal.  ``refractive_index``: what the instrument divided out; 1.0: none.  ``accuracy`` of the stamps.
    """

    stamp_ns: int
    period_s: float
    displacement_m: np.ndarray
    quality: np.ndarray
    refractive_index: float
    accuracy: Accuracy = field(default_factory=Accuracy)


@dataclass(frozen=True)
class SpotBlock:
    """Samples of one position-sensitive detector, oldest first.

    ``x_m``, ``y_m`` (n,) along u and v of the setup; ``intensity_V`` (n,) the sum signal.
    A sample without light has NaN positions and its intensity as measured.  ``accuracy`` of the stamps.
    ``angle_rad`` (n, 2): azimuth and elevation of a steered beam, where they are measured.
    """

    stamp_ns: int
    period_s: float
    x_m: np.ndarray
    y_m: np.ndarray
    intensity_V: np.ndarray
    accuracy: Accuracy = field(default_factory=Accuracy)
    angle_rad: np.ndarray | None = None


class Interferometer(Protocol):
    """Displacement of one or more beams."""

    def connect(self) -> None:
        """Open the connection and start measuring; :class:`DeviceError` if that fails."""

    def close(self) -> None:
        """Close the connection; does nothing when it is closed."""

    def select_setup(self, name: str) -> None:
        """Route the beams to a setup (optical switch); may do nothing."""

    def reset(self) -> None:
        """Make the present distance the zero of every beam."""

    def read_block(self, samples: int, period_s: float) -> DisplacementBlock:
        """Take ``samples`` samples ``period_s`` apart; blocks about their product."""

    def shift_time(self, step_s: float) -> None:
        """The host's clock has jumped by ``step_s`` [s] since the last block."""

    def environment(self) -> dict[str, float]:
        """``air_temperature`` [°C], ``air_pressure`` [Pa], ``humidity`` [0..1]; absent: no sensor.

        ``scale_temperature/x`` (``/y``, ``/z``) [°C] where the instrument knows them.
        """


class SpotSensor(Protocol):
    """Spot on a position-sensitive detector."""

    def connect(self) -> None:
        """Open the connection; :class:`DeviceError` if that fails."""

    def close(self) -> None:
        """Close the connection; does nothing when it is closed."""

    def read_block(self, samples: int, period_s: float) -> SpotBlock:
        """Take ``samples`` samples ``period_s`` apart; blocks about their product."""

    def shift_time(self, step_s: float) -> None:
        """The host's clock has jumped by ``step_s`` [s] since the last block."""


class SteeredSpotSensor(SpotSensor, Protocol):
    """A detector whose box also turns the beam."""

    def steer(self, angles: np.ndarray) -> None:
        """Command azimuth and elevation (2,) [rad]."""


class MotionController(Protocol):
    """A machine's control."""

    def connect(self) -> None:
        """Open the connection; :class:`DeviceError` if that fails."""

    def close(self) -> None:
        """Close the connection; the machine keeps doing what it does."""

    def make_ready(self) -> None:
        """Leave emergency stop, switch on, home, idle in MDI; waits until it is so."""

    def select_setup(self, name: str) -> None:
        """Have the mirror mounted for a setup: an M-code, or the operator's word."""

    def move(self, position_m: np.ndarray, feed_m_s: float) -> None:
        """Start towards ``position_m`` (3,) [m] in a straight line; returns at once."""

    def in_position(self) -> bool:
        """Whether the last move is over and the axes stand within the control's window."""

    def position(self) -> np.ndarray:
        """Actual position (3,) [m], machine frame."""

    def stop(self) -> None:
        """Abort the motion; returns when the machine stands still."""

    def state(self) -> dict[str, object]:
        """What the control says of itself: ``estop``, ``on``, ``homed``, ``idle``, ``mode``."""
