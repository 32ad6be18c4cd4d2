"""Effects by name, parameters, draws, files of one's own."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.effects import VOCABULARY, all_effects, effect_class, effects_in_file
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.acting import ALLOWED, allow_effect_files
from stepdiag_ros.virtual.offline import simulate_log

OWN = '''
import numpy as np
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView


class Sag(Effect):
    name = 'sag'
    title = 'The spindle sags.'
    parameters = (Parameter('amp', 'm', 0.0, 1e-5),)

    def before_pose(self, moment: Moment) -> None:
        moment.shift = moment.shift - self.amp * np.array([0.0, 0.0, 1.0])

    def appearance(self, view: StopView) -> list[Form]:
        return [Form('constant', -view.by_shift[2:], ('amp',), np.full(1, 1e-6))]
'''


def test_the_vocabulary_is_the_contract_s():
    found = all_effects()
    assert tuple(found) == VOCABULARY
    assert len(VOCABULARY) == 19
    assert all(kind.name == name for name, kind in found.items())


@pytest.mark.parametrize('name', VOCABULARY)
def test_everything_is_said(name):
    kind = effect_class(name)
    for text in (kind.title, kind.remedy, kind.signature, kind.neighbours):
        assert text.strip().endswith('.') and len(text) > 20
    assert kind.sources
    assert kind.parameters
    assert all(p.low <= p.high and p.unit for p in kind.parameters)
    # What it is distinguished from are effects that exist.
    assert all(other in VOCABULARY for other in re.findall(r'\b[a-z]+(?:_[a-z]+)+\b', kind.neighbours))


@pytest.mark.parametrize('name', VOCABULARY)
def test_draws_are_plausible_and_of_the_generator_alone(name):
    kind = effect_class(name)
    drawn = [kind.draw(np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1]
    assert drawn[0] != drawn[2]
    for values in drawn:
        effect = kind(**values)
        for p in kind.parameters:
            value = np.atleast_1d(getattr(effect, p.name))
            assert value.shape == (p.size,)
            assert np.all(np.isfinite(value))
            assert p.name not in values or np.all(np.abs(value) <= max(abs(p.low), abs(p.high)) * 1.001)


@pytest.mark.parametrize('name', VOCABULARY)
def test_an_effect_acts_and_the_same_cell_gives_the_same_log(bench, name):
    # Small against a 3 cm detector, large against the noise.
    values = dict(effect_class(name).draw(np.random.default_rng(3)))
    if name == 'count_slip':
        values['arrival'] = 20
    if name == 'clock_skew':
        values = {'interferometer': 0.05, 'psd': 0.0}
    cell = replace(bench.cell, effects={name: values})
    setups = ('ppp', 'lin_x')
    first, again = (simulate_log(cell, setups=setups) for _ in range(2))
    plain = simulate_log(bench.cell, setups=setups)
    np.testing.assert_array_equal(first.displacement.values, again.displacement.values)
    np.testing.assert_array_equal(first.spot.values, again.spot.values)
    both = [np.abs(getattr(first, s).values - getattr(plain, s).values).max()
            for s in ('displacement', 'spot')]
    assert 1e-9 < max(both) < 0.02


def test_an_unknown_name_and_an_unknown_parameter():
    with pytest.raises(StepdiagError, match='no effect of this name; names are air_refraction_drift'):
        effect_class('gremlins')
    with pytest.raises(ValueError, match='unknown parameter size; known are B'):
        effect_class('backlash')(size=1.0)
    with pytest.raises(ValueError, match="motion is 'EXW'"):
        effect_class('non_rigid_coupling')(motion='EXW')
    with pytest.raises(ValueError, match='own axis'):
        effect_class('non_rigid_coupling')(motion='EXX', by='X')


def test_an_effect_of_one_s_own_takes_part(bench, tmp_path, monkeypatch):
    path = tmp_path / 'sag.py'
    path.write_text(OWN)
    found = all_effects([str(path)])
    assert tuple(found) == (*VOCABULARY, 'sag')
    form = found['sag']().appearance(bench.view)[0]
    change = bench.change(bench.with_effect(found['sag'](amp=1e-6)))
    # A constant shift is taken by the resets but for what it moves the spot.
    spot = change[:, bench.view.beams:]
    np.testing.assert_allclose(spot, form.columns[0, :, bench.view.beams:] * 1e-6, atol=1e-12)
    cell = replace(bench.cell, source=str(tmp_path / 'cell.yaml'),
                   effects={'sag': {'file': 'sag.py', 'amp': 1e-6}})
    with pytest.raises(StepdiagError, match=r'would be run; if you trust it, give --effect .*sag\.py'):
        simulate_log(cell, setups=('ppp',))
    monkeypatch.setenv(ALLOWED, '')
    allow_effect_files([path])
    log = simulate_log(cell, setups=('ppp',))
    direct = simulate_log(bench.cell, setups=('ppp',), effects=[found['sag'](amp=1e-6)])
    np.testing.assert_array_equal(log.spot.values, direct.spot.values)


@pytest.mark.parametrize(('text', 'words'), [
    (None, 'does not exist'), ('x = 1\n', 'holds no effect'), ('1/0\n', 'cannot be run: ZeroDivisionError'),
    ('import sys\nsys.exit(0)\n', 'cannot be run: SystemExit'),
    ('def (:\n', 'cannot be run: SyntaxError'), (OWN.replace("'sag'", "'my sag'"), 'letters, digits'),
    (OWN.replace("'sag'", "'backlash'"), 'name of the vocabulary')])
def test_files_that_hold_none(tmp_path: Path, text, words):
    path = tmp_path / 'mine.py'
    if text is not None:
        path.write_text(text)
    with pytest.raises(StepdiagError, match=words) as caught:
        effects_in_file(str(path))
    assert str(path) in str(caught.value)


def test_two_of_one_name(tmp_path):
    for name in ('a.py', 'b.py'):
        (tmp_path / name).write_text(OWN)
    with pytest.raises(StepdiagError, match='named sag already'):
        all_effects([str(tmp_path / 'a.py'), str(tmp_path / 'b.py')])


def test_what_people_are_told_of_an_effect_is_in_its_class(tmp_path):
    from stepdiag_ros.report.words import title

    shorts = [effect_class(name).short for name in VOCABULARY]
    assert all(shorts) and len(set(shorts)) == len(shorts)
    assert title('backlash') == effect_class('backlash').short
    path = tmp_path / 'sag.py'
    path.write_text(OWN.replace("name = 'sag'", "name = 'sag_of_mine'"))
    effects_in_file(str(path))
    assert title('sag_of_mine') == 'Sag of mine'
    path.write_text(OWN.replace("name = 'sag'", "name = 'sag_of_mine'\n    short = 'Spindle sags'"))
    effects_in_file(str(path))
    assert title('sag_of_mine') == 'Spindle sags'


def test_no_other_module_lists_effects():
    """Outside of the effects and of the sealed worlds of the blind check, which must not know them, nobody lists names.

    A single name or a pair is a rule about what a log shows, as when two look alike.
    """
    package = Path(__file__).resolve().parents[3] / 'stepdiag_ros'
    listed = {}
    for path in package.rglob('*.py'):
        if path.relative_to(package).parts[0] not in ('effects', 'blind'):
            named = set(re.findall(r"""['"]([a-z]+(?:_[a-z]+)*)['"]""", path.read_text(encoding='utf-8')))
            if len(named & set(VOCABULARY)) > 2:
                listed[str(path.relative_to(package))] = sorted(named & set(VOCABULARY))
    # Pairs with the run that tells them apart: they belong to no one effect.
    listed.pop('gap/experiment_design/advice.py', None)
    assert not listed
