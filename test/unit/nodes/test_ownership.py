"""Who is up on this computer, and how many machines it may carry."""

from pathlib import Path

import pytest

from stepdiag_ros.cli.main import main
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.bringup import (
    MACHINE_BYTES,
    MACHINES_A_PROCESSOR,
    SHARED_BYTES,
    SHARING_A_PROCESSOR,
    free_bytes,
    machines_carried,
    refuse_too_many,
)
from stepdiag_ros.nodes.ownership import CELL, SEQUENCER, Ownership, machines_up

CELLS = Path(__file__).resolve().parents[3] / 'cells'


@pytest.fixture
def domain(monkeypatch, tmp_path):
    """A domain that no graph has; the marks need none."""
    monkeypatch.setenv('ROS_DOMAIN_ID', f'test-{tmp_path.name}')


def test_machines_that_are_up_are_known_by_their_marks(domain, monkeypatch):
    assert machines_up() == []
    owned = [Ownership('/b', CELL), Ownership('/a', CELL), Ownership('/a', SEQUENCER)]
    try:
        assert machines_up() == ['/a', '/b']
        monkeypatch.setenv('ROS_DOMAIN_ID', 'another')
        assert machines_up() == []
    finally:
        for mark in owned:
            mark.release()


def test_more_machines_than_the_computer_carries_are_refused(domain):
    refuse_too_many(2, 2, 'hall.yaml')
    mark = Ownership('/a', CELL)
    try:
        with pytest.raises(StepdiagError, match='hall.yaml: 2 machines beside 1 that are up are more than the 2 that'):
            refuse_too_many(2, 2, 'hall.yaml')
    finally:
        mark.release()


def test_the_limit_is_that_of_processors_or_memory(domain, monkeypatch):
    monkeypatch.setattr('os.sched_getaffinity', lambda _process: set(range(16)))
    for free, carried in ((64 << 30, 32), (4 << 30, 8), (100 << 20, 1)):    # 4 GiB: docs/bench/hall.md
        monkeypatch.setattr('stepdiag_ros.nodes.bringup.free_bytes', lambda free=free: free)
        assert machines_carried(sharing=True) == carried
    mark = Ownership('/a', CELL)
    try:
        monkeypatch.setattr('stepdiag_ros.nodes.bringup.free_bytes', lambda: SHARED_BYTES + MACHINE_BYTES)
        assert machines_carried() == 2     # the one that is up has its memory already
    finally:
        mark.release()


def test_free_memory_is_read_as_the_kernel_writes_it(tmp_path):
    (tmp_path / 'meminfo').write_text('MemTotal:       16384 kB\nMemFree:  512 kB\nMemAvailable:    2048 kB\n')
    assert free_bytes(tmp_path / 'meminfo') == 2 << 20
    assert free_bytes() > 0


def test_the_limit_grows_with_the_processors(monkeypatch):
    monkeypatch.setattr('os.sched_getaffinity', lambda _process: {0, 1, 2})
    monkeypatch.setattr('stepdiag_ros.nodes.bringup.free_bytes', lambda: 64 << 30)
    assert machines_carried() == 3 * MACHINES_A_PROCESSOR
    assert machines_carried(sharing=True) == 3 * SHARING_A_PROCESSOR > machines_carried()


@pytest.mark.parametrize('command', [['hall', str(CELLS / 'hall.yaml'), '--most', '3'],
                                     ['up', str(CELLS / 'multiplex.yaml'), '--most', '1']])
def test_the_commands_refuse_before_anything_is_started(domain, capsys, command):
    assert main(command) == 2
    assert 'that this computer carries' in capsys.readouterr().err
