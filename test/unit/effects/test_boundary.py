"""What a file of the user's own gives is checked where it enters: one line with file, class, method, shapes."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effects_in_file
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.offline import simulate_log

SOUND = '''
import numpy as np
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView


class Sag(Effect):
    name = 'sag'
    short = 'Spindle sags'
    parameters = (Parameter('amp', 'm', 0.0, 1e-5),)

    def before_pose(self, moment):
        moment.shift = moment.shift - self.amp * np.array([0.0, 0.0, 1.0])

    def appearance(self, view):
        return [Form('constant', -view.by_shift[2:], ('amp',), np.full(1, 1e-6))]
'''
FORM = "[Form('constant', -view.by_shift[2:], ('amp',), np.full(1, 1e-6))]"


def of(tmp_path, text):
    path = tmp_path / 'sag.py'
    path.write_text(text, encoding='utf-8')
    return effects_in_file(str(path))[0]


@pytest.mark.parametrize(('form', 'words'), [
    ("[Form('constant', -view.by_shift[2], ('amp',), np.full(1, 1e-6))]",
     r'columns is \(\d+, 3\), wanted is an array of shape \(1, \d+, 3\); these are 1 coefficient as in names'),
    ("[Form('constant', np.nan * view.by_shift[2:], ('amp',), np.full(1, 1e-6))]", r'columns is nan at \[0, 0, 0\]'),
    ("[Form('constant', -view.by_shift[2:], ('amp', 'more'), np.full(1, 1e-6))]", 'wanted is an array of shape .2,'),
    ("[Form('constant', -view.by_shift[2:], 'amp', np.full(1, 1e-6))]", "names is 'amp'; give a tuple"),
    ("[Form('constant', -view.by_shift[2:], ('amp',), 1e-6)]", r'scale is float of shape \(\), wanted'),
    ("[Form('constant', -view.by_shift[2:], ('amp',), np.zeros(1))]", 'scale holds 0; give sizes above 0'),
    ("[Form('constant', -view.by_shift[2:], ('amp',), np.ones(1), inside=-view.by_shift[2:])]",
     r'inside is \(1, \d+, 3\)'),
    ("[Form('constant', -view.by_shift[2:], ('amp',), np.ones(1), gain=np.ones(3))]",
     r'gain is \(3,\), wanted .* \(1, 3\)'),
    ("Form('constant', -view.by_shift[2:], ('amp',), np.ones(1))", 'gives Form; return a list of Form'),
    ('[view.by_shift]', 'holds a ndarray; return Form objects'),
    ('[view.by_shift @ np.ones(7)]', r'\(line 15\): ValueError: .*stepdiag effect check')])
def test_what_appearance_gives(bench, tmp_path, form, words):
    kind = of(tmp_path, SOUND.replace(FORM, form))
    with pytest.raises(StepdiagError, match=words) as caught:
        kind().appearance(bench.view)
    said = str(caught.value)
    assert said.startswith(f'{tmp_path / "sag.py"}: Sag.appearance') and '\n' not in said


def test_a_form_that_is_tuned_is_checked_too(bench, tmp_path):
    kind = of(tmp_path, SOUND.replace('np.full(1, 1e-6))]', "np.full(1, 1e-6), shape={'tau_s': 1.0}, "
                                                           'retune=lambda shape: 7)]'))
    with pytest.raises(StepdiagError, match='holds a int'):
        kind().appearance(bench.view)[0].retune({'tau_s': 2.0})


@pytest.mark.parametrize(('change', 'words'), [
    ('moment.shift = moment.shift[:, 0]', r'moment.shift is \(\d+,\), wanted is an array of shape \(\d+, 3\)'),
    ('moment.turn[0] = np.nan', r'moment.turn is nan at \[0, 0\], 3 of \d+ numbers are not finite'),
    ('moment.spot = moment.shift', 'moment.spot is set before there is one; change it in after_light'),
    ('moment.shift = None', 'moment.shift is NoneType'),
    ('raise SystemExit(0)', r'\(line 12\): SystemExit: 0; correct this line'),
    ('moment.shift = moment.shift - np.ones(7)', r'\(line 12\): ValueError: .*effect check')])
def test_what_the_physical_face_writes(bench, tmp_path, change, words):
    kind = of(tmp_path, SOUND.replace('moment.shift = moment.shift - self.amp * np.array([0.0, 0.0, 1.0])', change))
    with pytest.raises(StepdiagError, match=words) as caught:
        simulate_log(replace(bench.cell), setups=('lin_x',), effects=[kind()])
    assert str(caught.value).startswith(f'{tmp_path / "sag.py"}: Sag.before_pose')


def test_stamps_and_sensors(tmp_path):
    kind = of(tmp_path, SOUND + "\n    def clock_offset(self, sensor):\n        return None\n"
                                "\n    def environment(self, seconds):\n        return {'temperature': 1.0}\n")
    with pytest.raises(StepdiagError, match="clock_offset: gives None for 'psd'; return a finite number"):
        kind().clock_offset('psd')
    with pytest.raises(StepdiagError, match=r"\['temperature'\] is float of shape"):
        kind().environment(np.arange(4.0))


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('0.0, 1e-5)', '1e-5, 0.0)', 'Sag.parameters holds'), ('0.0, 1e-5)', "'x', 1e-5)", 'Sag.parameters holds'),
    ('0.0, 1e-5)', '0.0, 1e-5, 0)', 'Sag.parameters holds'),
    ("(Parameter('amp', 'm', 0.0, 1e-5),)", 'None', 'Sag.parameters is None; give a tuple'),
    ("short = 'Spindle sags'", 'short = 3', 'Sag.short is 3; give a text'),
    ("name = 'sag'", 'name = np.zeros(0)', 'Sag.name is array'), ("name = 'sag'", 'name = 7', 'Sag.name is 7')])
def test_attributes(tmp_path, old, new, words):
    assert old in SOUND
    with pytest.raises(StepdiagError, match=words):
        of(tmp_path, SOUND.replace(old, new))
