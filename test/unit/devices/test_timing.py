"""Times of polls and matched clocks, against simulated delays."""

import time

import numpy as np

from stepdiag_ros.devices.timing import DRIFT, ClockMatch, Grid, times_of_polls

PERIOD = 1e-3


def test_a_sample_s_time_lies_between_request_and_answer():
    rng = np.random.default_rng(1)
    asked = 1.7e9 + np.arange(50) * PERIOD + rng.exponential(2e-4, 50)
    asked = np.maximum.accumulate(asked)
    answered = asked + rng.exponential(1e-3, 50)
    stamp_ns, period_s, known = times_of_polls(list(asked), list(answered), PERIOD, 3, 0)
    taken = stamp_ns + known.taken_ns
    assert np.all(np.abs(taken * 1e-9 - 0.5 * (asked + answered)) < known.uncertainty_ns * 1e-9 + 1e-6)
    assert np.all(taken - known.uncertainty_ns <= asked * 1e9 + 500)
    assert np.all(taken + known.uncertainty_ns >= answered * 1e9 - 500)
    assert np.all(np.diff(taken) > 0) and known.missed == 3
    # A reader who knows stamp and period alone never dates a sample later than it was taken.
    assert np.all(np.arange(50) * period_s * 1e9 <= known.taken_ns + 1)


def test_requests_that_go_off_together_keep_their_order():
    _, period_s, known = times_of_polls([5.0] * 4, [5.001] * 4, PERIOD, 0, 0)
    assert np.all(np.diff(known.taken_ns) > 0) and period_s == PERIOD


def test_an_answer_that_takes_long_does_not_date_a_block_before_the_last_one():
    # Ten polls every 5 ms, the last answered 0.2 s late: evenly spaced over all of it, the first would be 88 ms early.
    asked = 1.7e9 + 0.05 + np.arange(10) * 5e-3
    answered = asked + 1e-4
    answered[-1] += 0.2
    before_ns = int(1.7e9 * 1e9) + 45_000_000
    stamp_ns, period_s, known = times_of_polls(list(asked), list(answered), 5e-3, 0, before_ns)
    assert stamp_ns > before_ns
    assert np.all(stamp_ns + known.taken_ns >= asked * 1e9 - 500)
    assert np.all(np.arange(10) * period_s * 1e9 <= known.taken_ns + 1) and period_s > 4e-3
    # Of a block before that says nothing, or that was stamped by a clock set back since, it takes no account.
    assert times_of_polls(list(asked), list(answered), 5e-3, 0, 0)[0] < before_ns
    stamp_ns, _, known = times_of_polls(list(asked), list(answered), 5e-3, 0, before_ns + 3_600_000_000_000)
    assert known.taken_ns[0] == 0 and abs(stamp_ns - asked[0] * 1e9) < 1e5


def test_what_was_due_while_nobody_polled_is_missed_and_not_made_up_for():
    grid = Grid()
    assert grid.wait(PERIOD) == (1, 0)
    time.sleep(0.05)
    count, missed = grid.wait(PERIOD)
    assert count == 1 and missed >= 48
    grid.forget()
    time.sleep(0.02)
    assert grid.wait(PERIOD)[1] == 0


def test_matched_clocks_are_as_good_as_the_best_exchange_whatever_delays_the_others():
    rng = np.random.default_rng(2)
    offset, drift = 1234.5, 2e-5
    match = ClockMatch()
    for k in range(60):
        other = float(k)
        ours = offset + other * (1.0 + drift)
        before, after = rng.exponential(5e-3, 2)
        match.add(ours - before - 1e-4, other, ours + after + 1e-4)
        assert abs(match.ours(other) - ours) <= match.uncertainty(other) + 1e-9
    assert match.uncertainty(59.0) < 2e-3


def test_a_clock_that_was_set_begins_anew():
    match = ClockMatch()
    match.add(10.0, 0.0, 10.001)
    match.add(3610.0, 1.0, 3610.001)
    assert abs(match.ours(1.0) - 3610.0005) < 1e-9
    match.shift(-3600.0)
    assert abs(match.ours(1.0) - 10.0005) < 1e-9
    assert match.uncertainty(2.0) > match.uncertainty(1.0) + 0.9 * DRIFT
