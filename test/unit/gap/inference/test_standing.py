"""Arrivals that several runs share: against the covariance of all readings written out."""

import numpy as np
import pytest

from stepdiag_ros.estimate.dense import weighted
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.noise import arrivals, run_covariance
from stepdiag_ros.estimate.standing import standing_arrivals, with_standing


@pytest.fixture(scope='module')
def observed(case):
    return case.observe()


def test_a_run_backwards_begins_on_the_arrivals_that_the_run_forwards_ended_on(observed):
    table = observed.table
    numbers = standing_arrivals(table)
    forwards, backwards = (np.flatnonzero((table.setup == 0) & (table.repeat == table.repeat.min())
                                          & (table.direction == d)) for d in (1, -1))
    assert np.array_equal(numbers[forwards[-1]], numbers[backwards[0]])
    assert np.array_equal(np.diff(numbers[forwards], axis=0) != 0, np.diff(arrivals(table)[forwards], axis=0) != 0)


def test_the_covariance_is_that_of_readings_that_share_arrivals(observed):
    table, fit = observed.table, observed.fit
    plain = solution_of(fit, table)
    found = with_standing(plain, fit, table).covariance - plain.covariance
    rows = np.arange(len(table))
    shared, apart = (run_covariance(rows, fit.noise.position, 0.0, np.zeros_like(fit.residual), fit.arrival, numbers)
                     for numbers in (standing_arrivals(table), arrivals(table)))
    jacobian = fit.jacobian.toarray()
    gain = fit.covariance @ np.stack([weighted(column, fit.whiteners) for column in jacobian.T])
    parameters = fit.parameters
    _, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    expected = reporting @ gain @ (shared - apart) @ gain.T @ reporting.T
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    straight = [i for i, (name, k) in enumerate(plain.names) if name == 'EZY' and k > 0]
    assert np.all(np.diag(found)[straight] > 0.0)
