"""The further run in the sealed world."""

import numpy as np
import pytest

from stepdiag_ros.blind.settle import is_settled, longer_log
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.estimate.reduce import reduce_log


@pytest.mark.parametrize('kind', ['mirror_mount_creep', 'psd_rotation'])
def test_the_run_comes_at_the_end_and_nothing_before_it_changes(kind):
    made = make(Order('develop', 5, 1, 'single', (kind,), 'field', small=True))
    run = {'setup': 'ppp.2', 'standoff_m': 0.9, 'psd_offset_m': [0.02, 0.0], 'mirror_turn_rad': [1e-4, -1e-4],
           'at_once': True}
    longer = longer_log(made, run)
    for now, before in ((longer.displacement, made.log.displacement), (longer.spot, made.log.spot)):
        np.testing.assert_array_equal(now.values[:len(before)], before.values)
    table = reduce_log(longer)
    assert table.setup_names[-1] == 'ppp.2' and table.setup[-1] == len(table.setup_names) - 1
    assert longer.description.setups['ppp.2'].standoff == 0.9
    assert longer.description.noise == made.log.description.noise


def test_settled_is_one_sure_and_true_effect():
    assert is_settled({'a': 0.97, 'b': 0.02}, ('a', 'b'), ['a'])
    assert not is_settled({'a': 0.97, 'b': 0.02}, ('a', 'b'), ['b'])
    assert not is_settled({'a': 0.9, 'b': 0.1}, ('a', 'b'), ['a'])
    assert not is_settled({'a': 0.97, 'b': 0.6}, ('a', 'b'), ['a'])
    assert not is_settled({}, ('a', 'b'), ['a'])
