"""What the samples of dwells say of their own noise."""

from dataclasses import replace

import numpy as np

from stepdiag_ros.gap.preprocess.observe import observe


def test_readings_in_steps_do_not_hide_their_noise(case):
    """A converter whose step is two standard deviations leaves most neighbours equal: their median difference is 0."""
    log = case.log()
    step = 4.0e-7
    coarse = replace(log, spot=replace(log.spot, values=np.rint(log.spot.values / step) * step))
    plain, seen = observe(log).bin_sigma, observe(coarse).bin_sigma
    expected = np.sqrt(1.0 + step**2 / 12.0 / 2.0e-7**2)   # noise and what is rounded off
    ratio = np.nanmedian(seen[:, 1:] / plain[:, 1:], axis=0)
    assert np.all(np.abs(ratio / expected - 1.0) < 0.15)
    np.testing.assert_allclose(seen[:, 0], plain[:, 0])
