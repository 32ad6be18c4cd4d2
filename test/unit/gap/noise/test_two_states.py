"""What snaps between two states is told from tails and from correlated noise."""

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Effect, Moment
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.noise.two_states import _two_rather_than_one


class Rattling(Effect):
    """The mirror leans to either side after a move."""

    name = 'rattling'
    state = np.cumsum(np.random.default_rng(2).random(4000) < 0.3) % 2 - 0.5

    def before_light(self, moment: Moment) -> None:
        moment.mirror = moment.mirror + 1.6e-6 * self.state[moment.arrival, None] * np.array([0.6, 0.8])


@pytest.mark.long
def test_a_rattling_mirror_is_no_noise(case):
    found = diagnose(case.log(Rattling()), [kind() for kind in all_effects().values()])
    assert found.verdict == 'unexplained' and not found.effects
    assert 'one of two' in found.unmodelled


@pytest.mark.parametrize('seed', range(3))
def test_tails_and_correlation_are_not_two_states(seed):
    rng = np.random.default_rng(seed)
    walk = np.zeros(600)
    for i in range(1, len(walk)):
        walk[i] = 0.8 * walk[i - 1] + rng.normal()
    for score in (rng.normal(size=600), rng.standard_t(3.0, 600), walk, rng.uniform(size=600),
                  np.rint(rng.normal(size=600) / 0.7) * 0.7):
        assert _two_rather_than_one(score) < 6.0
    assert _two_rather_than_one(rng.choice([-2.4, 2.4], 600) + rng.normal(size=600)) > 20.0
