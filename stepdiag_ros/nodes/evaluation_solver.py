"""The solver's node: evaluates what the graph delivers, and publishes the errors.

It hears the same messages as the recorder, keeps them, and gives them to the same pure
function as ``stepdiag evaluate BAG`` does: the result has the same bits.  It evaluates by
itself when a calibration has ended, and on the service ``evaluate``.  Activating begins
a new log.
"""

import json
import sys
import threading
import time

from action_msgs.msg import GoalStatus, GoalStatusArray
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from stepdiag_msgs.msg import GeometricErrors
from stepdiag_ros.bag.schemas import DESCRIPTION, STEP, TOPICS
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import Solution, evaluate
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import SQUARENESS
from stepdiag_ros.nodes.assembler import LogAssembler
from stepdiag_ros.nodes.base import (
    ERROR,
    OK,
    WARN,
    Health,
    StepdiagNode,
    overridable,
    reliable,
    run_node,
)
from stepdiag_ros.nodes.ears import Ears, Heard
from stepdiag_ros.nodes.stamps import stamp_of
from stepdiag_ros.nodes.step_sequencer import ACTION

TOPIC = 'geometric_errors'
#: Longest wait for samples that are still on their way.
SETTLE_S = 3.0


def errors_message(solution: Solution, time_ns: int) -> GeometricErrors:
    """A solution as a message."""
    squareness = {name: solution.squareness(name) if solution.has(name) else (float('nan'),) * 2
                  for name in SQUARENESS}
    return GeometricErrors(
        header=Header(stamp=stamp_of(time_ns)), status=solution.status,
        reduced_chi2=float('nan') if solution.reduced_chi2 is None else float(solution.reduced_chi2),
        dof=int(solution.dof or 0),
        squareness=[squareness[name][0] for name in ('EC0Y', 'EB0Z', 'EA0Z')],
        squareness_sigma=[squareness[name][1] for name in ('EC0Y', 'EB0Z', 'EA0Z')],
        json=json.dumps(solution.to_json_dict(), allow_nan=True))


class EvaluationSolver(StepdiagNode):
    """Keeps a log in memory and evaluates it."""

    def __init__(self):
        super().__init__('evaluation_solver')
        self.text('evaluate_when_done', True, 'evaluate by itself when a calibration has succeeded')
        self._publisher = self.create_lifecycle_publisher(
            GeometricErrors, TOPIC, reliable(1, latched=True), qos_overriding_options=overridable())
        self.create_service(Trigger, 'evaluate', self._on_evaluate)
        self.create_subscription(GoalStatusArray, f'{ACTION}/_action/status', self._on_status,
                                 reliable(10, latched=True))
        self._lock = threading.Lock()
        self._assembler = LogAssembler(self.get_namespace())
        self._ears: Ears | None = None
        self._working = threading.Lock()
        self._running: set[bytes] = set()
        self._last = 'nothing evaluated yet'
        self._failed = False

    def activate(self) -> None:
        self._assembler = LogAssembler(self.get_namespace())
        self._running.clear()
        self._ears = Ears(self, TOPICS, self._keep, latched=(DESCRIPTION,))

    def deactivate(self) -> None:
        if self._ears is not None:
            self._ears.close()

    def cleanup(self) -> None:
        self.deactivate()
        self._ears = None

    def _keep(self, heard: Heard) -> None:
        with self._lock:
            self._assembler.add(heard.topic, heard.cdr, heard.sequence)

    def _on_status(self, array: GoalStatusArray) -> None:
        """A calibration that ends while this node is active is evaluated once."""
        for status in array.status_list:
            goal = bytes(status.goal_info.goal_id.uuid)
            if status.status in (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING):
                self._running.add(goal)
            elif goal in self._running and status.status != GoalStatus.STATUS_CANCELING:
                self._running.discard(goal)
                if status.status == GoalStatus.STATUS_SUCCEEDED and self.state == 'active' \
                        and self.value('evaluate_when_done'):
                    threading.Thread(target=self._evaluate, name='evaluation', daemon=True).start()

    def _on_evaluate(self, _request, response: Trigger.Response) -> Trigger.Response:
        """Waits for the result; messages are kept meanwhile, the ears have a thread of their own."""
        response.success, response.message = self._evaluate()
        return response

    def _evaluate(self) -> tuple[bool, str]:
        """Evaluate and publish; (success, the document or what is wrong)."""
        if self.state != 'active':
            return False, f'{self.get_name()} is not active'
        with self._working:
            try:
                solution = evaluate(self._whole_log())
            except StepdiagError as error:
                self._last, self._failed = str(error), True
                self.get_logger().error(str(error))
                return False, str(error)
            message = errors_message(solution, time.time_ns())
            self._publisher.publish(message)
            self._last, self._failed = f'{solution.status}, reduced chi2 {solution.reduced_chi2}', False
            return True, message.json

    def _whole_log(self) -> CalibrationLog:
        """The log, once the samples of the last dwell have arrived too."""
        end = time.monotonic() + SETTLE_S
        while True:
            with self._lock:
                kept = self._assembler.copy()
            log = kept.build()
            last = log.steps.time_ns[-1]
            behind = [s for s in (log.displacement, log.spot) if len(s) and s.time_ns[-1] < last]
            if not behind or time.monotonic() > end:
                return log
            time.sleep(0.05)

    def health(self) -> Health:
        if self._ears is None or self.state != 'active':
            return Health(OK, self.state)
        lost = sum(self._ears.lost.values())
        values = {'messages': len(self._assembler), 'lost': lost,
                  'steps': self._assembler.count(STEP), 'last': self._last}
        if self._failed:
            return Health(ERROR, self._last, values)
        if lost:
            return Health(WARN, f'{lost} messages were lost', values)
        return Health(OK, 'evaluating' if self._working.locked() else 'listening', values)


def main() -> int:
    return run_node(EvaluationSolver)


if __name__ == '__main__':
    sys.exit(main())
