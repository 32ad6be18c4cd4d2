"""The blind check posed to general methods of variable selection, on the same logs.

Sum of single effects (pysusie), best subset selection (abess with EBIC), and exhaustive EBIC over
all single effects and pairs get what our diagnosis gets: the log in parity space, dwells' bins
included, and every form of every effect as columns there.  None of them knows "something else".
Logs with vibration or clock skew are left out: those are found in the samples and have no columns.
Our own answers on the same logs are shown in addition.

    python bench/bench_blind_peers.py SET            a set that was sealed and answered (bags/blind)
    python bench/bench_blind_peers.py SET --peers    install the peers first (into build/blind_peers)

Writes SET/peers.md and prints it.
"""

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import numpy as np

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.blind.opened import load, shown
from stepdiag_ros.blind.score import COUNTS_FROM, Case, credible_set, mean, median, share
from stepdiag_ros.blind.seal import LOGS
from stepdiag_ros.effects import all_effects
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import estimate_noise
from stepdiag_ros.gap.inference.parity import parity
from stepdiag_ros.gap.preprocess.observe import observe

ROOT = Path(__file__).resolve().parents[1]
PEERS = ROOT / 'build' / 'blind_peers'
NAMES = tuple(all_effects())
HEAD = """On the first {count} logs of the set, {outside} with effects from outside; vibration and clock skew, which have no
columns in parity space, are left out.  Detected means here that something was named: of effects from outside nothing
should be."""


def pose(log_folder: str, target: str) -> None:
    """Write one log's problem."""
    observation = observe(read_log(log_folder))
    noise = estimate_noise(observation.table, observation.log.description.noise, observation.fit.arrival)
    space = parity(observation, observation.fit, noise, readings_of(observation.table))
    columns, effect, form = [], [], []
    for number, kind in enumerate(all_effects().values()):
        for one in kind().appearance(observation.view):
            block = space.project(one)
            norms = np.linalg.norm(block, axis=0)
            block = block[:, norms > 1e-6] / norms[norms > 1e-6]
            if block.shape[1]:
                form += [len(set(form))] * block.shape[1]
                effect += [number] * block.shape[1]
                columns.append(block)
    np.savez(target, y=space.data, X=np.concatenate(columns, axis=1).astype(np.float32),
             effect=np.array(effect), form=np.array(form))


def figures(cases: list[Case], answers: dict[str, dict]) -> dict[str, dict]:
    """What can be asked of a method that only selects."""
    def of(case: Case) -> dict:
        return answers[case.name]

    def named(case: Case) -> list[str]:
        return [NAMES[n] for n in of(case)['named']]
    null = [c for c in cases if c.category == 'null']
    known = [c for c in cases if c.category in ('single', 'pair') and c.weakest >= COUNTS_FROM]
    single = [c for c in known if c.category == 'single']
    separable = [c for c in single if c.separable]
    pair = [c for c in known if c.category == 'pair']
    outside = [c for c in cases if c.category == 'outside' and c.weakest >= COUNTS_FROM]

    def truth(case: Case) -> float:
        return of(case)['probability'].get(str(NAMES.index(case.true_names[0])), 0.0)

    def sets(case: Case) -> list[list[int]]:
        return of(case)['sets']
    return {
        'false alarms on null logs': share(null, lambda c: bool(named(c))),
        'detection': share(known + outside, lambda c: bool(named(c))),
        'right effect first, among separable ones': share(
            separable, lambda c: named(c)[:1] == c.true_names),
        'mean probability on the truth': mean(truth(c) for c in single),
        '95 % sets: coverage': share(single, lambda c: any(
            NAMES.index(c.true_names[0]) in s for s in sets(c))),
        '95 % sets: mean size': mean(np.mean([len(s) for s in sets(c)]) for c in single if sets(c)),
        'effect from outside: misnamed': share(outside, lambda c: bool(named(c))),
        'both of a pair, exactly': share(pair, lambda c: set(named(c)) == set(c.true_names)),
        'time for one log, median [s]': median(of(c)['seconds'] for c in cases)}


def ours(case: Case) -> dict:
    """Our answer in the peers' shape."""
    return {'named': [NAMES.index(n) for n in case.named if n in NAMES], 'seconds': case.extra['seconds'],
            'probability': {str(NAMES.index(n)): p for n, p in case.extra['ranking'].items() if n in NAMES},
            'sets': [[NAMES.index(n) for n in credible_set(case) if n in NAMES]]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('folder', type=Path, metavar='SET', nargs='?', default=ROOT / 'bags' / 'blind')
    parser.add_argument('--peers', action='store_true', help='install the peers first')
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--first', type=int, help='only so many logs; their numbers are drawn, so that any part is fair')
    args = parser.parse_args()
    python = PEERS / 'bin' / 'python'
    if args.peers and not python.exists():
        subprocess.run([sys.executable, '-m', 'venv', str(PEERS)], check=True)
        subprocess.run([str(python), '-m', 'pip', 'install', '-q', '-r',
                        str(ROOT / 'requirements' / 'bench_blind.txt')], check=True)
    if not python.exists():
        print(f'{python} is missing: the peers are left out; run with --peers to install them')
        return
    cases = [c for c in load(args.folder)[0] if not {'vibration', 'clock_skew'} & set(c.true_names)][:args.first]
    problems = args.folder / 'peers'
    problems.mkdir(exist_ok=True)
    # A few logs at a time: a problem is some ten megabytes.
    missing = [c.name for c in cases if not (problems / f'{c.name}.json').exists()]
    with ProcessPoolExecutor(args.processes) as pool:
        for start in range(0, len(missing), 8):
            some = missing[start:start + 8]
            list(pool.map(pose, [str(args.folder / LOGS / n) for n in some],
                          [str(problems / f'{n}.npz') for n in some]))
            subprocess.run([str(python), str(ROOT / 'bench' / 'peers_blind.py'), str(problems), str(args.processes)],
                           check=True)
            for name in some:
                (problems / f'{name}.npz').unlink()
            print(f'\r{start + len(some)} of {len(missing)}', end='', file=sys.stderr, flush=True)
    print(file=sys.stderr)
    answers = {c.name: json.loads((problems / f'{c.name}.json').read_text()) for c in cases}
    methods = list(next(iter(answers.values())))
    answers = {c.name: {'stepdiag': ours(c), **answers[c.name]} for c in cases}
    methods = ['stepdiag', *methods]
    results = {m: figures(cases, {n: a[m] for n, a in answers.items()}) for m in methods}
    lines = [HEAD.format(count=len(cases), outside=sum(c.category == 'outside' for c in cases)), '',
             '| | ' + ' | '.join(methods) + ' |', '|---|' + '---|' * len(methods)]
    for name in results[methods[0]]:
        cells = [shown(results[m][name], 'interval' in results[m][name]) for m in methods]
        lines.append(f'| {name} | ' + ' | '.join(cells) + ' |')
    (args.folder / 'peers.md').write_text('\n'.join(lines) + '\n')
    print('\n'.join(lines))


if __name__ == '__main__':
    main()
