"""Waiting for a future of rclpy in a thread that is not the executor's."""

import math
import threading
from collections.abc import Callable

from rclpy.task import Future

from stepdiag_ros.nodes.patience import Patience


def ended(future: Future, timeout_s: float | None, meanwhile: Callable[[], object] = lambda: None,
          period_s: float = 0.1) -> bool:
    """True once ``future`` is done, False after ``timeout_s`` [s] of patience (``None``: waits as long as it takes).

    ``meanwhile()`` is called every ``period_s`` [s]; what it raises ends the waiting.
    """
    done = threading.Event()
    future.add_done_callback(lambda _future: done.set())
    patience = Patience(math.inf if timeout_s is None else timeout_s, period_s)
    while not done.wait(period_s):
        if patience.over():
            return False
        meanwhile()
    return True
