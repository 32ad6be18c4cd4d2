"""The part held out: every repeat in turn."""

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.closing import closing


def test_every_repeat_is_foretold_once(case):
    joint = case.diagnose().joint
    found = closing(joint)
    assert found.count == int(joint.fit.present.sum())
    assert 'each repeat' in found.held_out
    assert found.before == found.after == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / found.count))


def test_an_effect_found_closes_the_gap(case):
    found = case.diagnose(effect_class('backlash')(B=[4e-6, 0.0, 3e-6])).closing
    assert found.before > 1.2
    assert found.after < 1.0 + 0.1 * (found.before - 1.0) + 4.0 * np.sqrt(2.0 / found.count)
    assert found.after_m < found.before_m
