"""The limits of what a further part will show, on parts that are drawn."""

import numpy as np
import pytest

from stepdiag_ros.gap.summary.further_part import limits


def within(parts, dof, scatter, rng, trials=400):
    """Share of further parts within the limits from ``parts`` others: normal errors of 60 readings, whose size differs
    from part to part by a factor of exp(±scatter)."""
    size = np.exp(scatter * rng.standard_normal((trials, parts + 1)))
    squares = rng.chisquare(60, (trials, parts + 1)) / 60 * size**2
    told = [limits(row[:-1], dof) for row in squares]
    return float(np.mean([low <= row[-1] <= high for row, (low, high) in zip(squares, told, strict=True)]))


@pytest.mark.parametrize('parts', [1, 2, 4, 9])
def test_parts_of_nothing_but_noise_are_within(parts):
    """A binomial of 400 with 0.95 is below 0.91 once in 2000."""
    assert within(parts, 60.0, 0.0, np.random.default_rng(parts)) > 0.91


@pytest.mark.parametrize('parts', [4, 9])
def test_parts_that_differ_widen_them(parts):
    """Parts that differ by a third: their own scatter tells, whatever the forecast believes."""
    assert within(parts, 60.0, 0.33, np.random.default_rng(parts)) > 0.88
    few, many = limits(np.array([1.0, 1.05, 0.95, 1.0]), 60.0), limits(np.array([2.0, 0.5, 1.0, 0.5]), 60.0)
    assert many[1] > 1.5 * few[1] and many[0] < few[0] / 1.5


def test_limits_follow_the_unit_and_zero_stays_zero():
    one, scaled = limits(np.array([1.0, 1.3]), 40.0), limits(np.array([1e-12, 1.3e-12]), 40.0)
    assert scaled == pytest.approx(np.multiply(one, 1e-12))
    assert limits(np.zeros(3), 10.0) == (0.0, 0.0)


def test_with_many_parts_they_are_those_of_chi_square():
    """What c and ν are is known then: an independent way to the same limits."""
    rng = np.random.default_rng(5)
    low, high = limits(rng.chisquare(50, 2000) / 50, 50.0)
    drawn = np.quantile(rng.chisquare(50, 200_000) / 50, [0.025, 0.975])
    assert (low, high) == pytest.approx(tuple(drawn), rel=0.03)
