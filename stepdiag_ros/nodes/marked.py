"""Publishers of stamped messages that say when the clock behind their stamps was set.

The reader of a log puts stamps right by what is published on ``clock_step``
(:mod:`stepdiag_ros.bag.clocksteps`); for that each publisher counts its messages.
"""

from typing import Any

from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Header

from stepdiag_msgs.msg import ClockStep
from stepdiag_ros.bag.schemas import CLOCK_STEP
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.nodes.base import overridable, reliable
from stepdiag_ros.nodes.stamps import stamp_of


class Marked:
    """The stamped topics of one node; ``prefix`` is the machine's where a node serves several."""

    def __init__(self, node: LifecycleNode):
        self._node = node
        self._steps: dict[str, Any] = {}
        self._topics: list[MarkedPublisher] = []

    def publisher(self, kind: type, topic: str, prefix: str = '') -> 'MarkedPublisher':
        """A lifecycle publisher of ``prefix + topic``, reliable and deep."""
        if prefix not in self._steps:
            self._steps[prefix] = self._create(ClockStep, prefix + CLOCK_STEP)
        made = MarkedPublisher(self._create(kind, prefix + topic), topic, prefix)
        self._topics.append(made)
        return made

    def follow_clock(self) -> float:
        """Follow the system's clock; a step [s] is announced and returned, 0.0: there was none.

        To be called by the thread that publishes, between two messages.
        """
        step_s = HOST.follow()
        if step_s:
            self._node.get_logger().warning(f'the system clock was set by {step_s:+.3f} s; '
                                            'the log says so, durations are not touched')
            for topic in self._topics:
                self._steps[topic.prefix].publish(ClockStep(
                    header=Header(stamp=stamp_of(HOST.now_ns()), frame_id=self._node.get_name()),
                    step=step_s, topic=topic.name, published=topic.published))
        return step_s

    def _create(self, kind: type, topic: str) -> Any:
        return self._node.create_lifecycle_publisher(kind, topic, reliable(),
                                                     qos_overriding_options=overridable())


class MarkedPublisher:
    """A lifecycle publisher that counts what it has published."""

    def __init__(self, publisher: Any, name: str, prefix: str):
        self._publisher, self.name, self.prefix = publisher, name, prefix
        self.published = 0

    def publish(self, message: Any) -> None:
        if self._publisher.is_activated:
            self.published += 1
            self._publisher.publish(message)
