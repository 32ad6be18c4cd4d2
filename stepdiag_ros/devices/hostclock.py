"""Time of this computer whose durations no step of the system's clock disturbs.

Stamps are the system's time.  Whoever sets that clock, by hand or by a time service that finds it far
off, must not make a wait last an hour or a block of samples end before it began.  So time is the monotonic
clock plus an offset; the offset follows the system's clock only when :meth:`HostClock.follow` is called,
between two blocks or stops, and a step is returned to the caller, who writes it into the log.
"""

import threading
import time

STEP_S = 0.010
"""A change of the offset between two looks that is a step; less is a clock that is being steered (NTP
slews by at most 500 ppm, 5 ms in ten seconds)."""
LOOK_S = 0.0005
"""A look that took longer was interrupted and is taken again."""


def _offset_ns() -> int:
    """System time minus monotonic time [ns], of the least disturbed of some looks."""
    best = None
    for _ in range(10):
        before = time.monotonic_ns()
        system = time.time_ns()
        after = time.monotonic_ns()
        if best is None or after - before < best[0]:
            best = after - before, system - (before + after) // 2
        if best[0] < LOOK_S * 1e9:
            break
    return best[1]


class HostClock:
    """One per process; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._offset_ns = _offset_ns()

    def now_ns(self) -> int:
        """Nanoseconds since the epoch."""
        return time.monotonic_ns() + self._offset_ns

    def now(self) -> float:
        """Seconds since the epoch."""
        return self.now_ns() * 1e-9

    def follow(self) -> float:
        """Follow the system's clock; the step [s] that it has made since the last call, 0.0: none."""
        with self._lock:
            offset_ns = _offset_ns()
            step_s = (offset_ns - self._offset_ns) * 1e-9
            self._offset_ns = offset_ns
        return step_s if abs(step_s) > STEP_S else 0.0


HOST = HostClock()
