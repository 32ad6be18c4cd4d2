"""Between nothing and a finding: a hint, which is reported and not claimed."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import ALARM, SUSPICION, UNKNOWN_PENALTY
from stepdiag_ros.gap.experiment_design.advice import FOR_HINT, advise
from stepdiag_ros.gap.experiment_design.extended_log import ExtendedLog, Known
from stepdiag_ros.gap.experiment_design.next_run import recommend
from stepdiag_ros.report.gap_page import gap_page
from stepdiag_ros.report.gap_words import JOIN, headline, summary

BENT = 4.6e-6
"""[1/m] that shows with a log evidence of about 7."""


def _backlash(case, size):
    return case.diagnose(effect_class('backlash')(B=[size, 0.0, 0.0]))


@pytest.fixture(scope='module')
def faint(case):
    return _backlash(case, 9e-7)


def test_what_is_likelier_than_nothing_but_not_enough_is_a_hint(faint):
    assert faint.verdict == 'no_gap' and not faint.effects and not faint.joint.active
    assert SUSPICION < faint.hint.found.log_bayes < ALARM
    said = faint.to_json_dict()['hint']
    assert said['names'] == ['backlash'] and said['forms'] == list(faint.hint.forms.values())
    assert said['log_evidence'] == faint.hint.found.log_bayes and said['claimed_from'] == ALARM


def test_the_hint_is_said_and_what_would_settle_it(faint):
    assert headline(faint).startswith('Nothing is wrong') and 'hint of “Backlash' in headline(faint)
    for said in (summary(faint, 'log'), gap_page(faint, 'log')):
        assert 'once more' in said and '--further' in said
        assert 'a hint, not a finding: a finding takes 3000 times' in said
    assert faint.next_run.between == ('backlash', 'nothing')
    assert 'decide between backlash and nothing' in faint.next_measurement


def test_no_hint_where_there_is_nothing_or_a_finding(unaffected, lost_motion):
    for found, verdict in ((unaffected, 'no_gap'), (lost_motion, 'explained')):
        assert found.verdict == verdict and found.hint is None
        assert found.to_json_dict()['hint'] is None and 'hint' not in summary(found, 'log')


@pytest.mark.long
def test_where_no_run_is_worth_it_all_is_done_once_more(case):
    """A mount that creeps and a beam that turns: no single run tells either from nothing and from the other."""
    found = case.diagnose(effect_class('mirror_mount_creep')(amp=[4.4e-6, -4.4e-6], tau=40.0))
    words, run = advise(found.joint, [], found.indistinguishable, False, found.hint.settles)
    assert words == FOR_HINT and run is None
    assert JOIN in summary(replace(found, next_measurement=words, next_run=None), 'log')


def test_what_is_weaker_is_not_spoken_of(case):
    found = _backlash(case, 8e-7)
    assert 0.0 < found.raw[0].log_bayes < SUSPICION
    assert found.hint is None and 'hint' not in headline(found)


def test_nothing_predicts_less_spread_than_what_may_act(faint):
    backlash = effect_class('backlash')()
    form = backlash.appearance(faint.joint.observation.view)[0]
    run = recommend(faint.joint, [[(1.0, [(backlash, form)])], [(1.0, [])]]).run
    extended = ExtendedLog(faint.joint, run, Known(faint.joint))
    plain, acting = extended.forecast([]), extended.forecast([(backlash, form)])
    assert plain.mean.shape == acting.mean.shape
    assert np.all(np.sum(plain.spread**2, axis=1) <= np.sum(acting.spread**2, axis=1) * (1.0 + 1e-9))
    assert plain.volume < acting.volume


@pytest.mark.long
def test_a_hint_says_what_it_may_be_taken_for(case):
    found = case.diagnose(effect_class('mirror_mount_creep')(amp=[4.4e-6, -4.4e-6], tau=40.0))
    group, = found.indistinguishable
    assert {'beam_pointing_drift', 'mirror_mount_creep'} <= set(group)
    said = headline(found)
    assert 'hint of' in said and '“Laser beam turns slowly”' in said and '“Mirror\'s mount creeps”' in said
    assert set(found.separation) == set(group) - set(found.hint.forms)


def test_a_hint_without_a_name_says_what_it_looks_like(case):
    class Bent(Effect):
        """Lengths bent beyond a part of the range."""

        name = 'bent'

        def after_light(self, measurement):
            measurement.length = measurement.length - BENT * np.maximum(measurement.length - 0.35, 0.0)**2

    found = case.diagnose(Bent())
    assert found.verdict == 'no_gap' and list(found.hint.forms) == ['unknown']
    assert 'hint of unmodelled structure (' in headline(found) and 'not in the list' not in headline(found)


@pytest.mark.long
def test_a_hint_stands_beside_what_is_claimed(case):
    """Stamps are judged by themselves: what else is there may be a hint."""
    found = case.diagnose(effect_class('clock_skew')(psd=0.05), effect_class('backlash')(B=[9e-7, 0.0, 0.0]))
    assert [f.name for f in found.effects] == ['clock_skew'] and list(found.hint.forms) == ['backlash']
    for said in (summary(found, 'log'), gap_page(found, 'log')):
        assert 'a hint, not a finding' in said
    assert 'cause found' in gap_page(found, 'log')


def test_light_that_is_only_a_hint_explains_no_hum(case):
    class Hum(Effect):
        """The mains on the detector."""

        name = 'hum'

        def after_light(self, measurement):
            swing = 3e-7 * np.sin(2.0 * np.pi * 11.3 * measurement.seconds)
            measurement.spot = measurement.spot + swing[:, None] * np.array([0.8, 0.6])

    found = case.diagnose(effect_class('ambient_light')(level=0.0, swing=3.8e-3, period=2000.0), Hum())
    assert found.ranking['ambient_light'] >= 0.2 and not found.effects
    assert found.verdict == 'unexplained' and 'swings at 11.3 Hz' in found.unmodelled


def test_what_has_no_shape_takes_the_odds_that_a_name_does(case):
    """A pattern that fits anything is less likely before the log is seen: the evidence must make up for that too."""
    log = case.log()
    table, values = reduce_log(log), log.spot.values.copy()
    own = np.random.default_rng(3).normal(size=(4, 16))
    for setup, index, (lo, hi) in zip(table.setup, table.index, table.spot_rows, strict=True):
        values[lo:hi, 1] += 1.36e-7 * own[setup, index] if setup < len(own) else 0.0
    found = diagnose(replace(log, spot=replace(log.spot, values=values)), [kind() for kind in all_effects().values()])
    assert found.hint.found.names == (UNKNOWN,)
    assert ALARM < found.hint.found.log_bayes < found.hint.found.claimed_from == ALARM + UNKNOWN_PENALTY
    assert found.verdict == 'no_gap'
