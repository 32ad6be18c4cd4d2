"""A log is whole when its last dwell has ended and what was read till then has come: topics wait for no other."""

from types import SimpleNamespace

import numpy as np
import pytest

from stepdiag_ros.model.log import DONE, DWELL
from stepdiag_ros.nodes.listener import ListenerNode

ENDS = 100.0


class Stamped(SimpleNamespace):
    """What has times."""

    def __len__(self) -> int:
        return len(self.time_ns)


def _log(phase: int = DONE, **late: float) -> SimpleNamespace:
    """A log whose last step ends at ENDS; ``late``: how long before it the last of a topic was."""
    def times(name: str, period: float) -> Stamped:
        return Stamped(time_ns=ENDS - late.get(name, -1.0) - period * np.arange(20.0)[::-1])
    return SimpleNamespace(steps=SimpleNamespace(phase=[phase], time_ns=[ENDS]),
                           **{name: times(name, 0.1) for name in ('displacement', 'spot', 'beam_angle')},
                           environment={'air_temperature': times('air', 5.0)})


@pytest.mark.parametrize('early', [_log(DWELL), _log(displacement=0.3), _log(spot=0.3), _log(beam_angle=0.3),
                                   _log(air=5.2)])
def test_what_is_on_its_way_is_waited_for(early):
    received = iter([early, early, whole := _log(air=3.0)])
    assert ListenerNode.whole_log(SimpleNamespace(log_so_far=lambda: next(received))) is whole
