"""Samples a second read from a bag into arrays: ours against two general readers.

One bag by our own writer, three readers in turn in one process, each over ``--rounds``
rounds; the best round counts, because a busy machine only ever adds.  Seconds are
seconds of the process (all three work in one thread), so that what else the machine
does counts for nobody.
Each must end with the same seven arrays (times, values and health of both sensors;
checked), so nobody is paid for work left undone.

    python bench/bench_read.py [--samples 1000000] [--block 25 --block 1000]
"""

import argparse
import json
import platform
import tempfile
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.schemas import DISPLACEMENT, SPOT
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import DONE, DWELL, MOVE, CalibrationLog, Samples, StepEvents

DESCRIPTION = """
schema: 1
machine: {name: bench, chain: FXYZ, volume: [0.8, 0.6, 0.5], tool: [0.0, 0.0, -0.15]}
plan: {steps: 10, order: XYZ, repeats: 1}
setups:
  lin_x: {standoff: 0.35, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.8, stops: 2}
"""
START = 1_790_000_000_000_000_000
PERIOD = 100_000    # ns: 10 kHz


def make_log(count: int) -> CalibrationLog:
    """Two dwells and ``count`` samples of each sensor at 10 kHz."""
    rng = np.random.default_rng(1)
    description = Description.from_yaml(DESCRIPTION)
    time_ns = START + np.arange(count, dtype=np.int64) * PERIOD
    none = np.zeros(count, np.intp)
    phases = np.array([MOVE, DWELL, DONE, MOVE, DWELL, DONE])
    at = START + np.linspace(0, count * PERIOD, 6).astype(np.int64)
    one = np.ones(6, np.int64)
    steps = StepEvents(at, ('lin_x/0/+',), 0 * one, ('lin_x',), 0 * one, 0 * one, one,
                       np.repeat([0, 1], 3), np.repeat([255, 0], 3), np.zeros((6, 3)), phases)
    distance = Samples(time_ns, rng.normal(0.0, 1e-6, (count, 1)), np.full(count, 97.0),
                       np.ones(count), ('lin_x',), none, none)
    spot = Samples(time_ns, rng.normal(0.0, 1e-5, (count, 2)), np.full(count, 2.5),
                   np.ones(count), ('lin_x',), none, none)
    return CalibrationLog(description, steps, distance, spot)


#: What a reader hands back: times [ns], displacement [m], quality, times [ns], x [m], y [m], sum [V].
Arrays = tuple[np.ndarray, ...]


def ours(bag: Path) -> Arrays:
    log = read_log(bag)
    return (log.displacement.time_ns, log.displacement.values[:, 0], log.displacement.health,
            log.spot.time_ns, log.spot.values[:, 0], log.spot.values[:, 1], log.spot.health)


def _gathered(messages: Iterable[tuple[str, object]]) -> Arrays:
    """The same arrays from decoded messages, as one would write it with a general reader."""
    columns: list[list[np.ndarray]] = [[] for _ in range(7)]
    for topic, message in messages:
        if topic.endswith(DISPLACEMENT):
            fields, at = (message.displacement, message.quality), 0
        elif topic.endswith(SPOT):
            fields, at = (message.x, message.y, message.intensity), 3
        else:
            continue
        stamp = message.header.stamp
        offset = np.rint(np.arange(len(fields[0])) * message.sample_period * 1e9).astype(np.int64)
        columns[at].append(stamp.sec * 1_000_000_000 + stamp.nanosec + offset)
        for number, values in enumerate(fields, at + 1):
            columns[number].append(np.asarray(values))
    return tuple(np.concatenate(c) for c in columns)


def _decoded_by_rosbags(bag: Path) -> Iterable[tuple[str, object]]:
    from rosbags.highlevel import AnyReader
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            yield connection.topic, reader.deserialize(raw, connection.msgtype)


def _decoded_by_mcap_fast(bag: Path) -> Iterable[tuple[str, object]]:
    from mcap.reader import make_reader
    from mcap_ros2_support_fast.decoder import DecoderFactory
    with open(next(bag.glob('*.mcap')), 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            yield channel.topic, message


def by_rosbags(bag: Path) -> Arrays:
    return _gathered(_decoded_by_rosbags(bag))


def by_mcap_fast(bag: Path) -> Arrays:
    return _gathered(_decoded_by_mcap_fast(bag))


READERS: dict[str, Callable[[Path], Arrays]] = {
    'stepdiag_ros': ours, 'rosbags': by_rosbags, 'mcap-ros2-support-fast': by_mcap_fast}


def measure(samples: int, block: int, rounds: int, compression: str) -> dict:
    """One row: samples a second (both sensors counted) of each reader."""
    log = make_log(samples)
    row = {'block_samples': block, 'samples_per_sensor': samples, 'compression': compression}
    with tempfile.TemporaryDirectory() as folder:
        bag = write_log(log, Path(folder) / 'bench', block, compression=compression)
        row['bytes'] = sum(f.stat().st_size for f in bag.iterdir())
        best: dict[str, float] = {}
        wanted = (log.displacement.time_ns, log.displacement.values[:, 0], log.displacement.health,
                  log.spot.time_ns, log.spot.values[:, 0], log.spot.values[:, 1], log.spot.health)
        for _ in range(rounds):
            for name, read in READERS.items():
                begin = time.process_time()
                arrays = read(bag)
                took = time.process_time() - begin
                if not all(map(np.array_equal, arrays, wanted)):
                    raise SystemExit(f'{name} read something else than was written')
                best[name] = min(best.get(name, took), took)
        row['samples_per_second'] = {name: 2 * samples / t for name, t in best.items()}
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--samples', type=int, default=1_000_000, help='samples a sensor at most')
    parser.add_argument('--block', type=int, action='append', help='samples a block, repeatable')
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--compression', default='zstd', choices=('none', 'zstd', 'lz4'))
    parser.add_argument('--out', type=Path, default=Path(__file__).parents[1] / 'docs' / 'bench',
                        help='folder for read.json and read.md (default: docs/bench)')
    args = parser.parse_args()
    rows = []
    names = list(READERS)
    lines = ['| samples a block | ' + ' | '.join(f'{n}, samples/s' for n in names)
             + ' | × rosbags | × mcap-ros2-support-fast |',
             '|---:' * (len(names) + 3) + '|']
    for block in args.block or [1, 10, 25, 100, 1000]:
        count = min(args.samples, 40_000 * block)
        row = measure(count, block, args.rounds, args.compression)
        rows.append(row)
        rate = row['samples_per_second']
        lines.append(f'| {block} | ' + ' | '.join(f'{rate[n]:,.0f}' for n in names)
                     + f' | {rate[names[0]] / rate[names[1]]:.1f}'
                     + f' | {rate[names[0]] / rate[names[2]]:.1f} |')
        print('\n'.join(lines) if len(rows) == 1 else lines[-1], flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    machine = {'python': platform.python_version(), 'machine': platform.machine()} | {
        p: version(p) for p in ('numpy', 'mcap', 'rosbags', 'mcap-ros2-support-fast')}
    (args.out / 'read.json').write_text(json.dumps({'environment': machine, 'rows': rows}, indent=1)
                                        + '\n')
    (args.out / 'read.md').write_text(
        '# Reading a bag into arrays\n\nMade by `python bench/bench_read.py`; both '
        'sensors counted, processor time of one thread, CRCs checked where the reader can, '
        f'chunks {args.compression}, best of {args.rounds} rounds, same arrays demanded of all.\n\n'
        + '\n'.join(lines) + '\n\n'
        + ', '.join(f'{k} {v}' for k, v in machine.items()) + '\n')


if __name__ == '__main__':
    main()
