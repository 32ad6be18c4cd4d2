"""What is said of the noise, and from where it is a finding."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.noise.stated import _steps
from stepdiag_ros.model.description import Noise


@pytest.mark.parametrize('times, verdict', [(2.0, 'no_gap'), (10.0, 'unexplained')])
def test_a_log_ten_times_noisier_than_its_description_is_a_finding(case, times, verdict):
    log = case.log()
    noise = log.description.noise
    said = replace(log, description=replace(log.description, noise=Noise(
        noise.displacement, noise.spot, noise.position_repeatability / times, noise.angle_repeatability)))
    found = diagnose(said, [kind() for kind in all_effects().values()])
    assert found.verdict == verdict and not found.effects
    assert ('noisier than its description' in found.unmodelled) == (verdict == 'unexplained')


def test_of_several_beams_it_is_said_which():
    one, two = _steps(np.array([5e-9, 0.0, 5e-9, 0.0, 0.0]))
    assert 'displacement of beam 0:' in one and 'displacement of beam 2:' in two
    assert list(_steps(np.array([5e-9, 0.0, 0.0]))) == ['noise: displacement: readings move in steps of 0.005 µm']


def test_beside_a_name_too(case):
    """The name explains what it does; the log stays ten times as noisy as it should be."""
    log = case.log(effect_class('psd_gain')(x=0.02))
    noise = log.description.noise
    said = replace(log, description=replace(log.description, noise=Noise(
        noise.displacement, noise.spot, noise.position_repeatability / 10.0, noise.angle_repeatability)))
    found = diagnose(said, [kind() for kind in all_effects().values()])
    assert found.verdict == 'partly_explained' and [f.name for f in found.effects] == ['psd_gain']
    assert 'noisier than its description' in found.unmodelled
