"""Twenty drawn machines, the tables of every control: the worst place before, predicted, and after.

    python bench/bench_tables.py        half a minute a core; writes docs/bench/tables.md and prints it

Each machine is drawn with all 21 errors, its own chain, volume and tool, measured by a simulated calibration with noise,
evaluated, and given the tables of each control.  The files' text is then applied to the true machine by the
implementations that the tests have of each control, which share nothing with the package, with rotations over levers.
"""

import os
import sys

os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'})

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'test' / 'unit' / 'compensate'))

from applied import APPLIED, ORIGIN  # noqa: E402

from stepdiag_ros.compensate.compensation import compensation, worsened  # noqa: E402
from stepdiag_ros.compensate.controls import CONTROLS  # noqa: E402
from stepdiag_ros.estimate import evaluate  # noqa: E402
from stepdiag_ros.estimate.gauge import to_reference_lines  # noqa: E402
from stepdiag_ros.model.machine import tool_pose  # noqa: E402
from stepdiag_ros.virtual.cell import parse_cell  # noqa: E402
from stepdiag_ros.virtual.offline import simulate_log  # noqa: E402

PAGE = ROOT / 'docs' / 'bench' / 'tables.md'
CHAINS = ('FXYZ', 'XFYZ', 'YXFZ', 'XYFZ', 'YFXZ')
HEAD = """\
# Tables on drawn machines

Made by `python bench/bench_tables.py`. Each row is a machine with all 21 errors drawn (positioning to 15 µm,
straightness to 6 µm, rotations to 30 µrad, squareness 30 µrad), its own chain, volume and tool, measured by a simulated
calibration with noise. *Before* is the true largest deviation of the tool's tip in the volume in µm, counted from the
reference lines. For each control: what the tables' prediction says (U of the repeats, 95 %, in brackets) and what the true machine does
when the written text is applied to it by an independent implementation of that control, with rotations over their
levers. An asterisk: the tables of the line were held back, because they would have made places worse.

"""


def cell_of(number: int):
    """A drawn machine's cell: the demo's plan and noise, everything else its own."""
    rng = np.random.default_rng(9000 + number)
    text = yaml.safe_load((ROOT / 'cells' / 'demo.yaml').read_text(encoding='utf-8'))
    volume = [round(float(v), 3) for v in rng.uniform((0.3, 0.25, 0.2), (0.8, 0.6, 0.5))]
    text['seed'] = 9000 + number
    text['machine'] = {'name': f'drawn{number}', 'chain': CHAINS[number % len(CHAINS)], 'volume': volume,
                       'tool': [round(float(v), 3) for v in rng.uniform((-0.03, -0.03, -0.2), (0.03, 0.03, -0.05))],
                       'origin': ORIGIN.tolist()}
    text['plan'] |= {'steps': 6}
    for axis, length in zip('xyz', volume, strict=True):
        text['setups'][f'lin_{axis}']['length'] = length
    text['geometry'] = {'drawn': {'positioning': 15e-6, 'straightness': 6e-6, 'angle': 3e-5, 'squareness': 3e-5}}
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    text['motion'] |= {'dwell': 0.1}
    return parse_cell(yaml.safe_dump(text, sort_keys=False), 'drawn')


def off(errors, machine, target: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Length of the deviation (n,) [m] at ``target`` when ``command`` is given."""
    point, _ = tool_pose(errors, command, np.array(machine.tool), machine.chain)
    return np.linalg.norm(point - target - np.array(machine.tool), axis=1)


def row_of(number: int) -> tuple[list[str], float, np.ndarray]:
    """Cells of the table; the most that a place became worse beyond its U [m]; counts: tables refused, places that became
    worse beyond their U, places, largest deviations outside the prediction's U."""
    cell = cell_of(number)
    machine, true = cell.description.machine, to_reference_lines(cell.geometry)
    solution = evaluate(simulate_log(cell))
    # The cell knows of nothing but noise, so the budget of a real one would say too much.
    solution = replace(solution, covariance=solution.repeatability)
    row, most, refused, beyond, places, outside = [], -np.inf, 0, 0, 0, 0
    for name, control in CONTROLS.items():
        found = compensation(solution, machine, control)
        target = found.before.points
        before = off(true, machine, target, target)
        if not row:
            row += [str(number), machine.chain, ' × '.join(f'{1e3 * v:.0f}' for v in machine.volume),
                    f'{1e6 * before.max():.1f}']
        if found.refusals:
            row += ['refused', '–']
            refused += 1
            continue
        after = off(true, machine, target, APPLIED[name](found.files, target, 1, machine=machine))
        size, spread, _ = found.worst_after
        mark = '*' if found.line_alone is not None else ''
        row += [f'{1e6 * size:.1f} ({1e6 * spread:.1f}){mark}', f'{1e6 * after.max():.1f}']
        room = found.after.size_m - found.before.size_m - worsened(found.before, found.after)
        beyond += int(np.sum(after - before > room))
        most = max(most, float(np.max(after - before - room)))
        outside += int(abs(after.max() - size) > spread)
        places += len(target)
    return row, most, np.array([refused, beyond, places, outside])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--machines', type=int, default=20)
    parser.add_argument('--out', type=Path, default=PAGE)
    args = parser.parse_args()
    rows, worst, counts = [], -np.inf, np.zeros(4, int)
    for number in range(1, args.machines + 1):
        row, most, more = row_of(number)
        rows.append(row)
        worst, counts = max(worst, most), counts + more
    heads = ['machine', 'chain', 'volume / mm', 'before',
             *(head for name in CONTROLS for head in (f'{name}: predicted', 'after'))]
    lines = ['| ' + ' | '.join(heads) + ' |', '|---' * 3 + '|---:' * (len(heads) - 3) + '|']
    lines += ['| ' + ' | '.join(row) + ' |' for row in rows]
    refused, beyond, places, outside = counts
    sets = len(rows) * len(CONTROLS)
    tail = (f'\n{refused} of {sets} sets of tables were refused. The true largest deviation lies outside the U of its '
            f'prediction in {outside} of {sets - refused}. Of {places} places under these tables {beyond} truly became worse '
            f'beyond their U, by {max(1e6 * worst, 0.0):.2f} µm at most: the estimate is off there by more than U.\n')
    text = HEAD + '\n'.join(lines) + '\n' + tail
    args.out.write_text(text, encoding='utf-8')
    print(text)


if __name__ == '__main__':
    main()
