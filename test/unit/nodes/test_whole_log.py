"""A log is whole when its last dwell has ended and what was read till then has come: topics wait for no other."""

from types import SimpleNamespace

import numpy as np
import pytest

from stepdiag_ros.model.log import DONE, DWELL, ScalarSeries
from stepdiag_ros.nodes.listener import ListenerNode

ENDS = 100.0


class Stamped(SimpleNamespace):
    """What has times."""

    def __len__(self) -> int:
        return len(self.time_ns)


def _log(phase: int = DONE, period: float = 1.0, **late: float) -> SimpleNamespace:
    """A log whose last step ends at ENDS; ``late``: how long before it the last of a topic was.

    ``period`` [s]: of the air's readings, which a log holds up to its last step.
    """
    def times(name: str, interval: float) -> np.ndarray:
        return np.int64(1e9 * (ENDS - late.get(name, -1.0) - interval * np.arange(20.0)[::-1]))
    samples = {name: Stamped(time_ns=times(name, 0.1)) for name in ('displacement', 'spot', 'beam_angle')}
    air = ScalarSeries(times('air', period), np.full(20, 20.0), np.zeros(20)).during(0, int(1e9 * ENDS))
    return SimpleNamespace(steps=SimpleNamespace(phase=[phase], time_ns=[int(1e9 * ENDS)]),
                           environment={'air_temperature': air}, **samples)


def _given_by(*logs: SimpleNamespace) -> SimpleNamespace:
    received = iter(logs)
    return ListenerNode.whole_log(SimpleNamespace(log_so_far=lambda: next(received)))


@pytest.mark.parametrize('early', [_log(DWELL), _log(displacement=0.3), _log(spot=0.3), _log(beam_angle=0.3),
                                   _log(air=1.2), _log(air=0.4), _log(air=61.0, period=60.0)])
def test_what_may_be_on_its_way_is_waited_for(early):
    assert _given_by(early, early, whole := _log()) is whole


def test_a_reading_that_is_far_off_is_not_waited_for():
    assert _given_by(early := _log(air=30.0, period=60.0)) is early
