"""The gap monitor's node: does the rigid-body model explain what is being measured?

After each traverse it fits what has been measured so far, and publishes the errors of it.  When the residuals leave
the noise floor, which the log itself gives, it warns on ``/diagnostics`` and says where; a mistake of commissioning it
names there as soon as readings show it.  When a calibration has ended, or on the service ``diagnose``, it runs the
whole diagnosis and publishes ``gap_report``; not of a log with such a mistake.
"""

import argparse
import math
import os
import sys
import threading
import time
import traceback
from dataclasses import dataclass, replace

import numpy as np
from rclpy.utilities import remove_ros_args

from stepdiag_msgs.msg import GapReport, GeometricErrors
from stepdiag_msgs.srv import Diagnose
from stepdiag_ros.bag.shown import ERRORS_SO_FAR, GAP
from stepdiag_ros.effects import all_effects
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import Solution, evaluate
from stepdiag_ros.estimate.sanity_fit import must_be_sane
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.nodes.answers import errors_message, report_message
from stepdiag_ros.nodes.base import ERROR, OK, WARN, Health, overridable, reliable, run_node
from stepdiag_ros.nodes.listener import ListenerNode

#: With fewer degrees of freedom a fit says nothing about its residuals.
LEAST_DOF = 20
#: The watching takes at most this share of a processor.
SHARE = 0.25


@dataclass(frozen=True)
class Leaving:
    """How far the residuals are above the noise floor: reduced chi2, its excess in sigmas, the worst setup."""

    reduced_chi2: float
    dof: int
    sigmas: float
    worst_setup: str


def leaving(solution: Solution) -> Leaving | None:
    """Compare a fit's residuals with what the noise allows; ``None`` where the fit cannot say."""
    if solution.dof is None or solution.dof < LEAST_DOF or solution.reduced_chi2 is None:
        return None
    sigmas = (solution.reduced_chi2 - 1.0) / math.sqrt(2.0 / solution.dof)
    residuals, worst = solution.residuals, ''
    if residuals is not None:
        def size(name: str) -> float:
            return float(np.nanmean(residuals.displacement_m[residuals.setup == name] ** 2))
        measured = [name for name in dict.fromkeys(residuals.setup)
                    if np.isfinite(residuals.displacement_m[residuals.setup == name]).any()]
        worst = max(measured, key=size, default='')
    return Leaving(float(solution.reduced_chi2), int(solution.dof), sigmas, str(worst))


class GapMonitor(ListenerNode):
    """Watches the residuals, and diagnoses when all is measured."""

    def __init__(self, effect_files: tuple[str, ...] = ()):
        super().__init__('gap_monitor')
        self._effect_files = effect_files
        self.number('alarm', 5.0, 'excess of the reduced chi2 over 1 that is worth a warning, in its own '
                    'standard deviations', 1.0, 100.0, '1')
        self.number('period', 5.0, 'between two looks at the residuals', 0.5, 3600.0, 's')
        self.text('diagnose_when_done', True, 'diagnose by itself when a calibration has succeeded')
        self._publisher = self.create_lifecycle_publisher(
            GapReport, GAP, reliable(1, latched=True), qos_overriding_options=overridable())
        self._so_far = self.create_lifecycle_publisher(
            GeometricErrors, ERRORS_SO_FAR, reliable(1, latched=True), qos_overriding_options=overridable())
        self.create_service(Diagnose, 'diagnose', self._on_diagnose)
        # Of the present log: what still computes for an earlier one finds its own set.
        self._stop = threading.Event()
        self._leaving: Leaving | None = None
        self._mistakes = ''
        self._verdict = ''
        self._fault_of_work = ''

    def configure(self) -> None:
        self._effects = [kind() for kind in all_effects(self._effect_files).values()]

    def activate(self) -> None:
        super().activate()
        self._leaving, self._mistakes, self._verdict, self._fault_of_work = None, '', '', ''
        self._stop = threading.Event()
        threading.Thread(target=self._watch, args=(self._stop,), name='watch', daemon=True).start()

    def deactivate(self) -> None:
        # Not waited for: a diagnosis under way may take minutes, and whoever begins a new log has no use for it.
        self._stop.set()
        super().deactivate()

    def _watch(self, stop: threading.Event) -> None:
        """Look at the residuals whenever there is something new, sparingly."""
        seen, wait_s = 0, 1.0
        while not stop.wait(wait_s):
            wait_s = self.value('period')
            received = self.steps_received()
            if received == seen:
                continue
            seen, began = received, time.process_time()
            with self.working():
                if stop.is_set():
                    return
                try:
                    log = self.log_so_far()
                    solution = evaluate(log)
                    if stop.is_set():
                        return
                    self._leaving, self._mistakes = leaving(solution), '; '.join(map(str, solution.sanity))
                    self._so_far.publish(errors_message(solution, int(log.steps.time_ns[-1]), complete=False))
                except StepdiagError:
                    continue   # not enough has been measured yet
                except Exception as error:
                    self.get_logger().error(traceback.format_exc())
                    self._failed(f'the residuals cannot be judged: {type(error).__name__}: {error}')
                    continue
            wait_s = max(wait_s, (time.process_time() - began) / SHARE)

    def calibration_done(self) -> None:
        if self.value('diagnose_when_done'):
            self._diagnose()

    def _on_diagnose(self, _request, response: Diagnose.Response) -> Diagnose.Response:
        return self._diagnose()

    def _diagnose(self) -> Diagnose.Response:
        """Diagnose and publish."""
        stop = self._stop
        if self.state != 'active':
            return Diagnose.Response(success=False, message=f'{self.get_name()} is not active')
        with self.working():
            try:
                log = self.whole_log()
                must_be_sane(log)
                diagnosis = diagnose(log, self._effects)
                if stop.is_set():
                    return Diagnose.Response(success=False, message='another log was begun meanwhile; stepdiag gap '
                                                                    'diagnoses the bag of this one')
            except StepdiagError as error:
                return self._failed(str(error))
            except Exception as error:
                # The measuring goes on whatever the diagnosis stumbles over; say it and keep it.
                self.get_logger().error(traceback.format_exc())
                return self._failed(f'the diagnosis failed: {type(error).__name__}: {error}')
            report = report_message(diagnosis, time.time_ns())
            self._publisher.publish(report)
            self._fault_of_work, self._verdict = '', diagnosis.verdict
            return Diagnose.Response(success=True, report=report,
                                     document=to_json(diagnosis.to_json_dict(), indent=None))

    def _failed(self, why: str) -> Diagnose.Response:
        self._fault_of_work = why
        self.get_logger().error(why)
        return Diagnose.Response(success=False, message=why)

    def health(self) -> Health:
        listening = self.health_of_listening()
        state = self._leaving
        values = {**listening.values, 'verdict': self._verdict or 'none yet'}
        if state is not None:
            values |= {'reduced_chi2': state.reduced_chi2, 'dof': state.dof,
                       'excess_sigmas': state.sigmas, 'worst_setup': state.worst_setup}
        if listening.level != OK or self.state != 'active':
            return replace(listening, values=values)
        if self._fault_of_work:
            return Health(ERROR, self._fault_of_work, values)
        if self._mistakes:
            return Health(WARN, f'the log is not sane: {self._mistakes}', values)
        if state is not None and state.sigmas > self.value('alarm'):
            return Health(WARN, f'residuals leave the noise floor: reduced chi2 {state.reduced_chi2:.2f}, '
                                f'most in setup {state.worst_setup}', values)
        return Health(OK, 'residuals within the noise' if state is not None else 'watching', values)


def main() -> int:
    parser = argparse.ArgumentParser(prog='gap_monitor', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='Python file with an effect of your own; it is run, so give only files that you trust')
    # From the command line alone: a parameter could be set by everybody on this computer.
    files = tuple(parser.parse_args(remove_ros_args(sys.argv)[1:]).effect)
    os.nice(10)   # watching must not delay those who measure
    return run_node(lambda: GapMonitor(files))


if __name__ == '__main__':
    sys.exit(main())
