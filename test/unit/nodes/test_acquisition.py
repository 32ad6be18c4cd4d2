"""The acquisition's thread: blocks in order, commands between them, lost and found again."""

import os
import threading
import time
from dataclasses import dataclass

import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.nodes import acquisition
from stepdiag_ros.nodes.acquisition import Acquisition
from stepdiag_ros.nodes.patience import Patience

PERIOD_S = 1e-3


@dataclass
class Block:
    stamp_ns: int
    period_s: float
    samples: int


class Instrument:
    """Ten samples a block; fails when told to."""

    def __init__(self):
        self.stamp_ns, self.broken, self.connects, self.skip_ns = 0, False, 0, 0
        self.unforeseen = None

    def connect(self):
        self.connects += 1
        if self.broken:
            raise DeviceError('interferometer at x:1: cannot connect')

    def close(self):
        pass

    def read_block(self):
        time.sleep(0.001)
        if self.unforeseen is not None:
            raise self.unforeseen
        if self.broken:
            raise DeviceError('interferometer at x:1: stalls')
        stamp = self.stamp_ns + self.skip_ns
        self.skip_ns = 0
        self.stamp_ns = stamp + 10_000_000
        return Block(stamp, PERIOD_S, 10)


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr(acquisition, 'RETRY_S', 0.01)
    instrument, blocks, said = Instrument(), [], []
    work = Acquisition(instrument, instrument.read_block, lambda b: b.samples, blocks.append, said.append)
    work.start()
    yield work, instrument, blocks, said
    work.stop()


def wait_for(condition) -> None:
    patience = Patience(20)
    while not condition():
        assert not patience.over()
        time.sleep(0.002)


def test_blocks_follow_each_other_without_a_gap(bench):
    work, _, blocks, _ = bench
    wait_for(lambda: len(blocks) > 5)
    work.stop()
    assert work.samples == 10 * work.blocks == 10 * len(blocks) and work.gaps == 0
    stamps = [b.stamp_ns for b in blocks]
    assert stamps == list(range(0, 10_000_000 * len(stamps), 10_000_000))


def test_a_command_runs_in_the_thread_between_blocks(bench):
    work, _, blocks, _ = bench
    wait_for(lambda: blocks)
    assert work.call(lambda: threading.current_thread().name).result(10) == 'acquisition'


def test_missing_time_is_counted(bench):
    work, instrument, blocks, _ = bench
    wait_for(lambda: len(blocks) > 2)
    instrument.skip_ns = 5_000_000
    wait_for(lambda: work.gaps)
    assert work.gaps == 1 and work.gap_s == pytest.approx(0.005)


def test_a_lost_instrument_is_said_and_found_again(bench):
    work, instrument, blocks, said = bench
    wait_for(lambda: blocks)
    instrument.broken = True
    wait_for(lambda: instrument.connects > 1)
    assert 'cannot connect' in work.error and 'stalls; trying to connect again' in said[0]
    with pytest.raises(DeviceError):
        work.call(lambda: None).result(10)
    instrument.broken = False
    count = len(blocks)
    wait_for(lambda: len(blocks) > count)
    assert work.reconnects == 1 and not work.error and said[-1] == 'connected again'


def test_a_stopped_acquisition_refuses_commands(bench):
    work, *_ = bench
    work.stop()
    with pytest.raises(DeviceError, match='not active'):
        work.call(lambda: None).result(10)


@pytest.mark.parametrize('error', [KeyError('x'), RecursionError('too deep'), MemoryError(), ValueError('two\nlines'),
                                   AttributeError("'NoneType' object has no attribute 'get'")])
def test_what_nobody_foresaw_is_a_line_and_sampling_goes_on(bench, error):
    work, instrument, blocks, said = bench
    wait_for(lambda: blocks)
    instrument.unforeseen = error
    wait_for(lambda: work.error)
    assert type(error).__name__ in work.error and 'test_acquisition.py:' in work.error and '\n' not in work.error
    instrument.unforeseen, count = None, len(blocks)
    wait_for(lambda: len(blocks) > count)
    assert work.running and not work.error and [line.split(';')[-1] for line in said] == [
        ' trying to connect again', 'connected again']


def test_a_command_that_nobody_foresaw_to_fail_is_refused_and_sampling_goes_on(bench):
    work, _, blocks, _ = bench
    wait_for(lambda: blocks)
    with pytest.raises(DeviceError, match='ZeroDivisionError'):
        work.call(lambda: 1 // 0).result(10)
    count = len(blocks)
    wait_for(lambda: len(blocks) > count)
    assert work.running


def test_a_fault_that_comes_again_and_again_is_reported_once(bench):
    work, instrument, blocks, said = bench
    wait_for(lambda: blocks)
    instrument.unforeseen = KeyError('x')
    wait_for(lambda: instrument.connects > 4)
    assert len(said) == 1


def test_it_says_whether_the_system_lets_it_go_first(bench):
    work, _, blocks, _ = bench
    wait_for(lambda: blocks)
    assert work.real_time == (os.sched_getscheduler(work._thread.native_id) == os.SCHED_RR)
