"""The sequencer's node: the action ``run_step_diagonal``, ``sequencer/step``, ``cell_description``.

It drives the machine control along the plan, has the sensors put to each setup and
zeroed at each run's start, and announces every change of phase.  A goal is only begun
when every source delivers and the recorder confirms that it receives them; otherwise the
goal ends at once, nothing has moved, and the result's message names what is silent.

The machine moves only while its client lives, who publishes the goal's UUID on
``run_step_diagonal/lease``; and what a sequencer finds moving when it starts it stops.
A run that a node's death has broken off is repeated when the node is back.
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from unique_identifier_msgs.msg import UUID

from stepdiag_msgs.action import RunStepDiagonal
from stepdiag_msgs.msg import Displacement, RecorderStatus, SampleTiming, SpotPosition, Step
from stepdiag_msgs.srv import ResetDisplacement, SelectSetup
from stepdiag_ros.bag.schemas import DESCRIPTION, DISPLACEMENT, SPOT, STEP, STEP_TIMING
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.linuxcnc_rsh import PORT, LinuxCncRsh
from stepdiag_ros.devices.registry import DEFAULT, driver
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import NONE
from stepdiag_ros.nodes.base import ERROR, OK, Health, StepdiagNode, overridable, reliable, run_node
from stepdiag_ros.nodes.clocks import ASK_S, ClockComparison
from stepdiag_ros.nodes.futures import ended
from stepdiag_ros.nodes.lease import TICK_S, Lease
from stepdiag_ros.nodes.light import Light
from stepdiag_ros.nodes.marked import Marked
from stepdiag_ros.nodes.ownership import SEQUENCER, ControlOwnership, Ownership
from stepdiag_ros.nodes.run_plan import (
    Run,
    Stop,
    attempt,
    first_repeats,
    once_more,
    planned_runs,
    remaining,
    with_steps,
)
from stepdiag_ros.nodes.runner import Cancelled, Interrupted, Outcome, Progress, Runner
from stepdiag_ros.nodes.scene import SceneTopics
from stepdiag_ros.nodes.stamps import clock_name, ns_of, stamp_of
from stepdiag_ros.nodes.subscription import RECEIVED_TOPICS
from stepdiag_ros.nodes.watch import Recording, Watch

#: Setup services wait for an operator who mounts a mirror.
SERVICE_TIMEOUT_S = 60.0
ACTION = 'run_step_diagonal'
#: Here a goal's client says that it lives, by the goal's UUID.
LEASE = f'{ACTION}/lease'
NEXT_STOP, AT_ONCE = 'next_stop', 'at_once'
LONGEST_DWELL_S = 600.0
#: So long the light of a shared interferometer is held to see before a start that all deliver.
READY_S = 2.0
#: A run that is broken off so often has another trouble than a node that died.
RETRIES = 5
#: Feedback begins with this while a person is waited for.
ASK = 'waiting until somebody has mounted'


class StepSequencer(StepdiagNode):
    """Runs the plan on a machine control that speaks linuxcncrsh."""

    def __init__(self):
        super().__init__('step_sequencer')
        self.text('host', '', 'host name or address of the machine control', fixed=True)
        self.text('driver', DEFAULT['cnc'], 'name of the driver of the machine control', fixed=True)
        self.count('port', PORT, 'TCP port of the machine control', 1, 65535, fixed=True)
        self.count('watch_port', 0, "TCP port of the control's watchdog; 0: it has none", 0, 65535, fixed=True)
        self.number('timeout', 5.0, 'silence after which the control counts as stalled',
                    0.1, 120.0, 's')
        self.text('description_file', '', 'YAML file of the cell description', fixed=True)
        self.count('steps', 0, "steps of each axis along a diagonal; 0: the description's", 0, limits.STEPS)
        self.number('feed', 0.02, 'feed of every move', 1.0e-6, 5.0, 'm/s', fixed=True)
        self.number('dwell', 0.5, 'measuring time at a stop, where the goal gives none',
                    0.001, LONGEST_DWELL_S, 's')
        self.number('stand', 0.0, 'so much longer is the first dwell after a mounting', 0.0, 3600.0, 's')
        self.number('guard', 0.025, 'rest after a dwell before the next move: as late as a sample may '
                    'be taken after its stamp', 0.0, 10.0, 's')
        self.text('origin', [0.0, 0.0, 0.0], "machine coordinates of the volume's lower corner [m]", fixed=True)
        self.text('setup_codes', [''], 'what has a mirror mounted: setup=M-code, e.g. ppp=M101', fixed=True)
        self.text('ask_operator', False, 'a setup without a code is mounted by a person, who confirms by the '
                                         'service sequencer/mounted', fixed=True)
        self.number('lease', 5.0, 'a client that has not renewed its lease for so long is lost', 0.5, 3600.0, 's',
                    fixed=True)
        self.text('lost_client', NEXT_STOP, f'what ends a run whose client is lost: {NEXT_STOP} (when that has been '
                                            f'measured) or {AT_ONCE}', fixed=True)
        self.number('resume_timeout', 60.0, 'wait for a node or an instrument that broke a run off before the '
                    'calibration ends; 0: none', 0.0, 3600.0, 's')
        self.text('listeners', ['recorder', 'evaluation_solver'],
                  'nodes that must be connected to sequencer/step and receive the sources before a start', fixed=True)
        self.text('sources', [DISPLACEMENT, SPOT], 'topics that must deliver before a start', fixed=True)
        self.text('light', '', 'action of the multiplexer that gives a shared interferometer, e.g. /hall/use_source; '
                               'empty: the interferometer is its own', fixed=True)
        self.count('light_priority', 0, 'who asks for the light with a higher one goes before', 0, 255)
        self.number('ready_timeout', 20.0, 'wait for sources, recorder and listeners before a goal is refused',
                    0.0, 600.0, 's')
        self.number('source_timeout', 3.0, 'silence after which a source counts as lost',
                    0.1, 60.0, 's')
        self._ownership = Ownership(self.get_namespace(), SEQUENCER)
        self._marked = Marked(self)
        self._steps = self._marked.publisher(Step, STEP)
        self._timing = self._marked.publisher(SampleTiming, STEP_TIMING)
        self._scene = SceneTopics(self)
        self._clocks = ClockComparison(self, self._marked, {topic.partition('/')[0] for topic in self.value('sources')})
        self._clock_timer = self.every(ASK_S, self._compare_clocks)
        self._description_publisher: Publisher | None = None
        self._select = {sensor: self.create_client(SelectSetup, f'{sensor}/select_setup')
                        for sensor in ('interferometer', 'psd')}
        self._reset = self.create_client(ResetDisplacement, 'interferometer/reset')
        full = self.resolve_topic_name
        self._watch = Watch([full(t) for t in self.value('sources')], [full(DESCRIPTION)],
                            self.value('source_timeout'))
        self._light = Light(self, self.value('light'), self.get_namespace(),
                            self.value('light_priority')) if self.value('light') else None
        if self._light is not None:
            self._watch.expect(full(DISPLACEMENT), False)
        kinds = {DISPLACEMENT: (Displacement, self._on_displacement), SPOT: (SpotPosition, self._on_spot)}
        for topic in self.value('sources'):
            if topic not in kinds:
                raise StepdiagError(f'step_sequencer: parameter sources names {topic!r}; '
                                    f'known are {", ".join(kinds)}')
            self.create_subscription(kinds[topic][0], topic, kinds[topic][1], reliable(),
                                     qos_overriding_options=overridable())
        self.create_subscription(RecorderStatus, 'recorder/status', self._on_recorder, reliable(10))
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)
        self.create_subscription(UUID, LEASE, self._on_lease, lease_qos())
        self._mounted, self._asking = threading.Event(), False
        self.create_service(Trigger, 'sequencer/mounted', self._on_mounted)
        self._action = ActionServer(
            self, RunStepDiagonal, ACTION, self._execute, goal_callback=self._on_goal,
            cancel_callback=lambda _handle: CancelResponse.ACCEPT)
        self.controller: LinuxCncRsh | None = None
        self._control: ControlOwnership | None = None
        self.description: Description | None = None
        self._worker: threading.Thread | None = None
        self._leave = threading.Event()
        self._goal, self._lease = b'', Lease()
        self._lease_timer = self.every(TICK_S, self._lease.tick)
        self._progress: Progress | None = None
        self._last = ''
        self._broken: list[str] = []
        self._clock_steps: list[float] = []
        # Events published by this process since the bag was opened, and the repeats in it.
        self._bag, self._file = '', 0
        self._published = 0
        self._repeats: dict[str, int] = {}

    # -- lifecycle ---------------------------------------------------------------

    def configure(self) -> None:
        path = self.stated('description_file')
        self.stated('host')
        try:
            text = Path(path).read_text(encoding='utf-8')
        except OSError as error:
            raise StepdiagError(f'{path}: cannot be read: {error.strerror}') from None
        self.description = with_steps(Description.from_yaml(text, path), self.value('steps'))
        origin = tuple(self.value('origin'))
        if len(origin) != 3:
            raise StepdiagError(f'step_sequencer: parameter origin is {list(origin)}; '
                                'give three coordinates in metres')
        self.controller = driver('cnc', self.value('driver'), 'step_sequencer: parameter driver')(
            {**{name: self.value(name) for name in ('host', 'port', 'timeout', 'watch_port')}, 'origin': origin,
             'setup_codes': _codes(self.value('setup_codes'))})
        if self.value('lost_client') not in (NEXT_STOP, AT_ONCE):
            raise StepdiagError(f'step_sequencer: parameter lost_client is {self.value("lost_client")!r}; '
                                f'choose {NEXT_STOP} or {AT_ONCE}')
        try:
            # Before anything is said to it: who commands it already would be stopped.
            self._control = ControlOwnership(self.value('host'), self.value('port'))
            self.controller.connect()
            if not self.controller.state()['idle']:
                # Whoever commanded this is gone: this node is the control's only sequencer.
                self.get_logger().warning('the machine was moving when the sequencer started; stopping it')
                self.controller.stop()
        except StepdiagError:
            self.cleanup()
            raise

    def activate(self) -> None:
        self._leave.clear()
        # A publisher anew: a latched one would hand the next recorder the description of an earlier plan.
        self._description_publisher = self.create_publisher(
            String, DESCRIPTION, reliable(1, latched=True), qos_overriding_options=overridable())
        self._description_publisher.publish(String(data=self.description.to_yaml()))

    def deactivate(self) -> None:
        self._leave.set()
        if self._worker is not None:
            self._worker.join()
            self._worker = None
        self._scene.forget()
        if self._description_publisher is not None:
            self.destroy_publisher(self._description_publisher)
            self._description_publisher = None

    def cleanup(self) -> None:
        self.deactivate()
        if self.controller is not None:
            self.controller.close()
            self.controller = None
        if self._control is not None:
            self._control.release()
            self._control = None

    def health(self) -> Health:
        values: dict[str, object] = {'device': f'{self.value("host")}:{self.value("port")}',
                                     'goal': 'none' if self._worker is None else 'under way',
                                     'goal_id': '' if self._worker is None else self._goal.hex(),
                                     'last': self._last}
        progress = self._progress
        if progress is not None:
            values |= {'run': progress.run.run_id, 'stop': progress.done, 'stops': progress.total,
                       'time_left_s': progress.time_left_s}
            return Health(OK, progress.doing, values)
        wants = self._watch.wants() if self.state == 'active' else []
        if wants:
            return Health(ERROR, 'cannot start: ' + '; '.join(wants), values)
        return Health(OK, 'ready' if self.state == 'active' else self.state, values)

    # -- what is received -----------------------------------------------------------

    def _on_displacement(self, message: Displacement) -> None:
        self._note(DISPLACEMENT, message, len(message.quality), any(message.quality))

    def _on_spot(self, message: SpotPosition) -> None:
        self._note(SPOT, message, len(message.x), any(x == x for x in message.x))

    def _note(self, topic: str, message, samples: int, signal: bool) -> None:
        begin = ns_of(message.header.stamp) - self._clocks.offset_ns(topic.partition('/')[0])
        self._watch.block(self.resolve_topic_name(topic), begin,
                          begin + round(samples * message.sample_period * 1e9), signal,
                          message.header.frame_id)

    def _compare_clocks(self) -> None:
        if self._worker is not None:
            self._clocks.ask()

    def _follow_clock(self) -> float:
        """Follow the system's clock; the step [s] that it has made."""
        step_s = self._marked.follow_clock()
        if step_s:
            self._clocks.shift(step_s)
        return step_s

    def _on_recorder(self, status: RecorderStatus) -> None:
        self._watch.recorder(Recording(
            time.monotonic(), status.recording, status.bag, frozenset(status.hears),
            dict(zip(status.topics, status.received, strict=True)), int(sum(status.lost)), status.file))

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            space, _, name = f'/{status.name}'.rpartition('/')
            if space == self.get_namespace().rstrip('/') and name in self.value('listeners'):
                received = next((v.value for v in status.values if v.key == RECEIVED_TOPICS), '')
                self._watch.listener(name, frozenset(map(self.resolve_topic_name, received.split())))

    def _on_lease(self, goal: UUID) -> None:
        if bytes(goal.uuid) == self._goal:
            self._lease.renew()

    # -- the action --------------------------------------------------------------

    def _on_goal(self, _goal: RunStepDiagonal.Goal) -> GoalResponse:
        if self.state != 'active' or self._worker is not None:
            why = 'not active' if self.state != 'active' else 'busy with another goal'
            self.get_logger().error(f'a goal was rejected: {self.get_name()} is {why}')
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _execute(self, handle: ServerGoalHandle) -> RunStepDiagonal.Result:
        done = Future(executor=self.executor)
        self._goal = bytes(handle.goal_id.uuid)
        self._lease.renew()
        self._worker = threading.Thread(target=self._work, args=(handle, done), name='sequence',
                                        daemon=True)
        self._worker.start()
        how, result = await done
        self._worker, self._progress = None, None
        self._last = result.message
        self.get_logger().info(result.message)
        getattr(handle, how)()
        return result

    def _work(self, handle: ServerGoalHandle, done: Future) -> None:
        """One goal, in a thread of its own."""
        try:
            outcome = self._calibrate(handle)
            how, message = 'succeed', self._closing_word(outcome)
        except Cancelled as stop:
            outcome = getattr(stop, 'outcome', Outcome((), 0))
            how = 'canceled' if handle.is_cancel_requested else 'abort'
            message = f'stopped on request after {outcome.stops} stops; the machine stands still'
        except StepdiagError as error:
            outcome = getattr(error, 'outcome', Outcome((), 0))
            how, message = 'abort', str(error)
        except Exception as error:
            outcome, how = Outcome((), 0), 'abort'
            message = f'{type(error).__name__}: {error}'
            self.get_logger().error(message)
        done.set_result((how, RunStepDiagonal.Result(
            success=how == 'succeed', message=message, run_ids=list(outcome.run_ids),
            stops=outcome.stops)))

    def _measurable(self, goal: RunStepDiagonal.Goal) -> None:
        """Refuse what no log can hold or no dwell ends, before it is spelled out."""
        if not 0.0 <= goal.dwell <= LONGEST_DWELL_S:
            raise StepdiagError(f'refused: a dwell of {goal.dwell:g} s; give 0 for that of {self.get_name()}, or at '
                                f'most {LONGEST_DWELL_S:g} s')
        once = len(planned_runs(self.description, goal.setups, 1))
        if goal.repeats > limits.REPEATS or once * goal.repeats > limits.RUNS:
            raise StepdiagError(f'refused: {goal.repeats} repeats of {once} runs; a log holds at most '
                                f'{limits.REPEATS} repeats and {limits.RUNS} runs')

    def _calibrate(self, handle: ServerGoalHandle) -> Outcome:
        goal = handle.request
        if goal.steps not in (0, self.description.plan.steps):
            raise StepdiagError(
                f'refused: {goal.steps} steps were asked for and the cell description that is being '
                f'recorded says {self.description.plan.steps}; set the parameter steps of '
                f'{self.get_name()} and begin a new bag (stepdiag calibrate --steps does both)')
        self._measurable(goal)
        self._follow_clock()
        self._clock_steps = []
        asked = planned_runs(self.description, goal.setups)   # unknown setups are refused at once
        held = [*goal.completed, *filter(None, [goal.broken])]
        with self._lit(asked[0].setup, READY_S, handle):
            self._await_ready(handle, bool(held))
        bag = self._watch.recording.bag
        self._begin_bag(bag, held)
        runs = remaining(planned_runs(self.description, goal.setups, goal.repeats, self._repeats),
                         goal.completed, goal.broken)
        self._ready_control()

        def cancelled() -> bool:
            return handle.is_cancel_requested or self._leave.is_set()

        def report(progress: Progress) -> None:
            self._progress = progress
            handle.publish_feedback(RunStepDiagonal.Feedback(
                run_id=progress.run.run_id, setup=progress.run.setup, stop=progress.done,
                stops=progress.total, axis=progress.axis, time_left=progress.time_left_s,
                doing=progress.doing, completed=[*goal.completed, *progress.completed]))

        def mount(setup: str) -> None:
            self._mount(setup, lambda: self._alive(handle),
                        lambda: report(replace(self._progress, doing=f'{ASK} setup {setup}')))

        dwell = goal.dwell if goal.dwell > 0.0 else self.value('dwell')
        runner = Runner(self.controller, self._announce, mount, self._zero,
                        lambda setup: self._check(bag, setup),
                        lambda setup, time_ns: self._caught_up(bag, setup, time_ns, handle),
                        report, cancelled, lambda run, error: self._again(run, error, bag, handle),
                        lambda stop: self._attended(handle, stop), HOST.now_ns,
                        self.value('feed'), dwell, self.value('guard'), self.value('stand'),
                        light=lambda run, expected_s: self._lit(run.setup, expected_s, handle))
        try:
            return runner.execute(runs)
        finally:
            for run in runs:
                self._repeats[run.setup] = run.repeat + 1

    @contextmanager
    def _lit(self, setup: str, expected_s: float, handle: ServerGoalHandle) -> Iterator[None]:
        """Have the light of a shared interferometer; where it is the machine's own it always has."""
        if self._light is None:
            yield
            return

        def tell(doing: str) -> None:
            if self._progress is not None:
                self._progress = replace(self._progress, doing=doing)
            told = self._progress or Progress(planned_runs(self.description, [setup])[0], 0, 0, NONE, 0.0, doing)
            handle.publish_feedback(RunStepDiagonal.Feedback(
                run_id='' if self._progress is None else told.run.run_id, setup=setup, stop=told.done,
                stops=told.total, axis=NONE, time_left=told.time_left_s, doing=doing,
                completed=[*handle.request.completed, *told.completed]))
        topic = self.resolve_topic_name(DISPLACEMENT)
        with self._light.hold(expected_s, lambda: self._alive(handle), tell):
            self._call(self._select['interferometer'], SelectSetup.Request(setup=setup), 'interferometer/select_setup')
            self._watch.expect(topic, True)
            self._watch.begin()
            try:
                yield
            finally:
                self._watch.expect(topic, False)

    def _await_ready(self, handle: ServerGoalHandle, resumed: bool) -> None:
        """Every source delivers, and the recorder and the listeners receive it, or the goal is refused."""
        # Who takes a calibration over was started a moment ago, and has to find the others first.
        timeout_s = max(self.value('ready_timeout'), self.value('resume_timeout') if resumed else 0.0)
        if wants := self._wait_until_ready(handle, timeout_s):
            raise StepdiagError('refused to start: ' + '; '.join(wants))

    def _wait_until_ready(self, handle: ServerGoalHandle, timeout_s: float, bag: str = '') -> list[str]:
        """Wait until all deliver and all is kept (in ``bag``, where one is named); what is missing after the time."""
        began = time.monotonic()
        listeners = [name for name in self.value('listeners') if name]
        while True:
            wants = (self._watch.wants(since_s=began) + self._unconnected(listeners)
                     + self._watch.not_receiving(listeners, began))
            if not wants and bag and (now := self._watch.recording.bag) != bag:
                wants = [f'the recorder writes {now} and not {bag}']
            if not wants or time.monotonic() > began + timeout_s:
                return wants
            self._alive(handle)
            time.sleep(0.05)

    def _again(self, run: Run, error: Interrupted, bag: str, handle: ServerGoalHandle) -> Run:
        """Wait until an interrupted run can be repeated, into the same bag; it bears another name then."""
        timeout_s = self.value('resume_timeout')
        if not timeout_s or attempt(run.run_id) > RETRIES:
            raise error
        self.get_logger().warning(f'{run.run_id} was broken off: {error}; it is repeated as soon as all deliver again')
        handle.publish_feedback(RunStepDiagonal.Feedback(
            run_id=run.run_id, setup=run.setup, stop=self._progress.done, stops=self._progress.total, axis=NONE,
            doing=f'{run.run_id} was broken off, waiting to repeat it: {error}',
            completed=[*handle.request.completed, *self._progress.completed]))
        if wants := self._wait_until_ready(handle, timeout_s, bag):
            raise StepdiagError(f'{error}; waited {timeout_s:g} s to repeat {run.run_id}: {"; ".join(wants)}')
        self._file = self._watch.recording.file
        self._published -= self._unrecorded()      # what is lost is measured again
        self._ready_control()
        repeated = once_more(run)
        self._broken.append(run.run_id)
        self.get_logger().info(f'{run.run_id} is repeated as {repeated.run_id}')
        return repeated

    def _alive(self, handle: ServerGoalHandle) -> None:
        """Raise what ends a calibration while the machine stands: a request, or a client that is lost."""
        if handle.is_cancel_requested or self._leave.is_set():
            raise Cancelled
        self._attended(handle, True)

    def _attended(self, handle: ServerGoalHandle, stop: bool) -> None:
        """Raise :class:`StepdiagError` if the client is lost, while an axis may move (not ``stop``) only if told so."""
        silent_s = self._lease.silent_s
        if not handle.request.unattended and silent_s > self.value('lease') \
                and (stop or self.value('lost_client') == AT_ONCE):
            raise StepdiagError(f'the client has not renewed its lease for {silent_s:.1f} s and is taken for lost; '
                                'the machine stands still')

    def _unconnected(self, listeners: Sequence[str]) -> list[str]:
        """Listeners that would miss the first step."""
        names = [info.node_name for info in
                 self.get_subscriptions_info_by_topic(self.resolve_topic_name(STEP))]
        return [f'{listener} is not connected to {self.resolve_topic_name(STEP)}'
                for listener in listeners if not any(name.startswith(listener) for name in names)]

    def _begin_bag(self, bag: str, resumed: Sequence[str] = ()) -> None:
        """Number runs from 0 in a new bag; refuse one that holds runs which are not ours.

        ``resumed``: runs of a sequencer that has ended, whose calibration this one takes over.
        """
        self._broken, self._file = [], self._watch.recording.file
        if bag != self._bag:
            self._bag, self._published, self._repeats = bag, 0, {}
        if resumed:
            self._repeats = first_repeats(resumed)
            self._published -= self._unrecorded()
        if self._unrecorded() < 0:
            raise StepdiagError(f'refused to start: {bag} holds runs of a sequencer that has ended '
                                'since; begin a new bag (stepdiag calibrate does)')

    def _ready_control(self) -> None:
        """Homed and idle; a connection that was lost in the meantime is made anew."""
        try:
            self.controller.state()
        except StepdiagError:
            self.controller.close()
            self.controller.connect()
        self.controller.make_ready()

    def _on_mounted(self, _request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._asking
        response.message = '' if self._asking else 'no setup is waited for'
        self._mounted.set()
        return response

    def _mount(self, setup: str, alive: Callable[[], None], ask: Callable[[], None]) -> None:
        """Mirror, base unit and sensors to a setup, by the control's code or a person's hands."""
        self.controller.select_setup(setup)
        if self.value('ask_operator') and setup not in _codes(self.value('setup_codes')):
            self._mounted.clear()
            self._asking = True
            ask()
            try:
                while not self._mounted.wait(0.1):
                    alive()
            finally:
                self._asking = False
        for sensor, client in self._select.items():
            if sensor == 'interferometer' and self._light is not None:
                continue   # it is put to the setup when it has the light
            self._call(client, SelectSetup.Request(setup=setup), f'{sensor}/select_setup')
        if SPOT in self.value('sources'):
            # Where no detector looks its stream goes on, dark.
            self._watch.expect(self.resolve_topic_name(SPOT), self.description.setups[setup].sees_spot)
        self._watch.begin()

    def _zero(self) -> None:
        self._timing.publish(SampleTiming(header=Header(stamp=stamp_of(HOST.now_ns())), clock=clock_name()))
        self._clocks.record(now=True)
        self._call(self._reset, ResetDisplacement.Request(), 'interferometer/reset')
        self._watch.begin()

    def _check(self, bag: str, setup: str) -> float:
        """Raise :class:`Interrupted` if a run has lost something; returns by how much [s] the clock was set since."""
        step_s = self._follow_clock()
        self._clocks.record(now=False)
        if step_s:
            self._clock_steps.append(step_s)
            self._watch.begin()
        if self._light is not None and not self._light.held:
            raise Interrupted('the light was taken back: nothing was received from this machine in time')
        self._watch.check(bag, setup)
        if self._watch.recording.file != self._file:
            raise Interrupted('the recorder was started again during the run')
        return step_s

    def _caught_up(self, bag: str, setup: str, time_ns: int, handle: ServerGoalHandle) -> None:
        """Wait until all sources have delivered up to ``time_ns``, see light, and all is recorded; or end the run."""
        end = time.monotonic() + self.value('source_timeout')
        while self._watch.delivered_until() < time_ns or self._watch.dark() or self._unrecorded() > 0:
            self._alive(handle)
            time_ns += round(self._check(bag, setup) * 1e9)
            if time.monotonic() > end and (missing := self._unrecorded()) > 0:
                raise Interrupted(f'the recorder has not confirmed {missing} step events')
            time.sleep(0.01)
        self._check(bag, setup)

    def _unrecorded(self) -> int:
        """Step events that were published into the bag and that the recorder has not confirmed."""
        return self._published - self._watch.recording.received.get(self.resolve_topic_name(STEP), 0)

    def _call(self, client, request, name: str) -> None:
        """Call a service from the worker's thread."""
        if not client.wait_for_service(timeout_sec=5.0):
            raise Interrupted(f'the service {name} is not there; is its driver running?')

        def alive() -> None:
            if self._leave.is_set():
                raise Cancelled
            if wants := self._watch.wants():
                raise Interrupted(f'no answer from {name}: ' + '; '.join(wants))

        future = client.call_async(request)
        if not ended(future, SERVICE_TIMEOUT_S, alive):
            raise StepdiagError(f'the service {name} does not answer for {SERVICE_TIMEOUT_S:g} s')
        if not future.result().success:
            raise Interrupted(f'{name}: {future.result().message}')

    def _announce(self, run: Run, stop: Stop, phase: int, time_ns: int) -> None:
        x, y, z = (float(v) for v in stop.position_m)
        self._steps.publish(Step(
            header=Header(stamp=stamp_of(time_ns), frame_id=run.setup), run_id=run.run_id,
            setup=run.setup, repeat=run.repeat, direction=stop.direction, index=stop.index,
            axis=stop.axis, commanded=Point(x=x, y=y, z=z), phase=phase))
        self._published += 1
        self._scene.announce(self.description, run.run_id, run.setup, (x, y, z), phase, time_ns)

    def _closing_word(self, outcome: Outcome) -> str:
        """Wait until samples and recorder have caught up, and say what was done."""
        now, end = HOST.now_ns(), time.monotonic() + self.value('source_timeout')
        while time.monotonic() < end and (self._watch.delivered_until() < now or self._unrecorded() > 0):
            time.sleep(0.05)
        said = self._watch.recording
        word = f'{outcome.stops} stops in {len(outcome.run_ids)} runs'
        missing = self._unrecorded()
        if missing > 0:
            word += f'; the recorder has not confirmed {missing} of {self._published} step events'
        if self._broken:
            word += f'; repeated, because they were broken off: {", ".join(self._broken)}'
        if self._clock_steps:
            word += '; the system clock was set by ' + ', '.join(f'{s:+.3f} s' for s in self._clock_steps)
        if said.lost:
            word += f'; the recorder lost {said.lost} messages'
        return word


def lease_qos() -> QoSProfile:
    """A sign of life: only the last one counts, and none is sent again."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def _codes(pairs: list[str]) -> dict[str, str]:
    """``['ppp=M101']`` -> ``{'ppp': 'M101'}``."""
    codes = {}
    for pair in filter(None, pairs):
        setup, _, code = pair.partition('=')
        if not code:
            raise StepdiagError(f'step_sequencer: parameter setup_codes holds {pair!r}; '
                                'write setup=M-code, e.g. ppp=M101')
        codes[setup] = code
    return codes


def main() -> int:
    return run_node(StepSequencer)


if __name__ == '__main__':
    sys.exit(main())
