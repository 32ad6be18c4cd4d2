"""From a cell file to a moving machine as `ros2 launch` starts it: parameter file, default namespace, autostart."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.nodes.graph import NODES
from stepdiag_ros.nodes.operator import Operator
from stepdiag_ros.virtual.cell_process import CellProcess
from test.some import some

STEPDIAG = [sys.executable, '-m', 'stepdiag_ros.cli.main']


class Launched:
    """The nodes as `ros2 launch` keeps them: what dies is started again after a second, with the very same command."""

    def __init__(self, parameters: str):
        # What `launch_ros` passes to each node of launch/cell.launch.py.
        options = ['--ros-args', '-r', '__ns:=/cell1', '--params-file', parameters, '-p', 'autostart:=true']
        self._commands = {name: [sys.executable, '-c', f'import sys; from stepdiag_ros.start import {name}; '
                                 f'sys.exit({name}())', *options] for name in NODES}
        self.nodes = {name: self._start(name) for name in NODES}
        self._died_s: dict[str, float] = {}

    def _start(self, name: str) -> subprocess.Popen:
        return subprocess.Popen(self._commands[name], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def watch(self) -> None:
        for name, node in self.nodes.items():
            if node.poll() is not None and time.monotonic() > self._died_s.setdefault(name, time.monotonic()) + 1.0:
                self.nodes[name] = self._start(name)
                del self._died_s[name]

    def __enter__(self) -> 'Launched':
        return self

    def __exit__(self, *_exception) -> None:
        for node in self.nodes.values():
            node.send_signal(signal.SIGINT)
        for node in self.nodes.values():
            node.wait(300)


@pytest.mark.timeout(600)
def test_nodes_started_as_by_launch_calibrate_the_machine(ros_domain: int, cell_file: Path, tmp_path: Path) -> None:
    runtime = tmp_path / 'run'
    runtime.mkdir()
    with CellProcess(cell_file, runtime) as instruments:
        instruments.start()
        done = subprocess.run([*STEPDIAG, 'parameters', str(cell_file), '--runtime', str(runtime), '--bag-folder',
                               str(tmp_path)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        with Launched(done.stdout.strip()):
            made = subprocess.run([*STEPDIAG, 'calibrate', '/cell1', '--setups', 'lin_x', '--bag',
                                   str(tmp_path / 'log')], capture_output=True, text=True, timeout=400)
    # Measured as asked; that one line alone evaluates to "not ok" is said by the status.
    assert made.returncode == 1, made.stderr + made.stdout
    assert made.stdout.startswith('succeeded: 4 stops in 2 runs')
    assert (tmp_path / 'log' / 'metadata.yaml').is_file()


def test_without_a_cell_that_runs_the_command_says_how_to_start_one(cell_file: Path, tmp_path: Path) -> None:
    done = subprocess.run([*STEPDIAG, 'parameters', str(cell_file), '--runtime', str(tmp_path)], capture_output=True,
                          text=True)
    assert done.returncode == 2 and 'cell_process' in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.mark.timeout(900)
@pytest.mark.parametrize('node', some('interferometer_driver', later=['recorder', 'step_sequencer']))
def test_a_calibration_goes_on_where_a_node_that_launch_started_dies(ros_domain: int, tmp_path: Path, write_cell,
                                                                     repeated, eventually, node: str) -> None:
    runtime, cell = tmp_path / 'run', write_cell(tmp_path, dwell=0.5)
    runtime.mkdir()
    with CellProcess(cell, runtime) as instruments:
        instruments.start()
        parameters = subprocess.run([*STEPDIAG, 'parameters', str(cell), '--runtime', str(runtime), '--bag-folder',
                                     str(tmp_path)], capture_output=True, text=True, check=True).stdout.strip()
        killed = []
        with Launched(parameters) as launched, Operator('/cell1') as operator:
            for name in NODES:
                operator.bring(name, 'active', 300.0)
            bag = eventually(lambda: operator.recorder and operator.recorder.bag)

            def kill(feedback) -> None:
                # In the first of the two runs, so that there is one to be broken off however late this comes.
                if feedback.stop >= 2 and not killed:
                    killed.append(feedback.run_id)
                    launched.nodes[node].kill()
            outcome = operator.calibrate(setups=['ppp'], feedback=kill, meanwhile=launched.watch)
            assert operator.recorder.bag == bag
    assert killed and outcome.succeeded, outcome.message
    again = repeated(outcome.run_ids, ['ppp/0/+', 'ppp/0/-'])
    assert again
    log = read_log(bag)
    for run in again:
        said = f'run {run.rpartition("/")[0]} was broken off and repeated as {run};'
        assert any(w.startswith(said) for w in log.warnings), log.warnings
    assert len(open_bag(Path(bag)).files) == (2 if node == 'recorder' else 1)
    assert not list(tmp_path.glob('.*.recording'))     # the mark goes with the writer
