"""The recorder's node: every contract topic of a machine, and what viewers show, into a rosbag2 directory.

Active is recording: activating opens a bag, deactivating closes it.  ``recorder/status``
says five times a second what is received and what was lost by sequence number.  On SIGTERM it
stops taking in, drains what has arrived and closes; ``kill -9`` costs what came in
since the writer's last flush, a quarter of a second.  Whoever starts it again, it goes on in the bag
that it tore (:mod:`stepdiag_ros.bag.mark`).
"""

import sys
import time
from datetime import datetime
from pathlib import Path

from stepdiag_msgs.msg import RecorderStatus
from stepdiag_msgs.srv import NameLog
from stepdiag_ros.bag.append import go_on
from stepdiag_ros.bag.mark import Mark
from stepdiag_ros.bag.qos import LATCHED, RELIABLE, qos_profile, qos_yaml
from stepdiag_ros.bag.schemas import DESCRIPTION, TOPICS
from stepdiag_ros.bag.shown import SHOWN
from stepdiag_ros.bag.writer import COMPRESSIONS, BagWriter
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.base import DEPTH, ERROR, OK, WARN, Health, StepdiagNode, reliable, run_node
from stepdiag_ros.nodes.stamps import stamp_of
from stepdiag_ros.nodes.subscription import RECEIVED_TOPICS, RawSubscription, Received

STATUS_PERIOD_S = 0.2
NAME_LOG = 'recorder/name_log'
RECORDED = TOPICS | SHOWN


class Recorder(StepdiagNode):
    """Writes what is published below its namespace."""

    def __init__(self):
        super().__init__('recorder')
        self.text('bag', '', 'directory that is written first, which must not exist; empty: a new one in bag_folder',
                  fixed=True)
        self.text('bag_folder', '.', 'where new bags are made', fixed=True)
        self.text('compression', 'zstd', f'of the chunks: {", ".join(COMPRESSIONS)}')
        self._go_on = self.text('go_on', False, 'go on in the bag, which exists: its recorder has died', fixed=True)
        self.count('queue_depth', 10_000, 'messages of a topic that may wait to be written', 1, 1_000_000)
        self._status = self.create_publisher(RecorderStatus, 'recorder/status', reliable(10))
        self.create_service(NameLog, NAME_LOG, self._on_name)
        self._timer = self.every(STATUS_PERIOD_S, self._publish_status)
        self._writer: BagWriter | None = None
        self._subscription: RawSubscription | None = None
        self._bag, self._next = '', ''
        self._file = 0
        self._earlier: dict[str, int] = {}
        self._announced: set[str] = set()

    def configure(self) -> None:
        asked = self.value('bag')
        # Beside its bag: two cells of one name, started in one folder, each write to a folder of their own.
        folder = Path(asked).parent if asked else Path(self.value('bag_folder'))
        self._mark = Mark(folder.expanduser().absolute(), self._machine(), asked)
        if self.value('compression') not in COMPRESSIONS:
            raise StepdiagError(f'recorder: parameter compression is {self.value("compression")!r}; '
                                f'choose one of {", ".join(COMPRESSIONS)}')

    def activate(self) -> None:
        torn = self._mark.torn()
        path = torn or self._path()
        self._announced = set()
        self._earlier = {}
        if torn is not None or self._go_on and path.exists():
            continued = go_on(path, self.value('compression'))
            self._writer, self._earlier = continued.writer, continued.received
            for name in continued.mended:
                self.get_logger().warning(f'{path / name} was torn; it is mended, and recording goes on in '
                                          f'{continued.writer.file.name}')
            self._go_on = False     # only this once: a bag of that name that comes later is a new one
        else:
            self._writer = BagWriter(path, compression=self.value('compression'))
        self._mark.put(path)
        self._file = self._writer.number
        self._bag = str(path)
        self._subscription = RawSubscription(self, RECORDED, self._write, latched=(DESCRIPTION,),
                          depth=self.value('queue_depth'))
        self._subscription.start()
        self.get_logger().info(f'recording {path}')

    def deactivate(self) -> None:
        if self._subscription is not None:
            self._subscription.close()
        if self._writer is not None:
            self._writer.close()
            self._mark.remove()
            self._writer = None
            self.get_logger().info(f'closed {self._bag}: {sum(self._subscription.received.values())} messages, '
                                   f'{sum(self._subscription.lost.values())} lost')
        self._publish_status()

    def cleanup(self) -> None:
        self.deactivate()
        self._subscription = None

    def _machine(self) -> str:
        return self.get_namespace().strip('/').replace('/', '_') or 'machine'

    def _path(self) -> Path:
        if self.value('bag') and not self._bag:
            return Path(self.value('bag')).expanduser().absolute()
        folder = Path(self.value('bag_folder')).expanduser().absolute()
        if self._next:
            named, self._next = folder / self._next, ''
            return named
        name = f'{self._machine()}_{datetime.now():%Y%m%d_%H%M%S}'
        # Two bags may be begun in one second.
        candidates = [folder / name, *(folder / f'{name}_{i}' for i in range(2, 100))]
        return next(path for path in candidates if not path.exists())

    def _on_name(self, request: NameLog.Request, response: NameLog.Response) -> NameLog.Response:
        name = request.name
        response.success = name != '..' and Path(name).name == name and name.isprintable()
        if response.success:
            self._next = name
        else:
            response.message = f'recorder: {name!r} cannot name a bag; give a name without a folder'
        return response

    def _write(self, received: Received) -> None:
        """One message, in the raw subscription's thread."""
        topic = self.resolve_topic_name(received.topic)
        if topic not in self._announced:
            self._announced.add(topic)
            self._writer.add_topic(topic, RECORDED[received.topic], self._offered(received.topic))
        self._writer.write(topic, received.cdr, received.received_ns, received.published_ns, received.sequence)

    def _offered(self, topic: str) -> str:
        """The publishers' quality of service as rosbag2 writes it.

        History and depth do not travel by discovery; they are the graph's own.
        """
        offered = [qos_profile(DEPTH, info.qos_profile.reliability.short_key,
                               info.qos_profile.durability.short_key)
                   for info in self._subscription.publishers(topic)]
        return qos_yaml(*offered) if offered else LATCHED if topic == DESCRIPTION else RELIABLE

    def _publish_status(self) -> None:
        raw, names = self._subscription, self.resolve_topic_name
        received = {t: n + self._earlier.get(names(t), 0) for t, n in raw.received.items()} \
            if raw is not None else {}
        lost = raw.lost if raw is not None else {}
        status = RecorderStatus(
            recording=self._writer is not None and not self._trouble(), bag=self._bag,
            file=self._file, topics=[names(t) for t in received], received=list(received.values()),
            lost=list(lost.values()), hears=[names(t) for t in raw.received_topics.split()] if raw is not None else [])
        status.header.stamp = stamp_of(time.time_ns())
        self._status.publish(status)

    def _trouble(self) -> str:
        failure = self._subscription.failure if self._subscription is not None else None
        return f'{type(failure).__name__}: {failure}' if failure is not None else ''

    def health(self) -> Health:
        raw = self._subscription
        if raw is None or self.state != 'active':
            return Health(OK, self.state, {'bag': self._bag})
        received, lost = raw.received, raw.lost
        values = {'bag': self._bag, 'received': sum(received.values()), 'lost': sum(lost.values()),
                  RECEIVED_TOPICS: raw.received_topics}
        if self._trouble():
            return Health(ERROR, f'stopped writing: {self._trouble()}', values)
        if values['lost']:
            return Health(WARN, f'{values["lost"]} messages were lost', values)
        return Health(OK, 'recording', values)


def main() -> int:
    return run_node(Recorder)


if __name__ == '__main__':
    sys.exit(main())
