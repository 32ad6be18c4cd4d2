"""A node that only looks: it subscribes, and has no publisher, service or client by which anything could be moved.

It finds the machines that run by what their nodes say of themselves and keeps of each what a viewer shows: the
description, where it stands, the last minute of both instruments, the errors, the diagnosis, which bags were finished.
"""

import re
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stepdiag_ros.nodes import base

# isort: split
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from stepdiag_msgs.msg import DisplacementMean, GapReport, GeometricErrors, RecorderStatus, SpotMean, Step
from stepdiag_ros.bag.schemas import DESCRIPTION, STEP
from stepdiag_ros.bag.shown import DISPLACEMENT_MEAN, ERRORS, ERRORS_SO_FAR, GAP, SPOT_MEAN
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description
from stepdiag_ros.nodes.overview import MULTIPLEXER, SEQUENCER, Overview, Said, overview
from stepdiag_ros.nodes.stamps import ns_of

#: Means of a minute, at twenty a second.
KEPT = 1200
#: More machines than a computer carries are not looked at in detail.
MOST = 64
BAGS = 50
#: More nodes are not remembered: anybody may write on /diagnostics.
NODES = 2000
#: A namespace as ROS takes it.
NAMESPACE = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')


@dataclass
class Seen:
    """What is known of one machine; read it under the observer's ``lock``.

    ``lengths``: (number, time [s], mean [m], scatter [m]); ``spots``: (number, time [s], x [m], y [m]); numbers rise.
    ``bags``: those with runs that were closed, in order.
    """

    namespace: str
    description: Description | None = None
    step: Step | None = None
    lengths: deque = field(default_factory=lambda: deque(maxlen=KEPT))
    spots: deque = field(default_factory=lambda: deque(maxlen=KEPT))
    count: int = 0
    errors: GeometricErrors | None = None
    gap: GapReport | None = None
    recording: str = ''
    bags: dict[str, None] = field(default_factory=dict)
    trouble: str = ''


class Observer:
    """Looks at all machines that run, or at those named in ``only``; a context manager."""

    def __init__(self, only: Sequence[str] = (), detail: bool = True):
        self.lock = threading.Lock()
        self._only = {'/' + name.strip('/') for name in only}
        self._detail = detail
        self._said: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._machines: dict[str, Seen] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node('observer', context=self._context, start_parameter_services=False, enable_rosout=False)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 200)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=base.spin, args=(self._executor, self._stop.is_set), name='observer',
                                        daemon=True)
        self._thread.start()

    def __enter__(self) -> 'Observer':
        return self

    def __exit__(self, *_exception) -> None:
        self.close()

    def close(self) -> None:
        """End the node."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        base.end(self._node, self._context, self._executor)

    def overview(self) -> Overview:
        """What runs; where machines were named, only those, and every laser."""
        now = time.monotonic()
        with self.lock:
            said = {name: Said(now - at, status.level == DiagnosticStatus.OK, status.message,
                               {v.key: v.value for v in status.values}) for name, (at, status) in self._said.items()}
        seen = overview(said)
        if not self._only:
            return seen
        return Overview(seen.lights, tuple(m for m in seen.machines if m.name in self._only),
                        tuple(t for t in seen.troubles if t.node.rpartition('/')[0] in self._only))

    def machines_that_run(self) -> list[str]:
        """Namespaces of all sequencers that have said something, those that are not looked at too."""
        with self.lock:
            return sorted(name.rpartition('/')[0] for name in self._said if name.endswith(f'/{SEQUENCER}'))

    def silent(self) -> list[str]:
        """Sequencers and multiplexers that are there and have not said anything yet, as on a busy computer."""
        there = {f'{space.rstrip("/")}/{name}' for name, space in self._node.get_node_names_and_namespaces()
                 if name in (SEQUENCER, MULTIPLEXER)}
        with self.lock:
            return sorted(there - self._said.keys())

    def machine(self, namespace: str) -> Seen | None:
        """What is known of a machine."""
        with self.lock:
            return self._machines.get(namespace)

    def bags(self) -> list[tuple[str, str]]:
        """Machine and path of every bag that was finished, the newest first."""
        with self.lock:
            return [(seen.namespace, bag) for seen in self._machines.values() for bag in seen.bags][::-1]

    # -- what is received ------------------------------------------------------------

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        found = []
        with self.lock:
            for status in array.status:
                name = '/' + status.name
                if name not in self._said and len(self._said) >= NODES:
                    continue
                self._said[name] = (time.monotonic(), status)
                space, _, node = name.rpartition('/')
                if self._detail and node == SEQUENCER and space not in self._machines and NAMESPACE.fullmatch(space) \
                        and (not self._only or space in self._only) and len(self._machines) < MOST:
                    found.append(self._machines.setdefault(space, Seen(space)))
        for seen in found:
            self._look_at(seen)

    def _look_at(self, seen: Seen) -> None:
        def subscribe(kind: type, topic: str, keep, latched: bool = False) -> None:
            def received(message) -> None:
                with self.lock:
                    keep(seen, message)
            self._node.create_subscription(kind, f'{seen.namespace}/{topic}', received,
                                           base.reliable(1 if latched else 200, latched=latched))
        subscribe(String, DESCRIPTION, _keep_description, latched=True)
        subscribe(Step, STEP, _keep_step)
        subscribe(DisplacementMean, DISPLACEMENT_MEAN, _keep_length)
        subscribe(SpotMean, SPOT_MEAN, _keep_spot)
        subscribe(GeometricErrors, ERRORS, _keep_errors, latched=True)
        subscribe(GeometricErrors, ERRORS_SO_FAR, _keep_errors, latched=True)
        subscribe(GapReport, GAP, _keep_gap, latched=True)
        subscribe(RecorderStatus, 'recorder/status', _keep_recorder)


def _keep_description(seen: Seen, message: String) -> None:
    try:
        seen.description, seen.trouble = Description.from_yaml(message.data, f'{seen.namespace}/{DESCRIPTION}'), ''
    except StepdiagError as error:
        seen.description, seen.trouble = None, str(error)


def _keep_step(seen: Seen, message: Step) -> None:
    seen.step = message


def _keep_length(seen: Seen, message: DisplacementMean) -> None:
    seen.count += 1
    seen.lengths.append((seen.count, 1e-9 * ns_of(message.header.stamp), message.displacement, message.scatter))


def _keep_spot(seen: Seen, message: SpotMean) -> None:
    seen.count += 1
    seen.spots.append((seen.count, 1e-9 * ns_of(message.header.stamp), message.x, message.y))


def _keep_errors(seen: Seen, message: GeometricErrors) -> None:
    """What rests on the latest step, on whichever topic and however late; of the same step, what is complete."""
    def rank(errors: GeometricErrors) -> tuple[int, bool]:
        return ns_of(errors.header.stamp), errors.complete
    if seen.errors is None or rank(message) >= rank(seen.errors):
        seen.errors = message


def _keep_gap(seen: Seen, message: GapReport) -> None:
    seen.gap = message


def _keep_recorder(seen: Seen, message: RecorderStatus) -> None:
    seen.recording = message.bag if message.recording else ''
    steps = dict(zip(message.topics, message.received, strict=False)).get(f'{seen.namespace}/{STEP}', 0)
    if steps and not message.recording and message.bag not in seen.bags and Path(message.bag).is_absolute():
        seen.bags[message.bag] = None
        while len(seen.bags) > BAGS:
            del seen.bags[next(iter(seen.bags))]
