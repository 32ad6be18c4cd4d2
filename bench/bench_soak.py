"""An hour of a whole cell at 1 kHz: memory and processor time of every process once a minute, and what was lost.

  python bench/bench_soak.py [--minutes 60] [--every 20] [--cell CELL.yaml] [--out docs/bench/soak.md] [--record soak.json]

The cell is brought up as `stepdiag up` does it, and records all the time.  It is calibrated at the beginning, every so many
minutes, and at the end, each time into a bag of its own; in between it is idle.  Memory is what the process has itself
allocated (anonymous pages), which no reclaim of shared files makes look smaller, and the resident set.  Lost is what the
bags lack by the publishers' sequence numbers, and samples that bear the mark of a missed poll (quality 0) in a dwell.  The
status is 1 if anything was lost, or if a process grows by more than 0.1 MiB a minute while the cell is idle, the first
stretch left out, in which what is bounded fills up.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.summary import summarise
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.nodes import environment
from stepdiag_ros.nodes.bringup import Bringup

#: Growth of an idle process [MiB/min] from which on its memory does not count as flat: 140 MiB a day.
FLAT_MIB_MIN = 0.1
PERIOD_S = 60.0


def family(pid: int) -> list[int]:
    """A process and all that it started."""
    found, todo = [], [pid]
    while todo:
        found.append(todo.pop())
        for task in Path(f'/proc/{found[-1]}/task').glob('*/children'):
            try:
                todo += [int(child) for child in task.read_text().split()]
            except OSError:
                continue
    return found


def taken(processes: list[int]) -> tuple[float, float, float]:
    """Anonymous memory and resident set [MiB], and processor time [s], of processes together."""
    anonymous = resident = ticks = 0
    for one in processes:
        try:
            status = dict(line.split(':', 1) for line in Path(f'/proc/{one}/status').read_text().splitlines())
            fields = Path(f'/proc/{one}/stat').read_text().rpartition(')')[2].split()
            anonymous += int(status['RssAnon'].split()[0])
            resident += int(status['VmRSS'].split()[0])
        except (OSError, KeyError):     # it has just ended
            continue
        ticks += int(fields[11]) + int(fields[12])
    return anonymous / 1024, resident / 1024, ticks / os.sysconf('SC_CLK_TCK')


class Soak:
    """A cell that runs, and what its processes take, minute by minute."""

    def __init__(self, cell: Bringup):
        self.cell, self.began, self._next = cell, time.monotonic(), 0.0
        self.rows: list[dict[str, Any]] = []
        self.calibrations: list[dict[str, Any]] = []
        self.idle = False

    @property
    def minutes(self) -> float:
        return (time.monotonic() - self.began) / 60.0

    def look(self) -> None:
        """To be called often: restarts what died, and takes a row when a minute is over."""
        self.cell.watch()
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + PERIOD_S
        status = self.cell.operator.recorder
        self.rows.append({
            'minute': self.minutes, 'idle': self.idle, 'load': os.getloadavg()[0],
            'lost': None if status is None else sum(status.lost),
            'received': None if status is None else sum(status.received),
            'taken': {name: taken(family(pid)) for name, pid in self.cell.pids().items()}
            | {'this script': taken([os.getpid()])}})
        print(f'{self.minutes:5.1f} min, load {os.getloadavg()[0]:4.1f}, lost {self.rows[-1]["lost"]}: '
              + ', '.join(f'{name} {row[0]:.2f}' for name, row in self.rows[-1]['taken'].items()), flush=True)

    def calibrate(self) -> None:
        """One calibration into a bag of its own; the recorder goes on in that bag afterwards."""
        self.idle = False
        operator, began = self.cell.operator, self.minutes
        row: dict[str, Any] = {'minute': began, 'how': 'failed', 'status': None, 'reduced_chi2': None}
        self.calibrations.append(row)
        try:
            operator.new_log()
            outcome = operator.calibrate(meanwhile=self.look)
            document = operator.evaluate()
            row |= {'how': outcome.how, 'message': outcome.message, 'status': document['status'],
                    'reduced_chi2': document['reduced_chi2'], 'took_min': self.minutes - began}
        except StepdiagError as error:
            row['message'] = str(error)
        print(f'{self.minutes:5.1f} min: {row}', flush=True)

    def rest(self, until_min: float) -> None:
        """Idle, recording."""
        self.idle = True
        while self.minutes < until_min:
            self.look()
            time.sleep(0.5)
        self.idle = False


def growth(rows: list[dict[str, Any]], name: str) -> float:
    """Slope of a process's anonymous memory [MiB/min] over the idle stretches, each with an offset of its own.

    The first two minutes of a stretch are left out: the diagnosis that follows a calibration is in them.  So is the first
    stretch of several: what is bounded fills up in it, as the index of a bag's file does.
    """
    minutes, memory, stretch, number, since = [], [], [], 0, None
    several = sum(before['idle'] and not row['idle'] for before, row in pairwise(rows)) > 1
    for row in rows:
        if not row['idle']:
            number, since = number + (since is not None), None
            continue
        since = row['minute'] if since is None else since
        if row['minute'] - since >= 2.0 and name in row['taken'] and not (number == 0 and several):
            minutes.append(row['minute'])
            memory.append(row['taken'][name][0])
            stretch.append(number)
    offsets = np.array(stretch)[:, None] == np.unique(stretch)[None, :]
    design = np.column_stack([minutes, offsets])
    if len(minutes) <= design.shape[1]:
        return float('nan')
    return float(np.linalg.lstsq(design, np.array(memory), rcond=None)[0][0])


def of_bag(bag: Path) -> dict[str, Any]:
    """What a bag holds, what it lacks, and what of its dwells is marked."""
    found = summarise(bag)
    log, row = None, {'minutes': found['duration_s'] / 60.0, 'messages': found['messages'],
                      'lost': sum(t['lost'] or 0 for t in found['topics']),
                      'damage': len(found['damage']), 'stops': 0, 'dwells_lost': 0, 'marked': 0, 'samples': 0}
    for machine in found['machines']:
        for key in ('displacement', 'spot'):
            row[key] = machine.get('samples', {}).get(key, {}).get('samples', 0)
        if machine.get('runs'):
            log = read_log(bag)
    if log is not None:
        table = reduce_log(log)
        row['stops'] = len(table)
        row['dwells_lost'] = int(np.isnan(table.displacement[:, 0]).sum() + np.isnan(table.spot[:, 0]).sum())
        for begin, end in zip(table.dwell_ns, table.done_ns, strict=True):
            health = log.displacement.health[slice(*np.searchsorted(log.displacement.time_ns, [begin, end]))]
            row['samples'] += len(health)
            row['marked'] += int((health == 0).sum())
    return row


def judged(soak: Soak, bags: list[dict[str, Any]]) -> tuple[bool, dict[str, float]]:
    """Whether nothing was lost and all memory is flat; growth of each process."""
    slopes = {name: growth(soak.rows, name) for name in soak.rows[-1]['taken']}
    whole = all(bag['lost'] == bag['damage'] == bag['dwells_lost'] == 0 for bag in bags)
    flat = all(slope <= FLAT_MIB_MIN for slope in slopes.values())      # not where the idle minutes were too few
    return whole and flat and all(c['how'] == 'succeeded' for c in soak.calibrations), slopes


def page(soak: Soak, bags: list[dict[str, Any]], slopes: dict[str, float], cell: Path) -> str:
    """The figures as Markdown."""
    shown = [soak.rows[round(i)] for i in np.linspace(0, len(soak.rows) - 1, min(8, len(soak.rows)))]
    first, last = soak.rows[0], soak.rows[-1]
    seconds = 60.0 * (last['minute'] - first['minute'])
    rate = sum(bag['displacement'] for bag in bags) / sum(60.0 * bag['minutes'] for bag in bags)
    lines = ['# An hour of a whole cell', '',
             f'Made by `python bench/bench_soak.py --out …`: `cells/{cell.name}`, brought up as `stepdiag up` does it, recording '
             f'for {last["minute"]:.0f} minutes, calibrated {len(soak.calibrations)} times, idle in between. '
             f'{len(os.sched_getaffinity(0))} processors, load {min(r["load"] for r in soak.rows):.1f} to '
             f'{max(r["load"] for r in soak.rows):.1f} by other work. {soak.cell.restarts} nodes had to be started again.', '',
             '## Memory', '',
             'Anonymous memory of each process [MiB], which is what it has itself allocated; in brackets the resident set at the '
             'end. Growth: by a straight line through the idle minutes after the second calibration.', '',
             '| minute | ' + ' | '.join(f'{row["minute"]:.0f}' for row in shown) + ' | growth, MiB/min | processor |',
             '|---|' + '---:|' * (len(shown) + 2)]
    for name, slope in slopes.items():
        used = (last['taken'][name][2] - first['taken'][name][2]) / seconds
        amounts = [f'{row["taken"][name][0]:.1f}' if name in row['taken'] else '–' for row in shown]
        grows = f'{slope:+.3f}' if np.isfinite(slope) else '–'
        amounts[-1] += f' ({last["taken"][name][1]:.0f})'
        lines.append(f'| `{name}` | ' + ' | '.join(amounts) + f' | {grows} | {100 * used:.1f} % |')
    lines += ['', '## Losses', '',
              f'Both sensors at once; {rate:.1f} displacement samples a second in the bags. Lost by the sequence numbers of all '
              'topics; dwells without a usable sample; samples of the dwells that are marked as missed.', '',
              '| bag | minutes | messages | displacement samples | spot samples | lost messages | stops | dwells lost | marked |',
              '|---|---:|---:|---:|---:|---:|---:|---:|---:|']
    for number, bag in enumerate(bags):
        lines.append(f'| {number} | {bag["minutes"]:.1f} | {bag["messages"]:,} | {bag.get("displacement", 0):,} | '
                     f'{bag.get("spot", 0):,} | {bag["lost"]} | {bag["stops"]} | {bag["dwells_lost"]} | '
                     f'{100 * bag["marked"] / max(1, bag["samples"]):.3f} % |')
    lines += ['', '## Calibrations', '', '| at minute | took, min | ended | evaluation | reduced χ² |', '|---:|---:|---|---|---:|']
    for row in soak.calibrations:
        lines.append(f'| {row["minute"]:.1f} | {row.get("took_min", float("nan")):.1f} | {row["how"]} | {row["status"]} | '
                     f'{row["reduced_chi2"] or float("nan"):.3f} |')
    return '\n'.join([*lines, ''])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--every', type=float, default=20.0, help='minutes between two calibrations (default: 20)')
    parser.add_argument('--cell', type=Path, default=Path(__file__).resolve().parents[1] / 'cells' / 'demo.yaml')
    parser.add_argument('--out', type=Path, help='write a Markdown page there')
    parser.add_argument('--record', type=Path, help='write every minute there, as JSON')
    given = parser.parse_args()
    os.environ.setdefault('ROS_DOMAIN_ID', str(environment.free_domain()))
    with tempfile.TemporaryDirectory(prefix='stepdiag-soak-') as folder:
        bags = Path(folder) / 'bags'
        bags.mkdir()
        with Bringup(given.cell, namespace='soak', bag_folder=bags, runtime=Path(folder) / 'run', say=print) as cell:
            soak = Soak(cell)
            while True:
                began = soak.minutes
                soak.calibrate()
                if began >= given.minutes - 1.0:
                    break
                soak.rest(min(began + given.every, given.minutes))
            soak.look()
        found = [of_bag(bag) for bag in sorted(path.parent for path in bags.glob('*/metadata.yaml'))]
    good, slopes = judged(soak, found)
    if given.record is not None:
        given.record.write_text(json.dumps({'rows': soak.rows, 'calibrations': soak.calibrations, 'bags': found,
                                            'growth': slopes}, indent=1), encoding='utf-8')
    text = page(soak, found, slopes, given.cell)
    print(text)
    if given.out is not None:
        given.out.write_text(text, encoding='utf-8')
    return 0 if good else 1


if __name__ == '__main__':
    sys.exit(main())
