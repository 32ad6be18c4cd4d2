"""Means over samples that go with those before them, against samples drawn so."""

import numpy as np
import pytest

from stepdiag_ros.estimate.correlated import (
    ALIKE,
    FIFTHS,
    SLOPE_AND_BEND,
    fifths_contrasts,
    of_bend,
    of_mean,
    scatters,
)


def drawn(rho, each, dwells=20_000):
    """Dwells (k, 5 each) of an AR(1) process of size one."""
    rng = np.random.default_rng(12)
    values = np.empty((dwells, FIFTHS * each))
    values[:, 0] = rng.standard_normal(dwells)
    for k in range(1, values.shape[1]):
        values[:, k] = rho * values[:, k - 1] + np.sqrt(1.0 - rho**2) * rng.standard_normal(dwells)
    return values


@pytest.mark.parametrize(('rho', 'each'), [(0.0, 4), (0.3, 3), (0.6, 7), (0.8, 7), (0.9, 20)])
def test_what_drawn_samples_scatter_by(rho, each):
    """By degree and for the mean; and the mean from contrasts beyond slope and bend alone, as a log shows them."""
    values = drawn(rho, each)
    neighbours = np.sqrt(np.mean(np.diff(values, axis=1)**2) / 2.0)
    fifths = values.reshape(len(values), FIFTHS, each).mean(axis=2)
    by_degree = np.sqrt(each) * (fifths @ fifths_contrasts().T).std(axis=0) / neighbours
    mean = np.sqrt(FIFTHS * each) * values.mean(axis=1).std() / neighbours
    near = int(np.argmin(np.abs(ALIKE - rho)))
    said = [np.interp(rho, ALIKE, column) for column in scatters(each)[0].T]
    assert abs(ALIKE[near] - rho) < 0.05
    assert by_degree == pytest.approx(said, rel=0.03)
    assert mean == pytest.approx(np.interp(rho, ALIKE, scatters(each)[1]), rel=0.03)
    loud = float(np.sqrt(np.mean(by_degree[SLOPE_AND_BEND:]**2)))
    assert of_mean(loud, each) == pytest.approx(mean, rel=0.06)
    assert of_bend(loud, each) == pytest.approx(by_degree[1] / loud, rel=0.06)


def test_where_fifths_tell_no_more_the_mean_is_held_to_what_they_tell():
    """Never less than the contrasts, never endless, and of the independent nothing is made."""
    for each in (1, 3, 7, 40):
        assert of_mean(1.0, each) == pytest.approx(1.0, abs=0.02)
        most = of_mean(float(np.sqrt(np.mean(scatters(each)[0][-1, SLOPE_AND_BEND:]**2))), each)
        assert np.isfinite(most) and most < 0.5 * scatters(each)[1][-1]
        assert of_mean(1e3, each) == 1e3
    assert of_mean(2.0, 0) == 2.0 and of_bend(2.0, 0) == 1.0
