"""Coverage of k = 2 for each kind of setup: virtual cells drawn anew, evaluated, held against their truth; and what comes
back of a cell without noise.

    python bench/bench_ways.py                 200 draws of each plan, an hour on one core
    python bench/bench_ways.py --draws 20      a quick look
    python bench/bench_ways.py --plans 'parallel lines' --draws 200

Each draw is another machine with other misalignments and noise.  Counted are the values of all errors that the evaluation
does not name as open, but those that are zero by definition.  Its rows go into docs/bench/ways.md, plan by plan.
"""

import os

# One core for everybody, before NumPy is loaded.
os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import argparse
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import evaluate, solution_of
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.metres import in_metres
from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.machine import SQUARENESS
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

KNOWN = 6e-6
ROUNDS, ZERO = 10, 1e-15
PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'bench' / 'ways.md'
CELLS = PAGE.parents[2] / 'cells'
CELL = """
schema: 1
seed: SEED
machine: {name: ways, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: STEPS, order: XYZ, repeats: 2}
setups:
SETUPS
noise: NOISE
geometry: {drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}}
misalignments: {drawn: {laser: LASER, mirror: 2.0e-4, psd_zero: 0.0, station: STATION}}
air: {sensors: []}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-12, settling: 0.0, dwell: 0.06, mount: 2.0}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05, in_motion: false}
"""
USUAL = '{displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}'
NONE = '{displacement: 0.0, spot: 0.0, position_repeatability: 0.0, angle_repeatability: 0.0}'
X, Y, Z = 0.2, 0.16, 0.12
LINES = ((0, 0, 0, X, 0, 0), (0, 0, 0, 0, Y, 0), (0, 0, 0, 0, 0, Z))
OFFSET = ((0, Y, 0, X, Y, 0), (0, 0, Z, X, 0, Z), (X, 0, 0, X, Y, 0), (0, 0, Z, 0, Y, Z), (X, 0, 0, X, 0, Z),
          (0, Y, 0, 0, Y, Z))
BODY = ((0, 0, 0, X, Y, Z), (X, 0, 0, 0, Y, Z), (0, Y, 0, X, 0, Z), (X, Y, 0, 0, 0, Z))
THREE = ((0, 0, 0, X, Y, 0, 'XY'), (0, 0, 0, X, 0, Z, 'XZ'), (0, 0, 0, 0, Y, Z, 'YZ'))
FACES = (*THREE, (X, 0, 0, 0, Y, 0, 'XY'), (X, 0, 0, 0, 0, Z, 'XZ'), (0, Y, 0, 0, 0, Z, 'YZ'))
STEPS = tuple((*way, 'XYZ') for way in BODY)
PLACES = ((-0.15, -0.12, -0.10), (0.42, -0.10, -0.05), (0.38, 0.35, -0.15), (-0.12, 0.30, 0.25))
TOOLS = ((0.0, 0.0, -0.12), (0.05, 0.0, -0.12), (0.0, 0.05, -0.12), (-0.04, -0.04, -0.20))
GRID = (0, 0, 0, X, Y, Z, 'grid')


def with_key(ways: tuple, key: str) -> tuple:
    """The ways with one more key of the cell file."""
    return tuple((*way[:6], way[6] if len(way) > 6 else 'together', key) for way in ways)


def stations(way: tuple, places: tuple, tools: tuple) -> tuple:
    return tuple((*way, f'station: {list(place)}, tool: {list(tool)}')
                 for place, tool in zip(places, tools, strict=True))


LEVEL = tuple((x, y, 0.0) for x, y in ((-0.15, -0.12), (0.42, -0.10), (0.10, 0.38)))
OUTLINES = (((0, 0, 0, X, Y, 0, 'around'), (-0.15, -0.12, -0.12)), ((0, 0, 0, X, 0, Z, 'around'), (-0.15, 0.0, -0.25)),
            ((0, 0, 0, 0, Y, Z, 'around'), (0.0, -0.15, -0.25)))
BY_RECTANGLES = tuple(stations(way, (place,), (TOOLS[0],))[0] for way, place in OUTLINES)
PLANS = {
    'body diagonals in one motion, body step diagonals, lines': (*STEPS, *LINES, *BODY),
    'body step diagonals without a detector, lines': (*with_key(STEPS, 'psd: false'), *LINES),
    'face diagonals in one motion, lines': (*(way[:6] for way in FACES), *LINES),
    'face step diagonals, lines': (*FACES, *LINES),
    'three faces from one corner, lines': (*THREE, *LINES),
    'parallel lines': (*LINES, *OFFSET),
    'parallel lines with overrun': with_key((*LINES, *OFFSET), 'overrun: 0.0005'),
    'three stations in the plane XY': stations((0, 0, 0, X, Y, 0, 'grid'), LEVEL, ((0.0, 0.0, 0.0),) * 3),
    'four stations in space': stations(GRID, PLACES, TOOLS),
    'rectangles in three planes followed from a station each, lines': (*BY_RECTANGLES, *LINES),
    'rectangles, three faces from one corner, lines': (*BY_RECTANGLES, *THREE, *LINES),
    'all but stations': (*FACES, *LINES, *OFFSET, *BODY),
    'rectangles with the beam regulated (cells/held_beam.yaml)': 'held_beam.yaml',
    'every kind in one plan (cells/family.yaml)': 'family.yaml'}
"""Ways of the setups, or a cell file."""


def cell_text(ways: tuple | str, seed: int, noise: str = USUAL, laser: float = 2e-4, station: float = 1e-3) -> str:
    """A cell file with these ways; ``laser`` [rad], ``station`` [m]: by how much beams and stations are off."""
    if isinstance(ways, str):
        text = (CELLS / ways).read_text(encoding='utf-8')
        for key, value in (('seed', str(seed)), ('noise', noise), ('misalignments', f'{{drawn: {{laser: {laser}, '
                           f'mirror: 2.0e-4, psd_zero: 0.0, station: {station}}}}}'), ('air', '{sensors: []}')):
            text = re.sub(f'(?m)^{key}: .*$', f'{key}: {value}', text)
        return text
    setups = []
    for number, way in enumerate(ways):
        keys = [f'from: {list(way[:3])}', f'to: {list(way[3:6])}', f'moves: {way[6] if len(way) > 6 else "together"}']
        followed = any('station' in str(part) for part in way[7:])
        keys += [*([] if followed else ['standoff: 0.2', 'psd_offset: [0.02, 0.0]']), *way[7:]]
        setups.append(f'  way_{number}: {{{", ".join(keys)}}}')
    grid = any('grid' in way for way in ways)
    text = CELL
    for key, value in (('STEPS', '2' if grid else '4'), ('SEED', str(seed)), ('NOISE', noise), ('LASER', str(laser)),
                       ('STATION', str(station)), ('SETUPS', '\n'.join(setups))):
        text = text.replace(key, value)
    return text


def judged(solution, geometry) -> list[tuple[str, int, float]]:
    """Name, row and deviation from the truth of every value that is neither open nor zero by definition."""
    truth = to_reference_lines(geometry)
    named = {name.split()[0] for entry in solution.unidentifiable for name in entry.names}
    found = []
    for row, (name, knot) in enumerate(solution.names):
        # Of three knots the reference line leaves the end of a straightness zero by definition, but for rounding.
        if name in named or knot == 0 or solution.sigma[row] < ZERO:
            continue
        true = truth.square[name] if knot < 0 else \
            float(truth.curves[name](solution.positions[name][knot:knot + 1])[0])
        found.append((name, row, abs(float(solution.value[row]) - true)))
    return found


def hits(ways: tuple | str, seed: int) -> tuple[list[bool], list[bool], str]:
    """Of one draw: whether each value lies within k = 2 of the truth, by the whole budget and by repeats; the status."""
    cell = parse_cell(cell_text(ways, seed))
    solution = evaluate(simulate_log(cell))
    away = judged(solution, cell.geometry)
    return ([bool(by <= 2.0 * solution.sigma[row]) for _, row, by in away],
            [bool(by <= 2.0 * solution.sigma_repeatability[row]) for _, row, by in away], solution.status)


def without_noise(ways: tuple | str, seed: int = 1) -> tuple[list[str], float, float]:
    """Errors that are shown, and the largest deviation [m], [rad] of those of a cell without noise.

    Its beams lie along the lines, and the estimate is told so; stations stand where they are said to, for whether one is
    above or below the plane of its targets bends lengths by nanometres only.  It starts from the one of the usual noise.
    """
    # Repeats would say that there is no noise.
    cell = parse_cell(re.sub(r'repeats: \d', 'repeats: 1', cell_text(ways, seed, NONE, 0.0, 0.0)))
    log = simulate_log(cell)
    usual = replace(log.description, noise=Noise())
    believed = evaluate(replace(log, description=usual))
    table = in_metres(log).table
    result = fit(usual, table, linear_laser=1e-7)
    for _ in range(ROUNDS):
        result = fit(log.description, table, linear_laser=1e-7, theta=result.theta)
        if result.converged:
            break
    free = replace(solution_of(result, table), unidentifiable=believed.unidentifiable)
    # What shows by second-order effects alone is known to some 10 µm at best: no test of nanometres.
    away = [(name, by) for name, row, by in judged(free, cell.geometry) if believed.sigma[row] < KNOWN]
    lengths = [by for name, by in away if name[1] in 'XYZ' and name not in SQUARENESS]
    angles = [by for name, by in away if name[1] not in 'XYZ' or name in SQUARENESS]
    return list(dict.fromkeys(name for name, _ in away)), max(lengths, default=0.0), max(angles, default=0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--draws', type=int, default=200)
    parser.add_argument('--plans', nargs='+', default=list(PLANS), choices=list(PLANS))
    asked = parser.parse_args()
    free = []
    for title in asked.plans:
        shown, metres, radians = without_noise(PLANS[title])
        free.append(f'| {title} | {len(shown)} | {1e9 * metres:.2g} nm | {1e9 * radians:.2g} nrad |')
        print(free[-1], flush=True)
    put_in(free, 'nm |')
    for title in asked.plans:
        drawn = [hits(PLANS[title], 1000 + seed) for seed in range(asked.draws)]
        whole, repeats = (np.concatenate([d[k] for d in drawn]) for k in range(2))
        fine = sum(status == 'ok' for *_, status in drawn)
        share = [f'{100 * part.mean():.1f} %' if len(part) else '–' for part in (repeats, whole)]
        row = f'| {title} | {len(drawn)} | {len(whole)} | {share[0]} | {share[1]} | {fine} of {len(drawn)} |'
        print(row, flush=True)
        put_in([row], ' of ')


def put_in(rows: list[str], mark: str) -> None:
    """Rows into the page, in the place of those of the same plans; ``mark``: what tells the table's rows.  What other plans
    gave, and what the page says, stays."""
    lines = PAGE.read_text(encoding='utf-8').splitlines()
    for row in rows:
        title = row.split(' | ')[0]
        of_table = [i for i, line in enumerate(lines) if line.startswith('| ') and mark in line]
        same = [i for i in of_table if lines[i].startswith(f'{title} | ')]
        place = same[0] if same else of_table[-1] + 1
        lines[place:place + len(same)] = [row]
    PAGE.write_text('\n'.join(lines) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
