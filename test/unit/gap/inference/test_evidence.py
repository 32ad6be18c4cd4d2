"""The closed form of the evidence against integration by brute force."""

import numpy as np
import pytest
from scipy import integrate, stats

from stepdiag_ros.gap.inference.evidence import SIZES, judge, log_mean


def _judge(columns, data, noise_dof=1e9):
    return judge((columns.T @ columns)[None], (columns.T @ data)[None], float(data @ data),
                 float(len(data)), noise_dof)[0]


def test_one_coefficient_against_integration():
    """With the noise known, the factor is the mean over sizes of ∫ N(z; Za, 1) N(a; 0, s²) da / N(z; 0, 1)."""
    rng = np.random.default_rng(3)
    column = rng.normal(size=40)
    data = rng.normal(size=40) + 0.6 * column

    def ratio(a, size):
        gain = a * column @ data - 0.5 * a * a * column @ column
        return np.exp(gain) * stats.norm.pdf(a, scale=size)

    factors = [integrate.quad(ratio, -8.0, 8.0, args=(s,), limit=400, points=[0.0, 0.5])[0]
               for s in SIZES]
    # Known noise is the limit of many degrees of freedom; there the fall is measured against ν + zᵀz.
    found = _judge(column[:, None], data, noise_dof=1e9)
    assert found.log_bayes == pytest.approx(np.log(np.mean(factors)), abs=1e-3)


def test_nothing_costs_and_something_pays():
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(200, 3))
    nothing = [_judge(columns, rng.normal(size=200)).log_bayes for _ in range(50)]
    assert np.mean(nothing) < -1.0
    assert _judge(columns, rng.normal(size=200) + columns @ np.array([1.0, 0.5, 0.0])).log_bayes > 30.0


def test_more_columns_of_no_use_cost_more():
    rng = np.random.default_rng(5)
    wide = rng.normal(size=(300, 20))
    data = rng.normal(size=300) + wide[:, 0]
    assert _judge(wide[:, :1], data).log_bayes > _judge(wide, data).log_bayes


def test_unknown_noise_makes_evidence_humbler():
    rng = np.random.default_rng(7)
    column = rng.normal(size=(60, 1))
    data = 5.0 * (rng.normal(size=60) + 0.8 * column[:, 0])
    assert _judge(column, data, noise_dof=5.0).log_bayes < _judge(column, data, noise_dof=1e9).log_bayes


def test_log_mean():
    assert log_mean([-1000.0, -1000.0]) == pytest.approx(-1000.0)
    assert log_mean([0.0, np.log(3.0)]) == pytest.approx(np.log(2.0))
