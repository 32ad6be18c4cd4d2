"""The multiplexer's node: it owns the optical switch and gives the light of one source to one machine after another.

Machines ask by the action ``use_source`` and have the light while their goal is active.  Feedback tells the place in
the queue and the expected wait.  Who asks or holds renews its lease on ``use_source/lease``; what is not renewed in
time is taken back.  Before the switch moves, the interferometer's driver is told that its readings are nobody's, and
afterwards whose they are (service ``interferometer/route``); so no reading is ever published under a wrong name.

Its queue is kept in memory.  One that starts gives nobody the light for the time of one lease: a predecessor that died
may have given it to a machine that still counts on it, which by then knows better and asks anew.
"""

import sys
import threading
import time
from dataclasses import dataclass

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future

from stepdiag_msgs.action import UseSource
from stepdiag_msgs.msg import Renewal
from stepdiag_msgs.srv import RouteSource
from stepdiag_ros.devices.optical_switch import PORT, OpticalSwitch, channels
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.base import ERROR, OK, Health, StepdiagNode, reliable, run_node
from stepdiag_ros.nodes.futures import ended
from stepdiag_ros.nodes.source_queue import Request, SourceQueue

ACTION = 'use_source'
LEASE = f'{ACTION}/lease'
ROUTE = 'interferometer/route'
#: So often the queue is looked at, and so often each goal is told its standing.
TICK_S, FEEDBACK_S = 0.02, 0.25
#: So long the interferometer's driver may take, and so long is waited after it or the switch failed.
ROUTE_S, RETRY_S = 3.0, 1.0


@dataclass
class _Goal:
    """A goal under way, and what ends it."""

    handle: ServerGoalHandle
    done: Future


class Multiplexer(StepdiagNode):
    """One optical switch, one queue."""

    def __init__(self):
        super().__init__('multiplexer')
        self.text('host', '', 'host name or address of the optical switch', fixed=True)
        self.count('port', PORT, 'TCP port of the optical switch', 1, 65535, fixed=True)
        self.number('timeout', 5.0, 'silence after which the switch counts as stalled', 0.1, 120.0, 's')
        served = self.text('serves', [''], 'machines behind the switch, namespace=channel, e.g. left=1', fixed=True)
        self.number('lease', 5.0, 'one who has the light, or waits for it, and has not said for so long that he lives '
                                  'is taken for dead', 0.5, 3600.0, 's')
        self._channels = channels(served)
        self._lock = threading.Lock()
        self._queue = SourceQueue(self.value('lease'), time.monotonic)
        self._goals: dict[bytes, _Goal] = {}
        self._switch: OpticalSwitch | None = None
        self._lit, self._free_s = '', 0.0
        self._trouble = ''
        self._leave = threading.Event()
        self._worker: threading.Thread | None = None
        self._route = self.create_client(RouteSource, ROUTE)
        self.create_subscription(Renewal, LEASE, self._on_renewal, reliable(100))
        self._action = ActionServer(self, UseSource, ACTION, self._execute, goal_callback=self._on_goal,
                                    cancel_callback=lambda _handle: CancelResponse.ACCEPT)

    # -- lifecycle ---------------------------------------------------------------

    def configure(self) -> None:
        self._switch = OpticalSwitch(self.stated('host'), self.value('port'), self._channels, self.value('timeout'))
        try:
            self._switch.connect()
            self._switch.selected()
        except StepdiagError:
            self.cleanup()
            raise

    def activate(self) -> None:
        self._queue.lease_s = self.value('lease')
        self._free_s = time.monotonic() + self._queue.lease_s
        self._leave.clear()
        self._worker = threading.Thread(target=self._work, name='queue', daemon=True)
        self._worker.start()

    def deactivate(self) -> None:
        self._leave.set()
        if self._worker is not None:
            self._worker.join()
            self._worker = None

    def cleanup(self) -> None:
        self.deactivate()
        if self._switch is not None:
            self._switch.close()
            self._switch, self._lit = None, ''

    def health(self) -> Health:
        values: dict[str, object] = {'device': f'{self.value("host")}:{self.value("port")}'}
        if self.state != 'active':
            return Health(OK, self.state, values)
        with self._lock:
            holder, waiting, usage = self._queue.holder, self._queue.waiting, self._queue.measure()
            waits = [self._queue.standing(request.key).wait_s for request in waiting]
            held_s = 0.0 if holder is None else time.monotonic() - holder.granted_s
        values |= {'holder': '' if holder is None else holder.machine.strip('/'), 'held_for_s': held_s,
                   'expected_s': 0.0 if holder is None else holder.expected_s,
                   'queue': ' '.join(request.machine.strip('/') for request in waiting),
                   'waits_s': ' '.join(f'{wait_s:.0f}' for wait_s in waits),
                   'held_s': usage.held_s, 'idle_s': usage.idle_s, 'idle_share': usage.idle_share,
                   'grants': usage.grants, 'handover_s': self._queue.handover_s}
        if self._trouble:
            return Health(ERROR, self._trouble, values)
        if holder is None:
            return Health(OK, 'nobody has the light', values)
        return Health(OK, f'{holder.machine.strip("/")} has the light, {len(waiting)} wait', values)

    # -- the action --------------------------------------------------------------

    def _on_goal(self, _goal: UseSource.Goal) -> GoalResponse:
        return GoalResponse.ACCEPT if self.state == 'active' else GoalResponse.REJECT

    async def _execute(self, handle: ServerGoalHandle) -> UseSource.Result:
        key, request = bytes(handle.goal_id.uuid), handle.request
        machine = f'/{request.machine.strip("/")}/'
        if machine not in self._channels:
            handle.abort()
            return UseSource.Result(success=False, message=f'{request.machine!r} is not behind this switch; there are '
                                    f'{", ".join(name.rstrip("/") for name in self._channels)}')
        goal = _Goal(handle, Future(executor=self.executor))
        with self._lock:
            self._goals[key] = goal
            self._queue.ask(key, machine, request.priority, request.expected)
        how, message, held_s = await goal.done
        getattr(handle, how)()
        return UseSource.Result(success=how == 'canceled', message=message, held=held_s)

    def _on_renewal(self, renewal: Renewal) -> None:
        with self._lock:
            self._queue.renew(bytes(renewal.goal), renewal.number)

    # -- the queue, in a thread of its own ---------------------------------------

    def _work(self) -> None:
        told_s = 0.0
        while not self._leave.wait(TICK_S):
            with self._lock:
                cancelled = [key for key, goal in self._goals.items() if goal.handle.is_cancel_requested]
                given_back = [request for key in cancelled if (request := self._queue.release(key))]
                taken_back = self._queue.expire()
                picked = self._queue.next() if time.monotonic() >= self._free_s else None
            for request in given_back:
                self._end(request, 'canceled', 'given back')
            for request in taken_back:
                word = f'not renewed for {self._queue.lease_s:g} s; taken back'
                self.get_logger().warning(f'{request.machine.strip("/")}: {word}')
                self._end(request, 'abort', word)
            if picked is not None:
                self._give(picked)
                told_s = 0.0
            if time.monotonic() - told_s >= FEEDBACK_S:
                told_s = time.monotonic()
                self._tell()
        with self._lock:
            left = [request for key in list(self._goals) if (request := self._queue.release(key))]
        for request in left:
            self._end(request, 'abort', 'the multiplexer was stopped')

    def _give(self, picked: Request) -> None:
        """Put the light on a machine; where that fails, it waits on at its place."""
        try:
            if self._lit != picked.machine:
                self._lit = ''
                self._own_readings('')
                self._switch.select(picked.machine)
            self._own_readings(picked.machine)
            self._lit, self._trouble = picked.machine, ''
        except StepdiagError as error:
            if not self._trouble:
                self.get_logger().error(str(error))
            self._trouble = str(error)
            with self._lock:
                self._queue.failed(picked)
            self._switch.close()
            if not self._leave.wait(RETRY_S):
                self._connect_again()
            return
        with self._lock:
            self._queue.granted(picked)

    def _connect_again(self) -> None:
        try:
            self._switch.connect()
        except StepdiagError as error:
            self._trouble = str(error)

    def _own_readings(self, machine: str) -> None:
        """Have the interferometer's driver publish for ``machine``; :class:`StepdiagError` if it does not say so."""
        name = self.resolve_service_name(ROUTE)
        if not self._route.wait_for_service(timeout_sec=ROUTE_S):
            raise StepdiagError(f'nobody offers {name}; is the interferometer driver active?')
        future = self._route.call_async(RouteSource.Request(machine=machine.rstrip('/')))
        if not ended(future, ROUTE_S):
            raise StepdiagError(f'{name} does not answer for {ROUTE_S:g} s')
        if not future.result().success:
            raise StepdiagError(f'{name}: {future.result().message}')

    def _tell(self) -> None:
        """Say to each goal where it stands."""
        with self._lock:
            standings = [(goal, self._queue.standing(key)) for key, goal in self._goals.items()]
        for goal, standing in standings:
            if standing is not None and goal.handle.is_active:
                goal.handle.publish_feedback(UseSource.Feedback(
                    granted=standing.granted, place=standing.place, wait=standing.wait_s,
                    lease=self._queue.lease_s, renewal=standing.renewal))

    def _end(self, request: Request, how: str, message: str) -> None:
        with self._lock:
            goal = self._goals.pop(request.key)
        held_s = time.monotonic() - request.granted_s if request.granted_s else 0.0
        goal.done.set_result((how, message, held_s))


def main() -> int:
    return run_node(Multiplexer)


if __name__ == '__main__':
    sys.exit(main())
