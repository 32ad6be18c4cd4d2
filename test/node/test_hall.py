"""A hall with real processes: machines share one laser, one dies in the middle, the others finish."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.nodes.hall import MACHINE_NODES, Hall
from stepdiag_ros.nodes.patience import Patience

NAMES = ('a', 'b', 'c')
NODES = tuple(name for name in MACHINE_NODES if name != 'gap_monitor')
LEASE_S = 10.0    # of the light; a client's is longer still: other tests keep the computer busy


@pytest.fixture
def hall(ros_domain, tmp_path, write_cell):
    cell = write_cell(tmp_path, 'tiny', dwell=0.3)
    cell.write_text(cell.read_text(encoding='utf-8') + 'client: {lease: 60.0}\n', encoding='utf-8')
    machines = ''.join(f'  - {{cell: tiny.yaml, name: {name}, seed: {n}}}\n' for n, name in enumerate(NAMES))
    file = tmp_path / 'hall.yaml'
    file.write_text(f'schema: 1\nlease: {LEASE_S}\nmachines:\n{machines}', encoding='utf-8')
    said: list[str] = []
    with Hall(file, bag_folder=tmp_path / 'bags', runtime=tmp_path / 'run', nodes=NODES, say=said.append) as running:
        running.said = said
        yield running


def values(hall: Hall) -> dict[str, str]:
    health = hall.source.operator.health('multiplexer')
    return {} if health is None else {v.key: v.value for v in health.values}


def test_one_machine_dies_in_the_middle_and_the_others_finish(hall, tmp_path, eventually):
    command = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'calibrate', '--all', '--json'],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    ended = threading.Event()
    answer: list[str] = []
    threading.Thread(target=lambda: (answer.extend(command.communicate()), ended.set()), daemon=True).start()
    sequencer = hall.machines['a'].pids()['step_sequencer']
    # In the middle: it has the light for a run (the look before the start is one grant a machine).
    eventually(lambda: values(hall).get('holder') == 'a' and int(values(hall)['grants']) > len(NAMES), 120.0,
               lambda: (values(hall), answer))
    os.kill(sequencer, signal.SIGSTOP)     # hangs: it neither measures nor gives the light back
    stopped_s = time.monotonic()
    eventually(lambda: values(hall).get('holder') != 'a', LEASE_S + 20.0)
    back_s = time.monotonic() - stopped_s
    for pid in hall.machines['a'].pids().values():
        os.kill(pid, signal.SIGKILL)
    patience = Patience(180.0)
    while not ended.is_set() and not patience.over():
        hall.watch()
        time.sleep(0.1)
    assert ended.is_set(), values(hall)
    results = json.loads(answer[0])
    assert {name: results[f'/{name}']['outcome'] for name in 'bc'} == {'b': 'succeeded', 'c': 'succeeded'}, answer
    assert results['/a']['outcome'] != 'succeeded' and command.returncode == 1
    assert 'a' in hall.lost and any('given up, the others go on' in text for text in hall.said)
    # The diagnostics come once a second; the lease itself is looked at fifty times a second.
    assert back_s < LEASE_S + 5.0
    for name in 'bc':
        log = read_log(results[f'/{name}']['bag'])
        assert len(set(log.steps.run)) >= 4 and log.namespace == f'/{name}'
        # A sample that was answered late has no quality.
        assert not [w for w in log.warnings if 'dwell' in w and 'signal quality' not in w]
