"""A node dies and comes back; a calibration loses its driver; Ctrl-C leaves nothing."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.bringup import Bringup
from stepdiag_ros.nodes.environment import NETWORK, SCOPE, free_domain


def test_a_node_that_dies_is_started_again_and_that_is_said(ros_domain, cell_file, tmp_path, eventually):
    said = []
    with Bringup(cell_file, bag=tmp_path / 'log', runtime=tmp_path / 'run', say=said.append) as cell:
        assert cell.watch() == []
        assert (tmp_path / '.tiny.recording').is_file()     # beside its bag, wherever the cell was started from
        before = cell.pids()
        for node in ('psd_driver', 'recorder'):
            os.kill(before[node], signal.SIGKILL)
            eventually(lambda node=node: cell.watch() == [node])
            assert cell.operator.state(node) == 'active'
            assert cell.pids()[node] != before[node]
        assert any('psd_driver was killed by signal 9; starting it again' in text for text in said)
        assert any('log is torn; it is mended' in text for text in said)
        assert cell.restarts == 2
        # The whole graph works again, and the bag is whole.
        eventually(lambda: cell.operator.recorder.file == 1)
        assert cell.operator.calibrate(setups=['lin_x']).succeeded
        pids = cell.pids()
    assert len(read_log(tmp_path / 'log').steps) == 12
    assert not [pid for pid in pids.values() if Path(f'/proc/{pid}').exists()]


def test_a_node_that_comes_back_has_the_parameters_that_were_set(cell, eventually):
    for seconds in (21.0, 22.0):
        cell.operator.set_parameters('step_sequencer', {'ready_timeout': seconds})
        os.kill(cell.pids()['step_sequencer'], signal.SIGKILL)
        eventually(lambda: cell.watch() == ['step_sequencer'])
        assert cell.operator.parameters('step_sequencer', ['ready_timeout']) == [seconds]


def test_a_driver_that_dies_in_a_run_and_is_not_waited_for_ends_it(cell):
    bag, killed = cell.runtime.parent / 'ended', threading.Event()
    cell.operator.new_log(str(bag))
    cell.operator.set_parameters('step_sequencer', {'resume_timeout': 0.0})

    def kill(feedback) -> None:
        if feedback.stop >= 1 and not killed.is_set():
            killed.set()
            os.kill(cell.pids()['interferometer_driver'], signal.SIGKILL)
    # One setup alone: a kill at the very change to another would do no harm.
    outcome = cell.operator.calibrate(setups=['ppp'], dwell_s=2.0, feedback=kill, meanwhile=cell.watch)
    assert killed.is_set() and outcome.how == 'aborted'
    assert 'interferometer' in outcome.message and outcome.stops < 8
    cell.operator.bring('recorder', 'inactive')
    assert len(read_log(bag).steps) > 0


def test_ctrl_c_leaves_no_process_and_a_whole_bag(ros_domain, cell_file, tmp_path, eventually):
    run = tmp_path / 'run'
    up = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'up', str(cell_file), '--bag',
                           str(tmp_path / 'log'), '--runtime', str(run)], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True)
    try:
        lines = []
        reader = threading.Thread(target=lambda: lines.extend(up.stdout), daemon=True)
        reader.start()
        eventually(lambda: any('calibrate with' in line for line in lines), 120)
        assert up.poll() is None
        from stepdiag_ros.nodes.operator import Operator
        with Operator('/tiny') as operator:
            assert operator.calibrate(setups=['lin_x']).succeeded
        children = _children(up.pid)
        assert len(children) >= 6
        up.send_signal(signal.SIGINT)
        assert up.wait(60) == 0
        reader.join(10)
    finally:
        if up.poll() is None:
            up.kill()
            up.wait()
        up.stdout.close()
    assert any('all processes have ended' in line for line in lines)
    assert not [pid for pid in children if Path(f'/proc/{pid}').exists()]
    log = read_log(tmp_path / 'log')
    assert len(log.steps) == 12 and not [w for w in log.warnings if 'recover' in w or 'metadata' in w]


def test_a_cell_file_with_an_error_is_one_line_and_nothing_is_started(tmp_path):
    path = tmp_path / 'bad.yaml'
    path.write_text('schema: 1\nmachine: {name: m, volume: [0.1, 0.1, 0.1]}\nplan: {steps: 0}\n'
                    'setups:\n  ppp: {standoff: 0.2}\n', encoding='utf-8')
    with pytest.raises(StepdiagError, match=r'bad\.yaml.*steps'):
        Bringup(path)


SCOPE_PROBE = """
import os, sys
from stepdiag_ros.nodes import environment
environment.prepare()                    # as importing a node does
print(environment.prepare(sys.argv[1]))
print(sorted((k, v) for k, v in os.environ.items() if k in environment.NETWORK and v))
"""


@pytest.mark.parametrize(('scope', 'said', 'kept'), [
    ('loopback', 'not followed: ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, ROS_STATIC_PEERS=192.0.2.1',
     'fastdds_loopback.xml'),
    ('open', 'WARNING: the network is OPEN', "('ROS_STATIC_PEERS', '192.0.2.1')")])
def test_the_cell_says_how_far_the_network_goes(scope, said, kept):
    bare = {k: v for k, v in os.environ.items() if k not in NETWORK and k != SCOPE}
    out = subprocess.run([sys.executable, '-c', SCOPE_PROBE, scope], capture_output=True, text=True, check=True,
                         env=bare | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_STATIC_PEERS': '192.0.2.1'}).stdout
    assert said in out and kept in out
    assert ('192.0.2.1' in out.splitlines()[1]) == (scope == 'open')


def test_a_free_domain_is_one_that_nobody_uses():
    assert free_domain() in range(1, 100)


def _children(pid: int) -> list[int]:
    """All descendants of a process."""
    found, front = [], [pid]
    while front:
        parent = front.pop()
        for task in Path(f'/proc/{parent}/task').glob('*/children'):
            front += [int(word) for word in task.read_text().split()]
        found += front[len(front):]
        found.append(parent)
    return [one for one in found if one != pid]
