"""The record of what the machine did, in memory and shared."""

import numpy as np

from stepdiag_ros.virtual.history import History, SharedHistory
from stepdiag_ros.virtual.motion import point_to_point

A, B, C = np.zeros(3), np.array([0.1, 0.0, 0.0]), np.array([0.1, 0.2, 0.0])


def fill(history):
    history.append(0, A, A, point_to_point(0.0, 1, 1, 1), -1)
    history.append(1_000_000_000, A, B, point_to_point(0.1, 0.1, 1.0, 20.0), 0)
    history.append(5_000_000_000, B, C, point_to_point(0.2, 0.1, 1.0, 20.0), 0)
    return history


def test_where_the_machine_is():
    history = fill(History())
    times = np.array([-5, 500_000_000, 4_900_000_000, 6_000_000_000, 60_000_000_000])
    number, commanded, actual, share = history.locate(times, 0.0)
    assert number.tolist() == [0, 0, 1, 2, 2]
    np.testing.assert_allclose(commanded[:3], [A, A, B], atol=1e-15)
    np.testing.assert_allclose(commanded[4], C)
    assert 0.0 < commanded[3, 1] < 0.2 and 0.0 < share[3] < 1.0
    np.testing.assert_array_equal(actual, commanded)


def test_a_lag_that_was_inherited_dies_out():
    history = History()
    history.append(0, B, B, point_to_point(0.0, 1, 1, 1), 0, lag=np.array([1e-3, 0.0, 0.0]))
    _, _, actual, _ = history.locate(np.array([0, 10_000_000, 1_000_000_000]), 0.01)
    np.testing.assert_allclose(B[0] - actual[:, 0], [1e-3, 1e-3 * np.exp(-1), 0.0], atol=1e-12)


def test_a_reader_follows_the_writer(tmp_path):
    path = tmp_path / 'motion.bin'
    writer = SharedHistory(path, create=True)
    reader = SharedHistory(path)
    assert reader.follow() == 0
    fill(writer)
    assert reader.follow() == 3
    times = np.linspace(0, 8e9, 50).astype(np.int64)
    np.testing.assert_array_equal(reader.locate(times, 0.01)[2], writer.locate(times, 0.01)[2])
    for i in range(200):
        writer.append(10_000_000_000 + i, C, C, point_to_point(0.0, 1, 1, 1), 1)
    assert reader.follow() == 203
    np.testing.assert_array_equal(reader.records, writer.records)
