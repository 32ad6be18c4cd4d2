"""The solver's node: evaluates what the graph delivers, and publishes the errors.

It receives the same messages as the recorder, keeps them, and gives them to the same pure
function as ``stepdiag evaluate BAG`` does: the result has the same bits.  It evaluates by
itself when a calibration has ended, and on the service ``evaluate``.  Activating begins
a new log.
"""

import sys
import traceback
from dataclasses import replace

from stepdiag_msgs.msg import GeometricErrors
from stepdiag_msgs.srv import Evaluate
from stepdiag_ros.bag.shown import ERRORS
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.estimate.status import OK as GOOD
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.nodes.answers import errors_message
from stepdiag_ros.nodes.base import ERROR, OK, Health, overridable, reliable, run_node
from stepdiag_ros.nodes.listener import ListenerNode


class EvaluationSolver(ListenerNode):
    """Keeps a log in memory and evaluates it."""

    def __init__(self):
        super().__init__('evaluation_solver')
        self.text('evaluate_when_done', True, 'evaluate by itself when a calibration has succeeded')
        self._publisher = self.create_lifecycle_publisher(
            GeometricErrors, ERRORS, reliable(1, latched=True), qos_overriding_options=overridable())
        self.create_service(Evaluate, 'evaluate', self._on_evaluate)
        self._last = 'nothing evaluated yet'
        self._failed = False

    def calibration_done(self) -> None:
        if self.value('evaluate_when_done'):
            self._evaluate()

    def _on_evaluate(self, _request, response: Evaluate.Response) -> Evaluate.Response:
        """Waits for the result; messages are kept meanwhile, the raw subscription has a thread of its own."""
        return self._evaluate()

    def _evaluate(self) -> Evaluate.Response:
        """Evaluate and publish."""
        if self.state != 'active':
            return Evaluate.Response(success=False, message=f'{self.get_name()} is not active')
        with self.working():
            try:
                log = self.whole_log()
                solution = evaluate(log)
            except StepdiagError as error:
                return self._refuse(str(error))
            except Exception as error:
                # The solver lives on, and keeps what it receives, whatever a log does to the evaluation.
                self.get_logger().error(traceback.format_exc())
                return self._refuse(f'the evaluation failed: {type(error).__name__}: {error}')
            errors = errors_message(solution, int(log.steps.time_ns[-1]))
            self._publisher.publish(errors)
            self._last, self._failed = f'{solution.status}, reduced chi2 {solution.reduced_chi2}', False
            if solution.status != GOOD:
                self.get_logger().warning('; '.join([solution.status, *map(str, solution.sanity)]))
            return Evaluate.Response(success=True, errors=errors,
                                     document=to_json(solution.to_json_dict(), indent=None))

    def _refuse(self, why: str) -> Evaluate.Response:
        self._last, self._failed = why, True
        self.get_logger().error(why)
        return Evaluate.Response(success=False, message=why)

    def health(self) -> Health:
        listening = self.health_of_listening()
        values = {**listening.values, 'last': self._last}
        if listening.level == OK and self._failed:
            return Health(ERROR, self._last, values)
        if listening.level == OK and self.is_working:
            return Health(OK, 'evaluating', values)
        return replace(listening, values=values)


def main() -> int:
    return run_node(EvaluationSolver)


if __name__ == '__main__':
    sys.exit(main())
