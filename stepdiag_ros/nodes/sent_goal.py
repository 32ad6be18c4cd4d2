"""A goal as its client keeps it: whoever has it may be silent, or may have been replaced.

That a sequencer says nothing does not mean that it has ended: it, this client, or the computer of either may have
stood still. So it is asked for the goal's result anew, which is what the protocol of actions has for it: one that was
started again answers at once that it knows no such goal; one that is silent answers when it goes on; of one that has
ended only the silence is known (decision 0345).
"""

import threading
import time
from collections.abc import Callable

from action_msgs.msg import GoalStatus
from rclpy.task import Future

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.patience import Patience

#: One that has not spoken of the goal for so long is asked whether it knows it, and again so often.
DOUBT_S, ASK_S = 3.0, 2.0
#: Silence that is worth a word, and silence that ends a calibration.
SILENT_S, GIVE_UP_S = 8.0, 100.0


class LostGoal(StepdiagError):
    """A sequencer answers that knows nothing of the goal: the one that had it has ended."""


class SentGoal:
    """A goal that ``server`` has accepted; ``ask(answered)`` requests its result and gives the answer's future to
    ``answered``; it does not wait.

    ``result`` is done when the goal has ended.  :meth:`look` is to be called often by who waits for it, :meth:`spoke`
    whenever a word of the goal came, by any thread.  ``silences`` are the lengths [s] of those that ended.
    """

    def __init__(self, server: str, ask: Callable[[Callable[[Future], None]], object]):
        self._server, self._ask = server, ask
        self.result = Future()
        self.silences: list[float] = []
        self._lock = threading.Lock()
        self._unknown = threading.Event()
        self._spoke_s, self._patience = time.monotonic(), Patience(GIVE_UP_S)
        self._request()

    @property
    def silent_s(self) -> float:
        """Since when nothing was heard of the goal."""
        return time.monotonic() - self._spoke_s

    def spoke(self, at_s: float) -> None:
        """A word of the goal came, then (monotonic)."""
        with self._lock:
            silent_s = at_s - self._spoke_s
            if silent_s > SILENT_S:
                self.silences.append(silent_s)
            if silent_s > 0.0:
                self._spoke_s = at_s
                self._patience.begin_anew()

    def look(self) -> None:
        """Ask where there is doubt; :class:`LostGoal` where the goal is not known any more, :class:`StepdiagError`
        after a silence too long."""
        if self._unknown.is_set():
            raise LostGoal(f'{self._server} has ended, and the one that runs now knows nothing of the calibration; '
                           'begin it anew')
        silent_s = self.silent_s
        with self._lock:
            exhausted = self._patience.over()
        if exhausted:
            raise StepdiagError(f'{self._server} has been silent for {silent_s:.0f} s: it has ended, or hangs, or '
                                'cannot be reached; the calibration is given up')
        if silent_s > DOUBT_S and time.monotonic() - self._asked_s > ASK_S:
            self._request()

    def _request(self) -> None:
        self._asked_s = time.monotonic()
        self._ask(self._answered)

    def _answered(self, answer: Future) -> None:
        if answer.cancelled() or answer.exception() is not None:
            return
        if answer.result().status == GoalStatus.STATUS_UNKNOWN:
            self._unknown.set()
            return
        self.spoke(time.monotonic())
        if not self.result.done():
            self.result.set_result(answer.result())


def silence_words(silences: list[float]) -> str:
    """What a result's message says of them."""
    return ''.join(f'; the sequencer was silent for {silent_s:.0f} s' for silent_s in silences)
