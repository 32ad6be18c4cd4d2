"""Stamps after a step of the clock are brought back; a publisher that began anew is not mistaken for another."""

import numpy as np

from stepdiag_ros.bag.check import lost_messages
from stepdiag_ros.bag.clocksteps import ClockStep, shift_ns
from stepdiag_ros.bag.schemas import TOPICS
from stepdiag_ros.bag.tables import Group, TopicTable

SECOND = 1_000_000_000


def test_stamps_after_a_step_are_brought_back():
    true = np.arange(10) * SECOND // 10 + 1_000 * SECOND
    stamp = true.copy()
    stamp[4:] -= 5 * SECOND
    stamp[7:] += 3600 * SECOND
    steps = [ClockStep('t', int(stamp[4]), -5 * SECOND, 104), ClockStep('t', int(stamp[7]), 3600 * SECOND, 107)]
    sequence, number = np.arange(10) + 101, np.arange(10)
    np.testing.assert_array_equal(stamp + shift_ns(stamp, sequence, number, steps), true)
    # In any order of rows, and where the message after the step was lost.
    rows = np.random.default_rng(1).permutation(10)
    got = stamp[rows] + shift_ns(stamp[rows], sequence[rows], number[rows], steps)
    np.testing.assert_array_equal(got, true[rows])
    kept = np.delete(np.arange(10), 4)
    got = stamp[kept] + shift_ns(stamp[kept], sequence[kept], number[kept], steps)
    np.testing.assert_array_equal(got, true[kept])


def test_a_publisher_that_began_anew_is_told_by_the_time():
    true = np.arange(12) * SECOND + 1_000 * SECOND
    sequence = np.array([1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6])     # started again after six messages
    stamp = true.copy()
    stamp[9:] += 60 * SECOND
    steps = [ClockStep('t', int(stamp[9]), 60 * SECOND, 3)]
    np.testing.assert_array_equal(stamp + shift_ns(stamp, sequence, np.arange(12), steps), true)


def test_without_steps_nothing_is_touched():
    stamp = np.array([3, 1, 2], np.int64)
    assert not shift_ns(stamp, np.arange(3), np.arange(3), []).any()


def _announced(*messages: tuple[str, int]) -> TopicTable:
    """A table of `clock_step` with these nodes' messages, each with the node's own count, in the order of the log."""
    nodes, counts = zip(*messages, strict=True)
    sequence = np.array(counts)
    return TopicTable('/m/clock_step', TOPICS['clock_step'], count=len(messages), sequences=[sequence], groups=[
        Group({'header.frame_id': np.array(nodes, 'S')}, np.arange(len(messages)), sequence)])


def test_nodes_that_announce_at_the_same_time_lose_nothing_of_each_other():
    """Each announces for every topic that it publishes, and counts these messages itself."""
    assert lost_messages(_announced(('psd', 1), ('laser', 1), ('laser', 2), ('laser', 3), ('psd', 2), ('laser', 4),
                                    ('psd', 3), ('laser', 5))) == 0
    assert lost_messages(_announced(('psd', 1), ('laser', 1), ('laser', 4), ('psd', 2))) == 2
