"""What a cell knows already is taken off a log, sample by sample."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from stepdiag_ros.effects import all_effects
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.twin.against import without_known
from stepdiag_ros.twin.story import unknown_starts
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

from ..conftest import DEMO

SAME_M = 1e-9
QUIET = {'displacement': 0.0, 'spot': 0.0, 'position_repeatability': 0.0, 'angle_repeatability': 0.0}
SERVO = {'servo_settling': {'amp': 7e-6, 'tau': 0.2}}


def _cell(folder, name, effects, **more):
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8')) | more | {'effects': effects}
    text['sampling'] |= {'interferometer': 100.0, 'psd': 100.0, 'in_motion': True}
    text['motion'] |= {'dwell': 0.3, 'mount': 20.0}
    path = folder / f'{name}.yaml'
    path.write_text(yaml.safe_dump(text, sort_keys=False), encoding='utf-8')
    return path


def _drawn(kind):
    values = kind.draw(np.random.default_rng(3))
    return {name: np.asarray(value).tolist() for name, value in dict(values).items()}


@pytest.mark.parametrize('name', [name for name in all_effects() if name != 'clock_skew'])
def test_what_an_effect_does_to_each_sample_is_taken_off(tmp_path, name):
    path = _cell(tmp_path, name, {name: _drawn(all_effects()[name])}, noise=QUIET)
    log, bare = simulate_log(load_cell(path)), simulate_log(load_cell(_cell(tmp_path, 'bare', {}, noise=QUIET)))
    less, notes = without_known(log, path)
    for with_it, freed, without in ((log.displacement, less.displacement, bare.displacement),
                                    (log.spot, less.spot, bare.spot)):
        assert np.nanmax(np.abs(freed.values - without.values)) < SAME_M
        assert np.array_equal(freed.time_ns, with_it.time_ns)
    assert name in notes[1]


def test_stamps_are_put_right(tmp_path):
    path = _cell(tmp_path, 'late', {'clock_skew': {'interferometer': 0.02, 'psd': -0.03}}, noise=QUIET)
    log = simulate_log(load_cell(path))
    less, _ = without_known(log, path)
    assert np.all(less.displacement.time_ns - log.displacement.time_ns == -20_000_000)
    assert np.all(less.spot.time_ns - log.spot.time_ns == 30_000_000)
    assert np.array_equal(less.displacement.values, log.displacement.values)


@pytest.mark.parametrize('effects', [SERVO, {'clock_skew': {'interferometer': 0.02, 'psd': 0.0}},
                                     {'backlash': {'B': [4e-6, 3e-6, 5e-6]}}])
def test_nothing_is_found_that_is_known(tmp_path, effects):
    path = _cell(tmp_path, 'cell', effects)
    log, _ = without_known(simulate_log(load_cell(path)), path)
    found = diagnose(log, [kind() for kind in all_effects().values()])
    assert found.verdict == 'no_gap', found.to_json_dict()['effects']


def test_what_the_log_does_not_tell_of_its_first_stops_is_not_held_against_it(tmp_path):
    """A machine that stood on its other side until each axis had moved again."""
    path = _cell(tmp_path, 'cell', {'backlash': {'B': [6e-6, 5e-6, 4e-6]}})
    log = simulate_log(load_cell(path))
    view = observe(log).view
    table = reduce_log(log)
    shift = np.tensordot(np.tile([6e-6, -5e-6, 4e-6], 7)[:len(unknown_starts(view))], unknown_starts(view), axes=1)
    stop = np.searchsorted(table.dwell_ns, log.displacement.time_ns, side='right') - 1
    moved = replace(log.displacement, values=log.displacement.values + shift[stop, :-2])
    less, notes = without_known(replace(log, displacement=moved), path)
    assert 'first stop' in notes[1] and 'first stop' not in without_known(log, path)[1][1]
    found = diagnose(less, [kind() for kind in all_effects().values()])
    assert found.verdict == 'no_gap', found.to_json_dict()['effects']
