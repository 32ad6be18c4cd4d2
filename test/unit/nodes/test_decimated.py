"""Means for plots: about twenty a second whatever the blocks, and never across a hole."""

import numpy as np
import pytest

from stepdiag_ros.nodes.decimated import Decimator, mean

SECOND = 1_000_000_000


@pytest.mark.parametrize(('rate', 'block'), [(1000, 50), (1000, 1), (1000, 7), (200, 10), (20_000, 100), (5, 1)])
def test_about_twenty_a_second_and_every_sample_once(rate, block):
    decimator, seen, times = Decimator(), [], []
    number = 3 * rate // block
    for i in range(number):
        samples = np.arange(i * block, (i + 1) * block, dtype=float)[:, None]
        enough = decimator.add(round(i * block / rate * SECOND), 1.0 / rate, samples)
        if enough is not None:
            times.append(enough[0])
            seen.append(enough[1][:, 0])
    assert len(seen) <= 3 * 20 + 1
    whole = np.concatenate(seen)
    np.testing.assert_array_equal(whole, np.arange(len(whole)))
    assert number * block - len(whole) < max(block, rate / 20 + block)
    for time, samples in zip(times, seen, strict=True):    # the stamp is the middle: the mean sample's own time
        assert time == pytest.approx(samples.mean() / rate * SECOND, abs=2)


def test_a_block_that_is_a_sample_short_is_a_mean_all_the_same():
    decimator = Decimator()
    means = [decimator.add(i * SECOND // 20, 0.001, np.full((49 if i % 2 else 50, 1), float(i))) for i in range(40)]
    assert [enough[1].mean() for enough in means] == list(range(40))


def test_what_comes_after_a_hole_is_no_mean_with_what_was_before_it():
    decimator = Decimator()
    assert decimator.add(0, 0.001, np.zeros((20, 1))) is None
    assert decimator.add(2 * SECOND, 0.001, np.ones((20, 1))) is None
    assert decimator.add(2 * SECOND + 20_000_000, 0.001, np.ones((40, 1)))[1].min() == 1.0
    assert decimator.add(SECOND, 0.001, np.full((50, 1), 2.0))[1].min() == 2.0    # the clock was set back


def test_the_mean_of_nothing_is_no_number():
    assert np.isnan(mean(np.array([np.nan, np.nan]))) and mean(np.array([np.nan, 2.0, 4.0])) == 3.0
