"""Tests by frequency: noise is noise in every band, and what has one frequency stands out in one."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.summary.bands import bands


@pytest.fixture(scope='module')
def null(case):
    observation = case.observe()
    return fit_jointly(observation, [], noise_of(observation))


def test_noise_stands_out_nowhere(null):
    found = bands(null)
    assert {b.channel for b in found} == {'displacement', 'spot_x', 'spot_y'}
    assert {b.setting for b in found} == {'path', 'reversal', 'time'}
    assert not any(b.stands_out for b in found)
    mean = np.average([b.before for b in found], weights=[b.count for b in found])
    # Two repeats of a small cell tell the noise to a third.
    assert 0.5 < mean < 1.5


@pytest.mark.parametrize(('setting', 'half_waves', 'channel'), [
    ('path', 5, 'displacement'), ('reversal', 9, 'spot_y'), ('time', 6, 'displacement')])
def test_one_frequency_stands_out_in_its_band(null, setting, half_waves, channel):
    view, space = null.observation.view, null.parity
    mine = view.setup == 0
    share = (view.time - view.time.min()) / np.ptp(view.time) if setting == 'time' else \
        (view.index + 0.5) / (view.index[mine].max() + 1)
    longest = 2.0 * (np.ptp(view.time) if setting == 'time' else np.ptp(view.distance[mine, 0]))
    column = view.zeros(1)
    wave = np.cos(np.pi * half_waves * share)
    column[0, :, {'displacement': 0, 'spot_y': -1}[channel]] = wave if setting == 'time' else \
        wave * mine * (view.direction if setting == 'reversal' else 1.0)
    seen = space.stop_part(column)[:, 0]
    data = space.data.copy()
    data[:space.stops] += 12.0 * seen / np.linalg.norm(seen)
    found = [b for b in bands(replace(null, parity=replace(space, data=data))) if b.setting == setting]
    # With pauses between the stops a wave in time shows in other octaves too.
    there = [b for b in found if b.channel == channel and b.shortest <= 1.01 * longest / half_waves <= 1.02 * b.longest]
    assert len(there) == 1 and there[0].stands_out
    assert (there[0].before - 1.0) * there[0].count == pytest.approx(144.0, abs=60.0)
    assert not any(b.stands_out for b in found if b.channel != channel)


@pytest.mark.long
def test_lost_motion_is_opposite_on_the_way_back_and_gone_with_its_effect(lost_motion):
    loud = [b for b in lost_motion.bands if b.stands_out]
    most = max(loud, key=lambda b: b.before)
    assert (most.channel, most.setting) == ('displacement', 'reversal')
    assert all(b.after < 2.5 for b in loud)
    assert any(row['stands_out'] for row in lost_motion.to_json_dict()['bands'])
