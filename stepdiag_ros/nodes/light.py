"""The light of a shared source, as a sequencer has it: asked of the multiplexer, held for a run, given back.

Runs between two zeroes need light without a break; the approach, the return, the change of setups and the waiting for
a person do not, and are made without holding it.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.action import ActionClient
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from stepdiag_msgs.action import UseSource
from stepdiag_msgs.msg import Renewal
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.base import StepdiagNode, reliable
from stepdiag_ros.nodes.futures import ended
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.nodes.runner import Interrupted
from stepdiag_ros.nodes.source_queue import Hold

#: So often who asks or holds says that it lives: a tenth of the multiplexer's default lease.
RENEW_S = 0.5
#: A multiplexer that answers nothing for so long is taken for dead, and is asked anew.
SILENCE_S = 10.0
#: One that is being started, or was killed and is started again, is waited for: the machine stands and holds nothing.
SERVER_S = 120.0


class _Asked:
    """One request: its key, what is known of its lease, what was last said of it."""

    def __init__(self) -> None:
        self.key = os.urandom(16)
        self.hold = Hold(time.monotonic)
        self.said: UseSource.Feedback | None = None
        self.said_s = time.monotonic()
        self.handle: Any = None

    def on_feedback(self, message: Any) -> None:
        self.said, self.said_s = message.feedback, time.monotonic()
        self.hold.confirmed(self.said.renewal, self.said.granted, self.said.lease)


class Light:
    """Asks at ``action`` for ``machine``'s light; to be used by one thread at a time, not the executor's."""

    def __init__(self, node: StepdiagNode, action: str, machine: str, priority: int):
        self._node, self._name, self._machine, self._priority = node, action, machine, priority
        self._client = ActionClient(node, UseSource, action)
        self._renewals = node.create_publisher(Renewal, f'{action}/lease', reliable(10))
        self._asked: _Asked | None = None
        node.every(RENEW_S, self._renew)

    @property
    def held(self) -> bool:
        """The light is this machine's, now."""
        asked = self._asked
        return asked is not None and asked.hold.holds

    @contextmanager
    def hold(self, expected_s: float, alive: Callable[[], None], tell: Callable[[str], None]) -> Iterator[None]:
        """Wait for the light, have it while the context lasts.

        ``alive()`` raises what ends the waiting, ``tell(text)`` is called with what is waited for.
        A request that is lost in the meantime is made anew.  Raises :class:`Interrupted` where nobody answers.
        """
        try:
            while not self._ask(expected_s, alive, tell):
                self._give_back()
            yield
        finally:
            self._give_back()

    def _ask(self, expected_s: float, alive: Callable[[], None], tell: Callable[[str], None]) -> bool:
        """Ask and wait; False where the request was lost and is to be made anew."""
        self._await_server(alive, tell)
        asked = self._asked = _Asked()
        goal = UseSource.Goal(machine=self._machine, priority=self._priority, expected=expected_s)
        sent = self._in_executor(lambda: self._client.send_goal_async(
            goal, asked.on_feedback, goal_uuid=UUID(uuid=list(asked.key))), alive)
        asked.handle = self._wait(sent, alive)
        if asked.handle is None or not asked.handle.accepted:
            alive()
            time.sleep(0.5)
            return False
        result = self._in_executor(asked.handle.get_result_async, alive)
        told_s = 0.0
        self._renew()
        while not asked.hold.holds:
            alive()
            if result is not None and result.done():
                if asked.said is None:      # refused at once; else no answer came in time
                    raise StepdiagError(f'{self._name}: {result.result().result.message}')
                return False
            if time.monotonic() - asked.said_s > SILENCE_S:
                return False
            if asked.said is not None and not asked.said.granted and time.monotonic() - told_s > 1.0:
                told_s = time.monotonic()
                tell(f'waiting for the light: place {asked.said.place}, about {asked.said.wait:.0f} s')
            time.sleep(0.01)
        return True

    def _await_server(self, alive: Callable[[], None], tell: Callable[[str], None]) -> None:
        patience, tell_s = Patience(SERVER_S), 0.0
        while not self._client.server_is_ready():
            if patience.over():
                raise Interrupted(f'nobody answers at {self._name} for {SERVER_S:g} s; is the multiplexer up?')
            if patience.waited_s >= tell_s:
                tell_s = patience.waited_s + 1.0
                tell(f'waiting for the multiplexer at {self._name}')
            alive()
            time.sleep(0.1)

    def _give_back(self) -> None:
        asked, self._asked = self._asked, None
        if asked is None:
            return
        asked.hold.end()
        if asked.handle is not None and asked.handle.accepted:
            asked.handle.cancel_goal_async()   # its answer changes nothing: what is not renewed is taken back

    def _renew(self) -> None:
        asked = self._asked
        if asked is not None:
            self._renewals.publish(Renewal(goal=list(asked.key), number=asked.hold.sent()))

    def _in_executor(self, request: Callable[[], Future], alive: Callable[[], None]) -> Future | None:
        """A future from the thread that receives its answer: rclpy would lose one that came before it was noted."""
        return self._wait(self._node.executor.create_task(request), alive)

    @staticmethod
    def _wait(future: Future | None, alive: Callable[[], None], timeout_s: float = SILENCE_S) -> Any:
        """The result; ``None`` after the time."""
        if future is None:
            return None
        return future.result() if ended(future, timeout_s, alive, period_s=0.05) else None
