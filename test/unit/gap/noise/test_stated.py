"""What is said of the noise, and from where it is a finding."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects
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
