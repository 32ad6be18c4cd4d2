"""What the samples of dwells say of their own noise."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.model.log import ScalarSeries


@pytest.mark.parametrize('reads', [np.nan, 1013.25])
def test_an_environment_in_another_unit_is_none(case, reads):
    log = case.log()
    time = log.steps.time_ns[::10]
    series = {topic: ScalarSeries(time, np.full(len(time), value), np.zeros(len(time)))
              for topic, value in (('air_temperature', 20.0), ('air_pressure', reads), ('scale_temperature/x', reads))}
    view = observe(replace(log, environment=series)).view
    assert view.air_index is None and view.scale_temperature is None
    whole = series | {'air_pressure': replace(series['air_pressure'], value=np.full(len(time), 101325.0))}
    assert observe(replace(log, environment=whole)).view.air_index is not None


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


def test_a_dwell_whose_last_part_has_no_sample_has_an_inside(case):
    """Seven samples in the first three quarters of a dwell: a fifth of its time is empty, and what goes on is seen."""
    log, table = case.log(), reduce_log(case.log())
    kept = np.zeros(len(log.spot.time_ns), bool)
    for (low, high), begin, end in zip(table.spot_rows, table.dwell_ns, table.done_ns, strict=True):
        some = low + np.linspace(0, high - low - 1, 9).astype(int)
        kept[some[log.spot.time_ns[some] - begin < 0.78 * (end - begin)]] = True

    def thinned(samples):
        return replace(samples, **{name: value[kept] for name, value in vars(samples).items()
                                   if isinstance(value, np.ndarray) and len(value) == len(kept)})
    few = observe(replace(log, displacement=thinned(log.displacement), spot=thinned(log.spot)))
    assert np.isfinite(few.bins).all(axis=(1, 2)).mean() > 0.9
    assert np.all(np.diff(few.view.bin_time, axis=1) > 0.0)
