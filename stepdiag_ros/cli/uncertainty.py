"""Uncertainty of a log's errors by an uncertainty budget: contributor by contributor, at any point.

The budget is a YAML file of named contributors, type A or B; without --budget the one that comes with
stepdiag is used (--print-budget shows it, to copy and edit).  Propagation is that of the GUM,
with all correlations; --draws adds Monte Carlo (GUM Supplement 1) through the full model.

  stepdiag uncertainty bags/demo
  stepdiag uncertainty bags/demo --budget mine.yaml --at 0.4,0.3,0.25 --draws 2000
  stepdiag uncertainty bags/demo --method step_diagonal --draws 500
  stepdiag uncertainty --print-budget > mine.yaml
"""

import argparse
from pathlib import Path

import numpy as np

from stepdiag_ros.cli.vector import vector
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import montecarlo
from stepdiag_ros.estimate.evaluate import evaluate_in_full
from stepdiag_ros.estimate.methods import METHODS
from stepdiag_ros.estimate.prediction import predict
from stepdiag_ros.estimate.propagate import (
    Setting,
    coverage_factor,
)
from stepdiag_ros.estimate.readings import readings_of_stops
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.model.budget import Budget
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.model.standard_budget import TEXT as STANDARD

NAME = 'uncertainty'
HELP = 'an uncertainty budget carried to every error and to any point of the volume'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', nargs='?', help='rosbag2 folder or .mcap file')
    parser.add_argument('--budget', metavar='FILE', type=Path, help='budget in YAML (default: the one shipped)')
    parser.add_argument('--at', action='append', metavar='X,Y,Z',
                        help='a commanded point [m], may be repeated (default: middle and far corner)')
    parser.add_argument('--draws', type=int, metavar='N', help='Monte Carlo with N draws besides')
    parser.add_argument('--seed', type=int, default=1, metavar='N', help='seed of the draws (default: 1)')
    parser.add_argument('--method', default='enhanced', metavar='NAME',
                        help='with --draws: another estimator for the draws (default: enhanced)')
    parser.add_argument('--json', action='store_true', help='print everything as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")
    parser.add_argument('--print-budget', action='store_true', help='print the shipped budget and end')


def run(args: argparse.Namespace) -> int:
    if args.print_budget:
        print(STANDARD, end='')
        return 0
    if args.bag is None:
        raise StepdiagError('no log given; name a rosbag2 folder or .mcap file')
    if args.draws is not None and not 2 <= args.draws <= 1_000_000:
        raise StepdiagError(f'--draws is {args.draws}; give 2 to 1000000')
    if args.method != 'enhanced' and args.draws is None:
        raise StepdiagError(f'--method {args.method}: only Monte Carlo works with any estimator; give --draws')
    from stepdiag_ros.bag.reader import read_log

    budget = _budget(args.budget)
    log = read_log(args.bag, args.namespace)
    points = np.array([vector(text, '--at') for text in args.at]) if args.at else \
        np.array([[0.5], [1.0]]) * np.array(log.description.machine.volume)
    full = evaluate_in_full(log, budget)
    found, setting = (full.fit, full.uncertainty), full.setting
    drawn = None if args.draws is None else _draw(args, log, setting.table, found, setting)
    if args.json:
        print(to_json(document(log, found, points, drawn)))
    else:
        print(text(log, found, points, drawn, args))
    return 0


def _budget(path: Path | None) -> Budget | None:
    if path is None:
        return None
    return Budget.from_yaml(read_text(path, limits.YAML_BYTES, 'budget'), str(path))


def _draw(args: argparse.Namespace, log: CalibrationLog, table: StopTable, found: tuple,
          setting: Setting) -> montecarlo.Drawn:
    result, uncertainty = found
    solution, rng = uncertainty.solution, np.random.default_rng(args.seed)
    machine = (solution.errors, solution.misalignments)
    if args.method == 'enhanced':
        return montecarlo.nonlinear(result, solution, uncertainty.causes, setting, *machine, args.draws, rng,
                                    step=uncertainty.step)
    if args.method not in METHODS:
        raise StepdiagError(f'--method {args.method}: not known; choose from {", ".join(METHODS)}')
    method = METHODS[args.method]
    cell = readings_of_stops(log.description, table)
    missing = method.lacks(cell)
    if missing:
        raise StepdiagError(f'{log.source}: method {args.method} needs {missing}{cell.why()}')
    own = method.run(log, cell)
    if not isinstance(own, Solution):
        raise StepdiagError(f'--method {args.method}: gives no error curves to draw; take another one')

    def estimate(one: StopTable) -> Solution:
        return method.run(log, readings_of_stops(log.description, one))
    return montecarlo.each(estimate, uncertainty.causes, setting, own, *machine, args.draws, rng)


def document(log: CalibrationLog, found: tuple, points: np.ndarray, drawn) -> dict:
    """Everything as plain data, SI units, standard uncertainties."""
    result, uncertainty = found
    solution, machine = uncertainty.solution, log.description.machine
    shares, at = uncertainty.shares(), uncertainty.at(machine, points)
    prediction = predict(solution, machine, points)
    total = np.sqrt(np.sum(shares**2, axis=0))
    lines = []
    for i, name in enumerate(uncertainty.names):
        line = {'name': name, 'at_points_m': at[i].tolist(), 'errors': _by_error(solution.names, shares[i])}
        if i < len(uncertainty.causes):
            c = uncertainty.causes[i].contributor
            line |= {'kind': c.kind, 'type': c.type, 'distribution': c.distribution, 'unit': c.unit,
                     'standard': c.standard if c.standard is not None else 'from log',
                     'dof': _finite(uncertainty.causes[i].dof)}
        lines.append(line)
    dof = uncertainty.effective_dof(shares)
    answer = {'contributors': lines, 'errors': solution.to_json_dict()['errors'],
              'effective_dof': _by_error(solution.names, [_finite(d) for d in dof]),
              'combined': _by_error(solution.names, total), 'status': solution.status,
              'points': {'position_m': points.tolist(), 'deviation_m': prediction.deviation_m.tolist(),
                         'covariance_m2': prediction.covariance_m2.tolist()},
              'unidentifiable': [{'names': list(u.names), 'why': u.why} for u in solution.unidentifiable]}
    if drawn is not None:
        lower, upper = drawn.interval()
        answer['monte_carlo'] = {'draws': len(drawn.values), 'sigma': _by_error(drawn.names, drawn.sigma),
                                 'mean': _by_error(drawn.names, drawn.values.mean(axis=0)),
                                 'lower_95': _by_error(drawn.names, lower),
                                 'upper_95': _by_error(drawn.names, upper), 'last_step_sigma': drawn.left}
    return answer


def _finite(value: float) -> float | str:
    return float(value) if np.isfinite(value) else 'infinite'


def _by_error(names, values) -> dict:
    """``{'EXX': [...], 'EC0Y': x}`` from values in a solution's order."""
    out: dict = {}
    for (name, knot), value in zip(names, values, strict=True):
        number = value if isinstance(value, str) else float(value)
        if knot < 0:
            out[name] = number
        else:
            out.setdefault(name, []).append(number)
    return out


def text(log: CalibrationLog, found: tuple, points: np.ndarray, drawn, args: argparse.Namespace) -> str:
    """The budget as a table for people."""
    _, uncertainty = found
    solution, machine = uncertainty.solution, log.description.machine
    at, shares = uncertainty.at(machine, points), uncertainty.shares()
    places = [', '.join(f'{1e3 * c:.0f}' for c in p) for p in points]
    lines = [f'{args.bag}: standard uncertainties of the deviation (x, y, z) in µm', '',
             f'{"contributor":28} {"type":4} {"distribution":12} ' + ' '.join(f'{p:>23}' for p in places)]
    for i, name in enumerate(uncertainty.names):
        kind, shape = '', ''
        if i < len(uncertainty.causes):
            c = uncertainty.causes[i].contributor
            kind, shape = c.type, c.distribution
        lines.append(f'{name:28} {kind:4} {shape:12} ' + ' '.join(_three(row) for row in at[i]))
    total = np.sqrt(np.sum(at**2, axis=0))
    factor = coverage_factor(uncertainty.effective_dof(at))
    lines += [f'{"combined":46} ' + ' '.join(_three(row) for row in total),
              f'{"expanded, 95 %":46} ' + ' '.join(_three(row) for row in factor * total), '']
    lines.append(f'{"error":6} {"u":>9} {"k":>5} {"U, 95 %":>9}' + ('' if drawn is None else f' {"Monte Carlo u":>14}')
                 + '       largest contributors')
    total = np.sqrt(np.sum(shares**2, axis=0))
    factor = coverage_factor(uncertainty.effective_dof(shares))
    for name in (*CURVES, *SQUARENESS):
        rows = [i for i, (n, _) in enumerate(solution.names) if n == name]
        row = max(rows, key=lambda i: total[i])
        unit = 'µm' if name in CURVES and name[1] in 'XYZ' else 'µrad'
        drawn_text = ''
        if drawn is not None:
            own = [i for i, (n, _) in enumerate(drawn.names) if n == name]
            drawn_text = f' {1e6 * drawn.sigma[own].max():14.3f}' if own else f' {"-":>14}'
        order = np.argsort(-shares[:, row], kind='stable')[:2]
        main = ', '.join(f'{uncertainty.names[i]} {1e6 * shares[i, row]:.3f}' for i in order if shares[i, row])
        lines.append(f'{name:6} {1e6 * total[row]:9.3f} {factor[row]:5.2f} {1e6 * factor[row] * total[row]:9.3f}'
                     f'{drawn_text} {unit:5} {main}')
    lines += ['', 'Each error at the position where it is largest; positions and all else: --json.']
    if drawn is not None:
        lines.append(f'Monte Carlo: {len(drawn.values)} draws through {args.method}, last step '
                     f'{drawn.left:.1e} of a standard uncertainty.')
    if solution.status != 'ok':
        lines.append(f'warning: {solution.status}')
    if (solution.reduced_chi2 or 0.0) > 2.0:
        lines.append(f'warning: reduced χ² is {solution.reduced_chi2:.1f}: the rigid-body model does not describe '
                     f'this log, and no budget covers that; stepdiag gap {args.bag} says why.')
    return '\n'.join(lines)


def _three(row: np.ndarray) -> str:
    return ' '.join(f'{1e6 * value:7.3f}' for value in row)
