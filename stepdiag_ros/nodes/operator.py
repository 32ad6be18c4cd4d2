"""One facade for whoever works with a running graph: commands, tests, scripts.

Blocking calls on a small node of its own: is everybody there, lifecycle transitions,
parameters, the action with progress, the evaluation.
"""

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stepdiag_ros.nodes import base

# isort: split
import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger
from unique_identifier_msgs.msg import UUID

from stepdiag_msgs.action import RunStepDiagonal
from stepdiag_msgs.msg import RecorderStatus
from stepdiag_msgs.srv import Evaluate, NameLog
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.futures import ended
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.nodes.recorder import NAME_LOG
from stepdiag_ros.nodes.sent_goal import SILENT_S, LostGoal, SentGoal, silence_words
from stepdiag_ros.nodes.step_sequencer import ACTION, LEASE, lease_qos

TRANSITIONS = {'configure': Transition.TRANSITION_CONFIGURE,
               'activate': Transition.TRANSITION_ACTIVATE,
               'deactivate': Transition.TRANSITION_DEACTIVATE,
               'cleanup': Transition.TRANSITION_CLEANUP}
#: So often a goal's client says that it lives: a twentieth of the sequencer's default lease.
LEASE_PERIOD_S = 0.25
#: So often a calibration is taken up again after a sequencer died, and so long its return is waited for.
RESUMES, RETURN_S = 5, 90.0
#: What may be asked more than once is asked again after so long.
ASK_AGAIN_S = 2.0
#: So long one question whether it is back may take.
ANSWER_S = 8.0
UNCONFIGURED, INACTIVE, ACTIVE = 'unconfigured', 'inactive', 'active'
#: Where each transition ends.
ENDS = {'configure': INACTIVE, 'activate': ACTIVE, 'deactivate': INACTIVE, 'cleanup': UNCONFIGURED}
#: From a state to another: the next transition on the way.
WAYS = {(UNCONFIGURED, ACTIVE): 'configure', (UNCONFIGURED, INACTIVE): 'configure', (INACTIVE, ACTIVE): 'activate',
        (INACTIVE, UNCONFIGURED): 'cleanup', (ACTIVE, INACTIVE): 'deactivate', (ACTIVE, UNCONFIGURED): 'deactivate'}


@dataclass(frozen=True)
class Calibration:
    """How a goal ended: ``succeeded``, ``canceled`` or ``aborted``, and the result's fields."""

    how: str
    message: str
    run_ids: tuple[str, ...]
    stops: int

    @property
    def succeeded(self) -> bool:
        return self.how == 'succeeded'


def running_machines(wait_s: float = 5.0) -> list[str]:
    """Namespaces in which a sequencer runs; waits until one is found, and a little longer."""
    with Operator('') as anybody:
        patience, found = Patience(wait_s, 0.5), set()
        while not patience.over():
            seen = {space for name, space in anybody.node.get_node_names_and_namespaces()
                    if name == 'step_sequencer'}
            if seen and seen == found:
                break
            found = seen
            time.sleep(0.5)
        return sorted(found)


class Operator:
    """Talks to the nodes below ``namespace``; a context manager.

    Its node spins in a thread of its own, so every method may simply wait.
    """

    def __init__(self, namespace: str, domain: int | None = None):
        self.namespace = '/' + namespace.strip('/')
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain,
                   signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node('operator', namespace=self.namespace, context=self._context,
                         start_parameter_services=False)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self._heard: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._recorder: RecorderStatus | None = None
        self._handle = None
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)
        self.node.create_subscription(RecorderStatus, 'recorder/status', self._on_recorder, 10)
        self._changed: dict[str, dict[str, ParameterMessage]] = {}
        self.node.create_subscription(ParameterEvent, '/parameter_events', self._on_parameters, 1000)
        self._action = ActionClient(self.node, RunStepDiagonal, ACTION)
        self._lease = self.node.create_publisher(UUID, LEASE, lease_qos())
        self.node.create_timer(LEASE_PERIOD_S, self._renew_lease, clock=base.steady_clock())
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=base.spin, args=(self._executor, self._stop.is_set), name='operator', daemon=True)
        self._thread.start()

    def __enter__(self) -> 'Operator':
        return self

    def __exit__(self, *_exception) -> None:
        self.close()

    def close(self) -> None:
        """End the node; the graph goes on."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        self._action.destroy()
        base.end(self.node, self._context, self._executor)

    # -- what is received -----------------------------------------------------------

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self._heard['/' + status.name] = (time.monotonic(), status)

    def _on_parameters(self, event: ParameterEvent) -> None:
        for parameter in event.changed_parameters:
            self._changed.setdefault(event.node, {})[parameter.name] = parameter

    def _renew_lease(self) -> None:
        handle = self._handle
        if handle is not None:
            self._lease.publish(handle.goal_id)

    def _on_recorder(self, status: RecorderStatus) -> None:
        self._recorder = status

    def health(self, node: str) -> DiagnosticStatus | None:
        """The last diagnostics of one of the machine's nodes."""
        return self._heard.get(f'{self.namespace}/{node}', (0.0, None))[1]

    @property
    def recorder(self) -> RecorderStatus | None:
        """The recorder's last status."""
        return self._recorder

    # -- lifecycle and parameters ------------------------------------------------

    def state(self, node: str, timeout_s: float = 10.0) -> str:
        """The node's lifecycle state; :class:`StepdiagError` if it does not answer."""
        return self._call_until_answered(GetState, f'{node}/get_state', GetState.Request(),
                                         timeout_s).current_state.label

    def answers(self, node: str, timeout_s: float) -> bool:
        """Whether the node tells its lifecycle state in time."""
        try:
            self.state(node, timeout_s)
        except StepdiagError:
            return False
        return True

    def transition(self, node: str, name: str, timeout_s: float = 60.0) -> bool:
        """Ask for a transition; whether the node made it.

        A node that has just been started may not know this client yet: its answer is lost then, and its state tells.
        """
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[name]))
        before = self.state(node, timeout_s)

        def told() -> ChangeState.Response | None:
            state = self.state(node, timeout_s)
            return None if state == before else ChangeState.Response(success=state == ENDS[name])
        return self._call_until_answered(ChangeState, f'{node}/change_state', request, timeout_s, told).success

    def bring(self, node: str, target: str, timeout_s: float = 60.0) -> None:
        """Take a node to ``target`` on the shortest way; :class:`StepdiagError` if it refuses.

        Somebody else may make a step of the way first (a node that starts by itself does): that is no refusal.
        """
        patience, state = Patience(timeout_s, ANSWER_S), self.state(node, timeout_s)
        while state != target and (name := WAYS.get((state, target))) and not patience.over():
            before, asked_s = state, time.monotonic()
            made = self.transition(node, name, timeout_s)
            state = self.state(node, timeout_s)
            if not made and state != target and state in (before, UNCONFIGURED):
                raise StepdiagError(f'{self.namespace}/{node} refuses to {name}: '
                                    f'{self._why(node, asked_s)}')
        if state != target:
            raise StepdiagError(f'{self.namespace}/{node} is {state}, not {target}')

    def _why(self, node: str, since_s: float) -> str:
        """What the node has said of itself since a moment (monotonic)."""
        patience = Patience(3.0)
        while not patience.over():
            at, health = self._heard.get(f'{self.namespace}/{node}', (0.0, None))
            if at > since_s and health.level == DiagnosticStatus.ERROR:
                return health.message
            time.sleep(0.05)
        return 'see its log'

    def parameters(self, node: str, names: Sequence[str]) -> list[Any]:
        """Values of some of a node's parameters."""
        answer = self._call_until_answered(GetParameters, f'{node}/get_parameters',
                                           GetParameters.Request(names=list(names)), 10.0)
        return [parameter_value_to_python(value) for value in answer.values]

    def setups_by_code(self) -> tuple[str, ...]:
        """Setups that the control mounts by a code, without a hand."""
        pairs, = self.parameters('step_sequencer', ['setup_codes'])
        return tuple(pair.partition('=')[0] for pair in pairs if pair)

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> None:
        """Change parameters; :class:`StepdiagError` names the one that is refused."""
        request = SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        answer = self._call_until_answered(SetParameters, f'{node}/set_parameters', request, 10.0)
        for (name, value), result in zip(values.items(), answer.results, strict=True):
            if not result.successful:
                raise StepdiagError(f'{self.namespace}/{node}: parameter {name} cannot be '
                                    f'{value!r}: {result.reason}')

    def restore_parameters(self, node: str, timeout_s: float, but: Sequence[str] = ()) -> None:
        """Give a node that was started again the parameters that were changed since this facade is here."""
        changed = [p for name, p in self._changed.get(f'{self.namespace}/{node}', {}).items() if name not in but]
        if changed:
            self._call_until_answered(SetParameters, f'{node}/set_parameters',
                                      SetParameters.Request(parameters=changed), timeout_s)

    def new_log(self, bag: str = '', steps: int = 0) -> None:
        """Begin a new bag, and have those who keep a log of their own begin anew with it.

        ``bag``: its directory, in the folder in which the recorder makes bags; empty: a name is made there.
        ``steps``: of each axis along a diagonal, if not those of the cell description.
        """
        self._require_sequencer()
        name = self._name_of(bag)
        self._refuse_while_busy()
        self.bring('step_sequencer', UNCONFIGURED)
        listeners = ['recorder', 'evaluation_solver']
        if self._is_there('gap_monitor'):
            listeners.append('gap_monitor')
        for node in listeners:
            self.bring(node, INACTIVE)
        named = self._call_until_answered(NameLog, NAME_LOG, NameLog.Request(name=name), 10.0)
        if not named.success:
            raise StepdiagError(named.message)
        self.set_parameters('step_sequencer', {'steps': steps})
        for node in (*listeners, 'step_sequencer'):
            self.bring(node, ACTIVE)

    def _require_sequencer(self) -> None:
        """:class:`StepdiagError` where no machine of this name is up."""
        if not Patience(10.0).until(self._action.server_is_ready):
            raise StepdiagError(f'no sequencer answers at {self.namespace}/{ACTION}; '
                                'is the cell up? (stepdiag up CELL.yaml)')

    def _refuse_while_busy(self) -> None:
        """Somebody else's calibration must not be ended by who wants one of his own."""
        began, patience = time.monotonic(), Patience(3.0)
        while not patience.over():
            at, health = self._heard.get(f'{self.namespace}/step_sequencer', (0.0, None))
            busy = health is not None and any(v.key == 'goal' and v.value == 'under way' for v in health.values)
            if health is not None and (not busy or at > began):
                break
            time.sleep(0.05)
        else:
            return   # it says nothing; whether it lives is seen by whoever asks it next
        if busy:
            raise StepdiagError(f'{self.namespace} is being calibrated by somebody else; wait until that has ended')

    def _name_of(self, bag: str) -> str:
        """The name by which the recorder is asked for a bag; :class:`StepdiagError` if it lies elsewhere."""
        if not bag:
            return ''
        where, = self.parameters('recorder', ['bag_folder'])
        folder, wanted = Path(where).expanduser().absolute(), Path(bag).absolute()
        if wanted.parent != folder:
            raise StepdiagError(f'{bag}: the recorder of {self.namespace} makes bags in {folder} alone; give a name '
                                'there, or start the cell with --bag-folder')
        return wanted.name

    def _is_there(self, node: str) -> bool:
        """Whether an optional node of the machine runs."""
        return any(name == node and space == self.namespace
                   for name, space in self.node.get_node_names_and_namespaces())

    # -- calibration -------------------------------------------------------------

    def calibrate(self, setups: Sequence[str] = (), repeats: int = 0, dwell_s: float = 0.0,
                  feedback: Callable[[RunStepDiagonal.Feedback], None] | None = None,
                  steps: int = 0, meanwhile: Callable[[], object] = lambda: None) -> Calibration:
        """Send the goal and wait until it has ended; Ctrl-C cancels it and waits for that.

        ``meanwhile()`` is called ten times a second; what it raises ends the waiting.  A calibration whose
        sequencer died is taken up again where it was broken off, once the sequencer is active again.
        """
        self._require_sequencer()
        goal = RunStepDiagonal.Goal(setups=list(setups), repeats=repeats, dwell=float(dwell_s),
                                    steps=steps)
        at: dict[str, Any] = {'completed': [], 'run_id': ''}

        def received(word: RunStepDiagonal.Feedback) -> None:
            at['completed'], at['run_id'] = list(word.completed), word.run_id
            if feedback is not None:
                feedback(word)
        lost: list[str] = []
        silences: list[float] = []
        while True:
            try:
                ended = self._one_goal(goal, received, meanwhile, silences)
                break
            except LostGoal as error:
                if len(lost) >= RESUMES or not at['run_id']:
                    raise
                lost.append(at['run_id'])
                self._await_return(error, meanwhile)
                goal.completed = at['completed']
                goal.broken = '' if at['run_id'] in at['completed'] else at['run_id']
        how = {GoalStatus.STATUS_SUCCEEDED: 'succeeded',
               GoalStatus.STATUS_CANCELED: 'canceled'}.get(ended.status, 'aborted')
        word = ''.join(f'; the sequencer ended during {run_id} and was started again' for run_id in lost)
        word += silence_words(silences)
        return Calibration(how, ended.result.message + word, (*goal.completed, *ended.result.run_ids),
                           ended.result.stops)

    def _one_goal(self, goal: RunStepDiagonal.Goal, received: Callable[[RunStepDiagonal.Feedback], None],
                  meanwhile: Callable[[], object], silences: list[float]) -> Any:
        """Send a goal and wait for its result; ``silences`` gets those of the sequencer [s]."""
        server, last = f'{self.namespace}/step_sequencer', RunStepDiagonal.Feedback()
        spoke_s, said_s = 0.0, time.monotonic()

        def on_feedback(message: Any) -> None:
            nonlocal last, spoke_s
            last, spoke_s = message.feedback, time.monotonic()
            received(last)
        handle = self.wait(self._asked(lambda: self._action.send_goal_async(goal, feedback_callback=on_feedback)), 30.0,
                           'the sequencer does not answer the goal')
        if not handle.accepted:
            raise StepdiagError(f'{server} rejects the goal: it is busy with another or not active')
        goal_id = bytes(handle.goal_id.uuid).hex()
        # Not waited for: this computer may be so busy that the thread that receives takes long.
        self._handle, sent = handle, SentGoal(server, lambda answered: self._executor.create_task(
            lambda: handle.get_result_async().add_done_callback(answered)))

        def look() -> None:
            nonlocal said_s
            meanwhile()
            at, health = self._heard.get(server, (0.0, None))
            if health is not None and any(v.key == 'goal_id' and v.value == goal_id for v in health.values):
                sent.spoke(at)
            sent.spoke(spoke_s)
            sent.look()
            if sent.silent_s > SILENT_S and time.monotonic() - said_s > 1.0:
                said_s = time.monotonic()
                last.doing = f'the sequencer has been silent for {sent.silent_s:.0f} s'
                received(last)
        try:
            return self.wait(sent.result, None, '', look)
        except KeyboardInterrupt:
            self.cancel()
            return self.wait(sent.result, 60.0, 'the sequencer does not end the goal')
        finally:
            self._handle = None
            silences += sent.silences

    def _answers(self) -> bool:
        """Whether the sequencer is active, asked directly."""
        try:
            return self.state('step_sequencer', ANSWER_S) == ACTIVE
        except StepdiagError:
            return False

    def _await_return(self, error: LostGoal, meanwhile: Callable[[], object]) -> None:
        """Wait until the sequencer is active again; ``error`` if it does not come back."""
        patience = Patience(RETURN_S, ANSWER_S)
        while not patience.over():
            meanwhile()
            if self._answers():
                return
            time.sleep(0.2)
        raise error

    def cancel(self) -> None:
        """Ask the goal under way to end; :meth:`calibrate` then returns."""
        handle = self._handle
        if handle is not None:
            self._asked(handle.cancel_goal_async)

    def mounted(self) -> None:
        """Tell the sequencer that the setup it waits for is mounted."""
        answer = self._call(Trigger, 'sequencer/mounted', Trigger.Request(), 10.0)
        if not answer.success:
            raise StepdiagError(answer.message)

    def evaluate(self, timeout_s: float = 300.0) -> dict[str, Any]:
        """Have the solver evaluate now; the document of ``stepdiag evaluate --json``."""
        answer = self._call(Evaluate, 'evaluate', Evaluate.Request(), timeout_s)
        if not answer.success:
            raise StepdiagError(answer.message)
        return json.loads(answer.document)

    # -- waiting -----------------------------------------------------------------

    def _client(self, kind: type, name: str) -> Any:
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        return self._clients[name]

    def _nobody(self, name: str) -> StepdiagError:
        return StepdiagError(f'nobody offers {self.namespace}/{name}; is the cell up? (stepdiag up CELL.yaml)')

    def _call(self, kind: type, name: str, request: Any, timeout_s: float) -> Any:
        client = self._client(kind, name)
        if not Patience(timeout_s).until(client.service_is_ready):
            raise self._nobody(name)
        return self.wait(client.call_async(request), timeout_s,
                         f'{self.namespace}/{name} does not answer')

    def _call_until_answered(self, kind: type, name: str, request: Any, timeout_s: float,
                             told: Callable[[], Any] = lambda: None) -> Any:
        """The answer to a request that may be sent more than once.

        The service of a node that was killed is still known for a while, and what is sent to it alone is lost: so
        the request is sent again every other second.  Whichever is answered first counts: on a busy computer each
        may take longer than that.  ``told`` looks before each further request whether the answer is known otherwise.
        """
        client, asked = self._client(kind, name), []
        patience, again_s = Patience(timeout_s), 0.0
        while not patience.over():
            if time.monotonic() >= again_s and client.service_is_ready():
                if asked and (answer := told()) is not None:
                    return answer
                if not any(future.done() for future in asked):
                    asked.append(client.call_async(request))
                again_s = time.monotonic() + ASK_AGAIN_S
            if answered := [future for future in asked if future.done()]:
                return answered[0].result()
            time.sleep(0.01)
        if not asked:
            raise self._nobody(name)
        raise StepdiagError(f'{self.namespace}/{name} does not answer for {timeout_s:g} s')

    def _asked(self, request: Callable[[], Future]) -> Future:
        """The future of an action's request, sent from the thread that receives the answers.

        rclpy's action client notes a request only after it has been sent, without a lock (its
        service client has one): an answer received in between by another thread would be dropped.
        """
        if threading.current_thread() is self._thread:
            return request()
        return self.wait(self._executor.create_task(request), 10.0, 'the thread that receives stands still')

    def wait(self, future: Future, timeout_s: float | None, complaint: str,
             meanwhile: Callable[[], object] = lambda: None) -> Any:
        """The future's result; :class:`StepdiagError` after the time."""
        if not ended(future, timeout_s, meanwhile):
            raise StepdiagError(f'{complaint} for {timeout_s:g} s')
        return future.result()
