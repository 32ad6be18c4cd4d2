"""The clocks of two computers compared while a calibration runs.

The sequencer says what time it is (``sequencer/clock``), each driver answers with its own (``interferometer/clock``,
``psd/clock``).  The driver's clock was read between question and answer: each exchange bounds the difference of the
two clocks from both sides, and the least delayed ones bound it closely whatever load delays the others
(:class:`~stepdiag_ros.devices.timing.ClockMatch`).  What follows goes into the log as ``clock_offset``.
"""

import threading
import time
from collections import deque
from collections.abc import Iterable

from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Header

from stepdiag_msgs.msg import ClockOffset
from stepdiag_ros.bag.schemas import CLOCK_OFFSET
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.timing import ClockMatch
from stepdiag_ros.nodes.marked import Marked
from stepdiag_ros.nodes.stamps import SECOND, clock_name, ns_of, stamp_of

ASK = 'sequencer/clock'
#: Between two questions, and at least between two messages for the log.
ASK_S, RECORD_S = 0.25, 5.0
#: An answer to an older question bounds nothing that a younger one does not bound better.
OPEN_QUESTIONS = 8


def answer_of(sensor: str) -> str:
    """The topic on which a sensor's driver tells its time."""
    return f'{sensor}/clock'


def exchange_qos() -> QoSProfile:
    """What is late is of no use: none is sent again."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def answer_clock(node: LifecycleNode, sensor: str, prefix: str = '') -> None:
    """Let a driver's node answer the sequencer (of the machine below ``prefix``)."""
    publisher = node.create_publisher(TimeReference, prefix + answer_of(sensor), exchange_qos())

    def answer(asked: Header) -> None:
        publisher.publish(TimeReference(header=Header(stamp=stamp_of(HOST.now_ns()), frame_id=clock_name()),
                                        time_ref=asked.stamp, source=asked.frame_id))
    node.create_subscription(Header, prefix + ASK, answer, exchange_qos())


class ClockComparison:
    """The sequencer's side.  Thread-safe: answers come in the executor's thread, offsets are wanted in any."""

    def __init__(self, node: LifecycleNode, marked: Marked, sensors: Iterable[str]):
        self._lock = threading.Lock()
        self._ask = node.create_publisher(Header, ASK, exchange_qos())
        self._records = marked.publisher(ClockOffset, CLOCK_OFFSET)
        self._matches = {sensor: ClockMatch() for sensor in sensors}
        self._names: dict[str, str] = {}
        self._asked: deque[int] = deque(maxlen=OPEN_QUESTIONS)
        self._recorded_s = float('-inf')
        for sensor in self._matches:
            node.create_subscription(TimeReference, answer_of(sensor),
                                     lambda told, sensor=sensor: self._answered(sensor, told), exchange_qos())

    def ask(self) -> None:
        """Ask all drivers for their time."""
        now_ns = HOST.now_ns()
        with self._lock:
            self._asked.append(now_ns)
        self._ask.publish(Header(stamp=stamp_of(now_ns), frame_id=clock_name()))

    def _answered(self, sensor: str, told: TimeReference) -> None:
        answered_ns, asked_ns = HOST.now_ns(), ns_of(told.time_ref)
        with self._lock:
            if asked_ns in self._asked and asked_ns <= answered_ns:
                self._names[sensor] = told.header.frame_id
                self._matches[sensor].add(asked_ns / SECOND, ns_of(told.header.stamp) / SECOND, answered_ns / SECOND)

    def shift(self, step_s: float) -> None:
        """The sequencer's own clock was set by ``step_s`` [s]."""
        with self._lock:
            self._asked.clear()
            for match in self._matches.values():
                match.shift(step_s)

    def offset_ns(self, sensor: str) -> int:
        """By how much [ns] a sensor's clock is ahead; 0 where it has not answered yet, or may be the same clock."""
        with self._lock:
            match = self._matches.get(sensor)
            if match is None or not match.known or match.may_be_one and self._names[sensor] == clock_name():
                return 0
            return round(-match.ours(0.0) * SECOND)

    def record(self, now: bool) -> None:
        """Publish the offsets for the log, ``now`` or when some time has passed; to be called by one thread only."""
        if not now and time.monotonic() < self._recorded_s + RECORD_S:
            return
        self._recorded_s = time.monotonic()
        with self._lock:
            told = [(sensor, self._names[sensor], -match.ours(0.0), match.uncertainty(HOST.now() - match.ours(0.0)))
                    for sensor, match in self._matches.items() if match.known]
        for sensor, name, offset_s, uncertainty_s in told:
            self._records.publish(ClockOffset(
                header=Header(stamp=stamp_of(HOST.now_ns()), frame_id=sensor), clock=name, reference=clock_name(),
                offset=offset_s, uncertainty=uncertainty_s))
