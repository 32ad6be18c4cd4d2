"""What an observer shows of two counts of the errors, which come on two topics and wait for no other."""

from types import SimpleNamespace

import pytest

from stepdiag_ros.nodes import environment

environment.prepare()

from stepdiag_msgs.msg import GeometricErrors  # noqa: E402
from stepdiag_ros.nodes.observer import _keep_errors  # noqa: E402
from stepdiag_ros.nodes.stamps import stamp_of  # noqa: E402


def _errors(last_step_ns: int, complete: bool) -> GeometricErrors:
    message = GeometricErrors(complete=complete)
    message.header.stamp = stamp_of(last_step_ns)
    return message


@pytest.mark.parametrize('late', [_errors(50, complete=False), _errors(100, complete=False)])
def test_a_count_so_far_that_comes_late_does_not_take_the_place_of_the_complete_one(late):
    seen = SimpleNamespace(errors=None)
    for message in (_errors(40, complete=False), whole := _errors(100, complete=True), late):
        _keep_errors(seen, message)
    assert seen.errors is whole


def test_what_is_measured_afterwards_does():
    seen = SimpleNamespace(errors=_errors(100, complete=True))
    _keep_errors(seen, more := _errors(110, complete=False))
    assert seen.errors is more
