"""What disturbs readings, put into their noise."""

from dataclasses import replace

import numpy as np

from stepdiag_ros.gap.noise.disturbances import _with_steps


def test_dwells_too_short_for_parts_have_the_noise_of_the_steps(case):
    """Without a warning: nothing was seen of what goes on inside."""
    observation, width = case.observe(), 1e-8
    blind = replace(observation, bins=np.full(observation.bins.shape, np.nan))
    sigma = _with_steps(blind, np.full(observation.bins.shape[2], width)).bin_sigma
    assert np.all(sigma >= 0.999 * width / np.sqrt(12.0)) and np.all(np.isfinite(sigma))
