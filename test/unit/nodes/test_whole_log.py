"""A log is whole when its last dwell has ended: the topics do not wait for each other."""

from types import SimpleNamespace

from stepdiag_ros.model.log import DONE, DWELL
from stepdiag_ros.nodes.listener import ListenerNode


def _log(phase: int) -> SimpleNamespace:
    return SimpleNamespace(steps=SimpleNamespace(phase=[phase], time_ns=[0]), displacement=[], spot=[])


def test_the_end_of_the_last_dwell_is_waited_for():
    received = iter([_log(DWELL), _log(DWELL), whole := _log(DONE)])
    listener = SimpleNamespace(log_so_far=lambda: next(received))
    assert ListenerNode.whole_log(listener) is whole
