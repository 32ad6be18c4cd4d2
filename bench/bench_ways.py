"""Coverage of k = 2 for each kind of setup: virtual cells drawn anew, evaluated, held against their truth.

    python bench/bench_ways.py                 200 draws of each plan, an hour on one core
    python bench/bench_ways.py --draws 20      a quick look
    python bench/bench_ways.py --plans 'parallel lines' --draws 200

Each draw is another machine with other misalignments and noise.  Counted are the values of all errors that the evaluation
does not name as open, but those that are zero by definition.  Writes docs/bench/ways.md and prints it.
"""

import os

# One core for everybody, before NumPy is loaded.
os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import argparse
from pathlib import Path

import numpy as np

from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'bench' / 'ways.md'
CELL = """
schema: 1
seed: SEED
machine: {name: ways, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 4, order: XYZ, repeats: 2}
setups:
SETUPS
noise: {displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}
geometry: {drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}}
misalignments: {drawn: {laser: 2.0e-4, mirror: 2.0e-4, psd_zero: 0.0}}
air: {sensors: []}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-12, settling: 0.0, dwell: 0.06, mount: 2.0}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
"""
X, Y, Z = 0.2, 0.16, 0.12
LINES = ((0, 0, 0, X, 0, 0), (0, 0, 0, 0, Y, 0), (0, 0, 0, 0, 0, Z))
OFFSET = ((0, Y, 0, X, Y, 0), (0, 0, Z, X, 0, Z), (X, 0, 0, X, Y, 0), (0, 0, Z, 0, Y, Z), (X, 0, 0, X, 0, Z),
          (0, Y, 0, 0, Y, Z))
BODY = ((0, 0, 0, X, Y, Z), (X, 0, 0, 0, Y, Z), (0, Y, 0, X, 0, Z), (X, Y, 0, 0, 0, Z))
THREE = ((0, 0, 0, X, Y, 0, 'XY'), (0, 0, 0, X, 0, Z, 'XZ'), (0, 0, 0, 0, Y, Z, 'YZ'))
FACES = (*THREE, (X, 0, 0, 0, Y, 0, 'XY'), (X, 0, 0, 0, 0, Z, 'XZ'), (0, Y, 0, 0, 0, Z, 'YZ'))
STEPS = tuple((*way, 'XYZ') for way in BODY)
PLANS = {
    'body diagonals in one motion, body step diagonals, lines': (*STEPS, *LINES, *BODY),
    'face diagonals in one motion, lines': (*(way[:6] for way in FACES), *LINES),
    'face step diagonals, lines': (*FACES, *LINES),
    'three faces from one corner, lines': (*THREE, *LINES),
    'parallel lines': (*LINES, *OFFSET),
    'all of them': (*FACES, *LINES, *OFFSET, *BODY)}


def cell_text(ways: tuple, seed: int) -> str:
    """A cell file with these ways."""
    setups = [f'  way_{number}: {{standoff: 0.2, psd_offset: [0.02, 0.0], from: {list(way[:3])}, to: {list(way[3:6])}, '
              f'moves: {way[6] if len(way) > 6 else "together"}}}' for number, way in enumerate(ways)]
    return CELL.replace('SEED', str(seed)).replace('SETUPS', '\n'.join(setups))


def hits(ways: tuple, seed: int) -> tuple[list[bool], list[bool], str]:
    """Of one draw: whether each value lies within k = 2 of the truth, by the whole budget and by repeats; the status."""
    cell = parse_cell(cell_text(ways, seed))
    solution = evaluate(simulate_log(cell))
    truth = to_reference_lines(cell.geometry)
    named = {name.split()[0] for entry in solution.unidentifiable for name in entry.names}
    whole, repeats = [], []
    for row, (name, knot) in enumerate(solution.names):
        if name in named or knot == 0:
            continue
        true = truth.square[name] if knot < 0 else \
            float(truth.curves[name](solution.positions[name][knot:knot + 1])[0])
        away = abs(float(solution.value[row]) - true)
        whole.append(bool(away <= 2.0 * solution.sigma[row]))
        repeats.append(bool(away <= 2.0 * solution.sigma_repeatability[row]))
    return whole, repeats, solution.status


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--draws', type=int, default=200)
    parser.add_argument('--plans', nargs='+', default=list(PLANS), choices=list(PLANS))
    asked = parser.parse_args()
    lines = ['# Coverage by kind of setup', '',
             f'Share of values within U (k = 2) of the truth over {asked.draws} drawn cells each; 95.4 % is what a normal '
             'error has. The whole budget holds what these cells do not draw (air, flatness, tool), and so covers more.', '',
             '| plan | values | by repeats | by the whole budget | evaluations that were ok |', '|---|---|---|---|---|']
    for title in asked.plans:
        drawn = [hits(PLANS[title], 1000 + seed) for seed in range(asked.draws)]
        whole, repeats = (np.concatenate([d[k] for d in drawn]) for k in range(2))
        fine = sum(status == 'ok' for *_, status in drawn)
        lines.append(f'| {title} | {len(whole)} | {100 * repeats.mean():.1f} % | {100 * whole.mean():.1f} % | '
                     f'{fine} of {len(drawn)} |')
        print(lines[-1], flush=True)
    PAGE.write_text('\n'.join(lines) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
