"""What a set explains, grown member by member, is what the whole covariance says."""

import numpy as np

from stepdiag_ros.gap.inference.explained import Explained

M = 60


def test_growing_is_the_inverse_of_the_whole_covariance():
    rng = np.random.default_rng(4)
    data, parts = rng.normal(size=M), [10.0**power * rng.normal(size=(M, k)) for power, k in ((0, 2), (2, 3), (1, 4))]
    found = Explained.nothing(data)
    for part in parts:
        found = found.and_then(part)
    whole = np.concatenate(parts, axis=1)
    inverse = np.linalg.inv(np.eye(M) + whole @ whole.T)
    np.testing.assert_allclose(np.eye(M) - found.basis @ found.basis.T, inverse, atol=1e-9)
    np.testing.assert_allclose(found.total, data @ inverse @ data, rtol=1e-9)
    more = rng.normal(size=(M, 2))
    np.testing.assert_allclose(found.freed(more), inverse @ more, atol=1e-9)


def test_coefficients_beside_others_are_those_of_all_at_once():
    rng = np.random.default_rng(5)
    data, others, mine = rng.normal(size=M), 3.0 * rng.normal(size=(M, 4)), 50.0 * rng.normal(size=(M, 2))
    values, covariance = Explained.nothing(data).and_then(others).coefficients(mine)
    whole = np.concatenate([mine, others], axis=1)
    posterior = np.linalg.inv(np.eye(6) + whole.T @ whole)
    np.testing.assert_allclose(values, (posterior @ whole.T @ data)[:2], atol=1e-9)
    np.testing.assert_allclose(covariance, posterior[:2, :2], atol=1e-12)


def test_coefficients_of_what_was_grown_are_those_of_all_at_once():
    rng = np.random.default_rng(6)
    data, parts = rng.normal(size=M), [30.0 * rng.normal(size=(M, k)) for k in (2, 3, 1)]
    found = Explained.nothing(data)
    for part in parts:
        found = found.and_then(part)
    whole = np.concatenate(parts, axis=1)
    posterior = np.linalg.inv(np.eye(6) + whole.T @ whole)
    np.testing.assert_allclose(found.within(parts[1]), (posterior @ whole.T @ data)[2:5], atol=1e-9)


def test_what_is_far_below_the_noise_is_left_out():
    found = Explained.nothing(np.ones(M)).and_then(np.full((M, 1), 0.1 / np.sqrt(M)))
    assert found.basis.shape == (M, 0)
