"""How many machines this computer carries: 1, 2, … virtual machines calibrated at the same time, each with its own laser.

  python bench/bench_machines.py [--most 4] [--cell CELL.yaml]

All are up and measure side by side.  Printed is a line for each number of machines: dwells without a usable sample, samples
of the dwells that are marked as without signal, how well the samples' times are known, the processor time that one machine
takes, and how much other work the computer did meanwhile.  A number is carried if no dwell was lost and less than 0.1 % of
the samples are marked.  The figures stand in docs/bench/hall.md, the number in nodes/bringup.py.
"""

import argparse
import os
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.nodes import bringup, environment

MOST_MARKED = 1e-3
SETUPS = ['ppp', 'lin_x']


def ticks(processes: list[int]) -> float:
    """Processor time [s] of processes and of what they started."""
    total, todo = 0, list(processes)
    while todo:
        pid = todo.pop()
        try:
            fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
            for task in Path(f'/proc/{pid}/task').glob('*/children'):
                todo += [int(child) for child in task.read_text().split()]
        except OSError:
            continue
        total += int(fields[11]) + int(fields[12])
    return total / os.sysconf('SC_CLK_TCK')


def busy() -> float:
    """Processor time [s] that the whole computer has spent."""
    fields = [int(f) for f in Path('/proc/stat').read_text().splitlines()[0].split()[1:]]
    return (sum(fields[:8]) - fields[3] - fields[4]) / os.sysconf('SC_CLK_TCK')


def one(count: int, cell: Path, folder: Path) -> bool:
    """Bring ``count`` machines up, calibrate all, print what became of their samples; whether all was kept."""
    text, machines, outcomes = cell.read_text(encoding='utf-8'), [], {}
    with ExitStack() as stack:
        for number in range(count):
            file = folder / f'm{number}.yaml'
            file.write_text(text.replace('name: demo', f'name: m{number}'), encoding='utf-8')
            machines.append(stack.enter_context(bringup.Bringup(
                file, bag=folder / f'log{number}', runtime=folder / f'run{number}')))
        began, own, all_ = time.monotonic(), sum(ticks(list(m.pids().values())) for m in machines), busy()

        def measure(machine: bringup.Bringup) -> None:
            outcomes[machine.namespace] = machine.operator.calibrate(SETUPS)
        threads = [threading.Thread(target=measure, args=(machine,)) for machine in machines]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        took = time.monotonic() - began
        own, all_ = sum(ticks(list(m.pids().values())) for m in machines) - own, busy() - all_
    lost = stops = marked = samples = 0
    known = []
    for number in range(count):
        log = read_log(folder / f'log{number}')
        table = reduce_log(log)
        stops += len(table)
        lost += int(np.isnan(table.displacement[:, 0]).sum() + np.isnan(table.spot[:, 0]).sum())
        for begin, end in zip(table.dwell_ns, table.done_ns, strict=True):
            rows = slice(*np.searchsorted(log.displacement.time_ns, [begin, end]))
            samples, marked = samples + len(log.displacement.health[rows]), marked + int(
                (log.displacement.health[rows] == 0).sum())
        if log.displacement.uncertainty_ns is not None:
            known.append(np.quantile(log.displacement.uncertainty_ns, 0.99) * 1e-6)
    good = all(o.succeeded for o in outcomes.values()) and not lost and marked <= MOST_MARKED * samples
    said = '; '.join(o.message for o in outcomes.values() if not o.succeeded)
    print(f'| {count} | {stops} | {lost} | {100 * marked / max(samples, 1):.3f} % | {max(known, default=np.nan):.2f} ms | '
          f'{took:.0f} s | {own / took / count:.2f} | {(all_ - own) / took:.2f} | {"yes" if good else "no"} | {said}', flush=True)
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--most', type=int, default=2 * len(os.sched_getaffinity(0)))
    parser.add_argument('--cell', type=Path, default=Path(__file__).resolve().parents[1] / 'cells' / 'demo.yaml')
    given = parser.parse_args()
    os.environ['ROS_DOMAIN_ID'] = str(environment.free_domain())
    bringup.START_TIMEOUT_S = 300.0     # what is measured is not the start
    print(f'{len(os.sched_getaffinity(0))} processors; {", ".join(SETUPS)} of {given.cell.name}, load before {os.getloadavg()}')
    print('| machines | stops | lost | marked | 99 % of times known to | took | processors a machine | other work | carried |')
    print('|---|---|---|---|---|---|---|---|---|')
    for count in range(1, given.most + 1):
        with tempfile.TemporaryDirectory() as folder:
            one(count, given.cell, Path(folder))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
