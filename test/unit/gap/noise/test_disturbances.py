"""What disturbs readings, put into their noise."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.disturbances import _with_steps, disturbed
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.gap.preprocess.timing import step_noise


def test_dwells_too_short_for_parts_have_the_noise_of_the_steps(case):
    """Without a warning: nothing was seen of what goes on inside."""
    observation, width = case.observe(), 1e-8
    blind = replace(observation, bins=np.full(observation.bins.shape, np.nan))
    table, beams = observation.table, observation.fit.model.beams
    least = np.sqrt(np.concatenate([step_noise(samples, rows, np.full(count, width)) for samples, rows, count in (
        (observation.log.displacement, table.displacement_rows, beams), (observation.log.spot, table.spot_rows, 2))]))
    sigma = _with_steps(blind, np.full(observation.bins.shape[2], width)).bin_sigma
    assert np.all(sigma >= 0.999 * least) and np.all(np.isfinite(sigma))


@pytest.mark.parametrize('step', [0.5, 1.2, 2.0])
def test_parts_of_dwells_read_in_steps_are_as_noisy_as_held_to_be(case, step):
    """Rounding of samples that differ is averaged away as their noise is; held to be that of one sample, it made the
    parts twice as noisy as they are, and the evidence of everything twice as large: noise of stops and parts is one."""
    law = f'{{displacement: {{quantum: {step * 5e-9:.3e}}}, spot: {{quantum: {step * 2e-7:.3e}}}}}'
    log = case.untidy(law)
    observation, _ = disturbed(log, observe(log))
    assert np.any(observation.table.quanta) == (step > 1.0)
    inside = fit_jointly(observation, [], noise_of(observation)).parity
    for channel in range(observation.bins.shape[2]):
        mine = inside.data[inside.stops:][inside.channel[inside.stops:] == channel]
        assert 0.8 < np.mean(mine**2) < 1.15, channel
