"""When samples were taken: polls on a grid of times, and the clock of an instrument matched with ours.

A reading was taken after its request was sent and before the answer had arrived, whatever else the computer did
meanwhile: the middle of the two is its time, half their distance by how much that can be off (Cristian, *Probabilistic
clock synchronization*, Distributed Computing 3, 1989).  Durations are counted by the monotonic clock, stamps by the
system's.
"""

import os
import time
from dataclasses import dataclass, field

import numpy as np

PAUSE_S = 0.5
"""After a pause of so much nothing was due: it is not counted as missed."""
GAP_PERIODS = 10.0
"""A block does not span a pause of more than so many of its sample periods."""
DRIFT = 5.0e-5
"""Rate [s/s] by which two quartz clocks drift apart at most (LabJack T7: 20 ppm typical)."""


def go_first() -> bool:
    """Whether the calling thread may go before all work that is not in real time (``SCHED_RR``).

    The system allows it to root and to users with a limit ``rtprio``; what is polled on time does so little that others
    do not notice.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except (AttributeError, OSError):
        return False
    return True


@dataclass(frozen=True)
class Accuracy:
    """When a block's samples were taken.

    ``taken_ns`` (n,) int: after the block's stamp; empty: as the block's period says.  ``uncertainty_ns`` (n,), or (1,)
    for all: by how much that can be off at most.  ``missed``: samples that were due before them and not taken.
    """

    taken_ns: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    uncertainty_ns: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    missed: int = 0


class Grid:
    """Times at which samples are due; those that have passed by the time we wake are missed, not made up for."""

    def __init__(self) -> None:
        self._due: float | None = None   # monotonic time of the next sample

    def forget(self) -> None:
        """What comes next was not due meanwhile."""
        self._due = None

    def wait(self, period_s: float, most: int = 1) -> tuple[int, int]:
        """Wait until samples are due: how many (at most ``most``, closer together than we can wake), and how many
        were missed."""
        now = time.monotonic()
        if self._due is None or not -PAUSE_S < now - self._due < PAUSE_S:
            self._due = now
        last = self._due + (most - 1) * period_s
        if last > now:
            time.sleep(last - now)
            now = time.monotonic()
        passed = int((now - self._due) / period_s + 1e-6) + 1
        self._due += passed * period_s
        return min(passed, most), max(passed - most, 0)


def times_of_polls(asked_s: list[float], answered_s: list[float], period_s: float, missed: int, before_ns: int
                   ) -> tuple[int, float, Accuracy]:
    """Stamp [ns], sample period [s] and accuracy of a block whose polls were sent and answered at such times (n,).

    Stamp and period describe evenly spaced samples, none of which is later than it was taken: a reader that knows
    nothing else finds no sample in a dwell that was taken before it.  None is earlier than ``before_ns``, when the
    last sample of the block before was taken (0: there is none), however long a single answer was on its way.
    """
    asked, answered = np.array(asked_s), np.maximum(answered_s, asked_s)
    origin = int(asked[0] * 1e9)
    low, high = (np.rint((t - asked[0]) * 1e9).astype(np.int64) for t in (asked, answered))
    # Requests that went off together were worked off one after the other.
    taken = np.maximum.accumulate((low + high) // 2 - np.arange(len(low))) + np.arange(len(low))
    count = len(taken)
    mean_ns = (taken[-1] - taken[0]) / (count - 1) if count > 1 else 0.0
    if mean_ns < 1e3:
        mean_ns = period_s * 1e9
    shift = int(np.floor(np.min(taken - np.arange(count) * mean_ns)))
    earliest = min(before_ns + 1 - origin, int(taken[0]))
    if before_ns and shift < earliest:
        shift = earliest
        mean_ns = min(mean_ns, *((taken[1:] - shift) / np.arange(1, count)))
    half = (high - low + 1) // 2 + np.abs(taken - (low + high) // 2)
    return origin + shift, mean_ns * 1e-9, Accuracy(taken - shift, half, missed)


class ClockMatch:
    """The system's time of another clock's readings, from exchanges that enclose each reading.

    Each exchange bounds the difference of the clocks from both sides; what all of them allow, widened by the rate at
    which the clocks may drift apart, is known whatever delayed single ones.
    """

    def __init__(self) -> None:
        self._low, self._high, self._at = -np.inf, np.inf, 0.0

    def add(self, asked_s: float, other_s: float, answered_s: float) -> None:
        """The other clock showed ``other_s`` some time between ``asked_s`` and ``answered_s`` [s] of ours."""
        widened = DRIFT * max(other_s - self._at, 0.0)
        low, high = asked_s - other_s, answered_s - other_s
        if low > self._high + widened or high < self._low - widened:
            self._low, self._high = low, high   # one of the clocks was set: begin anew
        else:
            self._low, self._high = max(low, self._low - widened), min(high, self._high + widened)
        self._at = other_s

    def shift(self, step_s: float) -> None:
        """Our clock was set by ``step_s`` [s]."""
        self._low, self._high = self._low + step_s, self._high + step_s

    @property
    def known(self) -> bool:
        return np.isfinite(self._high - self._low)

    @property
    def may_be_one(self) -> bool:
        """Whether what is known allows that the other clock is ours."""
        return self._low <= 0.0 <= self._high

    def ours(self, other_s: float) -> float:
        """Our time [s] at which the other clock shows ``other_s``."""
        return other_s + 0.5 * (self._low + self._high)

    def uncertainty(self, other_s: float) -> float:
        """By how much [s] :meth:`ours` can be off."""
        return 0.5 * (self._high - self._low) + DRIFT * abs(other_s - self._at)
