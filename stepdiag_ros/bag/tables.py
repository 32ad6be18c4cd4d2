"""The messages of a bag's contract topics as tables of columns.

Messages of several files and chunks are brought together until some 32 MiB are
at hand, grouped by topic and length, and each group is decoded at once.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stepdiag_ros.bag.cdr import alike, decode
from stepdiag_ros.bag.msgdef import Field, layout, long_name
from stepdiag_ros.bag.scan import HEADER_SIZE, McapFile, Room, Segment, gather
from stepdiag_ros.bag.schemas import TOPICS, split_topic
from stepdiag_ros.bag.source import BagSource
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits

BATCH = 32 << 20
_STAMP = ('header.stamp.sec', 'header.stamp.nanosec', 'header.frame_id')

#: What is decoded of each type.
WANTED = {
    'std_msgs/msg/String': ('data',),
    'stepdiag_msgs/msg/Step': (*_STAMP, 'run_id', 'setup', 'repeat', 'direction', 'index', 'axis',
                               'commanded.x', 'commanded.y', 'commanded.z', 'phase'),
    'stepdiag_msgs/msg/Displacement': (*_STAMP, 'sample_period', 'beams', 'displacement',
                                       'refractive_index', 'quality'),
    'stepdiag_msgs/msg/SpotPosition': (*_STAMP, 'sample_period', 'x', 'y', 'intensity'),
    'stepdiag_msgs/msg/SampleTiming': (*_STAMP, 'taken', 'uncertainty', 'clock'),
    'stepdiag_msgs/msg/ClockOffset': (*_STAMP, 'clock', 'reference', 'offset', 'uncertainty'),
    'stepdiag_msgs/msg/ClockStep': (*_STAMP, 'step', 'topic', 'published'),
    'geometry_msgs/msg/Vector3Stamped': (*_STAMP, 'vector.x', 'vector.y'),
    'sensor_msgs/msg/Temperature': (*_STAMP, 'temperature', 'variance'),
    'sensor_msgs/msg/FluidPressure': (*_STAMP, 'fluid_pressure', 'variance'),
    'sensor_msgs/msg/RelativeHumidity': (*_STAMP, 'relative_humidity', 'variance'),
}


@dataclass(frozen=True)
class Group:
    """Messages of one layout: ``values`` by field path, ``number`` (n,) their place in the log."""

    values: dict[str, np.ndarray]
    number: np.ndarray
    sequence: np.ndarray


@dataclass
class TopicTable:
    """One topic: its type, message count, log times (m,) [ns], and groups if it is decoded."""

    topic: str
    type: str
    encoding: str = 'cdr'
    count: int = 0
    log_times: list[np.ndarray] = field(default_factory=list)
    sequences: list[np.ndarray] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    malformed: int = 0
    schema_text: str = ''
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass
class Tables:
    """Every topic of a bag by name; ``warnings`` of the files; ``checked``: CRCs were there."""

    topics: dict[str, TopicTable] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    checked: bool = True
    bytes: int = 0
    metadata: dict[str, str] = field(default_factory=dict)


def collect(source: BagSource, wanted: Callable[[str], bool], tolerant: bool = False) -> Tables:
    """Scan the files of a bag in order; decode the contract topics that ``wanted`` lets pass.

    Others are counted.  ``tolerant`` turns damage into warnings (used by ``info``).
    """
    tables = Tables()
    number = 0
    room = room_of(source)
    for path in source.files:
        file = McapFile(path, tolerant, source.path, room=room)
        batch = _Batch(file, tables, wanted, number)
        for segment in file.segments():
            batch.add(segment)
        number = batch.finish()
        tables.warnings += [f'{path.name} {fault}' for fault in file.faults]
        tables.checked = tables.checked and file.checked
        tables.bytes += path.stat().st_size
        for channel in file.channels.values():
            batch.table(channel.id)
        for record in file.metadata:
            tables.metadata.update({f'{record.name}.{k}': v for k, v in record.metadata.items()})
    return tables


def room_of(source: BagSource) -> Room:
    """What the files of a bag may unpack to together."""
    return Room(sum(path.stat().st_size for path in source.files if path.is_file()))


class _Batch:
    """Collects segments of one file until they are worth decoding."""

    def __init__(self, file: McapFile, tables: Tables, wanted: Callable[[str], bool], number: int):
        self.file, self.tables, self.wanted, self.number = file, tables, wanted, number
        self.pending: list[Segment] = []
        self.size = 0
        self.layouts: dict[int, tuple[Field, ...] | None] = {}

    def add(self, segment: Segment) -> None:
        self.pending.append(segment)
        self.size += len(segment.buffer)
        if self.size >= BATCH:
            self.flush()

    def finish(self) -> int:
        self.flush()
        return self.number

    def flush(self) -> None:
        if not self.pending:
            return
        if len(self.pending) == 1:
            whole = self.pending[0]
        else:
            bases = np.cumsum([0] + [len(s.buffer) for s in self.pending[:-1]])
            whole = Segment(np.concatenate([s.buffer for s in self.pending]),
                            np.concatenate([s.offsets + b for s, b in zip(self.pending, bases, strict=True)]),
                            np.concatenate([s.lengths for s in self.pending]))
        self.pending, self.size = [], 0
        self._decode(whole)

    def _decode(self, segment: Segment) -> None:
        ids, sequence, log_time, _ = segment.headers()
        numbers = np.arange(self.number, self.number + len(segment))
        self.number += len(segment)
        for channel, mine in alike(ids):
            table = self.table(int(channel))
            table.count += len(mine)
            table.log_times.append(log_time[mine].astype(np.int64))
            table.sequences.append(sequence[mine].copy())
            fields, split = self._layout(int(channel), table), split_topic(table.topic)
            if fields is None or split is None:
                continue
            names = frozenset(WANTED[TOPICS[split[1]]])
            lengths = segment.lengths[mine]
            for length, which in alike(lengths):
                rows = mine[which]
                matrix = gather(segment.buffer, segment.offsets[rows] + HEADER_SIZE, int(length))
                done, bad = decode(matrix, fields, names)
                table.malformed += len(bad)
                table.groups += [Group(d.values, numbers[rows[d.rows]], sequence[rows[d.rows]])
                                 for d in done]
                if len(table.groups) > limits.LAYOUTS:
                    raise StepdiagError(f'{self.file.path}: topic {table.topic}: its messages have more than '
                                        f'{limits.LAYOUTS} layouts; no recorder writes so')

    def table(self, channel_id: int) -> TopicTable:
        channel = self.file.channels.get(channel_id)
        if channel is None:
            raise StepdiagError(f'{self.file.path}: holds messages of channel {channel_id}, which is '
                                'nowhere described: the file is damaged; mend it with: '
                                f'stepdiag recover {self.file.bag or self.file.path}')
        schema = self.file.schemas.get(channel.schema_id)
        name = long_name(schema.name) if schema and '/' in schema.name else \
            (schema.name if schema else 'unknown')
        table = self.tables.topics.get(channel.topic)
        if table is None:
            table = self.tables.topics[channel.topic] = TopicTable(
                channel.topic, name, channel.message_encoding,
                schema_text=schema.data.decode(errors='replace') if schema else '',
                metadata=channel.metadata)
        elif table.type != name:
            raise StepdiagError(f'{self.file.path}: topic {channel.topic} has type {table.type} '
                                f'and type {name} in one bag; give each type its own topic')
        return table

    def _layout(self, channel_id: int, table: TopicTable) -> tuple[Field, ...] | None:
        """Fields of a channel that is to be decoded, ``None`` for the others."""
        if channel_id not in self.layouts:
            split = split_topic(table.topic)
            self.layouts[channel_id] = None
            if split is not None and self.wanted(table.topic):
                self.layouts[channel_id] = self._checked_layout(channel_id, table, TOPICS[split[1]])
        return self.layouts[channel_id]

    def _checked_layout(self, channel_id: int, table: TopicTable, contract: str) -> tuple[Field, ...]:
        schema = self.file.schemas.get(self.file.channels[channel_id].schema_id)
        where = f'{self.file.path}: topic {table.topic}'
        if schema is None:
            raise StepdiagError(f'{where} carries no schema; the contract wants {contract}')
        if table.encoding != 'cdr':
            raise StepdiagError(f'{where} is encoded as {table.encoding or "nothing"}; '
                                'the contract wants cdr')
        fields = layout(table.topic, table.type, schema.data.decode('utf-8', 'replace'),
                        contract, str(self.file.path)) if schema.encoding == 'ros2msg' else None
        if fields is None:
            raise StepdiagError(f'{where} of type {table.type} has a schema in '
                                f'{schema.encoding or "no encoding"}; the contract wants ros2msg')
        return fields
