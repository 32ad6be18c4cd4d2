"""Parts of runs predicted from all other rows, against the same written out."""

import numpy as np
import pytest
from scipy import sparse

from stepdiag_ros.estimate.noise import Whitener
from stepdiag_ros.gap.summary.forecast import HeldOut, Run

UNKNOWNS = 12


@pytest.mark.parametrize('size', [40, 300])
def test_a_forecast_is_that_of_all_rows_written_out(size):
    rng = np.random.default_rng(2)
    runs = []
    for number in range(3):
        root = np.tril(np.triu(rng.standard_normal((size, size)), -4)) + 6.0 * np.eye(size)
        jacobian = rng.standard_normal((size, UNKNOWNS)) * (rng.random((size, UNKNOWNS)) < 0.4)
        jacobian[:, number] = 0.0   # of which this run tells nothing
        runs.append(Run(Whitener.of(np.arange(size) + number * size, root), sparse.csr_array(jacobian),
                        rng.standard_normal(size)))
    # A whole run, the end of another, and of the third nothing.
    none, end = np.zeros(size, bool), np.arange(size) >= size // 2
    parts = [[~none, none, none], [none, end, none]]
    precision = np.diag(rng.uniform(0.1, 1.0, UNKNOWNS))
    held = HeldOut(runs, parts, precision)
    white = np.concatenate([np.linalg.solve(run.whitener.factor, np.column_stack([run.jacobian.toarray(), run.rest]))
                            for run in runs])
    np.testing.assert_allclose(held.size(), np.linalg.norm(white[:, :-1], axis=0), rtol=1e-9)
    for number, part in enumerate(parts):
        mine = np.concatenate(part)
        others, own = white[~mine], white[mine]
        covariance = np.linalg.inv(others[:, :-1].T @ others[:, :-1] + precision)
        expected = covariance @ others[:, :-1].T @ others[:, -1]
        left = own[:, -1] - own[:, :-1] @ expected
        spread = np.eye(len(own)) + own[:, :-1] @ covariance @ own[:, :-1].T
        chi2, said, how_well = held.forecast(number)
        assert chi2 == pytest.approx(left @ np.linalg.solve(spread, left), rel=1e-9)
        np.testing.assert_allclose(said, expected, rtol=1e-8)
        np.testing.assert_allclose(how_well, covariance, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(held.size(number), np.linalg.norm(others[:, :-1], axis=0), rtol=1e-9)
