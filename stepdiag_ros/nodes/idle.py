"""What of an endless stream is worth keeping: samples while the machine is measured, and a little before.

Instruments deliver day and night; a node that keeps the log in memory would grow by megabytes a minute
while nothing is measured.  Samples while no stop is under way wait in a ring and are only kept when a
run begins soon after them.  Environment readings are few and are averaged over a whole log: an hour of
them is kept while idle.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping

from rclpy.serialization import deserialize_message

from stepdiag_ros.bag.schemas import CLOCK_OFFSET, CLOCK_STEP, DESCRIPTION, STEP
from stepdiag_ros.model.log import DONE

#: Samples so long before a run's first step, and so long after its last, are kept.
LEAD_S, TAIL_S = 10.0, 10.0
ENVIRONMENT_LEAD_S = 3600.0
#: A stop that is under way longer has lost its sequencer.
LONGEST_STOP_S = 4800.0


class IdleFilter:
    """Hands on to ``keep(topic, cdr, sequence)`` what belongs to runs, in order within each topic.

    ``step_class``: the message type of ``sequencer/step``.  ``clock``: monotonic seconds.
    """

    def __init__(self, keep: Callable[[str, bytes, int], None], step_class: type,
                 clock: Callable[[], float] = time.monotonic):
        self._keep, self._step_class, self._clock = keep, step_class, clock
        self._waiting: dict[str, deque[tuple[float, bytes, int]]] = {}
        self._until_s = float('-inf')    # what comes before this is kept at once

    def add(self, topic: str, cdr: bytes, sequence: int) -> None:
        """One message of a relative contract topic, as it came."""
        now = self._clock()
        if topic == STEP:
            self._release(now)
            under_way = deserialize_message(cdr, self._step_class).phase != DONE
            self._until_s = now + (LONGEST_STOP_S if under_way else TAIL_S)
        if topic in (STEP, DESCRIPTION, CLOCK_STEP, CLOCK_OFFSET) or now < self._until_s:
            self._keep(topic, cdr, sequence)
            return
        waiting = self._waiting.setdefault(topic, deque())
        waiting.append((now, cdr, sequence))
        while waiting and now - waiting[0][0] > self._lead(topic):
            waiting.popleft()

    def waiting(self) -> Mapping[str, int]:
        """Messages by topic that wait for a run to begin."""
        return {topic: len(messages) for topic, messages in self._waiting.items()}

    def _release(self, now: float) -> None:
        for topic, messages in self._waiting.items():
            for came, cdr, sequence in messages:
                if now - came <= self._lead(topic):
                    self._keep(topic, cdr, sequence)
        self._waiting.clear()

    @staticmethod
    def _lead(topic: str) -> float:
        return ENVIRONMENT_LEAD_S if topic.startswith('environment/') else LEAD_S
