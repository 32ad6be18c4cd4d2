"""Predict the volumetric error of the machine behind a log: at a grid, or at points of your own.

Evaluates the log and carries the errors found, with their uncertainty, to any point of the volume.
The table (--csv) holds position, deviation, its standard deviation, and the command that
cancels the deviation, all in metres.  Where nothing may be acted on, because lengths are not corrected for air, the
log does not describe a machine or leaves errors open, no command is given.

  stepdiag map bags/demo
  stepdiag map bags/demo --out map.png --csv map.csv --grid 21
  stepdiag map bags/demo --at 0.1,0.08,0.06 --tool 0,0,-0.2
"""

import argparse
import csv
from pathlib import Path

import numpy as np

from stepdiag_ros.cli.evaluate import tied_lines
from stepdiag_ros.cli.vector import vector
from stepdiag_ros.compensate.fit_to_act import not_metres, unfit
from stepdiag_ros.compensate.open_directions import openness
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.methods import run_method
from stepdiag_ros.estimate.prediction import Prediction, compensated_command, predict, volumetric_map
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.model.description import Machine

NAME = 'map'
HELP = 'the volumetric error that a solution predicts'
COLUMNS = ('x_m', 'y_m', 'z_m', 'dx_m', 'dy_m', 'dz_m', 'sigma_dx_m', 'sigma_dy_m', 'sigma_dz_m',
           'command_x_m', 'command_y_m', 'command_z_m')
FORMATS = ('.png', '.svg', '.pdf')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--method', default='enhanced', help='method that evaluates the log (default: enhanced)')
    parser.add_argument('--grid', type=int, default=11, metavar='N', help='positions an axis (default: 11)')
    parser.add_argument('--at', action='append', metavar='X,Y,Z', help='a commanded point [m]; may be repeated')
    parser.add_argument('--tool', metavar='X,Y,Z', help="another tool vector [m] than the log's")
    parser.add_argument('--out', metavar='FILE', type=Path, help=f'draw the map ({", ".join(FORMATS)})')
    parser.add_argument('--csv', metavar='FILE', type=Path, help='write the points as a table')
    parser.add_argument('--json', action='store_true', help='print the points as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log

    if not 2 <= args.grid <= 101:
        raise StepdiagError(f'--grid is {args.grid}; give 2 to 101 positions an axis')
    if args.out is not None and args.out.suffix.lower() not in FORMATS:
        raise StepdiagError(f'--out {args.out}: unknown kind of picture; end the name in {" or ".join(FORMATS)}')
    if args.out is not None and args.at:
        raise StepdiagError('--out draws the grid; leave --at away or ask in two calls')
    points = None if not args.at else np.array([vector(text, '--at') for text in args.at])
    tool = None if args.tool is None else vector(args.tool, '--tool')
    log = read_log(args.bag, args.namespace)
    solution, machine = run_method(args.method, log), log.description.machine
    if not isinstance(solution, Solution):
        raise StepdiagError(f'--method {args.method}: gives no errors to predict with; take enhanced')
    chart = None if points is not None else volumetric_map(solution, machine, args.grid, tool)
    prediction = chart.prediction if chart is not None else predict(solution, machine, points, tool)
    # Where nothing may be acted on, no command is given; the deviations are shown with their U all the same.
    loose = openness(solution).open
    wrong = '; '.join(filter(None, (not_metres(solution, log), *unfit(solution),
                                    f'the log leaves {", ".join(loose)} open' if loose else '')))
    command = None if wrong else _command(solution, machine, prediction, tool, args)
    try:
        if args.csv is not None:
            _write_table(args.csv, prediction, command)
        if args.out is not None and chart is not None:
            from stepdiag_ros.report.map_figure import draw_map

            draw_map(chart, machine, args.out, f'{machine.name}: predicted volumetric error')
    except OSError as error:
        raise StepdiagError(f'{error.filename}: cannot be written: {error.strerror}') from None
    tied = solution.traceability
    if args.json:
        answer = {'position_m': prediction.points.tolist(), 'deviation_m': prediction.deviation_m.tolist(),
                  'sigma_m': prediction.sigma_m.tolist(),
                  'command_m': None if command is None else command.tolist(), 'no_command': wrong or None,
                  'status': solution.status,
                  'reference_temperature': tied.reference_temperature if tied else None,
                  'traceability': tied.to_json_dict() if tied else None}
        print(to_json(answer | (dict(chart.to_json_dict()) if chart is not None else {})))
        return 0
    _print(prediction, command, machine, chart is not None)
    if wrong:
        print(f'no command is given: {wrong}')
    print('\n'.join((*tied_lines(solution), *(f'warning: {remark}' for remark in (tied.remarks if tied else ())))))
    for path, what in ((args.csv, 'table'), (args.out, 'picture')):
        if path is not None:
            print(f'{what}: {path}')
    return 0


def _command(solution: Solution, machine: Machine, prediction: Prediction, tool: np.ndarray | None,
             args: argparse.Namespace) -> np.ndarray:
    try:
        return compensated_command(solution.errors, machine, prediction.points, tool)
    except ValueError as error:
        raise StepdiagError(f'{args.bag}: {error}; its measured errors cannot be a machine\'s') from None


def _write_table(path: Path, prediction: Prediction, command: np.ndarray | None) -> None:
    columns = [prediction.points, prediction.deviation_m, prediction.sigma_m, *([] if command is None else [command])]
    table = np.hstack(columns)
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS[:table.shape[1]])
        writer.writerows([[repr(float(value)) for value in row] for row in table])


def _print(prediction: Prediction, command: np.ndarray | None, machine: Machine, grid: bool) -> None:
    size, sigma = prediction.size_m, prediction.size_sigma_m
    rows = [int(np.argmax(size))] if grid else range(len(size))
    if grid:
        spread = np.ptp(prediction.deviation_m, axis=0) * 1e6
        print(f'{machine.name}: deviation of the tool at {len(size)} points of the volume')
        print(f'  range        x {spread[0]:7.2f}   y {spread[1]:7.2f}   z {spread[2]:7.2f}  µm')
        print(f'  size         mean {np.mean(size) * 1e6:.2f}, largest {size.max() * 1e6:.2f} µm')
        print(f'  uncertainty  {2e6 * np.median(sigma):.2f} µm (k = 2, median), {2e6 * sigma.max():.2f} µm at most')
    for i in rows:
        place = ', '.join(f'{1e3 * c:.1f}' for c in prediction.points[i])
        parts = '   '.join(f'{name} {1e6 * d:+.2f} ± {2e6 * s:.2f}' for name, d, s in
                           zip('xyz', prediction.deviation_m[i], prediction.sigma_m[i], strict=True))
        print(f'{"largest at" if grid else "at"} ({place}) mm:  {parts}  µm (k = 2)')
        if command is not None:
            print('  cancelled by commanding ' + ', '.join(f'{1e3 * c:.5f}' for c in command[i]) + ' mm')
