"""What snaps between two states is told from tails and from correlated noise."""

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Effect, Moment
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.noise.two_states import _to_and_fro, _two_rather_than_one


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


@pytest.mark.parametrize('correlation', [0.0, 0.5, 0.8])
@pytest.mark.parametrize('dof', [2.5, 5.0, np.inf])
def test_errors_of_one_middle_do_not_step_to_and_fro(correlation, dof):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        value = np.zeros(400)
        for i, error in enumerate(rng.normal(size=400) if np.isinf(dof) else rng.standard_t(dof, 400)):
            value[i] = correlation * value[i - 1] + error
        assert _to_and_fro(np.diff(value)) < 1.0


def test_an_axis_that_rests_at_whole_counts_has_not_two_states():
    rng = np.random.default_rng(1)
    for count in (1.0, 2.0):
        places = count * np.rint(rng.normal(size=400) / count) + 0.1 * rng.normal(size=400)
        assert _to_and_fro(np.diff(places)) < 1.0


@pytest.mark.parametrize('changes', [0.05, 0.3])
def test_what_stays_in_a_state_for_a_while_is_seen_by_its_steps(changes):
    """Of each run only what differs from its mean is known: two states are blurred by that, their steps are not."""
    rng = np.random.default_rng(3)
    value = 15.0 * (np.cumsum(rng.random(360) < changes) % 2) + rng.normal(size=360)
    value = np.concatenate([run - run.mean() for run in np.split(value, 18)])
    assert _to_and_fro(np.diff(value)) > 25.0
    if changes < 0.1:
        assert _two_rather_than_one(value) < 12.0
