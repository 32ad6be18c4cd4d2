"""The further run in the sealed world."""

import numpy as np
import pytest

from stepdiag_ros.blind.settle import AT_ONCE_S, extended_log, is_settled
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.estimate.reduce import reduce_log


@pytest.mark.parametrize('kind', ['mirror_mount_creep', 'psd_rotation'])
def test_the_run_comes_at_the_end_and_nothing_before_it_changes(kind):
    made = make(Order('develop', 5, 1, 'single', (kind,), 'field', small=True))
    run = {'setup': 'ppp.2', 'standoff_m': 0.9, 'psd_offset_m': [0.02, 0.0], 'mirror_turn_rad': [1e-4, -1e-4],
           'at_once': True, 'light': 0.5, 'again_after_s': 300.0, 'watch_s': 60.0, 'wait_s': 900.0}
    longer = extended_log(made, run)
    for now, before in ((longer.displacement, made.log.displacement), (longer.spot, made.log.spot)):
        np.testing.assert_array_equal(now.values[:len(before)], before.values)
    table = reduce_log(longer)
    new = table.setup == len(table.setup_names) - 1
    assert table.setup_names[-1] == 'ppp.2' and table.setup[-1] == len(table.setup_names) - 1
    assert set(table.repeat[new]) == set(range(2 * made.cell.description.plan.repeats))
    assert 900.0 < (table.dwell_ns[new].min() - table.done_ns[~new].max()) * 1e-9 < 900.0 + 2.0 * AT_ONCE_S
    first, second = (table.repeat[new] < made.cell.description.plan.repeats), table.repeat[new] >= 2
    assert 300.0 < (table.dwell_ns[new][second].min() - table.done_ns[new][first].max()) * 1e-9 < 310.0
    taken = (table.done_ns - table.dwell_ns)[new] * 1e-9
    assert taken[0] == pytest.approx(60.0 + taken[1]) and taken[1:].max() < 2.0
    assert np.median(table.intensity[new]) == pytest.approx(0.5 * np.median(table.intensity[~new]), rel=1e-2)
    assert longer.description.setups['ppp.2'].standoff == 0.9
    assert longer.description.noise == made.log.description.noise


def test_a_further_line_has_stops_of_its_own():
    made = make(Order('develop', 5, 1, 'single', ('psd_rotation',), 'field', small=True))
    length = made.cell.description.machine.volume[1]
    table = reduce_log(extended_log(made, {
        'setup': 'lin_y.9', 'standoff_m': 0.4, 'psd_offset_m': [0.02, 0.0], 'mirror_turn_rad': [0.0, 0.0],
        'at_once': False, 'length': length, 'stops': 4}))
    new = table.setup == len(table.setup_names) - 1
    assert sorted(set(table.index[new])) == [0, 1, 2, 3] and table.commanded[new].max() == pytest.approx(length)


def test_settled_is_what_truly_acts_and_nothing_else():
    assert is_settled({'a': 0.97, 'b': 0.02}, ('a', 'b'), ['a'])
    assert not is_settled({'a': 0.97, 'b': 0.02}, ('a', 'b'), ['b'])
    assert not is_settled({'a': 0.9, 'b': 0.1}, ('a', 'b'), ['a'])
    assert not is_settled({'a': 0.97, 'b': 0.6}, ('a', 'b'), ['a'])
    assert not is_settled({}, ('a', 'b'), ['a'])
    assert is_settled({'a': 0.97, 'b': 0.02, 'c': 0.8}, ('a', 'b'), ['a', 'c'])  # what is not asked does not count


def test_settled_are_both_where_both_act_and_neither_where_neither_does():
    assert is_settled({'a': 0.97, 'b': 0.99}, ('a', 'b'), ['a', 'b'])
    assert not is_settled({'a': 0.97, 'b': 0.02}, ('a', 'b'), ['a', 'b'])
    assert is_settled({'a': 0.1, 'c': 0.98}, ('a', 'b'), ['c'])
    assert not is_settled({'a': 0.6, 'c': 0.98}, ('a', 'b'), ['c'])


def test_background_stays_when_the_beam_is_dimmed():
    made = make(Order('develop', 5, 1, 'single', ('ambient_light',), 'field', small=True))
    effect, = made.effects
    run = {'setup': 'ppp.2', 'standoff_m': 0.5, 'psd_offset_m': [0.02, 0.0], 'mirror_turn_rad': [0.0, 0.0],
           'at_once': False, 'light': 0.5, 'again_after_s': None}
    bright, dim = (extended_log(made, run | {'light': light}) for light in (1.0, 0.5))
    rows = bright.spot.setup == bright.spot.setup.max()
    volts = made.cell.instruments.detector.sum_voltage
    np.testing.assert_allclose((bright.spot.health - dim.spot.health)[rows], 0.5 * volts, rtol=1e-6)
    assert effect.beam == {}
