"""Numbers and causes in words."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from stepdiag_ros.effects import VOCABULARY
from stepdiag_ros.gap.diagnosis import Found
from stepdiag_ros.gap.summary.cross_validation import CrossValidation, Distance
from stepdiag_ros.report import words
from stepdiag_ros.report.gap_words import further_words, how_far, over_setups_words, size_words


@pytest.mark.parametrize(('value', 'unit', 'sigma', 'said'), [
    (5.71e-6, 'm', 1.2e-7, '5.71 ± 0.12 µm'), (-2.5e-3, 'm', None, '−2.50 mm'), (9.66e-9, 'm', None, '9.66 nm'),
    (3e-5, 'rad', 1e-6, '30.0 ± 1.0 µrad'), (0.02, '1', 0.001, '2.00 ± 0.10 %'), (4e-6, '1', None, '4.00 ppm'),
    (-0.0282, 's', 6e-4, '−28.20 ± 0.60 ms'), (1800.0, 's', None, '30.0 min'), (12.0, 'Hz', None, '12.0 Hz'),
    (0.0, 'm', None, '0 nm'), (float('nan'), 'm', None, 'not known')])
def test_quantities(value, unit, sigma, said):
    assert words.quantity(value, unit, sigma) == said


def test_probabilities_are_never_rounded_to_certainty():
    assert words.percent(0.99999) == '> 99.9 %'
    assert words.percent(1e-6) == '< 0.1 %'
    assert words.percent(0.5) == '50 %'
    assert [words.certainty(p) for p in (0.995, 0.95, 0.7, 0.2)] == ['practically certain', 'very likely', 'likely',
                                                                     'possible']


def test_every_effect_has_a_name_for_people():
    for name in VOCABULARY:
        assert words.title(name) != name and '_' not in words.title(name)
    assert words.title('my_own_effect') == 'My own effect'


def test_parameters_lose_their_unit_and_keep_their_meaning():
    assert words.parameter_unit('tau_s', 'm') == 's'
    assert words.parameter_unit('X shift', '1, m') == 'm'
    assert words.parameter_unit('X', '1, m') == '1'
    assert words.parameter_name('tau_s (2)') == 'time constant (2)'


@pytest.mark.parametrize(('after', 'sigma', 'said'), [
    (2.9e-7, 5e-8, 'the residual is noise.'),
    (3.4e-7, 1.9e-7, 'the residual is noise and the 0.190 µm by which the prediction itself is uncertain.')])
def test_what_is_left_is_not_said_to_be_noise_beside_more_than_noise(after, sigma, said):
    validation = CrossValidation(2.0, 1.0, 200, 100.0, 'each repeat', {'displacement': Distance(
        4.4e-7, after, 2.8e-7, sigma)})
    active = SimpleNamespace(effect=SimpleNamespace(name='servo_settling'))
    found = SimpleNamespace(cross_validation=validation, verdict='explained', unmodelled='', effects=[active],
                            joint=SimpleNamespace(active=[active]))
    assert how_far(found).endswith(said), how_far(found)


@pytest.mark.parametrize(('before', 'after', 'said'), [
    (1.26e-6, 1.55e-6, 'stays: 1.26 µm before and 1.55 µm after'),
    (1.26e-6, 4e-7, 'falls from 1.26 µm to 0.400 µm'),
    (2.9e-7, 3.3e-7, 'hardly shows: 0.290 µm before and 0.330 µm after')])
def test_a_gap_that_grows_does_not_fall(before, after, said):
    """A drift by its own amount in each run is in the fit and forecasts no other run."""
    validation = CrossValidation(2.0, 1.0, 200, 100.0, 'each repeat', {'displacement': Distance(
        before, after, 2.8e-7, 8e-6)})
    active = SimpleNamespace(effect=SimpleNamespace(name='structural_thermal_drift'))
    found = SimpleNamespace(cross_validation=validation, over_setups=validation, verdict='explained', unmodelled='',
                            effects=[active], joint=SimpleNamespace(active=[active]))
    assert f'predicted from the others, the gap {said}' in over_setups_words(found)
    if 'hardly' not in said:
        assert f'in the simulator the gap {said}' in how_far(found)


def test_setups_are_described():
    assert words.setup_words('npp') == 'diagonal to −X to +Y to +Z'
    assert words.setup_words('lin_y') == 'line along Y'
    assert words.setup_words('npp.2') == 'diagonal to −X to +Y to +Z, mounted once more'
    assert words.setup_words('lin_y.2') == 'line along Y, mounted once more'


@pytest.mark.parametrize(('parameters', 'said'), [
    ({'X': 2.247e-5, 'X wave 1': 5e-6, 'Y': 1e-5}, 'X 22.47 ± 0.10 µm, Y 10.00 ± 0.10 µm, k = 1'),
    ({'jump': 2e-6, 'jump (2)': -1e-6}, 'jump 2.00 ± 0.10 µm, k = 1')])
def test_forms_of_one_axis_are_one_size(parameters, said):
    found = Found('backlash', 'Lost motion.', 1.0, parameters, dict.fromkeys(parameters, 1e-7), 'm', '', 1.0, '')
    assert size_words(found) == said


def test_what_a_further_repeat_will_show_is_said_with_its_limits():
    of = Distance(4.0e-6, 1.0e-6, 0.8e-6, 0.0, (3.0e-6, 5.0e-6), (0.8e-6, 1.5e-6))
    assert further_words(CrossValidation(20.0, 1.5, 200, 100.0, 'each repeat in turn', {'displacement': of})) == (
        'Of a further repeat, predicted from all of these, expect an error of 0.800 µm to 1.50 µm, and 90 % to 100 % '
        'of the gap gone (95 %).')
    same = replace(of, before=1.0e-6)
    assert 'gone' not in further_words(CrossValidation(1.5, 1.5, 200, 100.0, 'each repeat', {'displacement': same}))
    alone = replace(of, before_95=None, after_95=None)
    assert further_words(CrossValidation(20.0, 1.5, 200, 100.0, 'none', {'displacement': alone})) == ''
