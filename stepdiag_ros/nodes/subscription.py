"""Raw subscriptions, which keep the sequence numbers.

A thread takes raw messages straight from the middleware, in place of an executor:
the events executor hands a callback no sequence number (decision 0031), no executor
promises an order, and what is taken here waits behind no other callback.
"""

import importlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import rclpy
from rclpy.node import Node

from stepdiag_ros.bag.schemas import OF_SEVERAL
from stepdiag_ros.nodes.base import DEPTH, overridable, reliable

PERIOD_S = 0.005
RECEIVED_TOPICS = 'received_topics'


@dataclass(frozen=True)
class Received:
    """One message as it came: ``cdr`` bytes, times in ns since the epoch, publisher's count."""

    topic: str
    cdr: bytes
    received_ns: int
    published_ns: int
    sequence: int


def message_class(name: str) -> type:
    """``stepdiag_msgs/msg/Step`` -> the Python class."""
    package, kind, last = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), last)


class RawSubscription:
    """Receives ``topics`` (relative name -> type) below ``node``'s namespace.

    From :meth:`start` on ``callback`` is called with each :class:`Received`, in its own thread, topics as
    given, messages of a topic in order.  ``latched`` names the topics whose last message is wanted although it
    was sent before.  The subscriptions belong to a second node, ``<name>_subscriptions``, which no executor sees;
    parameters
    ``qos_overrides.<topic>.subscription.…`` of that node change their quality.
    """

    def __init__(self, node: Node, topics: Mapping[str, str], callback: Callable[[Received], None],
                 latched: tuple[str, ...] = (), depth: int = DEPTH):
        self._callback = callback
        self._node = rclpy.create_node(f'{node.get_name()}_subscriptions', context=node.context,
                                       namespace=node.get_namespace(), enable_rosout=False,
                                       start_parameter_services=False)
        self._subscriptions = []
        for topic, type_name in topics.items():
            self._subscriptions.append((topic, self._node.create_subscription(
                message_class(type_name), topic, self._never,
                reliable(depth, latched=topic in latched), raw=True,
                qos_overriding_options=overridable())))
        self._stop = threading.Event()
        self._next: dict[str, int] = {}
        self._lock = threading.Lock()
        self._received = dict.fromkeys(topics, 0)
        self._lost = dict.fromkeys(topics, 0)
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._listen, name='raw subscription', daemon=True)

    def start(self) -> None:
        """Begin to hand on what was received, from when this object was made."""
        self._thread.start()

    @property
    def received(self) -> dict[str, int]:
        """Messages received so far by topic."""
        with self._lock:
            return dict(self._received)

    @property
    def received_topics(self) -> str:
        """Topics of which a message was received, as diagnostics report them under :data:`RECEIVED_TOPICS`."""
        return ' '.join(topic for topic, number in self.received.items() if number)

    @property
    def lost(self) -> dict[str, int]:
        """Messages missing by their sequence numbers, by topic."""
        with self._lock:
            return dict(self._lost)

    def resolved(self, topic: str) -> str:
        """The full name of a relative topic, remappings applied."""
        return self._node.resolve_topic_name(topic)

    def publishers(self, topic: str) -> list:
        """What publishes a topic, with quality of service."""
        return self._node.get_publishers_info_by_topic(self.resolved(topic))

    def close(self, drain: bool = True) -> None:
        """Stop receiving; with ``drain`` what has already arrived is still handed on."""
        if self._stop.is_set():
            return
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if drain and self.failure is None:
            self._take_all()
        self._node.destroy_node()

    def _listen(self) -> None:
        while not self._stop.wait(PERIOD_S):
            try:
                self._take_all()
            except Exception as error:
                self.failure = error
                return

    def _take_all(self) -> None:
        for topic, subscription in self._subscriptions:
            while True:
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                cdr, info = taken
                sequence = int(info['publication_sequence_number'] or 0)
                self._count(topic, sequence)
                self._callback(Received(topic, cdr, info['received_timestamp'],
                                     info['source_timestamp'], sequence))

    def _count(self, topic: str, sequence: int) -> None:
        with self._lock:
            expected = self._next.get(topic, sequence)
            # A publisher that was started anew counts from 1: what it sent before its first
            # message was received is no loss.  Where several publish, a bag's reader knows them apart.
            if sequence > expected and topic not in OF_SEVERAL:
                self._lost[topic] += sequence - expected
            self._next[topic] = sequence + 1
            self._received[topic] += 1

    @staticmethod
    def _never(_message: bytes) -> None:
        raise AssertionError('a raw subscription is not to be spun')
