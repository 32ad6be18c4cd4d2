"""Nodes with nothing to do hold what they hold: minutes of samples that belong to no run leave no memory behind.

An hour of it stands in docs/bench/soak.md.
"""

import time
from pathlib import Path

import pytest

from stepdiag_ros.nodes.bringup import Bringup

WARM_S, WATCHED_S = 60.0, 120.0
MOST_MIB_A_MINUTE = 0.5
"""A history that grew with the samples took 2.6 MiB a minute of each listener."""
NODES = ('evaluation_solver', 'gap_monitor', 'recorder', 'interferometer_driver', 'psd_driver', 'step_sequencer')


def anonymous_mib(pid: int) -> float:
    """What a process holds of its own; files and shared memory may come in later, once."""
    lines = Path(f'/proc/{pid}/status').read_text(encoding='ascii').splitlines()
    return int(next(line for line in lines if line.startswith('RssAnon:')).split()[1]) / 1024.0


def growth(pids: dict[str, int]) -> dict[str, float]:
    """What each node grows by [MiB a minute]."""
    time.sleep(WARM_S)
    before = {name: anonymous_mib(pids[name]) for name in NODES}
    began = time.monotonic()
    time.sleep(WATCHED_S)
    minutes = (time.monotonic() - began) / 60.0
    return {name: (anonymous_mib(pids[name]) - before[name]) / minutes for name in NODES}


@pytest.mark.long
def test_the_memory_of_idle_nodes_is_flat(ros_domain, tmp_path, write_cell):
    cell_file = write_cell(tmp_path)
    text = cell_file.read_text(encoding='utf-8')
    assert 'interferometer: 200.0, psd: 200.0' in text
    cell_file.write_text(text.replace('200.0', '1000.0'), encoding='utf-8')
    with Bringup(cell_file, bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        grown = growth(cell.pids())
    assert max(grown.values()) < MOST_MIB_A_MINUTE, grown
