"""The further run: what it is expected to bring."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.joint import fit_jointly
from stepdiag_ros.gap.next_run import recommend


@pytest.fixture(scope='module')
def small_offset(case):
    """A small offset of the detector's zero, fitted, and two sets of effects that could make it."""
    found = case.diagnose(effect_class('psd_zero_offset')(x=2e-5, y=-2e-5))
    view = found.joint.observation.view
    first = {name: (effect_class(name)(), effect_class(name)().appearance(view)[0])
             for name in ('psd_zero_offset', 'psd_gain')}
    joint = fit_jointly(found.nominal, [first['psd_zero_offset']], found.joint.noise)
    return joint, first


def test_a_run_is_recommended_that_tells_two_effects_apart(small_offset):
    joint, first = small_offset
    run = recommend(joint, [[first['psd_zero_offset']], [first['psd_gain']]])
    assert run.between == ('psd_gain', 'psd_zero_offset')
    assert run.setup.name.endswith('.2') and run.evidence > 0.5
    said = run.to_json_dict()
    assert said['setup'] == run.setup.name and 'psd_gain and psd_zero_offset' in said['text']


def test_no_run_tells_an_effect_from_itself(small_offset):
    joint, first = small_offset
    assert recommend(joint, [[first['psd_gain']], [first['psd_gain']]]) is None
    assert recommend(joint, [[first['psd_gain']]]) is None


def test_a_drift_without_a_like_in_the_longer_log_is_not_foretold(small_offset):
    joint, first = small_offset
    effect, form = first['psd_zero_offset']
    strange = replace(form, label='strange', columns=np.random.default_rng(1).normal(size=form.columns.shape))
    assert recommend(joint, [[first['psd_gain']], [(effect, strange)]]) is None
