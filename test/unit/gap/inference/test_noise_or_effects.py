"""Which of noise and effects a log shows: what decides between the noises that were tried."""

from types import SimpleNamespace

import pytest

from stepdiag_ros.gap.inference import noise_or_effects
from stepdiag_ros.gap.inference.candidates import Member
from stepdiag_ros.gap.inference.noise_or_effects import Settled, _against
from stepdiag_ros.gap.inference.search import EffectSet

SLIP = EffectSet((Member('count_slip', 0, 28.9),), 28.9)


def settled(alone, acting):
    """What was found in one noise, of given total log evidence without and with the slip."""
    screen = SimpleNamespace(candidates=[SimpleNamespace(effect='count_slip')])
    return Settled(SimpleNamespace(total=alone, active=()), SimpleNamespace(total=acting, active=(1,)),
                   [SLIP, EffectSet((), 0.0)], screen)


@pytest.fixture(autouse=True)
def stated_evidence(monkeypatch):
    monkeypatch.setattr(noise_or_effects, 'total_evidence', lambda joint, sets, screen: joint.total)


@pytest.mark.parametrize('acting', [settled(100.0, 50.0), settled(0.0, 55.0)])
def test_what_explains_less_than_the_noise_alone_is_gone(acting):
    """Also where it was found in the noise that wins."""
    nothing = settled(100.0, 50.0)
    found = _against(nothing, acting)
    assert found.joint is nothing.alone and not found.sets[0].members
    assert all(s.log_bayes < 0.0 for s in found.sets if s.members)


def test_an_effect_is_as_far_ahead_as_in_all():
    found = _against(settled(100.0, 50.0), settled(0.0, 120.0))
    assert found.joint.total == 120.0 and found.sets[0].members
    assert 0.0 < found.sets[0].log_bayes < 28.9
