"""Sealed worlds that are measured through the whole running graph: drivers, protocols, middleware, recorder.

A simulated log has no late poll, no converter's steps and no waiting process.  A live one is a calibration of a virtual
cell by ``stepdiag demo`` in processes of their own, half of them on a computer whose cores are all busy.  Nothing
acts in it: what the diagnosis finds is a false alarm.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from stepdiag_ros.blind.world import PURPOSES, Order
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.truth import truth

CELL = """\
schema: 1
seed: {seed}
machine: {{name: cell1, chain: {chain}, volume: [0.20, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}}
plan: {{steps: 3, order: XYZ, repeats: 2}}
setups:
{setups}
noise: {{displacement: {displacement:.2e}, spot: {spot:.2e},
        position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}}
geometry: {{drawn: {{positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}}}}
misalignments: {{drawn: {{laser: 3.0e-4, mirror: 2.0e-4, psd_zero: 0.0}}}}
air: {{temperature: 20.3, drift: {{temperature: 0.2, pressure: -40.0, humidity: 0.0}}, period: 1.0}}
motion: {{feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-9, settling: 0.002, dwell: 0.06}}
sampling: {{interferometer: {rate}, psd: {rate}, block: 0.05}}
"""
LINES = {'lin_x': 0.20, 'lin_y': 0.16, 'lin_z': 0.12}
BUSY = 'import os, sys\nwhile os.getppid() == int(sys.argv[1]): sum(range(10000))'
TIMEOUT_S = 900.0


def busy_loop() -> subprocess.Popen:
    """A process that keeps one core busy until it is killed, or this one has died, however it did."""
    return subprocess.Popen([sys.executable, '-c', BUSY, str(os.getpid())])


def draw_text(order: Order) -> str:
    """The cell file of a live world."""
    rng = np.random.default_rng(np.random.SeedSequence([PURPOSES[order.purpose], order.seed, order.number, 2]))
    usual = 'standoff: 0.2, psd_offset: [0.02, 0.0]'
    setups = [f'  {name}: {{{usual}}}' for name in ('ppp', 'npp', 'pnp', 'nnp')] \
        + [f'  {name}: {{{usual}, length: {length}, stops: 2}}' for name, length in LINES.items()]
    return CELL.format(seed=int(rng.integers(1 << 40)), chain=str(rng.choice(['FXYZ', 'XFYZ', 'XYFZ'])),
                       setups='\n'.join(setups), displacement=float(np.exp(rng.uniform(*np.log([3e-9, 2e-8])))),
                       spot=float(np.exp(rng.uniform(*np.log([1e-7, 5e-7])))), rate=float(rng.choice([500.0, 1000.0])))


def measure_live(order: Order, target: Path) -> dict[str, Any]:
    """Calibrate the order's cell live and put its bag to ``target``; returns the truth about it."""
    text = draw_text(order)
    with tempfile.TemporaryDirectory(prefix='stepdiag-live-') as folder:
        file, out = Path(folder) / 'cell.yaml', Path(folder) / 'out'
        file.write_text(text, encoding='utf-8')
        loops = [busy_loop() for _ in range(os.cpu_count() or 1 if order.loaded else 0)]
        try:
            done = subprocess.run([sys.executable, '-m', 'stepdiag_ros.cli.main', 'demo', '--cell', str(file),
                                   '--out', str(out), '--json'], capture_output=True, text=True, timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            raise StepdiagError(f'{target}: the live calibration did not end within {TIMEOUT_S:g} s') from None
        finally:
            for loop in loops:
                loop.kill()
                loop.wait()
        if not (out / 'log').is_dir() or done.returncode not in (0, 1):
            raise StepdiagError(f'{target}: the live calibration gave no log: '
                                + (done.stderr.strip().splitlines() or ['no message'])[-1])
        shutil.rmtree(target, ignore_errors=True)
        shutil.move(out / 'log', target)
    cell = parse_cell(text)
    said = truth(cell)
    return {'category': 'null', 'world': order.world, 'small': True, 'number': order.number, 'effects': [],
            'live': True, 'loaded': order.loaded, 'noise': vars(cell.description.noise), 'errors': said['errors'],
            'misalignments': said['misalignments']}


def write_live(order: Order, target: Path, truth_path: Path) -> None:
    """Make one live log; the truth is written last, so that a cut run is resumed rightly."""
    entry = measure_live(order, target)
    temporary = truth_path.with_suffix('.new')
    temporary.write_text(to_json(entry, indent=None, sort_keys=True) + '\n', encoding='utf-8')
    temporary.replace(truth_path)
