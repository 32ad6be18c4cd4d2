"""Counts lost inside a dwell are read off its samples, and the dwell counts without them."""

from types import SimpleNamespace

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.count_slip import QUARTER, whole_fringes
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.noise.slips_at_rest import slips_at_rest

COUNT, SIZE, NOISE = 200, 20, 4e-9
JUMP = 4.0 * QUARTER


def _seen(steps):
    """Slips found in white dwells of which some, by their number, step by so much [m] after seven of twenty samples."""
    values = NOISE * np.random.default_rng(3).standard_normal((COUNT, SIZE))
    for row, size in steps.items():
        values[row, 7:] += size
    rows = np.arange(COUNT)[:, None] * SIZE + np.array([0, SIZE])
    return slips_at_rest(SimpleNamespace(values=values.reshape(-1, 1)), SimpleNamespace(displacement_rows=rows))


def test_a_whole_count_is_found_with_its_place_and_size():
    slip, = _seen({40: -JUMP})
    assert (slip.row, slip.beam) == (40, 0)
    assert slip.jump == pytest.approx(-JUMP, abs=5.0 * slip.sigma)
    assert slip.behind == pytest.approx(13.0 / 20.0)


@pytest.mark.parametrize('steps', [{}, {40: 1.17 * QUARTER}, dict.fromkeys(range(20, 60, 10), JUMP)],
                         ids=['noise', 'no whole count', 'too often'])
def test_what_is_no_slip_is_left_alone(steps):
    assert _seen(steps) == ()


def test_a_count_in_air_is_a_whole_one_however_well_it_is_known():
    # The instrument divides by the index of air: 3e-4 of each count.
    assert whole_fringes(40.0 * QUARTER / 1.00027, 1e-11) > 2.0
    assert whole_fringes(40.3 * QUARTER, 1e-11) < -5.0


class SlipsInADwell(Effect):
    """The counter loses eight counts in the middle of a dwell, ten standard deviations of an arrival's error: half as
    many may as well be errors that go with those before, as far as one log tells."""

    def after_light(self, moment):
        after = (moment.arrival > 40) | ((moment.arrival == 40) & (moment.since_arrival > 0.15))
        moment.length = moment.length + 2.0 * JUMP * after[:, None]


def test_a_slip_in_a_dwell_keeps_its_name_and_size(case):
    found = case.diagnose(SlipsInADwell())
    assert [e.name for e in found.effects] == ['count_slip']
    effect = found.effects[0]
    assert effect.parameters['jump'] == pytest.approx(2.0 * JUMP, abs=4.0 * effect.sigma['jump'])
    assert any('lost count by 3.06' in line for line in found.warnings)


class SlipsInAnEarlyDwell(Effect):
    """The counter loses 52 counts in the third dwell of a log: until Z moves again an error of its first arrival, 331
    times as large as others, would leave the same stops."""

    def after_light(self, moment):
        after = (moment.arrival > 4) | ((moment.arrival == 4) & (moment.since_arrival > 0.25))
        moment.length = moment.length + 13.0 * JUMP * after[:, None]


@pytest.mark.long
def test_a_slip_that_was_seen_in_a_dwell_is_no_tail(case):
    found = diagnose(case.untidy('{position: {dof: 3}}', SlipsInAnEarlyDwell()),
                     [kind() for kind in all_effects().values()])
    assert found.verdict == 'explained'
    assert [(e.name, e.form) for e in found.effects] == [('count_slip', 'seen in the dwell of ppp/0/+ stop 2')]
    effect = found.effects[0]
    assert effect.parameters['jump'] == pytest.approx(13.0 * JUMP, abs=4.0 * effect.sigma['jump'])
