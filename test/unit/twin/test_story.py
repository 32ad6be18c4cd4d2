"""How a machine came to its first stops: found where the readings show it, and never invented."""

import numpy as np

from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.gap.inference.parity import parity
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.twin.story import started, unknown_starts


def test_a_start_that_shows_is_found_and_none_is_made_of_next_to_nothing(diagnosed):
    observation = diagnosed('').nominal
    space = parity(observation, observation.fit, noise_of(observation), readings_of(observation.table))
    columns = unknown_starts(observation.view)
    shown = np.argmax(np.linalg.norm(space.stop_part(columns), axis=0))
    found = started(columns, space, 2e-5 * columns[shown])
    left = space.stop_part((found - 2e-5 * columns[shown])[None])
    assert np.linalg.norm(left) < 0.02 * np.linalg.norm(space.stop_part(2e-5 * columns[shown][None]))
    # Some starts a machine imitates as well: nanometres of anything else must not become micrometres of them.
    apart = 1e-9 * np.random.default_rng(1).standard_normal(observation.view.reading.shape)
    assert np.abs(started(columns, space, apart)).max() < 1e-7
