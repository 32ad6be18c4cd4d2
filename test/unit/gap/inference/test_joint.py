"""Machine and effects fitted together."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.inference.evidence import SIZES, prior_sigma_of
from stepdiag_ros.gap.inference.joint import fit_jointly, held_to_sizes, solve, tuned
from stepdiag_ros.gap.inference.select_effects import noise_of


@pytest.mark.long
def test_a_coefficient_that_nothing_settles_is_held_to_the_size_of_the_others(case):
    found = case.diagnose(effect_class('psd_zero_offset')(x=3e-5, y=1e-5))
    active, space = found.joint.active[0], found.joint.parity
    form = active.form
    loose = replace(form, held=None, columns=np.concatenate([form.columns, 0.0 * form.columns[:1]]),
                    names=(*form.names, 'never seen'), scale=np.append(form.scale, form.scale[0]))
    (effect, held), = tuned(space, [(active.effect, loose)])
    assert prior_sigma_of(held) < 0.5 * SIZES[-1]
    result, = solve(space, [(effect, held)])
    assert np.sqrt(result.covariance[-1, -1]) <= 1.001 * prior_sigma_of(held) * held.scale[-1]
    free, = solve(space, [(effect, loose)])
    settled = np.sqrt(np.diag(free.covariance))[:-1] < 0.05 * np.abs(free.coefficients[:-1])
    assert settled.any()
    assert np.allclose(result.coefficients[:-1][settled], free.coefficients[:-1][settled], rtol=0.02)


def test_a_profile_is_held_to_every_size_that_the_log_leaves_it(lost_motion):
    """One coefficient that is seen leaves its profile's size open, and how far another may go that is not seen."""
    space, (active,) = lost_motion.joint.parity, lost_motion.joint.active
    unseen = replace(active.form, held=None, columns=np.concatenate([active.form.columns, 0.0 * active.form.columns]),
                     names=active.form.names * 2, scale=np.tile(active.form.scale, 2), inside=None, by_reading=None)
    profile = replace(unseen, process=True)
    ways = held_to_sizes(space, [(active.effect, profile)])
    probability, size = np.array([(p, chosen[0][1].held) for p, chosen in ways]).T
    assert 0.8 < probability.sum() <= 1.0 and len(ways) > 1
    likeliest = size[np.argmax(probability)]
    result, = solve(space, ways[int(np.argmax(probability))][1])
    np.testing.assert_allclose(np.sqrt(result.covariance[-1, -1]), likeliest * profile.scale[-1])
    assert [p for p, _ in held_to_sizes(space, [(active.effect, unseen)])] == [1.0]


def test_a_gain_of_the_spot_is_one_of_its_noise(case):
    """In x a third of the spot is read: of the mirror's turns a third too.  Taken as alike in x and y they were said
    to be three quarters of what they are, and the spot in y to scatter besides."""
    gain = effect_class('psd_gain')(x=-0.67, y=0.0)
    observation = case.observe(gain)
    form = next(form for form in gain.appearance(observation.view) if form.label == 'apart in x and y')
    joint = fit_jointly(observation, [(gain, form)], noise_of(observation))
    assert abs(joint.noise.angle / 2.0e-7 - 1.0) < 0.12
    rest = joint.parity.data - sum(joint.parity.project(a.form) @ (a.coefficients / a.form.scale) for a in joint.active)
    squares = [np.mean(rest[:joint.parity.stops][joint.parity.channel[:joint.parity.stops] == c]**2) for c in (1, 2)]
    assert 0.7 < squares[0] / squares[1] < 1.4
