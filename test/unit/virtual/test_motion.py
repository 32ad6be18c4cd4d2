"""Jerk-limited motion against limits, and against numerical integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stepdiag_ros.virtual.motion import (
    brake,
    evaluate,
    point_to_point,
    settling_time,
    tabulate,
)

LIMITS = [(0.1, 1.0, 20.0), (0.5, 8.0, 800.0), (2.0, 0.5, 3.0), (0.01, 5.0, 1.0)]
DISTANCES = [1e-7, 1e-4, 3e-3, 0.04, 0.9, 3.0]


def table_of(profile):
    return tabulate(profile.duration[None], profile.jerk[None], np.array([profile.speed]),
                    np.array([profile.acceleration]))


def curve(profile, times, lag=0.0):
    return evaluate(table_of(profile), np.zeros(len(times), int), times, lag)


@pytest.mark.parametrize('limits', LIMITS)
@pytest.mark.parametrize('distance', DISTANCES)
def test_a_move_covers_its_distance_within_the_limits(distance, limits):
    profile = point_to_point(distance, *limits)
    assert profile.length == pytest.approx(distance, rel=1e-12)
    times = np.linspace(0.0, profile.total_time, 4001)
    p, v, a, _ = curve(profile, times)
    speed, acceleration, jerk = limits
    assert v.max() <= speed * (1 + 1e-9)
    assert np.abs(a).max() <= acceleration * (1 + 1e-9)
    assert np.abs(np.diff(a)).max() <= jerk * times[1] * (1 + 1e-6)
    assert np.all(np.diff(p) >= -1e-15) and p[0] == 0.0


@pytest.mark.parametrize('limits', LIMITS)
def test_a_move_is_time_optimal(limits):
    """No slack: each profile touches at least one limit at its limit."""
    for distance in DISTANCES:
        profile = point_to_point(distance, *limits)
        _, v, a, _ = curve(profile, np.linspace(0.0, profile.total_time, 20001))
        cubic = 2.0 * np.cbrt(distance / (2.0 * limits[2])) * 2.0
        touches = [v.max() / limits[0], np.abs(a).max() / limits[1], cubic / profile.total_time]
        assert max(touches) > 0.999


def test_position_is_the_integral_of_the_jerk():
    profile = point_to_point(0.04, 0.1, 1.0, 20.0)
    edges = np.cumsum(profile.duration)

    def rate(t, y):
        phase = min(int(np.searchsorted(edges, t, side='right')), 6)
        return [y[1], y[2], profile.jerk[phase]]
    times = np.linspace(0.0, profile.total_time, 50)
    found = solve_ivp(rate, (0.0, profile.total_time), [0.0, 0.0, 0.0], t_eval=times,
                      max_step=1e-4, rtol=1e-10, atol=1e-14)
    p, v, _, _ = curve(profile, times)
    np.testing.assert_allclose(found.y[0], p, atol=1e-7)
    np.testing.assert_allclose(found.y[1], v, atol=1e-5)


def test_the_servo_is_a_first_order_lag():
    profile, lag = point_to_point(0.03, 0.2, 2.0, 60.0), 0.012
    end = profile.total_time + 8 * lag

    def rate(t, y):
        return (curve(profile, np.array([t]))[0] - y) / lag
    times = np.linspace(0.0, end, 200)
    found = solve_ivp(rate, (0.0, end), [0.0], t_eval=times, max_step=1e-3, rtol=1e-9, atol=1e-13)
    _, _, _, actual = curve(profile, times, lag)
    np.testing.assert_allclose(found.y[0], actual, atol=2e-9)


@pytest.mark.parametrize('lag', [0.002, 0.02])
def test_in_position_when_the_window_is_reached_and_not_before(lag):
    profile, window = point_to_point(0.05, 0.5, 8.0, 800.0), 5e-8
    table = table_of(profile)
    settled = settling_time(table, lag, window)[0]
    after = evaluate(table, np.zeros(100, int), settled + np.linspace(0.0, 0.1, 100), lag)[3]
    assert np.abs(after - 0.05).max() <= window * (1 + 1e-6)
    before = evaluate(table, np.zeros(1, int), np.array([settled - 0.1 * lag]), lag)[3]
    assert abs(before[0] - 0.05) > window


@pytest.mark.parametrize('when', [0.02, 0.05, 0.2, 0.3, 0.44])
def test_a_brake_joins_the_move_and_stops(when):
    limits = (0.1, 1.0, 20.0)
    move = point_to_point(0.04, *limits)
    assert when < move.total_time
    _, v, a, _ = (float(x[0]) for x in curve(move, np.array([when])))
    stop = brake(v, a, *limits[1:])
    times = np.linspace(0.0, stop.total_time, 2001)
    p, speed, acceleration, _ = curve(stop, times)
    assert speed[0] == pytest.approx(v) and acceleration[0] == pytest.approx(a)
    assert np.all(speed >= -1e-9) and abs(speed[-1]) < 1e-9
    assert np.abs(acceleration).max() <= limits[1] * (1 + 1e-9)
    assert np.abs(np.diff(acceleration)).max() <= limits[2] * times[1] * (1 + 1e-6)
    assert p[-1] < 0.04


def test_no_distance_takes_no_time():
    profile = point_to_point(0.0, 0.1, 1.0, 20.0)
    assert profile.total_time == 0.0 and profile.length == 0.0
    assert settling_time(table_of(profile), 0.01, 1e-8)[0] == 0.0
