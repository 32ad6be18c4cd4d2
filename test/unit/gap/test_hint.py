"""Between nothing and a finding: a hint, which is said and not claimed."""

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.longer import Known, Longer
from stepdiag_ros.gap.next_measurement import FOR_HINT
from stepdiag_ros.gap.next_run import recommend
from stepdiag_ros.gap.thresholds import ALARM, SUSPICION
from stepdiag_ros.report.gap_page import gap_page
from stepdiag_ros.report.gap_words import headline, summary


def _backlash(case, size):
    return case.diagnose(effect_class('backlash')(B=[size, 0.0, 0.0]))


@pytest.fixture(scope='module')
def faint(case):
    return _backlash(case, 9e-7)


def test_what_is_likelier_than_nothing_but_not_enough_is_a_hint(faint):
    assert faint.verdict == 'no_gap' and not faint.effects and not faint.joint.active
    assert faint.hint.names == ('backlash',) and SUSPICION < faint.hint.log_bayes < ALARM
    assert faint.to_json_dict()['hint'] == {
        'names': ['backlash'], 'log_evidence': faint.hint.log_bayes, 'claimed_from': ALARM}


def test_the_hint_is_said_and_what_would_settle_it(faint):
    assert headline(faint).startswith('Nothing is wrong') and 'hint of “Backlash' in headline(faint)
    for said in (summary(faint, 'log'), gap_page(faint, 'log')):
        assert 'a hint, not a finding: a finding takes 3000 times' in said
    assert faint.next_run.between == ('backlash', 'nothing')
    assert 'decide between backlash and nothing' in faint.next_measurement


@pytest.mark.parametrize(('size', 'verdict'), [(0.0, 'no_gap'), (3e-6, 'explained')])
def test_no_hint_where_there_is_nothing_or_a_finding(case, size, verdict):
    found = _backlash(case, size)
    assert found.verdict == verdict and found.hint is None
    assert found.to_json_dict()['hint'] is None and 'hint' not in summary(found, 'log')


def test_where_no_run_is_worth_it_all_is_done_once_more(case):
    found = _backlash(case, 8e-7)
    assert found.hint.log_bayes < SUSPICION
    assert found.next_measurement == FOR_HINT and found.next_run is None


def test_nothing_foretells_less_spread_than_what_may_act(faint):
    backlash = effect_class('backlash')()
    form = backlash.appearance(faint.joint.observation.view)[0]
    run = recommend(faint.joint, [[(1.0, [(backlash, form)])], [(1.0, [])]]).run
    longer = Longer(faint.joint, run, Known(faint.joint))
    plain, acting = longer.forecast([]), longer.forecast([(backlash, form)])
    assert plain.mean.shape == acting.mean.shape
    assert np.all(np.sum(plain.spread**2, axis=1) <= np.sum(acting.spread**2, axis=1) * (1.0 + 1e-9))
    assert plain.volume < acting.volume
