"""Where the gap lies: against what the virtual cell says without noise."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.blind.score import cells
from stepdiag_ros.blind.visibility import Yardstick
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.summary.where import shares
from stepdiag_ros.report.gap_words import how_far
from test.unit.gap.ring import FaintRing


@pytest.mark.parametrize(('name', 'values'), [
    ('backlash', {'B': [4e-6, 0.0, 3e-6]}),
    pytest.param('psd_rotation', {'angle': 0.05}, marks=pytest.mark.long),
])
def test_shares_are_those_of_the_difference_without_noise(case, lost_motion, name, values):
    effect = effect_class(name)(**values)
    yardstick = Yardstick(case.cell, case.log())
    true = cells(yardstick.shares(yardstick.change(case.log(effect))), case.cell.setup_names)
    found = lost_motion if name == 'backlash' else case.diagnose(effect)
    said = {(s.channel, s.setup): s.share for s in found.shares}
    assert sum(said.values()) == pytest.approx(1.0, abs=0.05)
    for key in {*true, *said}:
        assert said.get(key, 0.0) == pytest.approx(true.get(key, 0.0), abs=0.05), key


@pytest.mark.long
def test_shares_are_those_that_a_fit_leaves_where_the_model_bends():
    """The cosine of a beam takes a change of scale in a linear run: by the Jacobian half of the gap would lie there."""
    made = make(Order('sealed', 20261131, 531, 'single', ('scale_thermal_expansion',)))
    true = cells(made.truth['shares'], made.cell.setup_names)
    found = diagnose(made.log, [effect_class('scale_thermal_expansion')()])
    said = {(s.channel, s.setup): s.share for s in found.shares}
    assert {key for key, share in true.items() if share > 0.1} == set(said)
    for key, share in said.items():
        assert share == pytest.approx(true[key], abs=0.1), key


def test_cells_that_hold_only_noise_are_left_out(case):
    found = case.diagnose(effect_class('psd_zero_offset')(x=2e-4, y=0.0))
    assert found.shares and all(s.channel.startswith('spot') for s in found.shares)


def test_nothing_is_said_where_nothing_was_found(unaffected):
    assert shares(unaffected.joint, (), False) == ()


@pytest.mark.long
def test_what_shows_inside_the_dwells_alone_lies_where_it_shows_there(case):
    found = case.diagnose(FaintRing())
    assert 'rings after each move' in found.unmodelled
    # In every diagonal, not in the one cell that chance made largest among the stops.
    assert {share.setup for share in found.shares if share.channel == 'spot_y'} >= {'ppp', 'npp', 'pnp', 'nnp'}
    assert 'In the means of single stops it hardly shows' in how_far(found)


def test_residuals_say_where_something_without_a_name_lies(unaffected):
    joint = unaffected.joint
    table = joint.observation.table
    residual = joint.fit.residual.copy()
    rows = np.flatnonzero(table.setup == 1)[::3]
    residual[rows, 1] += 5e-6
    broken = replace(joint, observation=replace(joint.observation, fit=replace(joint.fit, residual=residual)))
    largest = shares(broken, (), True)[0]
    assert (largest.channel, largest.setup) == ('spot_x', table.setup_names[1])
    assert largest.share > 0.9


def test_what_was_taken_for_noise_lies_where_it_was_added(unaffected):
    joint = unaffected.joint
    table = joint.observation.table
    added = np.zeros(joint.fit.residual.shape)
    added[table.setup == 2, :-2] = 1e-15
    disturbed = replace(joint.observation, table=replace(table, disturbed=added))
    found = shares(replace(joint, observation=disturbed), (), True)
    assert [(s.channel, s.setup) for s in found] == [('displacement', table.setup_names[2])]
    assert found[0].share == pytest.approx(1.0)


def test_a_shake_lies_in_the_length_and_in_the_dwells(case):
    """Along Z: alike in all four diagonals, nothing of it in a line along X."""
    found = case.diagnose(effect_class('vibration')(amp=[0.0, 0.0, 2e-8], frequency=9.3))
    assert [e.name for e in found.effects] == ['vibration'] and 'look the same' in found.effects[0].remedy
    assert {s.channel for s in found.shares} == {'displacement'}
    diagonals = [s.share for s in found.shares if not s.setup.startswith('lin')]
    assert sum(diagonals) > 0.7 and max(diagonals) < 2.0 * min(diagonals)
    assert found.margins.state == {'moving': 0.0, 'settling': 1.0, 'at_rest': 0.0}


def test_every_margin_adds_up(lost_motion):
    margins = lost_motion.margins.to_json_dict()
    assert set(margins) == {'channel', 'setup', 'axis', 'direction', 'time', 'state'}
    for margin in margins.values():
        assert sum(margin.values()) == pytest.approx(1.0)
        assert min(margin.values()) >= 0.0
    assert margins['state']['at_rest'] > 0.9 and margins['axis']['Y'] < margins['axis']['X']


@pytest.mark.long
def test_wrong_stamps_lie_in_the_motion(case):
    late = effect_class('clock_skew')(interferometer=0.02)
    assert case.diagnose(late).margins.to_json_dict() == {'state': {'moving': 1.0, 'settling': 0.0, 'at_rest': 0.0}}
    both = case.diagnose(late, effect_class('backlash')(B=[4e-6, 0.0, 3e-6]))
    state = both.margins.state
    assert {e.name for e in both.effects} == {'clock_skew', 'backlash'}
    assert state['moving'] > 0.1 and state['at_rest'] > 0.0
    assert sum(state.values()) == pytest.approx(1.0)
