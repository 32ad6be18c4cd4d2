"""A rosbag2 directory, written so that rosbag2, Foxglove and the rest accept it.

While it records, the chunk in progress is flushed every quarter of a second and
synced to the disk once a second off the callers' threads, so that a killed process
loses no more than what came in since (decision 0013).  ``metadata.yaml`` is there
from the first moment and replaced atomically.
"""

import contextlib
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.writer import CompressionType, IndexType, Writer

from stepdiag_ros.bag.msgdef import schema_text as builtin_schema
from stepdiag_ros.bag.qos import RELIABLE, PlainDumper, parse_qos
from stepdiag_ros.bag.source import METADATA
from stepdiag_ros.bag.typehash import rihs01
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.files import real

COMPRESSIONS = {'none': CompressionType.NONE, 'zstd': CompressionType.ZSTD,
                'lz4': CompressionType.LZ4}
#: Small, because a damaged chunk is lost as a whole.
CHUNK_SIZE = 1 << 18
#: Of one file while it is recorded live.  The index of each, about 1.2 kB, stays in memory until its file is closed:
#: with four a second a file lasts a quarter of an hour (decision 0346).
MOST_CHUNKS = 4000
ROS_DISTRO = 'jazzy'
_MASK = 0xFFFFFFFF


@dataclass
class _Topic:
    name: str
    type: str
    qos: list[dict]
    hash: str
    schema: str
    schema_encoding: str
    channel: int = 0    # in the present file, as is the count; before: messages of the writer's earlier ones
    count: int = 0
    before: int = 0


@dataclass(frozen=True)
class EarlierTopic:
    """A topic as the earlier files of a bag hold it: type, quality of service, type hash, messages."""

    type: str
    qos: list[dict]
    hash: str
    count: int


@dataclass(frozen=True)
class Earlier:
    """What a bag holds already: the ``number`` of the file to begin, ``files`` (name, first and last log time
    [ns], messages), ``topics`` by name."""

    number: int
    files: tuple[tuple[str, int, int, int], ...]
    topics: dict[str, EarlierTopic]


class BagWriter:
    """Writes ``path/`` with ``<name>_0.mcap`` and ``metadata.yaml``; thread-safe.

    ``live``: flush every ``flush_period`` [s], sync every ``sync_period`` [s] from a
    thread of its own.  Without it (simulation, import) chunks are written when they
    are full, and the same messages give the same bytes.  A live bag is split into files of ``most_chunks`` chunks, so
    that the memory which their indexes take is bounded however long it records.
    ``compression``: ``none``, ``zstd`` or ``lz4``.  ``custom_data`` goes into
    ``metadata.yaml``.  Raises :class:`StepdiagError` if ``path`` exists, unless it is a bag to go on in,
    of which ``earlier`` says what it holds (:mod:`stepdiag_ros.bag.append`).
    """

    def __init__(self, path: str | Path, *, live: bool = True, compression: str = 'zstd',
                 flush_period: float = 0.25, sync_period: float = 1.0,
                 custom_data: dict[str, str] | None = None, earlier: Earlier | None = None,
                 most_chunks: int = MOST_CHUNKS):
        if compression not in COMPRESSIONS:
            raise StepdiagError(f'compression {compression!r} is unknown; choose one of '
                                f'{", ".join(COMPRESSIONS)}')
        self.path = Path(path)
        self._earlier = earlier or Earlier(0, (), {})
        #: Number in the bag of the first file that this writer writes, from 0.
        self.number = self._earlier.number
        self._compression, self._most_chunks = COMPRESSIONS[compression], most_chunks
        self._lock = threading.Lock()
        self._topics: dict[str, _Topic] = {}
        self._custom = dict(custom_data or {})
        self._stop = threading.Event()
        self._failure: Exception | None = None
        self._closed = False
        try:
            if earlier is None and self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
                raise StepdiagError(f'{self.path}: exists already; give a new name or remove it')
            self.path.mkdir(parents=True, exist_ok=True)
            self._begin_file()
        except OSError as error:
            raise StepdiagError(f'{self.path}: cannot be written: {error.strerror}') from None
        self._write_metadata()
        self._thread: threading.Thread | None = None
        if live:
            self._thread = threading.Thread(target=self._keep, args=(flush_period, sync_period),
                                            name='bag flush', daemon=True)
            self._thread.start()

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, *_) -> None:
        self.close()

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far by topic."""
        with self._lock:
            return {topic.name: topic.before + topic.count for topic in self._topics.values()}

    def _begin_file(self) -> None:
        """The bag's next file, with all topics that are known."""
        self.file = self.path / f'{real(self.path).name}_{self._earlier.number}.mcap'
        self._stream = open(self.file, 'xb')
        self._schemas: dict[tuple[str, str], int] = {}
        self._first: int | None = None
        self._last, self._chunks, self._dirty = 0, 0.0, False
        # Message indexes and chunk indexes, as rosbag2 writes them; an attachment
        # index without attachments confuses readers.
        self._writer = Writer(self._stream, chunk_size=CHUNK_SIZE, compression=self._compression,
                              index_types=IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA,
                              enable_data_crcs=True)
        self._writer.start(profile='ros2', library='stepdiag_ros')
        for topic in self._topics.values():
            self._register(topic)
        self._stream.flush()

    def _end_file(self) -> None:
        """Indexes and statistics of the file, which is complete then."""
        self._writer.add_metadata('rosbag2', {'serialized_metadata': _dump(self._information()),
                                              'ROS_DISTRO': ROS_DISTRO})
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def _split(self) -> None:
        """Complete this file and go on in the next; called with the lock held."""
        self._end_file()
        self._stream.close()
        self._earlier = Earlier(self._earlier.number + 1, self._files(), self._all_topics())
        for topic in self._topics.values():
            topic.before, topic.count = topic.before + topic.count, 0
        self._begin_file()

    def _register(self, topic: _Topic) -> None:
        """Schema and channel of a topic in the present file."""
        key = (topic.type, topic.schema)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(topic.type, topic.schema_encoding, topic.schema.encode())
        topic.channel = self._writer.register_channel(
            topic.name, 'cdr', self._schemas[key],
            {'offered_qos_profiles': _dump(topic.qos).strip(), 'topic_type_hash': topic.hash})

    def add_topic(self, name: str, type: str, qos_yaml: str = RELIABLE,
                  schema_text: str | None = None, type_hash: str | None = None,
                  schema_encoding: str = 'ros2msg') -> None:
        """Announce a topic.  Schema and hash of the contract's types are built in.

        ``qos_yaml`` is a YAML list of the publishers' profiles (:mod:`qos`).  A topic that
        is announced again with the same type is let pass.
        """
        qos = parse_qos(qos_yaml, name)
        text = builtin_schema(type) if schema_text is None else schema_text
        hashed = rihs01(type) if type_hash is None else type_hash
        with self._lock:
            self._check()
            known = self._topics.get(name)
            if known is not None:
                if known.type != type:
                    raise StepdiagError(f'{self.path}: topic {name} is recorded as {known.type} and '
                                        f'was announced again as {type}')
                return
            topic = _Topic(name, type, qos, hashed, text, schema_encoding)
            self._register(topic)
            self._topics[name] = topic
        self._write_metadata()

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int,
              sequence: int) -> None:
        """Store one message: log time is its receipt, publish time its source's stamp."""
        with self._lock:
            self._check()
            entry = self._topics.get(topic)
            if entry is None:
                raise StepdiagError(f'{self.path}: topic {topic} was not announced with add_topic')
            try:
                self._writer.add_message(entry.channel, log_time=log_time_ns, data=cdr,
                                         publish_time=publish_time_ns, sequence=sequence & _MASK)
            except OSError as error:    # a chunk was full and the disk too
                self._failure = error
                self._check()
            entry.count += 1
            self._chunks += len(cdr) / CHUNK_SIZE
            self._first = log_time_ns if self._first is None else min(self._first, log_time_ns)
            self._last = max(self._last, log_time_ns)
            self._dirty = True

    def flush(self) -> None:
        """Hand what was written to the operating system: safe against ``kill -9``."""
        with self._lock:
            if self._dirty and not self._closed:
                self._writer.flush()
                self._dirty = False
                self._chunks += 1

    def close(self) -> None:
        """Finish the file: indexes, statistics, metadata.  A second call does nothing.

        Raises :class:`StepdiagError` if the disk refused some of it; the bag is then torn.
        """
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        with self._lock:
            if self._closed:
                return
            self._closed = True
            try:
                if self._failure is not None:
                    raise self._failure
                self._end_file()
            except (OSError, StepdiagError) as error:
                raise StepdiagError(f'{self.file}: cannot be written: {error}; '
                                    f'mend it with: stepdiag recover {self.path}') from None
            finally:
                with contextlib.suppress(OSError):
                    self._stream.close()
        self._write_metadata()

    def _check(self) -> None:
        if self._closed:
            raise StepdiagError(f'{self.path}: the bag is closed')
        if self._failure is not None:
            raise StepdiagError(f'{self.file}: cannot be written: {self._failure}') from None

    def _keep(self, flush_period: float, sync_period: float) -> None:
        """The thread: flush often, sync and renew metadata.yaml once a second."""
        next_sync = time.monotonic() + sync_period
        while not self._stop.wait(flush_period):
            try:
                self.flush()
                if self._chunks > self._most_chunks:
                    with self._lock:
                        self._split()
                    next_sync = 0.0     # metadata.yaml names the new file at once
                if time.monotonic() >= next_sync:
                    next_sync = time.monotonic() + sync_period
                    os.fsync(self._stream.fileno())
                    self._write_metadata()
            except (OSError, StepdiagError) as error:
                # A full disk must reach the caller, whose next write raises it.
                self._failure = error
                return

    def _information(self) -> dict:
        """``rosbag2_bagfile_information``, version 9; called with the lock held or at the end."""
        files = self._files()
        times = [(first, last) for _, first, last, count in files if count]
        begin, end = (min(t for t, _ in times), max(t for _, t in times)) if times else (0, 0)
        topics = self._all_topics()
        return {'version': 9, 'storage_identifier': 'mcap', **_span(begin, end),
                'message_count': sum(count for *_, count in files),
                'topics_with_message_count': [
                    {'topic_metadata': {'name': name, 'type': topic.type, 'serialization_format': 'cdr',
                                        'offered_qos_profiles': topic.qos, 'type_description_hash': topic.hash},
                     'message_count': topic.count} for name, topic in topics.items()],
                'compression_format': '', 'compression_mode': '',
                'relative_file_paths': [name for name, *_ in files],
                'files': [{'path': name, **_span(first, last), 'message_count': count}
                          for name, first, last, count in files],
                'custom_data': self._custom or None, 'ros_distro': ROS_DISTRO}

    def _files(self) -> tuple[tuple[str, int, int, int], ...]:
        """Of every file of the bag, the present one the last: name, first and last log time [ns], messages."""
        start = self._first or 0
        return (*self._earlier.files, (self.file.name, start, self._last if self._first is not None else start,
                                       sum(topic.count for topic in self._topics.values())))

    def _all_topics(self) -> dict[str, EarlierTopic]:
        """The topics of all files."""
        topics = dict(self._earlier.topics)
        for name, t in self._topics.items():
            count = t.count + (topics[name].count if name in topics else 0)
            topics[name] = EarlierTopic(t.type, t.qos, t.hash, count)
        return topics

    def _write_metadata(self) -> None:
        with self._lock:
            text = _dump({'rosbag2_bagfile_information': self._information()})
        temporary = self.path / f'.{METADATA}.{threading.get_ident()}'
        try:
            temporary.write_text(text, encoding='utf-8')
            os.replace(temporary, self.path / METADATA)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise StepdiagError(f'{self.path / METADATA}: cannot be written: '
                                f'{error.strerror}') from None


def _span(first_ns: int, last_ns: int) -> dict:
    return {'starting_time': {'nanoseconds_since_epoch': first_ns}, 'duration': {'nanoseconds': last_ns - first_ns}}


def _dump(data) -> str:
    # No folded lines: readers with a YAML of their own do not know them.
    return yaml.dump(data, Dumper=PlainDumper, sort_keys=False, default_flow_style=False,
                     allow_unicode=True, width=1 << 20)
