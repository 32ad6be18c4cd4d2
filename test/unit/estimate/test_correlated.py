"""Means over samples that go with those before them, against samples drawn so."""

import numpy as np
import pytest

from stepdiag_ros.estimate.correlated import (
    ALIKE,
    FIFTHS,
    SLOPE_AND_BEND,
    fifths_contrasts,
    not_rounding,
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


def shown_by(values, each):
    """What a log shows: scatter of neighbours, that of contrasts of fifths by degree and of the means in its units."""
    neighbours = np.sqrt(np.mean(np.diff(values, axis=1)**2) / 2.0)
    fifths = values.reshape(len(values), FIFTHS, each).mean(axis=2)
    by_degree = np.sqrt(each) * (fifths @ fifths_contrasts().T).std(axis=0) / neighbours
    return neighbours, by_degree, float(np.sqrt(np.mean(by_degree[SLOPE_AND_BEND:]**2)))


@pytest.mark.parametrize(('rho', 'each', 'within'), [
    (0.0, 4, 0.06), (0.3, 3, 0.06), (0.6, 7, 0.06), (0.8, 7, 0.06), (0.9, 20, 0.06), (0.6, 1, 0.1), (0.8, 4, 0.1)])
def test_what_drawn_samples_scatter_by(rho, each, within):
    """By degree and for the mean; and the mean from contrasts beyond slope and bend alone, as a log shows them."""
    values = drawn(rho, each)
    neighbours, by_degree, loud = shown_by(values, each)
    mean = np.sqrt(FIFTHS * each) * values.mean(axis=1).std() / neighbours
    near = int(np.argmin(np.abs(ALIKE - rho)))
    said = [np.interp(rho, ALIKE, column) for column in scatters(each)[0].T]
    assert abs(ALIKE[near] - rho) < 0.05
    assert by_degree == pytest.approx(said, rel=0.03)
    assert mean == pytest.approx(np.interp(rho, ALIKE, scatters(each)[1]), rel=0.03)
    assert of_mean(loud, each, 2 * len(values)) == pytest.approx(mean, rel=within)


@pytest.mark.parametrize(('rho', 'step', 'each'), [
    (0.0, 1.0, 4), (0.5, 2.0, 4), (0.7, 1.0, 4), (0.7, 2.0, 4), (0.8, 2.0, 9)])
def test_what_is_rounded_off_does_not_pass_for_the_independence_of_samples(rho, step, each):
    """Readings in steps as large as their noise, or twice: taken for samples that are less alike, their means are said
    to be up to twice as certain as they are."""
    zero = np.random.default_rng(3).uniform(-50.0, 50.0, (20_000, 1))
    values = np.rint((drawn(rho, each) + zero) / step) * step - zero
    neighbours, _, loud = shown_by(values, each)
    mean = np.sqrt(FIFTHS * each) * values.mean(axis=1).std() / neighbours
    share = float(not_rounding(np.array([neighbours]), np.array([step]))[0])
    own = np.diff(drawn(rho, each), axis=1)
    assert share == pytest.approx(np.mean(own**2) / 2.0 / neighbours**2, abs=0.03)
    assert of_mean(loud, each, 2 * len(values), share) == pytest.approx(mean, rel=0.1)
    if rho > 0.6:
        assert of_mean(loud, each, 2 * len(values)) < 0.9 * mean


def test_readings_without_steps_are_not_rounded():
    assert not_rounding(np.array([1e-9, 0.0]), np.zeros(2)) == pytest.approx([1.0, 1.0])
    assert not_rounding(np.array([1e-7]), np.array([1e-9])) == pytest.approx([1.0], abs=1e-4)


def test_where_fifths_tell_no_more_the_mean_is_held_to_what_they_tell():
    """Never less than the contrasts, never endless, and of the independent nothing is made."""
    for each in (1, 3, 7, 40):
        assert of_mean(1.0, each, 1e6) == pytest.approx(1.0, abs=0.02)
        end = float(np.sqrt(np.mean(scatters(each)[0][-1, SLOPE_AND_BEND:]**2)))
        some, many = (of_mean(end, each, known) for known in (200, 20_000))
        assert some < many < 0.5 * scatters(each)[1][-1]
        assert of_mean(1e3, each, 1e6) == 1e3
    assert of_mean(2.0, 0, 1e6) == 2.0
