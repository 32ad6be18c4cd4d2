"""How well adopted cells give their logs again, and their parameters the truth.

    python bench/bench_adopt.py                  three logs of each effect, some minutes
    python bench/bench_adopt.py --draws 1 --effects backlash servo_settling

Of each effect that a cell file can hold parameters are drawn as it draws them itself, a log is simulated, diagnosed, and the
cell adopted.  Counted are logs in which the effect alone is named: how many times its noise the adopted cell leaves of
the log, and how far the parameters are from the true ones, in standard uncertainties and in percent.
"""

import argparse
import re

import numpy as np
import yaml

from stepdiag_ros.effects import all_effects
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.twin.adopt import CLOSED, adopt
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """
seed: {seed}
machine: {{name: bench, volume: [0.8, 0.6, 0.5], tool: [0.05, 0.0, -0.15]}}
plan: {{steps: 6, repeats: 2}}
setups:
  ppp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  npp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  pnp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  nnp: {{standoff: 0.3, psd_offset: [0.02, 0.0]}}
  lin_x: {{standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.8, stops: 2}}
  lin_y: {{standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.6, stops: 2}}
  lin_z: {{standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.5, stops: 2}}
noise: {{displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}}
geometry: {{drawn: {{positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}}}}
misalignments: {{drawn: {{laser: 4.0e-4, mirror: 3.0e-4, psd_zero: 0.0}}}}
motion: {{feed: 0.3, acceleration: 3.0, jerk: 100.0, in_position: 1.0e-9, settling: 0.005, dwell: 0.6, mount: 120.0}}
sampling: {{interferometer: 50, psd: 50, in_motion: true}}
"""


def plain(values: dict) -> dict:
    """Parameters as YAML takes them."""
    return {name: np.asarray(value).tolist() if not isinstance(value, str) else value for name, value in values.items()}


def one(name: str, seed: int) -> str:
    """A row of the table."""
    effects = all_effects()
    true = plain(effects[name].draw(np.random.default_rng(seed)))
    cell = yaml.safe_load(CELL.format(seed=seed))
    cell['effects'] = {name: true}
    log = simulate_log(parse_cell(yaml.safe_dump(cell), 'drawn'))
    found = diagnose(log, [kind() for kind in effects.values()])
    said = ', '.join(f'{f.name} {f.probability:.2f}' for f in found.effects) or found.verdict
    if [f.name for f in found.effects] != [name] or found.unmodelled:
        return f'| {name} | {seed} | {said}{"; " + found.unmodelled if found.unmodelled else ""} | – | – |'
    adopted = adopt(found)
    times = float(re.search(r'leaves ([\d.]+) times', ' '.join(adopted.notes)).group(1))
    got = adopted.cell['effects'].get(name)
    off = '; '.join(f'{key} {_off(got[key], true[key])}' for key in got or {} if key in true) if got else 'not adopted'
    return f'| {name} | {seed} | {said} | {times:.2f}{"" if times <= CLOSED else " !"} | {off} |'


def _off(got: object, true: object) -> str:
    if isinstance(true, str):
        return str(got)
    got, true = np.atleast_1d(np.asarray(got, float)), np.atleast_1d(np.asarray(true, float))
    return ' '.join(f'{g:.3g}' for g in got) + ' for ' + ' '.join(f'{t:.3g}' for t in true)


def main() -> None:
    parser = argparse.ArgumentParser(description='Adopted cells against their logs and the truth.')
    parser.add_argument('--draws', type=int, default=3)
    parser.add_argument('--effects', nargs='+', default=sorted(n for n, e in all_effects().items() if not e.not_adopted))
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    print('| effect | seed | found | times the noise that the adopted cell leaves | parameters adopted for true |')
    print('|---|---|---|---|---|')
    for name in args.effects:
        for seed in range(args.seed, args.seed + args.draws):
            print(one(name, seed), flush=True)


if __name__ == '__main__':
    main()
