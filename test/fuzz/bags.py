"""Bags for the fuzzer: sound ones, mutated ones with right checksums, and the ready-made attacks.

A bag is taken apart into its records, something is changed in one or in several, and it is put together again
with sizes and CRCs that fit, so that the change reaches the decoder; or bytes of the file are changed as they are.
"""

import random
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import zstandard

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 1, 2, 3, 4, 5, 6, 15
#: Bytes that mean something as a length, a float or a number.
SPECIAL = (b'\x00' * 8, b'\xff' * 8,
           b'\x00\x00\x00\x00\x00\x00\xf0\x7f', b'\x00\x00\x00\x00\x00\x00\xf8\x7f',
           struct.pack('<d', 1e300), struct.pack('<d', -1e300), struct.pack('<d', 5e-324), struct.pack('<Q', 1 << 62),
           struct.pack('<I', 1 << 30), struct.pack('<q', -1), b'\x1b[31m', b'%s%n', b'$\\frac{', b'<b>', b'\xed\xa0\x80')

UNPACK = {b'': bytes, b'zstd': lambda data: zstandard.ZstdDecompressor().decompress(data), b'lz4': lz4.frame.decompress}

Record = tuple[int, bytes]


def record(kind: int, body: bytes) -> bytes:
    return struct.pack('<BQ', kind, len(body)) + body


def text(value: bytes | str) -> bytes:
    raw = value.encode() if isinstance(value, str) else value
    return struct.pack('<I', len(raw)) + raw


def schema(number: int, name: str, body: str, encoding: str = 'ros2msg') -> Record:
    return SCHEMA, struct.pack('<H', number) + text(name) + text(encoding) + text(body)


def channel(number: int, schema_number: int, topic: str, encoding: str = 'cdr') -> Record:
    return CHANNEL, struct.pack('<HH', number, schema_number) + text(topic) + text(encoding) + struct.pack('<I', 0)


def message(number: int, data: bytes, time: int = 0, sequence: int = 0) -> Record:
    return MESSAGE, struct.pack('<HIQQ', number, sequence, time, time) + data


def chunk(data: bytes, compression: str = '', size: int | None = None, packed: bytes | None = None) -> bytes:
    """A chunk record; ``size`` and ``packed`` may lie."""
    if packed is None:
        packed = {'': lambda: data, 'zstd': lambda: zstandard.ZstdCompressor().compress(data),
                  'lz4': lambda: lz4.frame.compress(data)}[compression]()
    return record(CHUNK, struct.pack('<QQQI', 0, 0, len(data) if size is None else size, 0) + text(compression)
                  + struct.pack('<Q', len(packed)) + packed)


def whole(parts: list[bytes]) -> bytes:
    """A file of the parts, closed as it should be, without a summary."""
    return MAGIC + record(HEADER, text('ros2') + text('fuzz')) + b''.join(parts) + record(DATA_END, bytes(4)) \
        + record(FOOTER, bytes(20)) + MAGIC


def unpacked(file: bytes) -> list[Record]:
    """Records of a sound file, those of its chunks unpacked; indexes and the summary left out."""
    found: list[Record] = []

    def walk(data: bytes) -> None:
        at = 0
        while at + 9 <= len(data):
            kind, length = struct.unpack_from('<BQ', data, at)
            body = data[at + 9:at + 9 + length]
            if kind == DATA_END:
                return
            if kind == CHUNK:
                named = struct.unpack_from('<I', body, 28)[0]
                walk(UNPACK[body[32:32 + named]](body[32 + named + 8:]))
            elif kind in (SCHEMA, CHANNEL, MESSAGE):
                found.append((kind, body))
            at += 9 + length
    walk(file[len(MAGIC):])
    return found


def put_together(records: list[Record], compression: str = 'zstd') -> bytes:
    return whole([chunk(b''.join(record(kind, body) for kind, body in records), compression)])


def changed(body: bytes, rng: random.Random) -> bytes:
    """``body`` with one to four changes."""
    data = bytearray(body)
    for _ in range(rng.randint(1, 4)):
        if not data:
            return bytes(data)
        at = rng.randrange(len(data))
        how = rng.random()
        if how < 0.3:
            data[at] ^= 1 << rng.randrange(8)
        elif how < 0.6:
            special = rng.choice(SPECIAL)
            data[at:at + len(special)] = special
        elif how < 0.7:
            del data[at:at + rng.randint(1, 64)]
        elif how < 0.8:
            data[at:at] = data[at:at + rng.randint(1, 64)] * rng.randint(1, 8)
        elif how < 0.9:
            data[at] = rng.randrange(256)
        else:
            # Eight-byte aligned behind a CDR header: where the numbers stand.
            at = 4 + 8 * rng.randrange(max(1, (len(data) - 4) // 8))
            data[at:at + 8] = rng.choice(SPECIAL[:10])
    return bytes(data)


def mutated(file: bytes, rng: random.Random) -> bytes:
    """A file with changes: of its bytes as they stand, or of records that are packed again."""
    if rng.random() < 0.25:
        return changed(file[:rng.randint(8, len(file))] if rng.random() < 0.2 else file, rng)
    records = unpacked(file)
    for _ in range(rng.choice((1, 1, 2, 5, 40))):
        at = rng.randrange(len(records))
        how = rng.random()
        if how < 0.7:
            kind, body = records[at]
            # The head of a message seldom, its content mostly.
            keep = 22 if kind == MESSAGE and rng.random() < 0.9 else 2
            records[at] = kind, body[:keep] + changed(body[keep:], rng)
        elif how < 0.8:
            del records[at]
            if not records:
                return put_together(records)
        elif how < 0.9:
            records.insert(rng.randrange(len(records)), records[at])
        else:
            rng.shuffle(records)
    return put_together(records, rng.choice(('', 'zstd', 'lz4')))


# -- attacks -----------------------------------------------------------------------

DESCRIPTION_TOPIC, STEP_TOPIC, DISPLACEMENT_TOPIC = ('/m/cell_description', '/m/sequencer/step',
                                                     '/m/interferometer/displacement')
PLAIN = """schema: 1
machine: {name: m, chain: FXYZ, volume: [0.2, 0.2, 0.2], tool: [0, 0, 0]}
plan: {steps: 1, order: XYZ, repeats: 1}
setups: {ppp: {standoff: 0.2}}
"""


def described(yaml: str | bytes) -> bytes:
    """A bag that holds a description and nothing else of use."""
    raw = yaml.encode() if isinstance(yaml, str) else yaml
    cdr = b'\x00\x01\x00\x00' + struct.pack('<I', len(raw) + 1) + raw + b'\x00'
    return put_together([schema(1, 'std_msgs/msg/String', 'string data\n'), channel(1, 1, DESCRIPTION_TOPIC),
                         message(1, cdr)])


def _doubling(depth: int, each: int) -> str:
    parts = [f'm/T{0} a\n' * 1]
    for k in range(depth):
        parts.append('=' * 80 + f'\nMSG: m/T{k}\n' + ''.join(f'm/T{k + 1} f{j}\n' for j in range(each)))
    parts.append('=' * 80 + f'\nMSG: m/T{depth}\nuint8 x\n')
    return ''.join(parts)


def _zstd_lies(size: int) -> bytes:
    """A frame that says of itself to hold ``size`` bytes."""
    return b'\x28\xb5\x2f\xfd\xe0' + struct.pack('<Q', size) + b'\x01\x00\x00'


def attacks() -> dict[str, Callable[[], bytes]]:
    """Small files that ask for much."""
    zeros = bytes(1 << 28)
    tiny = record(MESSAGE, struct.pack('<HIQQ', 1, 0, 0, 0))
    head = record(*schema(1, 'std_msgs/msg/String', 'string data\n')) + record(*channel(1, 1, DESCRIPTION_TOPIC))
    return {
        'empty file': lambda: b'', 'magic alone': lambda: MAGIC, 'zeros': lambda: bytes(100_000),
        'magic and zeros': lambda: MAGIC + bytes(100_000),
        'zstd of zeros': lambda: whole([chunk(zeros, 'zstd')]), 'lz4 of zeros': lambda: whole([chunk(zeros, 'lz4')]),
        'many zstd chunks': lambda: whole([chunk(zeros[:1 << 26], 'zstd')] * 40),
        'zstd announces an exabyte': lambda: whole([chunk(b'', 'zstd', 1 << 60, _zstd_lies(1 << 60))]),
        'zstd holds an exabyte': lambda: whole([chunk(b'', 'zstd', 100, _zstd_lies(1 << 60))]),
        'zstd within bounds and a lie': lambda: whole([chunk(b'', 'zstd', 1 << 27, _zstd_lies(1 << 27))]),
        'lz4 announces little': lambda: whole([chunk(zeros, 'lz4', 100)]),
        'a million messages of nothing': lambda: whole([chunk(head + tiny * 1_000_000, 'zstd')]),
        'eight million messages of nothing': lambda: whole([chunk(head + tiny * 8_000_000, 'zstd')]),
        'a million schemas': lambda: whole([chunk(record(*schema(1, 'a/msg/B', 'uint8 x\n')) * 1_000_000, 'zstd')]),
        'every channel': lambda: whole([chunk(record(*schema(1, 'std_msgs/msg/String', 'string data\n')) + b''.join(
            record(*channel(k, 1, f'/m{k}/cell_description')) + record(*message(k, b'\x00\x01\x00\x00\x01\0\0\0\0'))
            for k in range(1, 60_000)), 'zstd')]),
        'doubling schema': lambda: put_together([schema(1, 'm/msg/A', _doubling(15, 4)), channel(1, 1, STEP_TOPIC),
                                                 message(1, bytes(64))]),
        'doubling schema of the right name': lambda: put_together([
            schema(1, 'stepdiag_msgs/msg/Step', _doubling(15, 4)), channel(1, 1, STEP_TOPIC), message(1, bytes(64))]),
        'schema that contains itself': lambda: put_together([
            schema(1, 'stepdiag_msgs/msg/Step', 'm/A a\n' + '=' * 80 + '\nMSG: m/A\nm/A b\nm/A c\nm/A d\n'),
            channel(1, 1, STEP_TOPIC), message(1, bytes(64))]),
        'schema of a megabyte': lambda: put_together([
            schema(1, 'stepdiag_msgs/msg/Step', 'uint8 x\n' * 200_000), channel(1, 1, STEP_TOPIC),
            message(1, bytes(9))]),
        'array of too many digits': lambda: put_together([
            schema(1, 'stepdiag_msgs/msg/Step', f'uint8[{"9" * 5000}] x\n'), channel(1, 1, STEP_TOPIC),
            message(1, bytes(64))]),
        'aliases': lambda: described('a: &a [x,x,x,x,x,x,x,x,x]\n' + ''.join(
            f'{chr(98 + k)}: &{chr(98 + k)} [{",".join(["*" + chr(97 + k)] * 9)}]\n' for k in range(9))),
        'deep lists': lambda: described('[' * 100_000), 'deep maps': lambda: described('{a: ' * 100_000),
        'deep blocks': lambda: described('- ' * 50_000), 'a tag of Python': lambda: described(
            '!!python/object/apply:os.system ["true"]'),
        'a long key': lambda: described('? ' + 'a' * 3_000_000 + '\n: 1\n'),
        'no text': lambda: described(b'\xff\xfe\x00'),
        'a million steps': lambda: described(PLAIN.replace('steps: 1', 'steps: 1000000')),
        'a million repeats': lambda: described(PLAIN.replace('repeats: 1', 'repeats: 1000000')),
        'a million stops': lambda: described(PLAIN + '  lin_x: {stops: 1000000}\n'),
        'setups without number': lambda: described(PLAIN.split('setups')[0] + 'setups:\n' + ''.join(
            f'  ppp.{k}: {{standoff: 0.1}}\n' for k in range(50_000))),
        **{f'volume {value}': lambda value=value: described(PLAIN.replace('0.2, 0.2, 0.2', f'{value}, 0.2, 0.2'))
           for value in ('1e300', '1.0e+300', '.inf', '.nan', '2020-01-01', '9' * 400, '9' * 5000, '0x' + 'f' * 5000,
                         'true', 'null', '"\\e[31m"', '-1', '1e-300', '5e-324', '[1]', '{a: 1}')},
        'a name that moves the cursor': lambda: described(PLAIN.replace('name: m', 'name: "\\e[2J\\e]0;owned\\a"')),
        'a name of a formula': lambda: described(PLAIN.replace('name: m', 'name: "$\\\\frac{1}$"')),
        'a topic that moves the cursor': lambda: put_together([
            schema(1, 'a/msg/B', 'uint8 x\n'), channel(1, 1, '/\x1b[31mred'), message(1, bytes(8))]),
    }


def small_bags(folder: Path) -> Iterator[tuple[str, bytes]]:
    """The sound bags that are mutated: of a virtual cell, small enough for a thousand runs."""
    from stepdiag_ros.cli.main import main
    for name, text, extra in (('diagonals', CELL, ()), ('line', CELL, ('--setups', 'lin_x')), ('ways', WAYS, ())):
        cell = folder / f'{name}.yaml'
        cell.write_text(text, encoding='utf-8')
        if not (folder / name).exists():
            assert main(['simulate', str(cell), '--out', str(folder / name), '--json', *extra]) == 0
        yield name, next((folder / name).glob('*.mcap')).read_bytes()


CELL = """
schema: 1
seed: 7
machine: {name: tiny, chain: FXYZ, volume: [0.10, 0.08, 0.06], tool: [0.0, 0.0, -0.10]}
plan: {steps: 2, order: XYZ, repeats: 1}
setups:
  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  npp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  pnp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  nnp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.10, stops: 3}
geometry:
  drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}
misalignments:
  drawn: {laser: 3.0e-4, mirror: 2.0e-4, psd_zero: 0.0}
air: {period: 1.0, scale_temperature: [20.1, 20.2, 20.3]}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 5.0e-8, settling: 0.002, dwell: 0.12, mount: 2.0}
sampling: {interferometer: 100.0, psd: 100.0, block: 0.05}
"""

#: Setups with ways of their own: in one motion, in turn, with an overrun, stations with a beam that follows and one that is held.
WAYS = CELL.split('setups:')[0] + """setups:
  face: {standoff: 0.20, psd_offset: [0.02, 0.0], from: [0.10, 0, 0], to: [0, 0.08, 0]}
  step: {standoff: 0.20, psd_offset: [0.02, 0.0], from: [0, 0, 0], to: [0.10, 0.08, 0], moves: XY}
  edge: {standoff: 0.20, psd: false, from: [0, 0, 0], to: [0.10, 0, 0], repeats: 2, overrun: 0.0005, targets: [0.05, 0.062]}
  s1: {station: [-0.15, -0.12, -0.10], from: [0, 0, 0], to: [0.10, 0.08, 0.06], moves: grid, steps: 1}
  s2: {station: [0.42, -0.10, -0.05], from: [0, 0, 0], to: [0.10, 0.08, 0.06], moves: grid, steps: 1, tool: [0.05, 0.0, -0.12]}
  around: {station: [-0.20, -0.18, -0.10], from: [0, 0, 0], to: [0.10, 0.08, 0], moves: around, regulated: true, feed: 0.02}
noise: {displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}
noise_law: {displacement: {dof: 3, correlation: 0.5, dropouts: 0.02, burst: 3}, spot: {dof: 4, quantum: 1.0e-8}}
material: {scales: {x: {expansion: 1.15e-5, sigma: 1.0e-6}}, workpiece: {expansion: 1.1e-5, temperature: 20.4}}
budget: [{name: detector zero, kind: psd_zero, type: B, distribution: normal, value: 1.0e-6, unit: m}]
""" + 'geometry:' + CELL.split('geometry:')[1].replace('laser: 3.0e-4', 'station: 1.0e-3, laser: 3.0e-4') + """
instruments: {psd: {steering: {range: 0.5, inputs: [4, 5]}}}
client: {lease: 5.0, lost: next_stop}
network: loopback
effects: {backlash: {B: [4.0e-6, 0.0, 2.0e-6]}}
"""
