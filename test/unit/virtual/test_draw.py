"""Random numbers addressed by seed, stream and index."""

import numpy as np
import pytest

from stepdiag_ros.virtual.draw import normals, uniforms


@pytest.mark.parametrize('columns', [1, 2, 3, 4, 5, 7])
def test_a_draw_does_not_depend_on_the_block_it_is_asked_in(columns):
    whole = normals(5, 'noise', 0, 1000, columns)
    assert whole.shape == (1000, columns)
    np.testing.assert_array_equal(normals(5, 'noise', 317, 200, columns), whole[317:517])
    np.testing.assert_array_equal(normals(5, 'noise', 999, 1, columns), whole[999:])


def test_seeds_and_streams_differ():
    a = normals(5, 'noise', 0, 50)
    assert not np.any(a == normals(6, 'noise', 0, 50))
    assert not np.any(a == normals(5, 'other', 0, 50))


def test_normals_are_normal_and_independent():
    sample = normals(1, 'statistics', 0, 200_000, 2)
    assert abs(sample.mean()) < 0.01
    np.testing.assert_allclose(sample.std(axis=0), 1.0, atol=0.01)
    np.testing.assert_allclose(np.mean(sample ** 4, axis=0), 3.0, atol=0.1)
    assert abs(np.corrcoef(sample.T)[0, 1]) < 0.01
    assert abs(np.corrcoef(sample[1:, 0], sample[:-1, 0])[0, 1]) < 0.01


def test_uniforms_stay_inside():
    sample = uniforms(1, 'u', 0, 100_000)
    assert 0.0 < sample.min() and sample.max() < 1.0
    assert abs(sample.mean() - 0.5) < 0.01
