"""Who waits counts the time in which it could have heard."""

import pytest

from stepdiag_ros.nodes.patience import Patience


def test_patience_that_is_looked_at_often_lasts_its_time(clock):
    patience, looks = Patience(3.0, 0.125, clock), 0
    while not patience.over():
        clock.s += 0.125
        looks += 1
    assert looks == 25 and patience.waited_s > 3.0


def test_a_standstill_exhausts_nobody_s_patience(clock):
    patience = Patience(30.0, 0.1, clock)
    clock.s += 600.0     # the computer stood still: nobody could have answered
    assert not patience.over()
    assert patience.waited_s == pytest.approx(0.2)


def test_it_begins_anew_with_a_sign_of_life(clock):
    patience = Patience(1.0, 0.5, clock)
    clock.s += 1.0
    assert not patience.over()
    patience.begin_anew()
    clock.s += 1.0
    assert not patience.over()
    clock.s += 1.0
    assert patience.over()


def test_what_a_look_waits_for_in_itself_counts(clock):
    """A node that lives and never answers is given up in time, though each question takes seconds."""
    patience, asked = Patience(90.0, 8.0, clock), 0
    while not patience.over():
        clock.s += 8.2
        asked += 1
    assert asked == 11


def test_until_tells_whether_it_came_true_and_ends_with_what_meanwhile_raises():
    looks = iter((False, False, True))
    assert Patience(60.0).until(lambda: next(looks))
    assert not Patience(0.0).until(lambda: False)
    with pytest.raises(ZeroDivisionError):
        Patience(60.0).until(lambda: False, lambda: 1 / 0)
