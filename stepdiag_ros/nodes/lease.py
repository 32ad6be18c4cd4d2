"""A lease as it is counted by one who waits for its renewals and may itself stand still.

Renewals that have arrived and have not been looked at yet are no silence. So only the time counts in which the
waiting node has listened (:mod:`stepdiag_ros.nodes.patience`): its executor ticks between two messages. A node that was
stopped, or whose computer was, or that had no processor, takes nobody for lost on waking up.
"""

import math
import threading
import time
from collections.abc import Callable

from stepdiag_ros.nodes.patience import Patience

TICK_S = 0.25


class Lease:
    """``renew`` and ``tick`` are called by the thread that receives, ``tick`` every ``TICK_S``; ``silent_s`` by any."""

    def __init__(self, now: Callable[[], float] = time.monotonic):
        self._lock = threading.Lock()
        self._listened = Patience(math.inf, TICK_S, now)

    def renew(self) -> None:
        """A sign of life has come."""
        with self._lock:
            self._listened.begin_anew()

    def tick(self) -> None:
        """What has arrived until now has been looked at."""
        with self._lock:
            self._listened.over()

    @property
    def silent_s(self) -> float:
        """How long [s] was listened without a sign of life."""
        with self._lock:
            return self._listened.waited_s
