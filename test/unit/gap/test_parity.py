"""Parity space holds what the fit leaves free, in units of the noise, and nothing else."""

import numpy as np

from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import estimate_noise
from stepdiag_ros.gap.parity import parity


def _space(observation):
    noise = estimate_noise(observation.table, observation.log.description.noise,
                           observation.fit.arrival)
    return parity(observation, observation.fit, noise, readings_of(observation.table))


def test_what_the_fit_can_imitate_is_not_seen(case):
    observation = case.observe()
    space = _space(observation)
    n, c = observation.fit.residual.shape
    columns = observation.fit.jacobian.toarray().T.reshape(-1, n, c)
    seen = np.linalg.norm(space.stop_part(columns), axis=0)
    whole = np.linalg.norm(space.white_part(columns), axis=0)
    assert np.all(seen[whole > 0] < 1e-6 * whole[whole > 0])


def test_null_data_are_white(case):
    space = _space(case.observe())
    assert 0.85 < np.sum(space.data[:space.stops]**2) / space.dof[0] < 1.15
    assert 0.8 < np.sum(space.data[space.stops:]**2) / space.dof[1] < 1.25


def test_data_are_not_changed_by_an_error_of_the_machine(case):
    """Adding what a change of the errors would add moves nothing in parity space."""
    observation = case.observe()
    space = _space(observation)
    rng = np.random.default_rng(1)
    change = (observation.fit.jacobian @ (rng.normal(size=observation.fit.parameters.size) * 1e-6))
    shifted = space.stop_part(change.reshape(1, *observation.fit.residual.shape))
    assert np.linalg.norm(shifted) < 1e-6 * np.linalg.norm(space.white_part(
        change.reshape(1, *observation.fit.residual.shape)))
