"""One MCAP file, read front to back, CRCs checked, messages found but not copied.

Whole chunks go out as :class:`Segment`: the decompressed bytes and where in them
each message lies, so that the decoder can lay NumPy views over them.  The message
indexes are hints only, because no CRC guards them: what they say is checked against
the records themselves, and whatever they leave out is walked (decision 0010).
"""

import io
import os
import struct
import zlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import open_regular

MAGIC = b'\x89MCAP0\r\n'
HEADER_SIZE = 31    # opcode, length, channel, sequence, log time, publish time of a message
_RECORD = struct.Struct('<BQ')
_CHUNK = struct.Struct('<QQQI')
_WORTH = 300    # messages in a chunk from which its indexes pay
_LOOSE_BYTES = 32 * limits.MIB
_TAIL = struct.Struct('<BQQQI8s')    # footer and closing magic


@dataclass(frozen=True)
class Segment:
    """Messages in one piece of memory.

    ``buffer`` (bytes,) uint8; ``offsets`` (m,) of the message records in it and
    ``lengths`` (m,) of their data.
    """

    buffer: np.ndarray
    offsets: np.ndarray
    lengths: np.ndarray

    def __len__(self) -> int:
        return len(self.offsets)

    def headers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Channel id, sequence, log time [ns] and publish time [ns] of each message, (m,)."""
        if not len(self.offsets):
            return (np.zeros(0, np.uint16), np.zeros(0, np.uint32),
                    np.zeros(0, np.uint64), np.zeros(0, np.uint64))
        head = gather(self.buffer, self.offsets + 9, HEADER_SIZE - 9)
        return (head[:, 0:2].view('<u2')[:, 0], head[:, 2:6].view('<u4')[:, 0],
                head[:, 6:14].view('<u8')[:, 0], head[:, 14:22].view('<u8')[:, 0])


def gather(buffer: np.ndarray, offsets: np.ndarray, length: int) -> np.ndarray:
    """Rows of ``length`` bytes that begin at ``offsets`` (m,) of ``buffer``: (m, length)."""
    if length == 0:
        return np.zeros((len(offsets), 0), np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(buffer, length)
    return windows[offsets]


class Room:
    """How much the files of a bag, of ``size`` bytes together, may still unpack to; -1: it is not known yet."""

    def __init__(self, size: int):
        self.size = size
        self.most = self.left = limits.unpacked_most(size)

    def take(self, size: int) -> bool:
        """Whether so many bytes more may be had; they are counted."""
        if size > self.left:
            return False
        self.left -= size
        return True


@dataclass
class McapFile:
    """A scan of the file at ``path``; iterate :meth:`segments` once, the rest fills meanwhile.

    Strict (default): the first damage raises :class:`StepdiagError` with the remedy.
    ``tolerant``: damage is noted in ``faults`` and what can be read is read.
    ``bag`` is what the remedy names.  ``complete`` says that footer and closing magic
    were there, ``checked`` that a CRC covers every message; ``lost`` counts, by channel,
    messages of chunks that could not be read, as far as their indexes tell.  ``room``: what
    the file may still unpack to, where several files share it.
    """

    path: Path
    tolerant: bool = False
    bag: Path | None = None
    header: Header | None = None
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None
    faults: list[str] = field(default_factory=list)
    complete: bool = False
    checked: bool = True
    lost: Counter = field(default_factory=Counter)
    room: 'Room' = field(default_factory=lambda: Room(-1))
    _described: int = 0
    _guarded: bool = False

    def segments(self) -> Iterator[Segment]:
        """Chunks in file order, then messages that stand outside chunks."""
        try:
            with open_regular(self.path) as stream:
                size = os.fstat(stream.fileno()).st_size
                if self.room.size < 0:
                    self.room = Room(size)
                yield from self._read(stream, size)
        except OSError as error:
            raise StepdiagError(f'{self.path}: cannot be read: {error.strerror}') from None

    def _read(self, stream, size: int) -> Iterator[Segment]:
        if size == 0:
            raise StepdiagError(f'{self.path}: is empty (0 bytes); nothing was recorded')
        if stream.read(len(MAGIC)) != MAGIC:
            raise StepdiagError(f'{self.path}: is not an MCAP file (its first bytes are not '
                                'the MCAP magic); give a rosbag2 directory or a .mcap file')
        expected = self._data_crc(stream, size)
        self._guarded = expected != 0
        running = zlib.crc32(MAGIC)
        loose: list[bytes] = []
        starts = self._summary(stream, size) if self.tolerant else []
        found = chunks = loose_bytes = 0
        chunk: _Chunk | None = None
        while True:
            begin = stream.tell()
            head = stream.read(_RECORD.size)
            if not head:
                break
            opcode, length = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, 1 << 63)
            if begin + _RECORD.size + length > size or length > limits.CHUNK_BYTES:
                self._fault(f'ends in the middle of a record at byte {begin} of {size}: '
                            'it is truncated or damaged' if begin + _RECORD.size + length > size else
                            f'has a record of {length} bytes at byte {begin}; '
                            f'at most {limits.CHUNK_BYTES} are read')
                later = starts[bisect_right(starts, begin):]
                if not later or len(self.faults) >= limits.FAULTS:
                    if chunk is not None:
                        yield self._walk(chunk)
                    chunk = self._salvage(stream.read(limits.CHUNK_BYTES)) if opcode == Opcode.CHUNK else None
                    break
                stream.seek(later[0])
                continue
            body = stream.read(length)
            if expected and opcode != Opcode.DATA_END:
                running = zlib.crc32(body, zlib.crc32(head, running))
            if opcode == Opcode.MESSAGE_INDEX:
                if chunk is not None:
                    chunk.hints.append(body)
                elif len(body) >= 6:
                    self.lost[int.from_bytes(body[:2], 'little')] += (len(body) - 6) // 16
                continue
            if chunk is not None:
                segment = self._walk(chunk)
                found += len(segment)
                yield segment
                chunk = None
            if opcode == Opcode.CHUNK:
                chunks += 1
                chunk = self._chunk(body, f'chunk {chunks} at byte {begin}')
            elif opcode == Opcode.MESSAGE:
                found += 1
                if length < HEADER_SIZE - 9:
                    self._fault(f'the message at byte {begin} is cut off')
                    continue
                self._take(length)
                loose.append(head + body)
                loose_bytes += len(loose[-1])
                if len(loose) >= 100_000 or loose_bytes > _LOOSE_BYTES:
                    yield _join(loose)
                    loose, loose_bytes = [], 0
            elif opcode == Opcode.DATA_END:
                if expected and running != expected:
                    self._fault('the CRC of its data section is wrong: a byte was changed')
                expected = 0
            elif opcode == Opcode.FOOTER:
                self._footer(stream, body, size)
                break
            else:
                self._small(opcode, body, begin)
        if chunk is not None:
            yield self._walk(chunk)
        if loose:
            self.checked = self.checked and self._guarded
            yield _join(loose)
        if not self.complete and not self.faults:
            self._fault('has no footer: its recording was not closed')
        if self.complete and self.statistics and self.statistics.message_count != found:
            self._fault(f'announces {self.statistics.message_count} messages and holds {found}')

    def _fault(self, what: str) -> None:
        if not self.tolerant:
            raise StepdiagError(f'{self.path}: {what}; mend it with: stepdiag recover {self.bag or self.path}')
        if len(self.faults) < limits.FAULTS:
            self.faults.append(what)

    def _take(self, size: int) -> None:
        if not self.room.take(max(0, size)):
            raise self._too_much()

    def _too_much(self) -> StepdiagError:
        return StepdiagError(f'{self.path}: holds more than {self.room.most} bytes of messages, many times its '
                             'size on disk: no calibration log does')

    def _summary(self, stream, size: int) -> list[int]:
        """Take in the summary, if there is one, and give the places of the chunks."""
        here, starts = stream.tell(), []
        stream.seek(max(0, size - _TAIL.size))
        tail = stream.read(_TAIL.size)
        if len(tail) == _TAIL.size and tail.endswith(MAGIC) and tail[0] == Opcode.FOOTER:
            summary = _TAIL.unpack(tail)[2]
            stream.seek(min(summary, size))
            data = stream.read(limits.SUMMARY_BYTES) if summary else b''
            position = 0
            while position + 9 <= len(data):
                opcode, length = _RECORD.unpack_from(data, position)
                body = data[position + 9:position + 9 + length]
                if opcode == Opcode.CHUNK_INDEX and len(body) >= 24:
                    starts.append(int.from_bytes(body[16:24], 'little'))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._small(opcode, body, summary + position)
                position += 9 + length
        stream.seek(here)
        return sorted({start for start in starts if start < size})

    def _salvage(self, body: bytes) -> '_Chunk | None':
        """What a chunk holds that was cut off: no CRC can vouch for it, only its records."""
        named = int.from_bytes(body[_CHUNK.size:_CHUNK.size + 4], 'little')
        compression = body[_CHUNK.size + 4:_CHUNK.size + 4 + named]
        data = body[_CHUNK.size + 12 + named:]
        if compression == b'zstd':
            import zstandard
            pieces = bytearray()
            unpacker = zstandard.ZstdDecompressor().decompressobj()
            try:
                for at in range(0, len(data), 4096):
                    pieces += unpacker.decompress(data[at:at + 4096])
                    if len(pieces) > min(limits.CHUNK_BYTES, self.room.left):
                        break
            except zstandard.ZstdError:
                pass    # what came out before stays good
            data = bytes(pieces)
        elif compression != b'':
            return None
        position = 0
        while position + 9 <= len(data):
            length = _RECORD.unpack_from(data, position)[1]
            if position + 9 + length > len(data):
                break
            position += 9 + length
        return _Chunk(data[:position], 'the chunk that is cut off') if position else None

    def _data_crc(self, stream, size: int) -> int:
        """CRC of the data section that the record before the summary holds; 0 if none."""
        here = stream.tell()
        stream.seek(max(0, size - _TAIL.size))
        tail = stream.read(_TAIL.size)
        crc = 0
        if len(tail) == _TAIL.size:
            opcode, length, summary, _, _, magic = _TAIL.unpack(tail)
            if opcode == Opcode.FOOTER and length == 20 and magic == MAGIC:
                stream.seek(max(0, (summary or size - _TAIL.size) - 13))
                end = stream.read(13)
                if len(end) == 13 and end[0] == Opcode.DATA_END:
                    crc = int.from_bytes(end[9:], 'little')
        stream.seek(here)
        return crc

    def _footer(self, stream, body: bytes, size: int) -> None:
        try:
            footer = Footer.read(_stream(body))
        except (struct.error, ValueError, McapError):
            self._fault('has a footer that is cut off')
            return
        if stream.read(len(MAGIC)) != MAGIC:
            self._fault('does not end with the MCAP magic: it is truncated')
            return
        self.complete = True
        if footer.summary_crc and footer.summary_start:
            stream.seek(footer.summary_start)
            # The CRC covers the summary and the footer up to the CRC itself.
            left, running = max(0, size - footer.summary_start - 12), 0
            while left and (piece := stream.read(min(left, 1 << 20))):
                running, left = zlib.crc32(piece, running), left - len(piece)
            if running != footer.summary_crc:
                self._fault('the CRC of its summary is wrong: a byte was changed')

    def _chunk(self, body: bytes, where: str) -> '_Chunk | None':
        try:
            _, _, full, crc = _CHUNK.unpack_from(body)
            at = _CHUNK.size
            named = int.from_bytes(body[at:at + 4], 'little')
            compression = body[at + 4:at + 4 + named][:40].decode('ascii')
            at += 4 + named + 8
            if full > limits.CHUNK_BYTES or not self.room.take(full):
                raise ValueError(f'it unpacks to {full} bytes, more than {limits.CHUNK_BYTES} in one chunk or '
                                 f'{self.room.most} in the bag')
            data = _decompress(compression, memoryview(body)[at:], full)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            self._fault(f'{where} is damaged: {error}')
            return None
        if crc and zlib.crc32(data) != crc:
            self._fault(f'{where} fails its CRC: a byte was changed')
            return None
        self.checked = self.checked and (crc != 0 or self._guarded)
        return _Chunk(data, where)

    def _walk(self, chunk: '_Chunk') -> Segment:
        """Find the messages of a decompressed chunk; take in its schemas and channels."""
        buffer = np.frombuffer(chunk.data, np.uint8)
        offsets, lengths = _hinted(buffer, chunk.hints)
        walked, whole = self._walk_gaps(chunk, offsets, lengths)
        if not whole and len(offsets):    # the hints were wrong
            offsets = lengths = np.zeros(0, np.intp)
            walked, whole = self._walk_gaps(chunk, offsets, lengths)
        if not whole:
            self._fault(f'{chunk.where} holds a record that is cut off')
        self._take(limits.SMALLEST_MESSAGE * (len(walked) + len(offsets)) - len(chunk.data))
        if walked:
            more = np.array(walked, np.intp)
            offsets = np.concatenate([offsets, more[:, 0]])
            lengths = np.concatenate([lengths, more[:, 1]])
            order = np.argsort(offsets)
            offsets, lengths = offsets[order], lengths[order]
        return Segment(buffer, offsets, lengths)

    def _walk_gaps(self, chunk: '_Chunk', offsets: np.ndarray,
                   lengths: np.ndarray) -> tuple[list[tuple[int, int]], bool]:
        """Walk what lies between the known messages.

        Returns offset and data length of the messages found there, and whether every
        stretch ended where the next message begins.
        """
        ends = np.concatenate([[0], offsets + HEADER_SIZE + lengths])
        begins = np.append(offsets, len(chunk.data))
        unpack, message, extra = _RECORD.unpack_from, int(Opcode.MESSAGE), HEADER_SIZE - 9
        data, found = chunk.data, []
        most = (len(data) + self.room.left) // limits.SMALLEST_MESSAGE
        for gap in np.flatnonzero(begins != ends):
            position, end = int(ends[gap]), int(begins[gap])
            while position + 9 <= end:
                opcode, length = unpack(data, position)
                if opcode == 0 or position + 9 + length > end or (opcode == message and length < extra):
                    break
                if opcode == message:
                    found.append((position, length - extra))
                    if len(found) > most:
                        raise self._too_much()
                else:
                    self._small(opcode, bytes(data[position + 9:position + 9 + length]), position)
                position += 9 + length
            if position != end:
                return found, False
        return found, True

    def _small(self, opcode: int, body: bytes, begin: int) -> None:
        """Records that describe; indexes and what we do not know are passed over."""
        self._described += 1
        if self._described > limits.DESCRIBING_RECORDS or len(self.channels) > limits.CHANNELS:
            raise StepdiagError(f'{self.path}: holds more than {limits.DESCRIBING_RECORDS} records that are no '
                                f'messages, or more than {limits.CHANNELS} channels: no recorder writes so')
        try:
            stream = _stream(body)
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                _printable(schema.name, schema.encoding)
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                _printable(channel.topic, channel.message_encoding)
                self.channels[channel.id] = channel
            elif opcode == Opcode.HEADER:
                self.header = Header.read(stream)
            elif opcode == Opcode.METADATA:
                self.metadata.append(Metadata.read(stream))
            elif opcode == Opcode.STATISTICS:
                self.statistics = Statistics.read(stream)
        except (struct.error, ValueError, McapError) as error:
            self._fault(f'the record at byte {begin} is damaged: {error or "cut off"}')


@dataclass
class _Chunk:
    """A decompressed chunk and the message index records that follow it."""

    data: bytes | memoryview
    where: str
    hints: list[bytes] = field(default_factory=list)


def _hinted(buffer: np.ndarray, hints: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
    """Offsets and data lengths (m,) of the messages that the indexes name.

    Empty if there are so few that a walk is faster, or if a single one is no message:
    then the indexes are worth nothing.  Whether they fit together the walk finds out.
    """
    none = np.zeros(0, np.intp), np.zeros(0, np.intp)
    if sum(map(len, hints)) < 16 * _WORTH:
        return none
    pieces = [np.frombuffer(body, '<u8', (len(body) - 6) // 16 * 2, 6)[1::2] for body in hints
              if len(body) > 6]
    if not pieces:
        return none
    offsets = np.sort(np.concatenate(pieces))
    if int(offsets[-1]) + HEADER_SIZE > len(buffer):
        return none
    offsets = offsets.astype(np.intp)
    head = gather(buffer, offsets, 9)
    lengths = head[:, 1:9].view('<u8')[:, 0]
    if (head[:, 0] != int(Opcode.MESSAGE)).any() or (lengths < HEADER_SIZE - 9).any() \
            or (lengths > len(buffer)).any():
        return none
    return offsets, lengths.astype(np.intp) - (HEADER_SIZE - 9)


def _printable(*names: str) -> None:
    """``ValueError`` if a name holds what no name holds."""
    for name in names:
        if not name.isprintable():
            raise ValueError(f'it names {name!r}')


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(body))


def _join(messages: list[bytes]) -> Segment:
    sizes = np.array([len(m) for m in messages], np.intp)
    offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp)
    return Segment(np.frombuffer(b''.join(messages), np.uint8), offsets, sizes - HEADER_SIZE)


def _decompress(name: str, data: memoryview, size: int) -> bytes | memoryview:
    """Bytes of a chunk; ``ValueError`` says what is wrong."""
    result: bytes | memoryview
    if name == '':
        result = data
    elif name == 'zstd':
        import zstandard
        try:
            # The frame's own word about its size is what the library would take memory for.
            said = zstandard.frame_content_size(data)
            if said not in (-1, size):
                raise ValueError(f'it holds {said} bytes and announces {size}')
            result = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        except zstandard.ZstdError as error:
            raise ValueError(f'zstd cannot decompress it ({error})') from None
    elif name == 'lz4':
        import lz4.frame
        try:
            result = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        except (RuntimeError, EOFError) as error:
            raise ValueError(f'lz4 cannot decompress it ({error})') from None
    else:
        raise ValueError(f'its compression {name!r} is unknown (known: none, zstd, lz4)')
    if len(result) != size:
        raise ValueError(f'it holds {len(result)} bytes and announces {size}')
    return result
