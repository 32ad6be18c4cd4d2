"""The diagnosis on logs of a small cell and, where they are at hand, on logs by others."""

import json
import warnings

import numpy as np
import pytest

from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.gap import diagnose
from test.some import some

KEYS = {'verdict', 'gap', 'where', 'effects', 'indistinguishable', 'next_measurement'}


def test_a_null_log_is_left_alone(unaffected):
    found = unaffected
    assert found.verdict == 'no_gap' and not found.effects and not found.shares
    assert 0.8 < found.cross_validation.after < 1.2


@pytest.mark.parametrize(('name', 'values', 'size'), some(
    ('backlash', {'B': [4e-6, 0.0, 3e-6]}, ('X', 4e-6)),
    later=[('psd_zero_offset', {'x': 2e-4, 'y': -1e-4}, ('x', 2e-4)),
           ('mirror_curvature', {'radius': 2000.0, 'astigmatism': 0.0}, None),
           ('servo_settling', {'amp': 5e-6, 'tau': 0.15}, None), ('psd_rotation', {'angle': 0.05}, None)]))
def test_a_single_effect_is_named_and_its_gap_closed(case, lost_motion, name, values, size):
    found = lost_motion if name == 'backlash' else case.diagnose(effect_class(name)(**values))
    assert [e.name for e in found.effects] == [name], found.to_json_dict()['sets'][:3]
    assert found.verdict == 'explained'
    assert found.effects[0].probability > 0.8
    assert found.cross_validation.after < 1.25
    if size:
        parameter, value = size
        assert found.effects[0].parameters[parameter] == pytest.approx(value, rel=0.25)


@pytest.mark.long
def test_two_at_once(case):
    found = case.diagnose(effect_class('backlash')(B=[5e-6, 4e-6, 3e-6]),
                          effect_class('psd_zero_offset')(x=3e-4, y=2e-4))
    assert {e.name for e in found.effects} == {'backlash', 'psd_zero_offset'}


def test_the_answer_has_the_contracts_form(lost_motion):
    answer = lost_motion.to_json_dict()
    json.dumps(answer)
    assert set(answer) >= KEYS
    assert set(answer['gap']) >= {'before_m', 'after_m', 'noise_floor_m', 'held_out'}
    assert sum(cell['share'] for cell in answer['where']) <= 1.0 + 1e-9
    assert answer['gap']['after_m'] < answer['gap']['before_m']


@pytest.mark.long
def test_scatter_without_a_pattern_is_called_unknown(case):
    from dataclasses import replace
    log = case.log()
    rng = np.random.default_rng(8)
    table_rng = rng.random(len(log.steps))
    values = log.displacement.values.copy()
    # Now and then a stop is off by some µm, with no rule to it.
    dwell = np.flatnonzero(log.steps.phase == 1)
    for event in dwell[table_rng[dwell] < 0.06]:
        lo, hi = np.searchsorted(log.displacement.time_ns,
                                 [log.steps.time_ns[event], log.steps.time_ns[event + 1]])
        values[lo:hi] += rng.normal() * 6e-6
    found = diagnose(replace(log, displacement=replace(log.displacement, values=values)),
                     [kind() for kind in all_effects().values()])
    assert found.unmodelled
    assert found.verdict in ('unexplained', 'partly_explained')


@pytest.mark.parametrize('name', some('log_01', later=['log_04', 'log_05']))
def test_open_field_logs(shared, name):
    """Logs by an independent maker: the reading of the contract is right."""
    folder = shared / 'field_logs' / 'open'
    truth = json.loads((folder / 'truth.json').read_text())
    found = diagnose(read_log(folder / name), [kind() for kind in all_effects().values()])
    assert {e.name for e in found.effects} == set(truth[name]['effects'])


@pytest.mark.parametrize(('name', 'acts', 'left'), some(
    ('stage_a_x', ['backlash'], 0.1), ('stage_b_x_back', [], 1.0), later=[('stage_a_z', ['backlash'], 0.6)]))
def test_measured_stages(shared, name, acts, left):
    """Two axes have lost motion; the third wanders.  No table has times, so no drift is given a cause.  The gap closes
    on the last cycles, against the noise of the cycles, or the report denies it.  No log has a detector to warn of."""
    log = import_csv(shared / 'real_data' / f'{name}.csv').log
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = diagnose(log, [kind() for kind in all_effects().values()])
    assert [e.name for e in found.effects] == acts
    assert found.unmodelled and found.joint.noise.source == 'repeats'
    assert found.cross_validation.held_out == 'the last 2 of 5 repeats, predicted from those before'
    assert found.cross_validation.gap.left <= left
    assert name != 'stage_b_x_back' or found.cross_validation.gap.left > 0.9
