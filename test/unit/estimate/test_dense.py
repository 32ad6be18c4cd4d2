"""Blocks of a sparse Jacobian and triangular equations, against SciPy's own."""

import numpy as np
import pytest
from scipy import linalg, sparse

from stepdiag_ros.estimate.dense import block_of
from stepdiag_ros.estimate.triangular import forward, whole


def test_a_block_is_its_rows_on_the_columns_that_they_meet():
    rng = np.random.default_rng(3)
    full = rng.standard_normal((30, 40)) * (rng.random((30, 40)) < 0.1)
    full[7] = 0.0
    for rows in np.array([3, 4, 5, 6, 7]), np.array([29, 2, 11]), np.array([7]):
        columns, block = block_of(sparse.csr_array(full), rows)
        np.testing.assert_array_equal(columns, np.flatnonzero(full[rows].any(axis=0)))
        np.testing.assert_array_equal(block, full[np.ix_(rows, columns)])


@pytest.mark.parametrize('shape', [(12,), (12, 1), (12, 5), (12, 0)])
@pytest.mark.parametrize('order', ['C', 'F'])
def test_triangular_equations(shape, order):
    rng = np.random.default_rng(4)
    square = rng.standard_normal((12, 12))
    factor = np.asarray(np.linalg.cholesky(square @ square.T + np.eye(12)), order=order)
    right = rng.standard_normal(shape)
    kept = right.copy()
    np.testing.assert_allclose(forward(factor, right), linalg.solve_triangular(factor, kept, lower=True), atol=1e-12)
    np.testing.assert_allclose(whole(factor, right), linalg.cho_solve((factor, True), kept), atol=1e-12)
    np.testing.assert_array_equal(right, kept)


def test_a_factor_without_an_inverse_is_an_error():
    with pytest.raises(linalg.LinAlgError, match='diagonal is zero'):
        forward(np.diag([1.0, 0.0, 1.0]), np.ones(3))
