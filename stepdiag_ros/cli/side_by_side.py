"""Many machines calibrated side by side, with one line of progress a machine."""

import argparse
import sys
import threading
import time
from pathlib import Path
from typing import Any

from stepdiag_ros.cli.calibrate import fit_words
from stepdiag_ros.cli.progress import Lines
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.guard.show import escaped


class _Machine(threading.Thread):
    """One machine's calibration, from a new bag to the evaluation."""

    def __init__(self, namespace: str, args: argparse.Namespace, lines: Lines):
        super().__init__(name=namespace, daemon=True)
        self.namespace, self._args, self._lines = namespace, args, lines
        self.result: dict[str, Any] = {'outcome': 'aborted', 'message': '', 'bag': '', 'stops': 0, 'run_ids': [],
                                       'evaluation': None}
        self._operator: Any = None
        self._cancelled = threading.Event()

    def run(self) -> None:
        from stepdiag_ros.nodes.operator import Operator
        try:
            with Operator(self.namespace) as self._operator:
                self._measure(self._operator)
        except StepdiagError as error:
            self.result['message'] = str(error)
        self._lines.show(self.namespace, self.result['stops'], self.result['stops'],
                         f'{self.result["outcome"]}: {self.result["message"]}', final=True)

    def _measure(self, operator: Any) -> None:
        args = self._args
        self._lines.show(self.namespace, 0, 0, 'begins a new bag')
        operator.new_log('', args.steps)
        outcome = operator.calibrate(
            args.setups, args.repeats, args.dwell, steps=args.steps, meanwhile=self._ask_to_end,
            feedback=lambda f: self._lines.show(self.namespace, f.stop, f.stops, f.doing, f.time_left))
        self.result |= {'outcome': outcome.how, 'message': outcome.message, 'stops': outcome.stops,
                        'run_ids': list(outcome.run_ids)}
        if outcome.stops:
            self._lines.show(self.namespace, outcome.stops, outcome.stops, 'evaluates')
            self.result['evaluation'] = operator.evaluate()
        self.result['bag'] = operator.recorder.bag if operator.recorder else ''
        operator.bring('recorder', 'inactive')   # closes the bag

    def _ask_to_end(self) -> None:
        if self._cancelled.is_set():
            self._cancelled.clear()
            self._operator.cancel()

    def cancel(self) -> None:
        """Have the machine stop; the thread ends when it stands."""
        self._cancelled.set()


def calibrate_all(args: argparse.Namespace) -> int:
    """Calibrate every machine that runs; the exit status: 0 if all succeeded and are ok."""
    from stepdiag_ros.nodes.operator import running_machines
    from stepdiag_ros.nodes.ownership import machines_up
    if args.target is not None or args.bag is not None or args.hardware:
        raise StepdiagError('--all takes neither TARGET nor --bag nor --hardware: it calibrates what runs, each into a '
                            'new bag')
    # Those of this computer are known by their marks, however slow the discovery is.
    machines = sorted({*machines_up(), *running_machines()})
    if not machines:
        raise StepdiagError('no machine is running; start a hall with stepdiag hall HALL.yaml')
    lines = Lines(machines, quiet=args.json)
    threads = [_Machine(namespace, args, lines) for namespace in machines]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        try:
            time.sleep(0.1)
        except KeyboardInterrupt:
            for thread in threads:
                thread.cancel()
    lines.close()
    return _say({thread.namespace: thread.result for thread in threads}, args.json)


def _say(results: dict[str, dict[str, Any]], as_json: bool) -> int:
    if as_json:
        print(to_json(results))
    for namespace, result in results.items() if not as_json else ():
        evaluation = result['evaluation']
        print(escaped(f'{namespace}: {result["outcome"]}: {result["message"]}'))
        if evaluation is not None:
            print(f'  {fit_words(evaluation)}')
            print(escaped(f'  details: stepdiag evaluate {Path(result["bag"])}'))
    sys.stdout.flush()
    outcomes = [result['outcome'] for result in results.values()]
    well = all(result['evaluation'] and result['evaluation']['status'] == 'ok' for result in results.values())
    return 130 if 'canceled' in outcomes else 0 if well and set(outcomes) == {'succeeded'} else 1
