"""Mend a torn or damaged bag: :func:`recover`.

The stream is read as far as it goes, what is sound is written into a new bag with
indexes, statistics and metadata, and that bag is read back with all checks on.  The
damaged one is left as it is.
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from stepdiag_ros.bag.check import lost_messages
from stepdiag_ros.bag.msgdef import long_name
from stepdiag_ros.bag.scan import HEADER_SIZE, McapFile
from stepdiag_ros.bag.source import BagSource, open_bag
from stepdiag_ros.bag.tables import Tables, collect, room_of
from stepdiag_ros.bag.writer import BagWriter
from stepdiag_ros.errors import StepdiagError


@dataclass(frozen=True)
class TopicRecovery:
    """One topic: messages ``recovered``; ``lost`` at least (``None``: nothing tells);
    ``gaps``: lost before the recorder by sequence number (``None``: no numbers);
    times of the first and last message [ns]."""

    topic: str
    type: str
    recovered: int
    lost: int | None
    gaps: int | None
    first_ns: int
    last_ns: int


@dataclass(frozen=True)
class Recovery:
    """Outcome: where the mended bag is, each topic, what was wrong, what could not be kept."""

    source: Path
    target: Path
    topics: tuple[TopicRecovery, ...]
    faults: tuple[str, ...]
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def recovered(self) -> int:
        return sum(topic.recovered for topic in self.topics)


def recover(path: str | Path, target: str | Path | None = None) -> Recovery:
    """Write what can be read of ``path`` to ``target`` (default ``<bag>_recovered`` beside it).

    Raises :class:`StepdiagError` if nothing can be recovered or ``target`` exists.
    """
    source = open_bag(path)
    stem = source.path.with_suffix('') if source.path.is_file() else source.path
    goal = Path(target) if target is not None else stem.with_name(stem.name + '_recovered')
    if goal.exists():
        raise StepdiagError(f'{goal}: exists already; name another folder with --to')
    faults = list(source.warnings)
    notes: list[str] = []
    expected: Counter = Counter()
    written: Counter = Counter()
    room = room_of(source)
    writer: BagWriter | None = None
    try:
        for file_path in source.files:
            file = McapFile(file_path, tolerant=True, bag=source.path, room=room)
            skipped: Counter = Counter()
            for segment in _segments(file, faults):
                if writer is None:
                    writer = BagWriter(goal, live=False, custom_data={
                        'recovered_from': source.path.name})
                _copy(file, segment, writer, source, written, skipped)
            faults += [f'{file_path.name} {fault}' for fault in file.faults]
            notes += [f'{file_path.name}: {count} message(s) of {what} could not be kept'
                      for what, count in skipped.items()]
            _expect(file, expected, written, skipped)
    finally:
        if writer is not None:
            writer.close()
    if writer is None or not written:
        raise StepdiagError(f'{source.path}: holds no message that can be recovered'
                            + (f' ({faults[0]})' if faults else ''))
    tables = _read_back(goal, written)
    return Recovery(source.path, goal, _report(tables, source, expected), tuple(faults), tuple(notes))


def _segments(file: McapFile, faults: list[str]):
    """Segments of a file; one that is empty or no MCAP at all is a fault, not an end."""
    try:
        yield from file.segments()
    except StepdiagError as error:
        faults.append(str(error))


def _copy(file: McapFile, segment, writer: BagWriter, source: BagSource, written: Counter,
          skipped: Counter) -> None:
    """Write the messages of a segment, announcing topics as they appear."""
    channels, sequences, log_times, publish_times = segment.headers()
    data = memoryview(segment.buffer)
    announced: dict[int, str | None] = {}
    for k in range(len(segment)):
        number = int(channels[k])
        if number not in announced:
            announced[number] = _announce(file, number, writer, source, skipped)
        topic = announced[number]
        if topic is None:
            skipped[_label(file, number)] += 1
            continue
        begin = int(segment.offsets[k]) + HEADER_SIZE
        writer.write(topic, bytes(data[begin:begin + int(segment.lengths[k])]), int(log_times[k]),
                     int(publish_times[k]), int(sequences[k]))
        written[topic] += 1


def _label(file: McapFile, number: int) -> str:
    channel = file.channels.get(number)
    return f'topic {channel.topic}' if channel else f'channel {number}, which is nowhere described,'


def _announce(file: McapFile, number: int, writer: BagWriter, source: BagSource,
              skipped: Counter) -> str | None:
    """Topic of a channel, or ``None`` if the bag cannot hold it."""
    channel = file.channels.get(number)
    schema = file.schemas.get(channel.schema_id) if channel else None
    if channel is None or schema is None or channel.message_encoding != 'cdr':
        return None
    name = long_name(schema.name) if '/' in schema.name else schema.name
    writer.add_topic(channel.topic, name, channel.metadata.get('offered_qos_profiles', ''),
                     schema.data.decode('utf-8', 'replace'),
                     channel.metadata.get('topic_type_hash') or _hash(source, channel.topic),
                     schema.encoding)
    return channel.topic


def _hash(source: BagSource, topic: str) -> str:
    """Type hash that ``metadata.yaml`` gives for a topic, else none."""
    for entry in source.metadata.get('topics_with_message_count') or []:
        about = entry.get('topic_metadata', {})
        if about.get('name') == topic:
            return str(about.get('type_description_hash', ''))
    return ''


def _expect(file: McapFile, expected: Counter, written: Counter, skipped: Counter) -> None:
    """Messages that a file must have held, by topic, as far as it says."""
    counts = file.statistics.channel_message_counts if file.statistics else None
    for number, channel in file.channels.items():
        if counts is not None:
            expected[channel.topic] += counts.get(number, 0)
        elif file.lost[number]:
            expected[channel.topic] = max(expected[channel.topic], written[channel.topic]) \
                + file.lost[number]


def _read_back(goal: Path, written: Counter) -> Tables:
    tables = collect(open_bag(goal), lambda topic: False)
    for topic, count in written.items():
        held = tables.topics[topic].count if topic in tables.topics else 0
        if held != count:
            raise StepdiagError(f'{goal}: topic {topic} was written with {count} messages and reads '
                                f'back with {held}; do not use this bag')
    return tables


def _report(tables: Tables, source: BagSource, expected: Counter) -> tuple[TopicRecovery, ...]:
    counts = source.counts or {}
    topics = []
    for name in sorted(tables.topics.keys() | counts.keys() | expected.keys()):
        table = tables.topics.get(name)
        count = table.count if table else 0
        said = max(counts.get(name, 0), expected.get(name, 0))
        known = name in counts or name in expected
        times = [t for t in table.log_times if len(t)] if table else []
        topics.append(TopicRecovery(
            name, table.type if table else '', count, max(said - count, 0) if known else None,
            lost_messages(table) if table else None,
            int(min(t.min() for t in times)) if times else 0,
            int(max(t.max() for t in times)) if times else 0))
    return tuple(topics)
