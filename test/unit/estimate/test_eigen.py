"""Eigenvalues, also where LAPACK's divide and conquer gives up."""

import numpy as np
import pytest

from stepdiag_ros.estimate.eigen import eigen


def drawn(*shape: int) -> np.ndarray:
    half = np.random.default_rng(2).normal(size=(*shape, shape[-1]))
    return half + np.swapaxes(half, -1, -2)


@pytest.mark.parametrize('shape', [(5,), (3, 4)])
def test_what_does_not_converge_is_found_all_the_same(monkeypatch, shape):
    matrix = drawn(*shape)
    value, vector = eigen(matrix)
    np.testing.assert_allclose(vector * value[..., None, :] @ np.swapaxes(vector, -1, -2), matrix, atol=1e-12)

    def gives_up(*_):
        raise np.linalg.LinAlgError('Eigenvalues did not converge')

    monkeypatch.setattr(np.linalg, 'eigh', gives_up)
    slow, vector = eigen(matrix)
    np.testing.assert_allclose(slow, value, atol=1e-12)
    np.testing.assert_allclose(vector * slow[..., None, :] @ np.swapaxes(vector, -1, -2), matrix, atol=1e-12)
