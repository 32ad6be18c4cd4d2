"""Compensation tables for a control, from a log.

Evaluates the log and writes the tables of the format asked for into DIR.  Load them as the control's
manual says, measure again, and see that the errors have shrunk before you rely on them.

  stepdiag compensate bags/demo --format linuxcnc --out tables
"""

import argparse
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json

NAME = 'compensate'
HELP = 'compensation tables for a control'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--format', required=True, choices=('linuxcnc', 'sinumerik', 'heidenhain', 'etalon', 'isg'),
                        help='whose tables')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True, help='folder for the tables')
    parser.add_argument('--json', action='store_true', help='print what was written as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.estimate import evaluate
    from stepdiag_ros.report.compensation import tables

    log = read_log(args.bag, args.namespace)
    solution = evaluate(log)
    files = tables(solution, args.format, log.description.machine.name)
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (args.out / name).write_text(text, encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{args.out}: cannot be written: {error.strerror or error}') from None
    if args.json:
        print(to_json({'format': args.format, 'files': [str(args.out / name) for name in files],
                          'reduced_chi2': solution.reduced_chi2, 'warnings': list(solution.warnings)}))
        return 0
    for name in files:
        print(args.out / name)
    if solution.reduced_chi2 is not None and solution.reduced_chi2 > 1.3:
        print(f'note: the log disagrees with the model (reduced chi2 {solution.reduced_chi2:.2f}); see '
              f'`stepdiag gap {args.bag}` before you load these')
    return 0
