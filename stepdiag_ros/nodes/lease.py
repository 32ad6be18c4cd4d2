"""A lease as it is counted by one who waits for its renewals and may itself stand still.

Renewals that have arrived and have not been looked at yet are no silence. So only the time counts in which the
waiting node has listened: its executor ticks between two messages, and a tick stands for at most twice its period,
however late it is. A node that was stopped, or whose computer was, or that had no processor, takes nobody for lost on
waking up.
"""

import threading
import time
from collections.abc import Callable

TICK_S = 0.25


class Lease:
    """``renew`` and ``tick`` are called by the thread that receives, ``tick`` every ``TICK_S``; ``silent_s`` by any."""

    def __init__(self, now: Callable[[], float] = time.monotonic):
        self._now = now
        self._lock = threading.Lock()
        self._silent_s, self._ticked_s = 0.0, now()

    def renew(self) -> None:
        """A sign of life has come."""
        with self._lock:
            self._silent_s = 0.0

    def tick(self) -> None:
        """What has arrived until now has been looked at."""
        with self._lock:
            now = self._now()
            self._silent_s += min(now - self._ticked_s, 2.0 * TICK_S)
            self._ticked_s = now

    @property
    def silent_s(self) -> float:
        """How long [s] was listened without a sign of life."""
        with self._lock:
            return self._silent_s
