"""Scatter without a pattern: arrivals that are off until the next move."""

import numpy as np
import pytest

from stepdiag_ros.gap.diagnose import _noise
from stepdiag_ros.gap.joint import fit_jointly
from stepdiag_ros.gap.observe import observe
from stepdiag_ros.gap.scatter import _mixture, stray_arrivals


def test_a_wide_share_of_scores_is_evidence_and_noise_is_not():
    rng = np.random.default_rng(4)
    quiet = [_mixture(rng.standard_normal(130), side) for _ in range(20) for side in (0.0, -1.0)]
    assert max(quiet) < 4.0
    score = rng.standard_normal(130)
    score[:20] -= 4.0 * rng.exponential(1.0, 20)
    assert _mixture(score, -1.0) > _mixture(score, 0.0) > 10.0
    assert _mixture(score, 1.0) < _mixture(score, 0.0)


def test_repeats_raised_by_what_is_off_do_not_hide_it():
    rng = np.random.default_rng(5)
    score = 0.4 * rng.standard_normal(260)
    score[:15] += 3.5 * rng.standard_normal(15)
    assert _mixture(score, 0.0) > 20.0


@pytest.fixture(scope='module')
def joint(case):
    observation = observe(case.log())
    return fit_jointly(observation, [], _noise(observation))


def test_short_arrivals_are_seen_in_the_data(joint):
    evidence, _ = stray_arrivals(joint)
    assert evidence < 6.0
    view, space = joint.observation.view, joint.parity
    rng = np.random.default_rng(6)
    short = np.where(rng.random(len(view.time)) < 0.2, rng.exponential(4.0, len(view.time)), 0.0)
    column = view.zeros(1)
    for axis in range(3):
        mine = view.axis == axis
        column[0, mine] = -(view.by_shift[axis] * (view.approach[:, axis] * short)[:, None])[mine]
    rest = space.data.copy()
    rest[:space.stops] += space.stop_part(column * joint.noise.position)[:, 0]
    evidence, words = stray_arrivals(joint, rest)
    assert evidence > 12.0 and 'random' in words
