"""Run the calibration on a cell and evaluate it.

TARGET is a cell file (the cell is brought up, calibrated and ended), or the namespace of a
machine that `stepdiag up` runs, e.g. /demo; without it, the one that runs.  The log goes into
a new bag.  With --all every machine that runs is calibrated, side by side.  Ctrl-C cancels:
the machine stands still and the bag is whole.

With --until-settled the log is diagnosed (as `stepdiag gap` does), and while it leaves open which cause acts, the cell
makes the further run that separates them best, if it can without hands: setups that its control mounts by code, waits,
long looks, repeats.  It ends when the answer is sure (status 0), or when no such run helps or time is up (status 1).

  stepdiag calibrate cells/demo.yaml
  stepdiag calibrate cells/demo.yaml --until-settled --settle-time 1800
  stepdiag calibrate --all
  stepdiag calibrate /demo --setups ppp npp --repeats 1 --bag bags/today
"""

import argparse
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stepdiag_ros.cli.progress import Bar
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.traceability import WORDS
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.jsontext import to_json

NAME = 'calibrate'
HELP = 'run the calibration on a cell and evaluate it'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('target', metavar='TARGET', nargs='?',
                        help='cell file, or namespace of a running machine (default: the one that runs)')
    parser.add_argument('--all', action='store_true',
                        help='calibrate every running machine, as those of a hall, side by side')
    parser.add_argument('--setups', nargs='+', default=[], metavar='NAME',
                        help="setups in the order of measuring (default: all of the cell's)")
    parser.add_argument('--steps', type=_up_to(limits.STEPS), default=0, metavar='N',
                        help="steps of each axis along a diagonal (default: the plan's)")
    parser.add_argument('--repeats', type=_up_to(limits.REPEATS), default=0, metavar='N',
                        help="forward and backward runs of each setup (default: the plan's)")
    parser.add_argument('--dwell', type=float, default=0.0, metavar='S',
                        help="measuring time at a stop [s] (default: the cell's)")
    parser.add_argument('--bag', type=Path, help='rosbag2 directory to write (default: a new one here)')
    parser.add_argument('--hardware', action='store_true',
                        help="with a cell file: its instruments are real, start no virtual cell")
    parser.add_argument('--until-settled', action='store_true',
                        help='diagnose the log and make further runs until it is sure which cause acts')
    parser.add_argument('--settle-time', type=_seconds, default=3600.0, metavar='S',
                        help='with --until-settled: longest time for further runs [s] (default: %(default)g)')
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='with --until-settled: Python file with an effect of your own; it is run, so give only '
                             'files that you trust')
    parser.add_argument('--json', action='store_true', help='print the evaluation as JSON')


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0e6:
        raise argparse.ArgumentTypeError(f'{text} is not between 0 and 1000000')
    return value


def _up_to(most: int) -> Callable[[str], int]:
    def whole_number(text: str) -> int:
        value = int(text)
        if not 0 <= value <= most:
            raise argparse.ArgumentTypeError(f'{value} is not between 0 and {most}')
        return value
    return whole_number


def run(args: argparse.Namespace) -> int:
    if args.all:
        from stepdiag_ros.cli.side_by_side import calibrate_all
        return calibrate_all(args)
    bar = Bar('calibrating', quiet=args.json)
    bag = None if args.bag is None else args.bag.expanduser().absolute()
    if bag is not None and bag.exists():
        raise StepdiagError(f'{bag}: exists already; give a new name or remove it')
    effects = _effects(args)
    settled = None
    with _target(args, bag, bar) as (operator, meanwhile):
        outcome = measure(operator, bar, args, meanwhile)
        bar.close()
        recorded = Path(operator.recorder.bag) if operator.recorder else bag
        document = operator.evaluate() if outcome.stops else None
        operator.bring('recorder', 'inactive')   # closes the bag
        if args.until_settled and outcome.succeeded:
            settled = _settled(operator, recorded, effects, bar, args, meanwhile)
            bar.close()
    if args.json:
        more = {} if settled is None else {'settled': settled.to_json_dict()}
        print(to_json({'outcome': outcome.how, 'message': outcome.message, 'bag': str(recorded),
                          'stops': outcome.stops, 'run_ids': list(outcome.run_ids),
                          'evaluation': document, **more}))
    else:
        print(f'{outcome.how}: {outcome.message}')
        print(f'log: {recorded}')
        if document is not None:
            print(summary(document))
            print(f'details: stepdiag evaluate {recorded}')
        if settled is not None:
            from stepdiag_ros.cli.settled import answer_words
            print(answer_words(settled, args.settle_time))
            further = ''.join(f' --further {one.bag}' for one in settled.rounds)
            print(f'details: stepdiag gap {recorded}{further}')
    if settled is not None and not settled.sure:
        return 130 if settled.outcome is not None and settled.outcome.how == 'canceled' else 1
    if outcome.how == 'succeeded' and document is not None and document['status'] != 'ok':
        return 1
    return {'succeeded': 0, 'canceled': 130}.get(outcome.how, 1)


def _effects(args: argparse.Namespace) -> list[Any]:
    """What the log is diagnosed against; a file that cannot be used is reported before anything moves."""
    if not args.until_settled:
        return []
    from stepdiag_ros.effects import all_effects
    return [kind() for kind in all_effects(args.effect).values()]


def _settled(operator: Any, bag: Path, effects: list[Any], bar: Bar, args: argparse.Namespace, meanwhile: Any) -> Any:
    """Further runs until the diagnosis is sure; each is said on the bar before it is made."""
    from stepdiag_ros.cli.settled import round_line
    from stepdiag_ros.nodes.settling import settle

    rounds: list[Any] = []

    def say(one: Any) -> None:
        rounds.append(one)
        bar.say(round_line(len(rounds), one))

    bar.say('diagnosing what the log leaves open')
    return settle(operator, bag, effects, time_s=args.settle_time, steps=args.steps, repeats=args.repeats,
                  dwell_s=args.dwell, say=say, meanwhile=meanwhile,
                  feedback=lambda f: bar.show(f.stop, f.stops, f.doing, f.time_left))


def measure(operator: Any, bar: Bar, args: argparse.Namespace, meanwhile=lambda: None) -> Any:
    """Send the goal with the command's options; progress on the bar."""
    from stepdiag_ros.nodes.step_sequencer import ASK

    def show(feedback) -> None:
        bar.show(feedback.stop, feedback.stops, feedback.doing, feedback.time_left)
        if feedback.doing.startswith(ASK):
            threading.Thread(target=confirm, args=(feedback.setup,), daemon=True).start()

    def confirm(setup: str) -> None:
        print(f'\nMount base unit and mirror for {setup}, then press Enter.', file=sys.stderr, flush=True)
        if sys.stdin.readline():   # at the end of input nobody can confirm: wait for the service
            operator.mounted()

    return operator.calibrate(args.setups, args.repeats, args.dwell, show, args.steps, meanwhile)


@contextmanager
def _target(args: argparse.Namespace, bag: Path | None, bar: Bar) -> Iterator[tuple[Any, Any]]:
    """The operator of what is to be calibrated, and what to do while waiting."""
    target = args.target
    if target is not None and (target.endswith(('.yaml', '.yml')) or Path(target).is_file()):
        from stepdiag_ros.nodes.bringup import Bringup
        with Bringup(target, hardware=args.hardware, bag=bag, steps=args.steps,
                     bag_folder=Path('.') if bag is None else bag.parent, say=bar.say) as cell:
            yield cell.operator, cell.watch
        return
    from stepdiag_ros.nodes.operator import Operator, running_machines
    if target is None:
        machines = running_machines()
        if len(machines) != 1:
            raise StepdiagError(f'{len(machines)} machines are running ({", ".join(machines)}); name one'
                                if machines else
                                'no machine is running; name a cell file, or start one with stepdiag up')
        target = machines[0]
    with Operator(target) as operator:
        operator.new_log('' if bag is None else str(bag), args.steps)
        yield operator, lambda: None


def fit_words(document: dict[str, Any]) -> str:
    """How well an evaluation fits; without degrees of freedom there is no reduced chi2 to say."""
    reduced, dof = document['reduced_chi2'], document['dof']
    if reduced is None:
        return f'status {document["status"]}, {dof} degrees of freedom'
    return f'status {document["status"]}, reduced chi2 {reduced:.3g} with {dof} degrees of freedom'


def _tied(tied: dict[str, Any] | None) -> list[str]:
    """What an evaluation says of metre, 20 °C and parts."""
    if tied is None:
        return []
    parts = tied['workpiece']
    return [f'lengths: {WORDS[tied["air"]]}; positioning errors: {tied["temperature"]}',
            f'parts: {parts if isinstance(parts, str) else parts["said"]}']


def summary(document: dict[str, Any]) -> str:
    """An evaluation in a few lines, µm and µrad."""
    lines = [fit_words(document),
             *_tied(document.get('traceability')), f'{"":6}{"range":>10}{"± (k=2)":>10}']
    lines[1:1] = [f'not sane: {finding["found"]}: {finding["change"]}' for finding in document.get('sanity', ())]
    for name, error in document['errors'].items():
        unit = 'µm' if name[1] in 'XYZ' and name[2] in 'XYZ' else 'µrad'
        if isinstance(error['value'], list):
            size = max(error['value']) - min(error['value'])
            sigma = max(error['sigma'])
        else:
            size, sigma, unit = error['value'], error['sigma'], 'µrad'
        lines.append(f'{name:6}{size * 1e6:10.2f}{2e6 * sigma:10.2f} {unit}')
    for open_direction in document['unidentifiable']:
        lines.append(f'not seen: {", ".join(open_direction["names"])}: {open_direction["why"]}')
    lines += [f'warning: {text}' for text in document.get('warnings', ())]
    return '\n'.join(lines)
