"""The clock of stamps: monotonic between looks, a step is returned once, steering is followed in silence."""

import time

import pytest

from stepdiag_ros.devices import hostclock
from stepdiag_ros.devices.hostclock import HostClock


def test_it_is_the_system_s_time():
    assert HostClock().now() == pytest.approx(time.time(), abs=0.01)


@pytest.mark.parametrize(('set_by_s', 'said'), [(-5.0, True), (3600.0, True), (0.05, True), (0.002, False)])
def test_a_step_is_said_once_and_only_when_it_is_looked_for(monkeypatch, set_by_s, said):
    clock, real = HostClock(), hostclock._offset_ns
    before = clock.now()
    monkeypatch.setattr(hostclock, '_offset_ns', lambda: real() + round(set_by_s * 1e9))
    assert clock.now() - before == pytest.approx(0.0, abs=0.05)      # nothing jumps by itself
    assert clock.follow() == (pytest.approx(set_by_s, abs=1e-3) if said else 0.0)
    assert clock.now() == pytest.approx(time.time() + set_by_s, abs=0.01)
    assert clock.follow() == 0.0
