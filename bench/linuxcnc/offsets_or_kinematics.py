"""Which way of compensating the whole volume measures better on LinuxCNC: kinematics or external offsets.

A simulated machine with errors of all 21 kinds goes along the body diagonal.  HAL's sampler notes the joints in
every servo cycle; from them follows where the tool point is, and how far from the straight line.  Needs LinuxCNC
and halcompile; as root both components are installed.

  python bench/linuxcnc/offsets_or_kinematics.py
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / 'test' / 'conformance'))
from linuxcnc_machine import ORIGIN, TOOL, TRAVEL, Running, configured, drawn_errors  # noqa: E402

from stepdiag_ros.linuxcnc import configuration, install, volume  # noqa: E402
from stepdiag_ros.linuxcnc.ini import put  # noqa: E402
from stepdiag_ros.linuxcnc.running import GROUP, USER  # noqa: E402
from stepdiag_ros.model.machine import tool_pose  # noqa: E402

ERRORS = drawn_errors(size=2.0e-5, angle=6.0e-5)
SAMPLER = 'loadrt sampler depth=30000 cfg=fff\naddf sampler.0 servo-thread\n' + ''.join(
    f'net joint{i} => sampler.0.pin.{i}\n' for i in range(3))
OFFSETS = 'loadrt stepdiagoffsets file=stepdiag/volume.txt\naddf stepdiagoffsets.update servo-thread\n' + ''.join(
    f'net place{i} joint.{i}.pos-cmd => stepdiagoffsets.joint-{i}\n'
    f'net counts{i} stepdiagoffsets.counts-{i} => axis.{axis}.eoffset-counts\n'
    f'setp axis.{axis}.eoffset-scale 1e-6\nsetp axis.{axis}.eoffset-enable 1\n' for i, axis in enumerate('xyz'))


def build_offsets() -> None:
    """Install the component of the other way."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(HERE / 'stepdiagoffsets.c', folder)
        shutil.copy(Path(volume.__file__).parent / 'volume_field.h', folder)
        subprocess.run(['halcompile', '--install', 'stepdiagoffsets.c'], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def prepare(folder: Path, way: str) -> None:
    configured(folder, watched=False)
    text = volume.volume_file(ERRORS, 'test', TOOL, TRAVEL, ORIGIN)
    if way == 'kinematics':
        configuration.write(folder, configuration.compensated((folder / 'machine.ini').read_text(), volume=text))
    elif way.startswith('offsets'):
        ini = (folder / 'machine.ini').read_text()
        for axis in 'XYZ':
            ini = put(ini, f'AXIS_{axis}', 'OFFSET_AV_RATIO', [way.split()[1]])
        configuration.write(folder, {'machine.ini': configuration.with_halfile(ini, 'offsets.hal'),
                                     'offsets.hal': OFFSETS, 'stepdiag/volume.txt': text})
    ini = (folder / 'machine.ini').read_text()
    configuration.write(folder, {'machine.ini': configuration.with_halfile(ini, 'sampler.hal'), 'sampler.hal': SAMPLER})


def measure(way: str, feed: float) -> tuple[float, float, float]:
    """Largest deviation [m] from the line under way, at the end right after in position, and a second later."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        prepare(Path(folder), way)
        with Running(Path(folder)) as machine:
            client, out = machine.client, machine.machine.folder / 'joints.txt'
            time.sleep(1.5)    # the kinematics ramp in, the offsets take hold
            client.move(np.zeros(3), 0.2)
            while not client.in_position():
                time.sleep(0.005)
            time.sleep(0.5)
            whom = {'user': USER, 'group': GROUP, 'extra_groups': []} if os.getuid() == 0 else {}
            with open(out, 'w') as file:
                sampler = subprocess.Popen([shutil.which('halsampler')], stdout=file, **whom)
                time.sleep(0.5)
                client.move(np.array(TRAVEL), feed)
                client._target = None    # offsets move the reported position: idle and still is arrived
                while not client.in_position():
                    time.sleep(0.002)
                arrived = len(out.read_text().splitlines())
                time.sleep(1.0)
                sampler.terminate()
                sampler.wait()
            rows = np.array([[float(v) for v in line.split()] for line in out.read_text().splitlines()
                             if len(line.split()) == 3 and 'overrun' not in line]) * 1e-3
            return deviations(rows, arrived)


def deviations(joints: np.ndarray, arrived: int) -> tuple[float, float, float]:
    """``joints`` (n, 3) [m]: drives, from the volume's corner where the machine was homed."""
    tool = tool_pose(ERRORS, joints, np.array(TOOL))[0] - np.array(TOOL)
    along = np.array(TRAVEL) / np.linalg.norm(TRAVEL)
    moving = np.any(np.abs(np.diff(joints, axis=0)) > 1e-6, axis=1)
    across = tool - np.outer(tool @ along, along)
    size = np.linalg.norm(across[1:][moving], axis=1)
    end = tool[min(arrived, len(tool) - 1)] - TRAVEL
    return float(size.max()), float(np.linalg.norm(end)), float(np.linalg.norm(tool[-1] - TRAVEL))


def main() -> None:
    install.install()
    build_offsets()
    print(f'{"way":22}{"feed":>8}{"off the line":>16}{"on arrival":>14}{"1 s later":>12}   [µm]')
    for feed in (0.05, 0.2):
        for way in ('none', 'kinematics', 'offsets 0.1', 'offsets 0.5'):
            numbers = ''.join(f'{1e6 * v:>14.3f}' for v in measure(way, feed))
            print(f'{way:22}{feed:>6.2f}  {numbers}', flush=True)


if __name__ == '__main__':
    main()
