"""What was fitted, in the terms of the simulator: parameters that do along the log's moves what the log shows."""

import numpy as np
import pytest
import yaml

from stepdiag_ros.effects import effect_class, effects_in_file
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.twin.adopt import CLOSED, adopt
from stepdiag_ros.twin.against import without_known
from stepdiag_ros.virtual.acting import ALLOWED
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

from ..conftest import DEMO, times_left

OWN = '''
import numpy as np
from stepdiag_ros.effects.base import Effect, Parameter
from stepdiag_ros.effects.patterns import follow, saturating
from stepdiag_ros.effects.timeforms import time_profiles

class SpindleGrowth(Effect):
    name = 'spindle_growth'
    title = 'The spindle warms up and pushes the tool out.'
    parameters = (Parameter('amp', 'm', 0.0, 5e-5), Parameter('tau', 's', 100.0, 3000.0))

    def before_pose(self, moment):
        grown = self.amp * saturating(moment.seconds, self.tau)
        moment.shift = moment.shift - grown[:, None] * np.array([0.0, 0.0, 1.0])

    def appearance(self, view):
        along_z = -view.by_shift[2:]
        return [follow(view, profile, along_z, ('growth',), 1e-5) for profile in time_profiles(view.time)]
'''


def _note(notes, start):
    return next(note for note in notes if note.startswith(start))


def test_a_servo_that_was_fitted_with_several_times_has_one(diagnosed):
    found = diagnosed('servo_settling', {'amp': 6e-6, 'tau': 0.13}, None, 0.5)
    written, notes = adopt(found)[:2]
    assert written['effects']['servo_settling']['amp'] == pytest.approx([6e-6] * 3, rel=0.03)
    assert written['effects']['servo_settling']['tau'] == pytest.approx(0.13, rel=0.03)
    assert not any(note.startswith('servo_settling') for note in notes)
    assert times_left(notes) == pytest.approx(1.0, abs=0.1)


def test_a_detail_that_the_guess_leaves_out_is_found_where_it_shows(diagnosed, monkeypatch):
    """Scales that are held elsewhere than at zero, of which the guess says nothing."""
    kind = effect_class('scale_thermal_expansion')
    found = diagnosed(kind.name, {'alpha': 1e-5, 'dT': [2.0, -1.0, 2.0], 'tau': 200.0, 'shift': [2e-5, 0.0, -1.5e-5]})
    monkeypatch.setattr(kind, 'course_of', ())
    monkeypatch.setattr(kind, 'guess', lambda self, fitted: {'alpha': [1e-5] * 3, 'dT': [2.0, -1.0, 2.0], 'tau': 200.0,
                                                             'shift': [0.0] * 3})
    written, notes = adopt(found)[:2]
    assert np.ptp(written['effects'][kind.name]['shift']) > 1.5e-5
    assert times_left(notes) <= CLOSED
    # The check can fail.
    monkeypatch.setattr('stepdiag_ros.twin.formula.SHOWS', np.inf)
    written, notes = adopt(found)[:2]
    assert 'shift' not in written['effects'][kind.name] and times_left(notes) > CLOSED


@pytest.mark.long
def test_what_the_log_does_not_tell_apart_stays_plausible(diagnosed):
    """Warmth and pressure of the air change the same index: no log tells 4 K from 1500 Pa."""
    found = diagnosed('air_refraction_drift', {'dT': 4.0, 'dP': -600.0, 'tau': 400.0}, None, 2.0)
    values = adopt(found).cell['effects']['air_refraction_drift']
    assert abs(values['dT']) < 7.5 and abs(values['dP']) < 1500.0
    assert values['tau'] == pytest.approx(400.0, rel=0.3)


def test_an_effect_of_ones_own_is_adopted_and_then_known(tmp_path, monkeypatch):
    file = tmp_path / 'spindle_growth.py'
    file.write_text(OWN, encoding='utf-8')
    monkeypatch.setenv(ALLOWED, str(file.resolve()))
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['sampling'] |= {'interferometer': 20.0, 'psd': 20.0, 'in_motion': False}
    text['motion'] |= {'dwell': 1.0, 'mount': 60.0}
    text['effects'] = {'spindle_growth': {'file': str(file), 'amp': 4e-5, 'tau': 500.0}}
    log = simulate_log(parse_cell(yaml.safe_dump(text), str(tmp_path / 'cell.yaml')))
    kind, = effects_in_file(str(file))
    found = diagnose(log, [kind()])
    written, notes = adopt(found)[:2]
    values = written['effects']['spindle_growth']
    assert values['file'] == str(file)
    assert values['amp'] == pytest.approx(4e-5, rel=0.2) and values['tau'] == pytest.approx(500.0, rel=0.3)
    new = tmp_path / 'adopted.yaml'
    new.write_text(yaml.safe_dump(written, sort_keys=False), encoding='utf-8')
    less, _ = without_known(log, new)
    assert diagnose(less, [kind()]).verdict == 'no_gap'


@pytest.mark.long
def test_what_the_physical_face_cannot_do_is_told(tmp_path, diagnosed):
    """An effect that appears along X and acts along Z."""
    file = tmp_path / 'spindle_growth.py'
    file.write_text(OWN.replace('-view.by_shift[2:]', 'view.by_shift[:1]'), encoding='utf-8')
    kind, = effects_in_file(str(file))
    drift = diagnosed('structural_thermal_drift', {'amp': [2e-4, 0.0, 0.0], 'tau': 300.0}, None, 2.0)
    found = diagnose(drift.log, [kind()])
    assert [f.name for f in found.effects] == ['spindle_growth']
    written, notes = adopt(found)[:2]
    assert written['effects'] == {} and 'not adopted' in _note(notes, 'spindle_growth')


def test_the_disagreement_is_that_of_the_machine_without_its_effect(diagnosed):
    """The check can fail: the cell without what acts leaves more than noise."""
    from stepdiag_ros.twin.adopt import _bare
    from stepdiag_ros.twin.twin import Twin

    found = diagnosed('backlash', {'B': [4e-6, 3e-6, 5e-6]})
    written, notes = adopt(found)[:2]
    stated = float(_note(notes, 'run along').split('chi2 ')[1].rstrip(')'))
    cell = parse_cell(yaml.safe_dump({**written, 'effects': {}}), 'adopted')
    assert stated < 1.15 and Twin(found, cell).left([])[1] > 2.0
    assert np.isfinite(Twin(found, _bare(written, found.joint.fit, None)).left([])[1])
