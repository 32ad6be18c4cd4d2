"""One source, many who ask: order, expected times, leases, and never two at once."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.source_queue import Hold, SourceQueue

from .clock import Clock

LEASE_S = 5.0


@pytest.fixture
def queue(clock) -> SourceQueue:
    return SourceQueue(LEASE_S, clock)


def grant(queue: SourceQueue) -> str:
    request = queue.next()
    assert queue.granted(request)
    return request.machine


def test_first_come_first_served_within_a_priority(queue):
    for key, machine, priority in ((b'a', 'a', 0), (b'b', 'b', 0), (b'c', 'c', 1)):
        queue.ask(key, machine, priority, 10.0)
    order = []
    while queue.waiting:
        order.append(grant(queue))
        queue.release(order[-1].encode())
    assert order == ['c', 'a', 'b']


def test_a_holder_is_not_ousted_by_priority(queue):
    queue.ask(b'a', 'a', 0, 10.0)
    grant(queue)
    queue.ask(b'b', 'b', 9, 10.0)
    assert queue.next() is None and queue.holder.machine == 'a'


def test_place_and_expected_time(queue, clock):
    for name, expected in (('a', 10.0), ('b', 20.0), ('c', 30.0)):
        queue.ask(name.encode(), name, 0, expected)
    grant(queue)
    clock.s += 4.0
    assert [(s.place, s.wait_s) for s in map(queue.standing, (b'a', b'b', b'c'))] == [(0, 0.0), (1, 6.0), (2, 26.0)]
    clock.s += 0.9   # no longer than the lease
    assert queue.standing(b'b').wait_s == pytest.approx(5.1)
    assert queue.standing(b'unknown') is None


def test_who_overruns_its_time_keeps_the_light_and_nobody_waits_a_negative_time(queue, clock):
    queue.ask(b'a', 'a', 0, 1.0)
    queue.ask(b'b', 'b', 0, 1.0)
    grant(queue)
    clock.s += 3.0
    queue.renew(b'a', 1)
    assert queue.standing(b'b').wait_s == 0.0 and queue.next() is None


def test_a_lease_that_is_not_renewed_is_taken_back_and_a_dead_one_does_not_wait(queue, clock):
    for name in 'abc':
        queue.ask(name.encode(), name, 0, 60.0)
    grant(queue)
    for number in range(1, 4):
        clock.s += 2.0
        queue.renew(b'c', number)
    assert [request.machine for request in queue.expire()] == ['a', 'b']
    assert grant(queue) == 'c'


def test_an_old_renewal_does_not_lengthen_a_lease(queue, clock):
    queue.ask(b'a', 'a', 0, 60.0)
    grant(queue)
    clock.s += 3.0
    queue.renew(b'a', 2)
    clock.s += 3.0
    queue.renew(b'a', 1)
    clock.s += 2.5
    assert queue.expire()


def test_what_ends_while_the_light_is_on_its_way_is_not_granted_and_nobody_else_is_picked(queue):
    for name in 'ab':
        queue.ask(name.encode(), name, 0, 1.0)
    picked = queue.next()
    queue.release(b'a')
    assert queue.next() is None
    assert not queue.granted(picked) and queue.holder is None
    assert grant(queue) == 'b'


def test_what_could_not_be_routed_keeps_its_place(queue, clock):
    for name in 'ab':
        queue.ask(name.encode(), name, 0, 1.0)
        clock.s += 0.1
    queue.failed(queue.next())
    assert queue.next().machine == 'a'


def test_one_key_asks_once(queue):
    queue.ask(b'a', 'a', 0, 1.0)
    with pytest.raises(StepdiagError, match='asks twice'):
        queue.ask(b'a', 'a', 0, 1.0)


def test_usage_counts_what_was_wanted_and_not_given(queue, clock):
    clock.s += 50.0                 # nobody wants it: not idle
    queue.ask(b'a', 'a', 0, 1.0)
    clock.s += 1.0
    grant(queue)
    clock.s += 4.0
    queue.release(b'a')
    clock.s += 50.0
    usage = queue.measure()
    assert (usage.idle_s, usage.held_s, usage.grants) == (1.0, 4.0, 1) and usage.idle_share == pytest.approx(0.2)


def test_four_machines_that_wait_keep_the_light_busy_nearly_as_by_the_best_schedule():
    """The queue's own code with the simulated clock of bench/bench_hall.py, against the exact schedule."""
    bench = runpy.run_path(str(Path(__file__).resolve().parents[3] / 'bench' / 'bench_hall.py'))
    random = np.random.default_rng(5)
    for dark in (0.1, 1.0):
        chains = bench['drawn'](random, 4, 3, dark)
        makespan, idle = bench['by_queue'](chains)
        least, whole = bench['exact'](chains)
        assert whole and idle < 0.1 and least <= makespan < 1.2 * least


def test_the_holder_counts_from_what_it_sent(clock):
    hold = Hold(clock)
    number = hold.sent()
    clock.s += 2.0
    hold.confirmed(number, True, LEASE_S)
    assert hold.holds
    clock.s += 3.0
    assert not hold.holds          # the owner, who received it later, still waits
    hold.confirmed(hold.sent(), True, LEASE_S)
    assert hold.holds
    hold.end()
    hold.confirmed(hold.sent(), True, LEASE_S)
    assert not hold.holds


class Machines(RuleBasedStateMachine):
    """Machines that ask, die and come back, messages that are late, lost or overtaken, and one owner."""

    def __init__(self):
        super().__init__()
        self.clock = Clock()
        self.queue = SourceQueue(LEASE_S, self.clock)
        self.keys = 0
        self.alive: dict[bytes, Hold] = {}
        self.frozen: dict[bytes, Hold] = {}          # cut off, not dead: it still believes what it last received
        self.to_owner: list[tuple] = []
        self.to_machine: list[tuple] = []
        self.picked = None
        self.last_change_s = self.clock.s

    # -- machines

    @precondition(lambda self: len(self.alive) < 5)
    @rule(priority=st.integers(0, 2), expected=st.floats(0.0, 30.0))
    def ask(self, priority, expected):
        self.keys += 1
        key = b'%d' % self.keys
        self.alive[key] = Hold(self.clock)
        self.queue.ask(key, key.decode(), priority, expected)

    @precondition(lambda self: self.alive)
    @rule(data=st.data())
    def renew(self, data):
        key = data.draw(st.sampled_from(sorted(self.alive)))
        self.to_owner.append(('renew', key, self.alive[key].sent()))

    @precondition(lambda self: self.alive)
    @rule(data=st.data())
    def give_back(self, data):
        key = data.draw(st.sampled_from(sorted(self.alive)))
        self.alive.pop(key).end()
        self.to_owner.append(('release', key, 0))

    @precondition(lambda self: self.alive)
    @rule(data=st.data())
    def die(self, data):
        self.alive.pop(data.draw(st.sampled_from(sorted(self.alive))))

    @precondition(lambda self: self.alive)
    @rule(data=st.data())
    def be_cut_off(self, data):
        key = data.draw(st.sampled_from(sorted(self.alive)))
        self.frozen[key] = self.alive.pop(key)

    # -- the wires

    @precondition(lambda self: self.to_owner)
    @rule(data=st.data(), lost=st.booleans())
    def reach_owner(self, data, lost):
        kind, key, number = self.to_owner.pop(data.draw(st.integers(0, len(self.to_owner) - 1)))
        if kind == 'release':
            self.queue.release(key)     # an action's cancelling is sent reliably
        elif not lost:
            self.queue.renew(key, number)

    @precondition(lambda self: self.to_machine)
    @rule(data=st.data())
    def reach_machine(self, data):
        """Some of what is under way arrives, however late; the rest goes on or is lost."""
        arriving = data.draw(st.sets(st.integers(0, len(self.to_machine) - 1)))
        for key, word in (self.to_machine[n] for n in sorted(arriving)):
            hold = self.alive.get(key) or self.frozen.get(key)
            if hold is not None:
                hold.confirmed(*word)
        self.to_machine = [] if data.draw(st.booleans()) else self.to_machine

    # -- the owner

    @precondition(lambda self: self.picked is None)
    @rule()
    def pick(self):
        self.picked = self.queue.next()
        if self.picked is not None:
            assert all(other.priority <= self.picked.priority for other in self.queue.waiting)

    @precondition(lambda self: self.picked is not None)
    @rule(works=st.booleans())
    def route(self, works):
        picked, self.picked = self.picked, None
        if works:
            self.queue.granted(picked)
        else:
            self.queue.failed(picked)

    @rule()
    def tell(self):
        for key in (*self.alive, *self.frozen):
            standing = self.queue.standing(key)
            if standing is not None:
                self.to_machine.append((key, (standing.renewal, standing.granted, LEASE_S)))

    @rule(seconds=st.sampled_from((0.02, 0.5, 2.6, 4.0)))
    def pass_time(self, seconds):
        self.clock.s += seconds

    @precondition(lambda self: self.picked is None)
    @rule()
    def a_good_moment(self):
        """All who live are received, the owner goes on and says so; only its word is still under way."""
        for key, hold in self.alive.items():
            self.queue.renew(key, hold.sent())
        request = self.queue.next()
        if request is not None:
            self.queue.granted(request)
        self.tell()

    # -- what must always be so

    @invariant()
    def never_two_at_once(self):
        using = [key for key, hold in (*self.alive.items(), *self.frozen.items()) if hold.holds]
        assert len(using) <= 1
        if using:   # and the owner knows it
            assert self.queue.holder is not None and self.queue.holder.key == using[0]

    @invariant()
    def places_are_a_row(self):
        standings = [self.queue.standing(request.key) for request in self.queue.waiting]
        assert [standing.place for standing in standings] == list(range(1, len(standings) + 1))
        assert all(standing.wait_s >= 0.0 for standing in standings)

    def teardown(self):
        """Whatever happened, after the time-out the light is free, and who asks then has it at once."""
        if self.picked is not None:
            self.queue.granted(self.picked)
        self.clock.s += LEASE_S + 0.001
        self.queue.ask(b'last', 'last', 0, 1.0)
        assert grant(self.queue) == 'last'


TestMachines = Machines.TestCase
TestMachines.settings = settings(max_examples=200, stateful_step_count=50, deadline=None,
                                 suppress_health_check=list(HealthCheck))
