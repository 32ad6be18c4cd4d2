"""What single samples show: a line in the spectrum, clocks that disagree, readings in steps."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap.inside import steps, timing, vibration


def _seen(log):
    table = reduce_log(log)
    return vibration(log, table), timing(log.displacement, table, table.displacement)


def test_a_quiet_log_shows_neither(case):
    shaking, clock = _seen(case.log())
    assert shaking.log_bayes < 5.0
    # The control reports in position only after the axis has settled: the middle is seen early, never before
    # the command.
    assert abs(clock.offset) < 0.05 and clock.before == 0.0 and clock.after == 0.0


def test_a_line_is_found_where_it_is(case):
    log = case.log()
    values = log.displacement.values + 4e-8 * np.sin(
        2 * np.pi * 9.0 * (log.displacement.time_ns - log.displacement.time_ns[0]) * 1e-9)[:, None]
    shaking, _ = _seen(replace(log, displacement=replace(log.displacement, values=values)))
    assert shaking.log_bayes > 100.0
    assert shaking.frequency == pytest.approx(9.0, abs=0.7)
    assert shaking.amplitude == pytest.approx(4e-8, rel=0.25)


def test_settling_is_not_taken_for_vibration(case):
    shaking, _ = _seen(case.log(effect_class('servo_settling')(amp=5e-6, tau=0.15)))
    assert shaking.log_bayes < 8.0


@pytest.mark.parametrize('offset', [-0.08, 0.05])
def test_stamps_that_are_off_are_measured(case, offset):
    log = case.log()
    late = replace(log.displacement, time_ns=log.displacement.time_ns + round(offset * 1e9))
    _, clock = _seen(replace(log, displacement=late))
    _, plain = _seen(log)
    assert clock.offset - plain.offset == pytest.approx(offset, abs=3e-3)


def test_readings_in_steps(case):
    log = case.log()
    table = reduce_log(log)
    assert np.all(steps(log.spot, table, table.spot_rows) == 0.0)
    coarse = replace(log.spot, values=np.round(log.spot.values / 2e-6) * 2e-6)
    table = reduce_log(replace(log, spot=coarse))
    assert steps(coarse, table, table.spot_rows) == pytest.approx([2e-6, 2e-6], rel=1e-6)
