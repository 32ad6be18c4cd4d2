"""Who waits for a sign of life counts the time in which it listened, not that in which it stood still."""

import pytest

from stepdiag_ros.nodes.lease import TICK_S, Lease

from .clock import Clock


def listen(lease: Lease, clock: Clock, seconds: float) -> None:
    for _ in range(round(seconds / TICK_S)):
        clock.s += TICK_S
        lease.tick()


def test_silence_is_as_long_as_it_was_listened(clock):
    lease = Lease(clock)
    listen(lease, clock, 6.0)
    assert lease.silent_s == pytest.approx(6.0)
    lease.renew()
    assert lease.silent_s == 0.0


def test_who_stood_still_takes_nobody_for_lost(clock):
    lease = Lease(clock)
    listen(lease, clock, 1.0)
    clock.s += 30.0          # this process was stopped; what has arrived lies there unread
    lease.tick()
    assert lease.silent_s <= 1.0 + 2.0 * TICK_S
    listen(lease, clock, 5.0)
    assert lease.silent_s > 5.0      # nobody has renewed it since: lost, after all
