"""Means over samples that go with those before them, against samples drawn so."""

import numpy as np
import pytest

from stepdiag_ros.estimate.correlated import ALIKE, SLOW, not_rounding, of_mean, sample_contrasts, scatters


def drawn(rho, count, dwells=20_000, dof=np.inf):
    """Dwells (k, count) of an AR(1) process of size one; its innovations of Student's t."""
    rng = np.random.default_rng(12)
    steps = rng.standard_normal((dwells, count)) if np.isinf(dof) else \
        rng.standard_t(dof, (dwells, count)) / np.sqrt(dof / (dof - 2.0))
    values = np.empty((dwells, count))
    values[:, 0] = steps[:, 0]
    for k in range(1, count):
        values[:, k] = rho * values[:, k - 1] + np.sqrt(1.0 - rho**2) * steps[:, k]
    return values


def shown_by(values):
    """What a log shows: scatter of neighbours; in its units that of each contrast, and of the mean."""
    neighbours = np.sqrt(np.mean(np.diff(values, axis=1)**2) / 2.0)
    count = values.shape[1]
    each = (values @ sample_contrasts(count).T).std(axis=0) / neighbours
    return neighbours, each, np.sqrt(count) * values.mean(axis=1).std() / neighbours


def told(each, count, known, share=1.0):
    slow, fast = (float(np.sqrt(np.mean(some**2))) for some in (each[:SLOW], each[SLOW:]))
    return of_mean(slow, fast, count, known, share)


@pytest.mark.parametrize('count', [5, 6, 9, 40, 333])
def test_contrasts_are_of_length_one_and_have_no_part_in_what_drifts_or_bends(count):
    functions, place = sample_contrasts(count), np.arange(float(count))
    assert np.sum(functions**2, axis=1) == pytest.approx(1.0)
    assert np.abs(functions @ np.stack([np.ones(count), place, place**2], axis=1)) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize(('rho', 'count', 'within'), [
    (0.0, 20, 0.06), (0.3, 15, 0.06), (0.6, 35, 0.06), (0.8, 35, 0.06), (0.9, 100, 0.06), (0.8, 20, 0.1),
    (0.55, 9, 0.06), (0.3, 7, 0.06), (0.7, 12, 0.06), (0.4, 5, 0.2)])
def test_what_drawn_samples_scatter_by(rho, count, within):
    """Each contrast, and the mean; and the mean from what the contrasts scatter by, as a log shows them."""
    values = drawn(rho, count)
    _, each, mean = shown_by(values)
    said = [np.interp(rho, ALIKE, column) for column in scatters(count)[0].T]
    assert each == pytest.approx(said, rel=0.03)
    assert mean == pytest.approx(np.interp(rho, ALIKE, scatters(count)[1]), rel=0.03)
    assert told(each, count, 2 * len(values)) == pytest.approx(mean, rel=within)


def test_half_of_the_dwells_may_have_a_sample_less():
    """Eleven samples or nine, alike by 0.8: held against eleven alone the contrasts of all told three fifths of it."""
    counts = np.repeat([9, 11], 10_000)
    values = {count: drawn(0.8, count, 10_000) for count in (9, 11)}
    neighbours = np.sqrt(np.mean(np.concatenate([np.diff(v, axis=1).ravel() for v in values.values()])**2) / 2.0)
    each = np.concatenate([v @ sample_contrasts(count).T for count, v in values.items()]) / neighbours
    mean = np.sqrt(np.mean([count * v.mean(axis=1).var() for count, v in values.items()])) / neighbours
    each = np.sqrt(np.mean(each**2, axis=0))
    assert told(each, counts, 40_000) == pytest.approx(mean, rel=0.15)
    assert told(each, 11, 40_000) < 0.65 * mean


def test_tails_that_reach_less_far_over_a_dwell_than_from_sample_to_sample_make_nothing_alike():
    """Against each other the contrasts of one dwell tell what is alike; against another measure of the noise's size
    they would tell that measure's share of the tails."""
    assert of_mean(1.2, 1.2, 9, 2000) == pytest.approx(1.2, abs=0.01)
    slow, fast = (float(np.sqrt(np.mean(some**2))) for some in np.split(shown_by(drawn(0.55, 9))[1], [SLOW]))
    assert of_mean(1.2 * slow, 1.2 * fast, 9, 40_000) == pytest.approx(1.2 * of_mean(slow, fast, 9, 40_000), rel=0.01)
    values = drawn(0.55, 9, dof=4.0)
    _, each, mean = shown_by(values)
    assert told(0.9 * each, 9, 2 * len(values)) == pytest.approx(mean, rel=0.06)


@pytest.mark.parametrize(('rho', 'step', 'count'), [
    (0.0, 1.0, 20), (0.5, 2.0, 20), (0.7, 1.0, 20), (0.7, 2.0, 20), (0.8, 2.0, 45), (0.6, 1.0, 9)])
def test_what_is_rounded_off_does_not_pass_for_the_independence_of_samples(rho, step, count):
    """Readings in steps as large as their noise, or twice: taken for samples that are less alike, their means are said
    to be up to twice as certain as they are."""
    zero = np.random.default_rng(3).uniform(-50.0, 50.0, (20_000, 1))
    values = np.rint((drawn(rho, count) + zero) / step) * step - zero
    neighbours, each, mean = shown_by(values)
    share = float(not_rounding(np.array([neighbours]), np.array([step]))[0])
    own = np.diff(drawn(rho, count), axis=1)
    assert share == pytest.approx(np.mean(own**2) / 2.0 / neighbours**2, abs=0.03)
    assert told(each, count, 2 * len(values), share) == pytest.approx(mean, rel=0.1)
    if rho > 0.6:
        assert told(each, count, 2 * len(values)) < 0.9 * mean


def test_readings_without_steps_are_not_rounded():
    assert not_rounding(np.array([1e-9, 0.0]), np.zeros(2)) == pytest.approx([1.0, 1.0])
    assert not_rounding(np.array([1e-7]), np.array([1e-9])) == pytest.approx([1.0], abs=1e-4)


def test_where_contrasts_tell_no_more_the_mean_is_held_to_what_they_tell():
    """Never less than the contrasts, never endless, and of the independent nothing is made."""
    for count in (5, 9, 15, 35, 200):
        assert of_mean(1.0, 1.0, count, 1e6) == pytest.approx(1.0, abs=0.02)
        some, many = (of_mean(1e3, 1.0, count, known) for known in (200, 20_000))
        assert some == many == 1e3
        end = scatters(count)[0][-1]
        slow = float(np.sqrt(np.mean(end[:SLOW]**2)))
        some, many = (of_mean(slow, float(np.sqrt(np.mean(end[SLOW:]**2))), count, known) for known in (200, 20_000))
        assert some < many < 0.6 * scatters(count)[1][-1]
    assert of_mean(2.0, 1.0, 4, 1e6) == 2.0
