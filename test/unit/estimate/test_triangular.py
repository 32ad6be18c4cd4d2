"""Triangular equations are those that SciPy solves, by a band or written out."""

import numpy as np
import pytest
from scipy import linalg

from stepdiag_ros.estimate.triangular import Banded, Full, kept


@pytest.mark.parametrize(('size', 'band', 'kind'),
                         [(300, 12, Banded), (300, 300, Full), (40, 5, Full), (257, 1, Banded)])
def test_a_factor_by_its_band_is_the_factor(size, band, kind):
    rng = np.random.default_rng(3)
    root = np.tril(np.triu(rng.standard_normal((size, size)), 1 - band)) + 5.0 * np.eye(size)
    factor = linalg.cholesky(root @ root.T, lower=True)
    found = kept(factor)
    assert type(found) is kind
    np.testing.assert_array_equal(found.factor, factor)
    np.testing.assert_array_equal(found.diagonal, np.diag(factor))
    for right in (rng.standard_normal(size), rng.standard_normal((size, 7))):
        before = right.copy()
        np.testing.assert_allclose(found.forward(right), linalg.solve_triangular(factor, right, lower=True), rtol=1e-9)
        np.testing.assert_allclose(found.backward(right), linalg.solve_triangular(factor, right, lower=True, trans='T'),
                                   rtol=1e-9)
        np.testing.assert_array_equal(right, before)
