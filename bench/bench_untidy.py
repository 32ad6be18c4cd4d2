"""Evaluation under noise as instruments have it: null logs of the blind check's worlds, half of them untidy, held against
their truth.

    python bench/bench_untidy.py               30 logs, some five minutes on one core
    python bench/bench_untidy.py --logs 200

Heavy tails, correlation, steps, bursts without signal, spikes, duplicates, late samples: what a log shows of the machine's
repeatability must be what was drawn, and U must hold.  Its row goes into docs/bench/untidy.md.
"""

import os

# One core for everybody, before NumPy is loaded.
os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import argparse
import json
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.blind.score import en_within
from stepdiag_ros.cli.main import main as stepdiag
from stepdiag_ros.estimate.evaluate import evaluate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--logs', type=int, default=30, help='how many (default: 30)')
    parser.add_argument('--seed', type=int, default=611, help='of the worlds (default: 611)')
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / 'set'
        stepdiag(['blind', 'seal', '--purpose', 'develop', '--seed', str(given.seed), '--null', str(given.logs),
                  '--untidy', '0.5', '--wide', '--quiet', '--out', str(folder)])
        truth = json.loads((folder / 'sealed' / 'truth.json').read_text())['logs']
        cases, ratios, ok = [], [], 0
        for name, world in truth.items():
            found = evaluate(read_log(folder / 'logs' / name))
            cases.append(SimpleNamespace(extra={'errors': {'after': found.to_json_dict()['errors']}}, truth=world))
            ratios += [found.noise[f'{what}_repeatability_{unit}'] / world['noise'][f'{what}_repeatability']
                       for what, unit in (('position', 'm'), ('angle', 'rad'))]
            ok += found.status == 'ok'
            print(f'{name}: {found.status}, {100.0 * en_within(cases[-1:])["value"]:.1f} % within U', flush=True)
    low, middle, high = np.quantile(ratios, (0.0, 0.5, 1.0))
    within = en_within(cases)
    print(f'| {len(truth)} | {within["count"]} | {100.0 * within["value"]:.1f} % '
          f'| {middle:.2f}; {low:.2f} to {high:.2f} | {ok} of {len(truth)} |')


if __name__ == '__main__':
    main()
