"""What an unmodelled structure correlates with."""

import numpy as np
import pytest

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.summary.correlates import correlates
from stepdiag_ros.report.gap_page import gap_page
from stepdiag_ros.report.gap_words import summary


class Leak(Effect):
    """The signal's strength leaks into the length."""

    name = 'leak'

    def after_light(self, measurement):
        seconds = measurement.seconds
        measurement.quality = 60.0 + 20.0 * np.sin(2.0 * np.pi * seconds / 97.0)
        measurement.length = measurement.length + 2e-6 * np.sin(2.0 * np.pi * seconds / 97.0)[:, None]


@pytest.fixture(scope='module')
def leaking(case):
    return diagnose(case.log(Leak()), [])


def test_the_signal_is_named_that_it_follows(leaking):
    first = leaking.correlates[0]
    assert (first.quantity, first.channel) == ('the signal quality of the laser', 'displacement')
    assert first.share > 0.9
    assert leaking.to_json_dict()['correlates'][0] == first.to_json_dict()


def test_it_is_said(leaking):
    for said in (summary(leaking, 'log'), gap_page(leaking, 'log')):
        assert 'It correlates with the signal quality of the laser (length, ' in said


def test_noise_goes_with_nothing(unaffected):
    found = unaffected
    assert correlates(found.joint) == () and found.to_json_dict()['correlates'] == []
    assert 'It correlates with' not in summary(found, 'log')
