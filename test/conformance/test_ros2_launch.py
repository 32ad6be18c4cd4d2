"""From an installed workspace to a moving machine by ROS's own `ros2 launch`, as docs/how-to/workspace.md says.

The launch system is not among the ROS wheels: where `ros2 launch` or the built package is not found this is skipped,
and test_launch.py compares the files with what is installed.
"""

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from stepdiag_ros.nodes.patience import Patience

ROS2 = shutil.which('ros2')


def finds_the_package() -> bool:
    if ROS2 is None:
        return False
    found = subprocess.run([ROS2, 'pkg', 'executables', 'stepdiag_ros'], capture_output=True, text=True)
    asked = subprocess.run([ROS2, 'launch', '--help'], capture_output=True)
    return asked.returncode == 0 and 'stepdiag_ros bringup' in found.stdout


pytestmark = [pytest.mark.skipif(not finds_the_package(), reason='`ros2 launch`, or stepdiag_ros in a sourced '
                                                                 'workspace, is not there'), pytest.mark.timeout(600)]


def stepdiag(*arguments: str, where: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([ROS2, 'run', 'stepdiag_ros', 'stepdiag', *arguments], cwd=where, capture_output=True,
                          text=True, timeout=300)


def calibrated(launch: list[str], where: Path) -> str:
    """What `stepdiag calibrate` says of a machine that `ros2 launch` has started, which is then ended by Ctrl-C."""
    with open(where / 'launch.log', 'wb') as log, subprocess.Popen(
            [ROS2, 'launch', 'stepdiag_ros', *launch], cwd=where, stdout=log, stderr=subprocess.STDOUT) as launched:
        try:
            patience, made = Patience(120.0, 10.0), stepdiag('calibrate', '--setups', 'lin_x', where=where)
            while made.returncode == 2 and not patience.over():      # it is not up yet
                made = stepdiag('calibrate', '--setups', 'lin_x', where=where)
        finally:
            launched.send_signal(signal.SIGINT)
            assert launched.wait(120) == 0, (where / 'launch.log').read_text()
    return made.stdout + made.stderr


def test_one_launch_file_brings_a_virtual_machine_up(ros_domain: int, tmp_path: Path) -> None:
    said = calibrated(['virtual.launch.py'], tmp_path)
    assert said.startswith('succeeded: 8 stops in 4 runs'), said + (tmp_path / 'launch.log').read_text()
    assert len(list(tmp_path.glob('cell1_*/metadata.yaml'))) >= 1
    assert 'all processes have ended' in (tmp_path / 'launch.log').read_text()


def test_nodes_by_themselves_with_their_parameter_file(ros_domain: int, tmp_path: Path) -> None:
    share = subprocess.run([ROS2, 'pkg', 'prefix', '--share', 'stepdiag_ros'], capture_output=True, text=True,
                           check=True)
    cell, runtime = Path(share.stdout.strip()) / 'cells' / 'demo.yaml', tmp_path / 'demo'
    with subprocess.Popen(['python3', '-m', 'stepdiag_ros.virtual.cell_process', str(cell), '--runtime', str(runtime)],
                          stdout=subprocess.DEVNULL) as instruments:
        try:
            made = stepdiag('parameters', str(cell), '--runtime', str(runtime), where=tmp_path)
            assert made.returncode == 0, made.stderr       # it waits until the instruments are up
            said = calibrated(['cell.launch.py', f'params:={runtime}/parameters.yaml'], tmp_path)
        finally:
            os.kill(instruments.pid, signal.SIGTERM)
    assert said.startswith('succeeded: 8 stops in 4 runs'), said + (tmp_path / 'launch.log').read_text()


@pytest.mark.parametrize(('params', 'word'), [('', 'params'), ('params:=none.yaml', 'there is no such parameter file')])
def test_without_a_parameter_file_nothing_is_started(ros_domain: int, tmp_path: Path, params: str, word: str) -> None:
    done = subprocess.run([ROS2, 'launch', 'stepdiag_ros', 'cell.launch.py', *filter(None, [params])], cwd=tmp_path,
                          capture_output=True, text=True, timeout=60)
    assert done.returncode != 0 and word in done.stdout + done.stderr
    assert 'process started' not in done.stdout + done.stderr
