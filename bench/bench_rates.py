"""Samples a second through driver, topic and recorder, both sensors at once, without loss.

The nodes are the real ones, each in a process of its own, Fast DDS between them.  With
`generator` an instrument inside the driver makes the samples on time, so that nothing but
driver, middleware and recorder is measured; with `virtual cell` they come over the
instruments' own protocols (JSON-RPC, a request a sample; the T7's stream).  The proof of no
loss are the publishers' sequence numbers in the bag, without a gap, and the count of samples.

  python bench/bench_rates.py [--rates 10000 50000] [--seconds 10] [--json]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.schemas import DISPLACEMENT, SPOT
from stepdiag_ros.devices.base import DisplacementBlock, SpotBlock
from stepdiag_ros.nodes.replaying import read_messages

BLOCK_S = 0.05
NAMESPACE = '/bench'
DESCRIPTION = """schema: 1
machine: {name: bench, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.1]}
plan: {steps: 1, repeats: 1}
setups:
  ppp: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
"""
CELL = DESCRIPTION + """
sampling: {interferometer: RATE, psd: RATE, block: BLOCK}
"""


class Generator:
    """An instrument that samples on the clock: blocks end to end, never late by more than a block."""

    def __init__(self):
        self._next_s: float | None = None
        self._random = np.random.default_rng(1)

    def connect(self) -> None:
        self._next_s = None

    def close(self) -> None:
        pass

    def reset(self) -> None:
        pass

    def select_setup(self, name: str) -> None:
        pass

    def environment(self) -> dict[str, float]:
        return {}

    def _times(self, samples: int, period_s: float) -> int:
        begin = time.time() if self._next_s is None else self._next_s
        self._next_s = begin + samples * period_s
        time.sleep(max(0.0, self._next_s - time.time()))
        return round(begin * 1e9)


class Lengths(Generator):
    def read_block(self, samples: int, period_s: float) -> DisplacementBlock:
        stamp = self._times(samples, period_s)
        return DisplacementBlock(stamp, period_s, self._random.normal(0, 5e-9, (samples, 1)),
                                 np.full(samples, 96, np.uint8), 1.00027)


class Spots(Generator):
    def read_block(self, samples: int, period_s: float) -> SpotBlock:
        stamp = self._times(samples, period_s)
        x, y = self._random.normal(0, 2e-7, (2, samples))
        return SpotBlock(stamp, period_s, x, y, np.full(samples, 8.0))


def node(name: str) -> int:
    """A driver whose instrument is a generator; this script runs itself for it."""
    from stepdiag_ros.nodes.base import run_node
    from stepdiag_ros.nodes.interferometer_driver import InterferometerDriver
    from stepdiag_ros.nodes.psd_driver import PsdDriver
    kind, instrument = {'interferometer_driver': (InterferometerDriver, Lengths),
                        'psd_driver': (PsdDriver, Spots)}[name]
    kind.build = lambda self: instrument()
    return run_node(kind)


def spawn(command: list[str], log: Path) -> subprocess.Popen:
    with open(log, 'wb') as stream:
        return subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)


def measure(rate: float, seconds: float, virtual: bool, folder: Path) -> dict:
    """One run; what the bag says of it."""
    from stepdiag_ros.nodes.operator import Operator
    from stepdiag_ros.nodes.player import Player
    from stepdiag_ros.nodes.replaying import Message

    folder.mkdir(parents=True)
    bag = folder / 'log'
    processes: list[subprocess.Popen] = []
    where = {'interferometer_driver': [], 'psd_driver': []}
    try:
        if virtual:
            import yaml
            text = CELL.replace('RATE', str(rate)).replace('BLOCK', str(BLOCK_S))
            (folder / 'cell.yaml').write_text(text, encoding='utf-8')
            processes.append(spawn([sys.executable, '-m', 'stepdiag_ros.virtual.cell_process',
                                    str(folder / 'cell.yaml'), '--runtime', str(folder / 'run')],
                                   folder / 'cell.log'))
            while not (folder / 'run' / 'endpoints.yaml').exists():
                time.sleep(0.05)
            at = yaml.safe_load((folder / 'run' / 'endpoints.yaml').read_text(encoding='utf-8'))
            where['interferometer_driver'] = ['-p', f'port:={at["interferometer"]["port"]}']
            where['psd_driver'] = ['-p', f'port:={at["psd"]["port"]}',
                                   '-p', f'stream_port:={at["psd"]["stream_port"]}']
        ros = ['--ros-args', '-r', f'__ns:={NAMESPACE}']
        sampling = ['-p', f'sample_rate:={float(rate)}', '-p', f'block_samples:={round(rate * BLOCK_S)}',
                    '-p', 'setup:=ppp']
        processes.append(spawn([sys.executable, '-m', 'stepdiag_ros.nodes.recorder', *ros, '-p',
                                f'bag:={bag}'], folder / 'recorder.log'))
        for name, more in where.items():
            start = ['-m', f'stepdiag_ros.nodes.{name}'] if virtual else [__file__, '--node', name]
            processes.append(spawn([sys.executable, *start, *ros, *sampling, *more],
                                   folder / f'{name}.log'))
        with Operator(NAMESPACE) as operator, Player(NAMESPACE) as player:
            operator.bring('recorder', 'active')
            player.wait_for_listeners(10.0)
            cdr = DESCRIPTION.encode() + b'\0'
            player.play(Message(-1, NAMESPACE, 1, 0, 'cell_description',
                                b'\0\1\0\0' + len(cdr).to_bytes(4, 'little') + cdr))
            for name in where:
                operator.bring(name, 'inactive')
            time.sleep(3.0)   # the recorder finds the drivers' topics
            for name in where:
                operator.bring(name, 'active')
            before = _cpu(processes)
            time.sleep(seconds)
            used = {k: (v - before[k]) / seconds for k, v in _cpu(processes).items()}
            for name in where:
                operator.bring(name, 'inactive')
            operator.bring('recorder', 'inactive')
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            process.wait(20)
    return _judge(bag, rate, used)


def _cpu(processes: list[subprocess.Popen]) -> dict[str, float]:
    """Processor seconds of each process until now."""
    found = {}
    for process in processes:
        fields = Path(f'/proc/{process.pid}/stat').read_text().rsplit(')', 1)[1].split()
        name = next((n for n in ('recorder', 'interferometer_driver', 'psd_driver')
                     if any(n in str(a) for a in process.args)), None)
        if name is None:
            continue   # the virtual cell: its work is in its own children
        found[name] = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    return found


def _judge(bag: Path, rate: float, cpu: dict[str, float]) -> dict:
    result: dict = {'rate_Hz': rate, 'cpu': {k: round(v, 2) for k, v in cpu.items()}}
    messages = read_messages(bag, NAMESPACE)[1]
    for label, topic in (('displacement', DISPLACEMENT), ('spot', SPOT)):
        mine = [m for m in messages if m.topic == topic]
        sequence = np.array([m.sequence for m in mine])
        lost = int(np.sum(np.diff(sequence) - 1))
        block = round(rate * BLOCK_S)
        span_s = (mine[-1].stamp_ns - mine[0].stamp_ns) * 1e-9
        result[label] = {'messages': len(mine), 'sequence': [int(sequence[0]), int(sequence[-1])],
                         'lost': lost, 'samples': len(mine) * block,
                         'samples_a_second': round((len(mine) - 1) * block / span_s)}
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--node', help=argparse.SUPPRESS)
    parser.add_argument('--rates', type=float, nargs='+', default=[10_000.0, 50_000.0, 200_000.0],
                        help='samples a second of each sensor, generator (default: 10, 50, 200 kHz)')
    parser.add_argument('--virtual-rates', type=float, nargs='*', default=[1_000.0, 10_000.0],
                        help='the same from the virtual cell (default: 1, 10 kHz)')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--out', type=Path, help='write a Markdown table there')
    args, rest = parser.parse_known_args()
    if args.node:
        return node(args.node)
    if rest:
        parser.error(f'unknown: {" ".join(rest)}')
    from stepdiag_ros.nodes.environment import free_domain
    os.environ['ROS_DOMAIN_ID'] = str(free_domain())
    rows = []
    with tempfile.TemporaryDirectory(prefix='stepdiag-bench-') as folder:
        for virtual, rates in ((False, args.rates), (True, args.virtual_rates)):
            for rate in rates:
                source = 'virtual cell' if virtual else 'generator'
                row = {'source': source} | measure(rate, args.seconds, virtual,
                                                   Path(folder) / f'{source.replace(" ", "_")}_{rate:.0f}')
                rows.append(row)
                if not args.json:
                    _print(row)
    if args.json:
        print(json.dumps(rows, indent=1))
    if args.out:
        args.out.write_text(_markdown(rows, args.seconds), encoding='utf-8')
    return 0 if all(r[s]['lost'] == 0 for r in rows for s in ('displacement', 'spot')) else 1


def _markdown(rows: list[dict], seconds: float) -> str:
    lines = ['# Samples a second through driver, topic and recorder', '',
             f'Made by `python bench/bench_rates.py --out …`; both sensors at once, {seconds:g} s each, '
             f'{1e3 * BLOCK_S:g} ms of samples in a message, '
             f'{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}. Every node is a process of '
             'its own. No sequence number is missing between the first and the last in the bag.', '',
             '| source | asked of each, samples/s | displacement, samples/s | spot, samples/s | messages, '
             'sequence numbers | lost | processor: drivers, recorder |', '|---|---:|---:|---:|---|---:|---|']
    for row in rows:
        got = [row[sensor] for sensor in ('displacement', 'spot')]
        received = ', '.join(f'{g["messages"]} ({g["sequence"][0]}–{g["sequence"][1]})' for g in got)
        cpu = [round(100 * row['cpu'][n]) for n in ('interferometer_driver', 'psd_driver', 'recorder')]
        lines.append(f'| {row["source"]} | {row["rate_Hz"]:,.0f} | {got[0]["samples_a_second"]:,} | '
                     f'{got[1]["samples_a_second"]:,} | {received} | {sum(g["lost"] for g in got)} | '
                     f'{cpu[0]} %, {cpu[1]} %, {cpu[2]} % |')
    lines += ['', '`generator`: the instrument is inside the driver and makes the samples on time. '
              '`virtual cell`: over JSON-RPC, a request a sample, and over the T7\'s stream.', '']
    return '\n'.join(lines)


def _print(row: dict) -> None:
    for sensor in ('displacement', 'spot'):
        got = row[sensor]
        print(f'{row["source"]:13} {row["rate_Hz"]:9.0f} Hz asked  {sensor:12} '
              f'{got["samples_a_second"]:9d} samples/s recorded  {got["messages"]:6d} messages, '
              f'sequence {got["sequence"][0]}..{got["sequence"][1]}, lost {got["lost"]}')
    print('              processor share: ' + ', '.join(f'{k} {100 * v:.0f} %' for k, v in row['cpu'].items()))


if __name__ == '__main__':
    sys.exit(main())
