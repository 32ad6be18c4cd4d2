"""Bring a virtual machine up, calibrate it, and show the errors found beside the true ones.

Everything real but the machine: instruments that speak their own protocols, ROS nodes in
processes of their own, a recorded bag.  Takes about a minute and a half.  Ends with status 0
if what was found agrees with the truth.
"""

import argparse
import os
import time
from datetime import datetime
from pathlib import Path

from stepdiag_ros.cli.progress import Bar
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json

NAME = 'demo'
HELP = 'bring a virtual machine up, calibrate it, show the errors found'
#: Share of the values that must lie within two standard deviations of the truth, and the
#: reduced chi2 that a fit must not exceed, for the demo to call itself a success.
AGREEMENT, GREATEST_CHI2 = 0.9, 1.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--cell', type=Path, help='cell file (default: the small machine cells/demo.yaml)')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='where bag, result and picture go (default: a new stepdiag_demo_… here)')
    parser.add_argument('--setups', nargs='+', default=[], metavar='NAME', help=argparse.SUPPRESS)
    parser.add_argument('--repeats', type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument('--json', action='store_true', help='print result and comparison as JSON')
    parser.set_defaults(steps=0, dwell=0.0)


def demo_cell() -> Path:
    """The demo's cell file: of the repository, or as installed."""
    beside = Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml'
    if beside.is_file():
        return beside
    try:
        from ament_index_python.packages import get_package_share_directory
        installed = Path(get_package_share_directory('stepdiag_ros')) / 'cells' / 'demo.yaml'
    except LookupError:
        installed = beside
    if not installed.is_file():
        raise StepdiagError(f'{installed}: the demo\'s cell file is not there; name one with --cell')
    return installed


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.cli.calibrate import measure
    from stepdiag_ros.estimate import evaluate
    from stepdiag_ros.estimate.compare import compare, text_table, truth_of
    from stepdiag_ros.nodes.bringup import Bringup
    from stepdiag_ros.nodes.environment import free_domain

    out = Path(f'stepdiag_demo_{datetime.now():%Y%m%d_%H%M%S}') if args.out is None else args.out
    if out.exists() and any(out.iterdir()):
        raise StepdiagError(f'{out}: is not empty; give a new --out')
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    bar = Bar('calibrating', quiet=args.json)
    bag = (out / 'log').absolute()
    domain = None if 'ROS_DOMAIN_ID' in os.environ else free_domain()
    with Bringup(args.cell or demo_cell(), bag=bag, runtime=out / 'run', domain=domain,
                 say=bar.say) as cell:
        up_s = time.monotonic() - began
        outcome = measure(cell.operator, bar, args, cell.watch)
        bar.close()
        if not outcome.succeeded:
            raise StepdiagError(f'the calibration was {outcome.how}: {outcome.message}; '
                                f'the logs of the nodes are in {out / "run"}')
        bar.say('evaluating, live')
        live = cell.operator.evaluate()
        truth_text = cell.truth_file.read_text(encoding='utf-8')
    log = read_log(bag)
    solution = evaluate(log)
    truth = truth_of(truth_text, log.description, 'log', str(cell.truth_file))
    same = same_result(live, solution.to_json_dict())
    outcome_vs_truth = compare({solution.method: solution}, truth, 'truth', log.description)
    share = outcome_vs_truth.within_k2[solution.method]
    (out / 'solution.json').write_text(to_json(solution.to_json_dict()), encoding='utf-8')
    (out / 'truth.json').write_text(truth_text, encoding='utf-8')
    picture = _picture(outcome_vs_truth, solution, truth, out / 'errors.png')
    chi2 = solution.reduced_chi2
    good = same and share is not None and share >= AGREEMENT and chi2 <= GREATEST_CHI2
    report = {'agrees': good, 'within_k2': share, 'reduced_chi2': chi2, 'live_equals_bag': same,
              'stops': outcome.stops, 'seconds': round(time.monotonic() - began, 1),
              'seconds_to_start': round(up_s, 1), 'bag': str(bag), 'picture': str(picture)}
    if args.json:
        print(to_json(report | {'evaluation': solution.to_json_dict()}))
    else:
        print(f'\n{text_table(outcome_vs_truth)}\n')
        print(f'{outcome.message}; reduced chi2 {chi2:.2f}; '
              f'{100 * share:.0f} % of the errors within k = 2 of the truth')
        print('the live evaluation and the one of the bag '
              + ('have the same bits' if same else 'DIFFER'))
        print(f'picture  {picture}\nlog      {bag}\nresult   {out / "solution.json"}')
        print(f'{report["seconds"]:.0f} s, of which {report["seconds_to_start"]:.0f} s to bring the '
              f'cell up.  ' + ('All well.' if good else 'The result does NOT agree with the truth.'))
    return 0 if good else 1


def same_result(one: dict, other: dict) -> bool:
    """Whether two evaluations have the same bits in every number (warnings name their source)."""
    def bare(document: dict) -> str:
        return to_json({k: v for k, v in document.items() if k != 'warnings'}, sort_keys=True)
    return bare(one) == bare(other)


def _picture(comparison, solution, truth, path: Path) -> Path:
    try:
        from stepdiag_ros.report.figures import calibration_figure
    except ImportError:
        from stepdiag_ros.report.compare_picture import draw
        draw(comparison, {solution.method: solution}, path, 'demo')
    else:
        calibration_figure(solution, truth, path)
    return path
