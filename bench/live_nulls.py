"""Live calibrations in a row on a busy computer, each diagnosed: none may have a finding.

Each is ``stepdiag demo`` of a cell without effects (drivers, protocols, recorder, processes of their own) while two
busy loops keep both cores loaded, then ``stepdiag gap`` on its log.  Printed is a line a run: verdict, samples without
signal in the dwells, dwells lost, how well the samples' times are known.  Ends with status 1 if any run has a finding,
lost a dwell or marked more than 0.1 % of the samples.

  python bench/live_nulls.py [--runs 10] [--busy 2] [--cell CELL.yaml] [--out DIR]
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.blind.live import busy_loop
from stepdiag_ros.estimate.reduce import reduce_log

STEPDIAG = [sys.executable, '-m', 'stepdiag_ros.cli.main']
MOST_MARKED = 1e-3


def one(out: Path, busy: int, cell: list[str]) -> dict:
    """A demo under load and its diagnosis."""
    loops = [busy_loop() for _ in range(busy)]
    try:
        done = subprocess.run([*STEPDIAG, 'demo', '--out', str(out), '--json', *cell], capture_output=True, text=True)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    if done.returncode not in (0, 1):
        return {'verdict': 'no log: ' + done.stderr.strip().splitlines()[-1], 'good': False}
    subprocess.run([*STEPDIAG, 'gap', str(out / 'log'), '--out', str(out / 'gap')], check=True, capture_output=True)
    gap = json.loads((out / 'gap' / 'log' / 'gap.json').read_text())
    log = read_log(out / 'log')
    table = reduce_log(log)
    begin = log.steps.time_ns[0]
    samples = log.displacement.time_ns >= begin
    marked = float(np.mean(log.displacement.health[samples] == 0))
    lost = int(np.sum((table.displacement_count == 0) | (table.spot_count == 0)))
    known = log.displacement.uncertainty_ns
    return {'verdict': gap['verdict'], 'effects': [e['name'] for e in gap['effects']], 'marked': marked, 'lost': lost,
            'dwells': len(table), 'least': int(table.displacement_count.min()),
            'median_ms': float(np.median(known)) * 1e-6, 'worst_ms': float(np.quantile(known, 0.999)) * 1e-6,
            'good': gap['verdict'] == 'no_gap' and not lost and marked < MOST_MARKED}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--busy', type=int, default=2, help='busy loops besides (2)')
    parser.add_argument('--cell', help="cell file (the demo's)")
    parser.add_argument('--out', type=Path, help='keep the logs there')
    given = parser.parse_args()
    out = given.out or Path(tempfile.mkdtemp(prefix='stepdiag-live-'))
    bad = 0
    for number in range(1, given.runs + 1):
        row = one(out / f'run_{number:02d}', given.busy, ['--cell', given.cell] if given.cell else [])
        bad += not row['good']
        print(number, json.dumps(row), flush=True)
    print(f'{given.runs - bad} of {given.runs} runs without a finding; logs in {out}')
    return 1 if bad else 0


if __name__ == '__main__':
    raise SystemExit(main())
