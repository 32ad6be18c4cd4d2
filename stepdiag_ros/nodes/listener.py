"""A node that keeps the log of its machine while it is being made.

The solver and the gap monitor receive the same messages as the recorder, keep them in a
:class:`LogAssembler`, and learn from the action's status when a calibration has ended.
Activating begins a new log.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from action_msgs.msg import GoalStatus, GoalStatusArray
from rclpy.serialization import deserialize_message

from stepdiag_msgs.msg import RecorderStatus, Step
from stepdiag_ros.bag.reader import build_log
from stepdiag_ros.bag.schemas import DESCRIPTION, STEP, TOPICS, split_topic
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.bag.tables import collect
from stepdiag_ros.model.log import DONE, CalibrationLog, ScalarSeries
from stepdiag_ros.nodes.assembler import LogAssembler
from stepdiag_ros.nodes.base import OK, WARN, Health, StepdiagNode, reliable
from stepdiag_ros.nodes.idle import IdleFilter
from stepdiag_ros.nodes.memory import give_back
from stepdiag_ros.nodes.stamps import ns_of
from stepdiag_ros.nodes.step_sequencer import ACTION
from stepdiag_ros.nodes.subscription import RECEIVED_TOPICS, RawSubscription, Received

RECORDER = 'recorder/status'
#: Longest wait for the recorder's first word: it speaks five times a second, but has to be found first.
WORD_S = 10.0
#: Longest wait for what is still on its way.
SETTLE_S = 5.0


def _on_their_way(log: CalibrationLog) -> bool:
    """Whether what was read before the last step's end may still be to come: a topic keeps its order, so that only what
    was read after that end says that nothing is.  For an environment that is read more seldom than one waits, only the
    reading that is due is waited for."""
    last = log.steps.time_ns[-1]
    samples = [s.time_ns for s in (log.displacement, log.spot, log.beam_angle) if len(s)]
    return any(times[-1] < last for times in samples) or any(_is_due(s, last) for s in log.environment.values())


def _is_due(readings: ScalarSeries, last_ns: int) -> bool:
    if readings.later or len(readings.time_ns) < 2:
        return False
    interval_ns = np.median(np.diff(readings.time_ns))
    return bool(interval_ns < SETTLE_S * 1e9 or readings.time_ns[-1] + interval_ns < last_ns)


class ListenerNode(StepdiagNode):
    """Keeps the log; ``calibration_done`` is called in a thread of its own."""

    def __init__(self, name: str):
        super().__init__(name)
        self.create_subscription(GoalStatusArray, f'{ACTION}/_action/status', self._on_status,
                                 reliable(10, latched=True))
        self._missed = ''        # the bag of which this node has missed the beginning
        self._asked_ns = 0       # since when the recorder's word is waited for; 0: it has come
        self._waited = False     # whoever wanted the log has waited for it once in vain
        self._keeping = threading.Lock()
        self._busy = threading.Lock()
        self._begin_log()
        self._subscription: RawSubscription | None = None
        self._running: set[bytes] = set()
        # Of the newest goal: its number, whether it has succeeded, and whether that has been acted on.
        self._newest: tuple[bytes, bool] = (b'', False)
        self._told: set[bytes] = set()
        self._telling = threading.Lock()

    @contextmanager
    def working(self) -> Iterator[None]:
        """One computation at a time, whose memory goes back to the system when it is over."""
        with self._busy:
            try:
                yield
            finally:
                give_back()

    @property
    def is_working(self) -> bool:
        """A computation is under way."""
        return self._busy.locked()

    def calibration_done(self) -> None:
        """A calibration has succeeded while this node was active."""

    def activate(self) -> None:
        self._begin_log()
        self._subscription = RawSubscription(self, TOPICS | {RECORDER: 'stepdiag_msgs/msg/RecorderStatus'}, self._keep,
                          latched=(DESCRIPTION,))
        self._subscription.start()

    def _begin_log(self) -> None:
        self._assembler = LogAssembler(self.get_namespace())
        self._filter = IdleFilter(self._assembler.add, Step)
        self._missed, self._asked_ns, self._waited = '', time.time_ns(), False

    def deactivate(self) -> None:
        if self._subscription is not None:
            self._subscription.close()

    def cleanup(self) -> None:
        self.deactivate()
        self._subscription = None

    def _keep(self, received: Received) -> None:
        try:
            self._take(received)
        except Exception as error:
            # Anybody on this computer may send anything: what is none of the topic's messages ends no log.
            self.callback_failed(error)

    def _take(self, received: Received) -> None:
        if received.topic == RECORDER:
            self._on_recorder(deserialize_message(received.cdr, RecorderStatus))
            return
        with self._keeping:
            self._filter.add(received.topic, received.cdr, received.sequence)

    def _on_status(self, array: GoalStatusArray) -> None:
        for status in array.status_list:
            goal = bytes(status.goal_info.goal_id.uuid)
            if status.status in (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING):
                self._running.add(goal)
            elif goal in self._running and status.status != GoalStatus.STATUS_CANCELING:
                self._running.discard(goal)
                if status.status == GoalStatus.STATUS_SUCCEEDED:
                    self._tell(goal)
        if array.status_list:
            newest = max(array.status_list, key=lambda status: ns_of(status.goal_info.stamp))
            self._newest = bytes(newest.goal_info.goal_id.uuid), newest.status == GoalStatus.STATUS_SUCCEEDED

    def _tell(self, goal: bytes) -> None:
        """A goal has succeeded; once."""
        with self._telling:
            if goal in self._told or self.state != 'active':
                return
            self._told.add(goal)
        threading.Thread(target=self.calibration_done, name='done', daemon=True).start()

    def _tell_what_was_missed(self) -> None:
        """A node that was started again may find that the calibration has ended without it."""
        goal, succeeded = self._newest
        if self._missed and succeeded:
            self._tell(goal)

    def _on_recorder(self, status: RecorderStatus) -> None:
        """The first word after this node was activated tells whether it has come too late."""
        if self._asked_ns and ns_of(status.header.stamp) > self._asked_ns and status.recording:
            self._asked_ns = 0
            held = dict(zip(status.topics, status.received, strict=True)).get(self.resolve_topic_name(STEP), 0)
            if held > self.steps_received():
                self._missed = status.bag
                self.get_logger().info(f'runs before are read from {status.bag}')
        self._tell_what_was_missed()     # with every word of the recorder, for the node may not be active yet

    def _log_of_bag(self, bag: str) -> CalibrationLog:
        """The log of a bag that is still being written: its last bytes may be missing."""
        source = open_bag(bag)
        space = self.get_namespace().rstrip('/')
        tables = collect(source, lambda topic: (split_topic(topic) or ('',))[0] == space, tolerant=True)
        return build_log(replace(source, counts=None), tables, space)

    def steps_received(self) -> int:
        """Step events kept so far."""
        return self._assembler.count(STEP)

    def log_so_far(self) -> CalibrationLog:
        """The log as it is; :class:`StepdiagError` if there is none yet.

        A node that was started again has missed the runs before; the recorder's bag has them all.
        """
        end = time.monotonic() + WORD_S
        while self._asked_ns and not self._waited and time.monotonic() < end:
            time.sleep(0.02)
        self._waited = True     # it counts whenever it comes
        if self._missed:
            return self._log_of_bag(self._missed)
        with self._keeping:
            kept = self._assembler.copy()
        return kept.build()

    def whole_log(self) -> CalibrationLog:
        """The log, once the last dwell has ended and its samples have arrived too: topics do not wait for each other,
        and a run's result may be received before its last step."""
        end = time.monotonic() + SETTLE_S
        while True:
            log = self.log_so_far()
            if (log.steps.phase[-1] == DONE and not _on_their_way(log)) or time.monotonic() > end:
                return log
            time.sleep(0.05)

    def health_of_listening(self) -> Health:
        """Whether what it keeps arrives."""
        if self._subscription is None or self.state != 'active':
            return Health(OK, self.state)
        lost = sum(self._subscription.lost.values())
        values = {'messages': len(self._assembler), 'lost': lost, 'steps': self.steps_received(),
                  RECEIVED_TOPICS: self._subscription.received_topics}
        if self._subscription.failure is not None:
            return Health(WARN, f'receives nothing more: {self._subscription.failure}', values)
        if lost:
            return Health(WARN, f'{lost} messages were lost', values)
        return Health(OK, 'listening', values)
