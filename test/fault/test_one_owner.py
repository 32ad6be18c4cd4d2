"""One namespace, one owner; a description belongs to its calibration; the network is loopback by default."""

import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.ownership import CELL, ControlOwnership, Ownership, ros_domain
from stepdiag_ros.nodes.patience import Patience

#: With a fifth of the samples: how they are taken is tried elsewhere.
DEMO = re.sub(r'(interferometer|psd): 1000\.0', r'\1: 200.0',
              (Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml').read_text(encoding='utf-8'))
#: Fast DDS reads it in the folder where a process starts.
WIDE_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles>
  <participant profile_name="wide" is_default_profile="true">
    <rtps><useBuiltinTransports>true</useBuiltinTransports></rtps>
  </participant>
</profiles></dds>
"""
STEPDIAG = [sys.executable, '-m', 'stepdiag_ros.cli.main']


class Up:
    """``stepdiag up`` in a process of its own; a context manager."""

    def __init__(self, cell: Path, folder: Path, **environment: str):
        self.lines: list[str] = []
        (folder / 'DEFAULT_FASTRTPS_PROFILES.xml').write_text(WIDE_PROFILE, encoding='utf-8')
        self.runtime = folder / 'run'
        self.process = subprocess.Popen(
            [*STEPDIAG, 'up', str(cell), '--bag', str(folder / 'first'), '--runtime', str(self.runtime),
             '--bag-folder', str(folder)], text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=folder, env=os.environ | environment)
        self._reader = threading.Thread(target=lambda: self.lines.extend(self.process.stdout), daemon=True)
        self._reader.start()

    def __enter__(self) -> 'Up':
        patience = Patience(300.0)
        try:
            while not any('calibrate with' in line for line in self.lines):
                assert self.process.poll() is None and not patience.over(), self.lines
                time.sleep(0.1)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_exception) -> None:
        self.process.terminate()
        self.process.wait(60.0)
        self._reader.join()
        self.process.stdout.close()

    def tree(self) -> list[int]:
        """Process ids of all that it has started."""
        found, front = [], [self.process.pid]
        while front:
            one = front.pop()
            for task in Path(f'/proc/{one}/task').glob('*/children'):
                front += [int(word) for word in task.read_text().split()]
            found.append(one)
        return found


@pytest.fixture(scope='module')
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('small') / 'demo.yaml'
    path.write_text(DEMO, encoding='utf-8')
    return path


#: What would widen the network, were it followed.
WIDE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_STATIC_PEERS': '192.0.2.1',
        'FASTDDS_BUILTIN_TRANSPORTS': 'LARGE_DATA'}


@pytest.fixture(scope='module')
def up(module_domain: int, small: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """A cell that was brought up in an environment that opens the network."""
    with Up(small, tmp_path_factory.mktemp('up'), **WIDE) as running:
        yield running


def test_a_second_owner_is_refused_and_the_kernel_frees_what_a_killed_one_held(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '77')
    holder = subprocess.Popen(
        [sys.executable, '-c', 'import time; from stepdiag_ros.nodes.ownership import *; '
                               'o, c = Ownership("/owned", CELL), ControlOwnership("localhost", 5998); '
                               'print("held", flush=True); time.sleep(60)'],
        stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == 'held\n'
        with pytest.raises(StepdiagError, match='/owned is up already in ROS domain 77'):
            Ownership('owned', CELL)
        Ownership('/other', CELL).release()
        monkeypatch.setenv('ROS_DOMAIN_ID', '78')
        Ownership('/owned', CELL).release()
        with pytest.raises(StepdiagError, match='at 127.0.0.1:5998: another sequencer on this computer commands it'):
            ControlOwnership('127.0.0.1', 5998)
        ControlOwnership('127.0.0.1', 5997).release()
    finally:
        holder.kill()
        holder.communicate()
    for same in ('77', '0x4d', '0115'):
        monkeypatch.setenv('ROS_DOMAIN_ID', same)
        assert ros_domain() == '77'
    Ownership('/owned', CELL).release()
    ControlOwnership('127.0.0.1', 5998).release()


def test_a_second_up_is_refused_in_one_line(up, small, tmp_path):
    before = up.tree()
    second = subprocess.run([*STEPDIAG, 'up', str(small), '--most', '9', '--bag', str(tmp_path / 'second')],
                            capture_output=True, text=True, timeout=300.0)
    assert second.returncode == 2
    assert [line for line in second.stderr.splitlines() if 'is up already' in line] == second.stderr.splitlines()
    assert not (tmp_path / 'second').exists() and sorted(up.tree()) == sorted(before)


def test_a_second_cell_in_the_same_runtime_folder_is_refused_before_it_writes(up, small, tmp_path):
    """A restarted node reads there which instruments are its own."""
    before = (up.runtime / 'parameters.yaml').read_bytes()
    second = subprocess.run([*STEPDIAG, 'up', str(small), '--namespace', 'b', '--most', '9',
                             '--runtime', str(up.runtime), '--bag', str(tmp_path / 'second')],
                            capture_output=True, text=True, timeout=300.0)
    assert second.returncode == 2 and 'another cell that is up keeps its parameters there' in second.stderr
    assert (up.runtime / 'parameters.yaml').read_bytes() == before


def test_a_second_sequencer_of_a_namespace_ends_at_once(up):
    second = subprocess.run(
        [sys.executable, '-m', 'stepdiag_ros.nodes.step_sequencer', '--ros-args', '-r', '__ns:=/demo',
         '--params-file', str(up.runtime / 'parameters.yaml'), '-p', 'autostart:=true'],
        capture_output=True, text=True, timeout=300.0)
    assert second.returncode == 2
    assert second.stderr.splitlines()[-1].startswith('stepdiag: /demo is up already in ROS domain')


def test_a_second_sequencer_of_a_control_is_refused_whatever_its_name(up):
    """And the first one keeps the control: the next test calibrates with it."""
    second = subprocess.Popen(
        [sys.executable, '-m', 'stepdiag_ros.nodes.step_sequencer', '--ros-args', '-r', '__ns:=/elsewhere',
         '--params-file', str(up.runtime / 'parameters.yaml'), '-p', 'autostart:=true'],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        said = next(line for line in second.stderr if 'machine control' in line)
        assert 'another sequencer on this computer commands it' in said
    finally:
        second.terminate()
        second.communicate(timeout=60)


def test_a_running_cell_is_calibrated_with_other_steps_and_then_with_its_own(up):
    folder = up.runtime.parent
    for name, more in (('two', ['--steps', '2']), ('own', [])):
        done = subprocess.run([*STEPDIAG, 'calibrate', '/demo', '--setups', 'lin_z', '--bag', str(folder / name),
                               '--dwell', '0.1', '--repeats', '1', '--json', *more],
                              capture_output=True, text=True, timeout=600.0)
        # Measured; one line alone evaluates to "not ok", which is status 1.
        assert done.returncode == 1, done.stdout + done.stderr
        assert json.loads(done.stdout)['evaluation'] is not None
    assert read_log(folder / 'two').description.plan.steps == 2
    assert read_log(folder / 'own').description.plan.steps == 4


def _open_sockets(pids: list[int]) -> list[str]:
    """Addresses of the processes' sockets, of whatever kind, that are not on loopback."""
    mine = set()
    for pid in pids:
        for entry in Path(f'/proc/{pid}/fd').iterdir():
            try:
                mine.add(os.readlink(entry))
            except OSError:
                continue
    found = []
    for kind in ('udp', 'udp6', 'tcp', 'tcp6', 'raw', 'raw6'):
        for line in Path(f'/proc/net/{kind}').read_text().splitlines()[1:]:
            words = line.split()
            if f'socket:[{words[9]}]' in mine and not words[1].startswith('0100007F:'):
                found.append(f'{kind} {words[1]}')
    return found


def test_the_network_is_loopback_whatever_the_environment_says(up):
    """Nodes and virtual instruments; what was not followed is reported."""
    assert len(up.tree()) > 6 and _open_sockets(up.tree()) == []
    assert any(all(f'{name}={value}' in line for name, value in WIDE.items()) for line in up.lines
               if 'not followed' in line), up.lines
    assert any('network: loopback' in line for line in up.lines)


def test_an_open_network_is_said_loudly(ros_domain, tmp_path):
    (cell := tmp_path / 'demo.yaml').write_text(DEMO + '\nnetwork: open\n', encoding='utf-8')
    with Up(cell, tmp_path, ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST', FASTRTPS_DEFAULT_PROFILES_FILE='') as opened:
        assert any('WARNING: the network is OPEN' in line for line in opened.lines), opened.lines
