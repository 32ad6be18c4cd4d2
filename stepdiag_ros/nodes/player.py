"""Publishes a log's messages on their topics, with ``/clock``."""

import time

from stepdiag_ros.nodes import base

# isort: split
import rclpy
from rclpy.duration import Duration
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from stepdiag_ros.bag.schemas import DESCRIPTION, TOPICS
from stepdiag_ros.nodes.replaying import Message
from stepdiag_ros.nodes.stamps import stamp_of
from stepdiag_ros.nodes.subscription import message_class


class Player:
    """Publishers of all contract topics below a namespace; a context manager."""

    def __init__(self, namespace: str):
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('replay', namespace=namespace or '/', context=self._context,
                                       start_parameter_services=False)
        self._publishers = {
            topic: self._node.create_publisher(
                message_class(kind), topic, base.reliable(latched=topic == DESCRIPTION),
                qos_overriding_options=base.overridable())
            for topic, kind in TOPICS.items()}
        self._clock = self._node.create_publisher(Clock, '/clock', 10)

    def __enter__(self) -> 'Player':
        return self

    def __exit__(self, *_exception) -> None:
        base.end(self._node, self._context)

    def wait_for_listeners(self, timeout_s: float) -> bool:
        """Whether every topic that has to be received has a listener before the time is over."""
        end = time.monotonic() + timeout_s
        needed = [p for t, p in self._publishers.items() if not t.startswith('environment/')]
        while not all(p.get_subscription_count() for p in needed):
            if time.monotonic() > end:
                return False
            time.sleep(0.05)
        return True

    def play(self, message: Message) -> None:
        """Publish one message as it is, the clock before it."""
        if message.stamp_ns >= 0:
            self._clock.publish(Clock(clock=stamp_of(message.stamp_ns)))
        self._publishers[message.topic].publish(message.cdr)

    def settle(self, timeout_s: float = 10.0) -> bool:
        """Wait until reliable readers have acknowledged; whether all did."""
        late = [p for p in self._publishers.values()
                if not p.wait_for_all_acked(Duration(seconds=timeout_s))]
        return not late
