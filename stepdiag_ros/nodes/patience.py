"""Waiting, counted in the time in which the one who waits could have heard.

Who waits looks again and again.  Where the computer, or the one who waits, has stood still between two looks, nobody
could have answered and nobody could have heard: so a look stands for at most twice its period, however late it is.
On a computer that is busy with other work patience lasts longer in the same way.
"""

import time
from collections.abc import Callable

#: Between two looks of :meth:`Patience.until`.
PAUSE_S = 0.05


class Patience:
    """``limit_s`` [s] of waiting by one who calls :meth:`over` every ``period_s`` [s] until it is true.

    ``period_s`` includes what a look waits for in itself, e.g. an answer: that time counts too.
    """

    def __init__(self, limit_s: float, period_s: float = 0.1, now: Callable[[], float] = time.monotonic):
        self._limit_s, self._longest_s, self._now = limit_s, 2.0 * period_s, now
        self.begin_anew()

    def begin_anew(self) -> None:
        """A sign of life has come."""
        self.waited_s, self._looked_s = 0.0, self._now()

    def over(self) -> bool:
        """Whether it is exhausted, with the time since the last look."""
        now = self._now()
        self.waited_s += min(now - self._looked_s, self._longest_s)
        self._looked_s = now
        return self.waited_s > self._limit_s

    def until(self, ready: Callable[[], object], meanwhile: Callable[[], object] = lambda: None) -> bool:
        """Whether ``ready()`` comes true in time; ``meanwhile()`` is called between two looks, what it raises ends the
        waiting."""
        while not ready():
            if self.over():
                return False
            meanwhile()
            time.sleep(PAUSE_S)
        return True
