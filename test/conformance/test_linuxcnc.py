"""The same client drives the virtual control and a real LinuxCNC, and both answer alike.

LinuxCNC (Debian's ``linuxcnc-uspace``) runs without a screen and without a real-time
kernel, as an ordinary user, its HAL looping commanded positions back; linuxcncrsh is its
display.  Where it is not installed its half is skipped, loudly.
"""

import fcntl
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.virtual.cell_process import CellProcess

DEMO = Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml'
USER, GROUP = 'nobody', 'nogroup'
"""Whom LinuxCNC runs as when the tests run as root, as whom it refuses to."""
TRAVEL = (0.2, 0.16, 0.12)

INI = """\
[EMC]
VERSION = 1.1
MACHINE = stepdiag
[DISPLAY]
DISPLAY = {folder}/display.sh
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = {folder}/parameters
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = {folder}/tools
[HAL]
HALFILE = {folder}/loop.hal
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 100
MAX_LINEAR_VELOCITY = 500
DEFAULT_LINEAR_ACCELERATION = 2000
MAX_LINEAR_ACCELERATION = 2000
[KINS]
KINEMATICS = trivkins coordinates=XYZ
JOINTS = 3
"""
AXIS = """\
[AXIS_{letter}]
MIN_LIMIT = -1
MAX_LIMIT = {travel}
MAX_VELOCITY = 500
MAX_ACCELERATION = 2000
[JOINT_{number}]
TYPE = LINEAR
HOME = 0
MIN_LIMIT = -1
MAX_LIMIT = {travel}
MAX_VELOCITY = 500
MAX_ACCELERATION = 2000
FERROR = 10
MIN_FERROR = 10
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_OFFSET = 0
HOME_SEQUENCE = 0
"""
HAL = """\
loadrt trivkins coordinates=XYZ
loadrt motmod servo_period_nsec=1000000 num_joints=3
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net joint0 joint.0.motor-pos-cmd joint.0.motor-pos-fb
net joint1 joint.1.motor-pos-cmd joint.1.motor-pos-fb
net joint2 joint.2.motor-pos-cmd joint.2.motor-pos-fb
net estop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare iocontrol.0.tool-prepared
net change iocontrol.0.tool-change iocontrol.0.tool-changed
"""


def free_port() -> int:
    with socket.create_server(('127.0.0.1', 0)) as probe:
        return probe.getsockname()[1]


class LinuxCnc:
    """One LinuxCNC with a configuration of its own; its shared memory allows one at a time."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix='stepdiag-linuxcnc-'))
        self.port = free_port()
        self._lock = open(Path(tempfile.gettempdir()) / f'stepdiag-linuxcnc-{os.getuid()}', 'w')
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        axes = ''.join(AXIS.format(letter=letter, number=i, travel=1e3 * TRAVEL[i] + 1.0)
                       for i, letter in enumerate('XYZ'))
        display = self.folder / 'display.sh'
        for path, text in ((self.folder / 'machine.ini', INI.format(folder=self.folder) + axes),
                           (self.folder / 'loop.hal', HAL), (self.folder / 'tools', ''),
                           (display, f'#!/bin/sh\necho $$ > {self.folder}/pid\n'
                                     f'exec linuxcncrsh --port {self.port} -- "$@"\n')):
            path.write_text(text)
        display.chmod(0o755)
        as_whom = {}
        if os.getuid() == 0:
            as_whom = {'user': USER, 'group': GROUP, 'extra_groups': []}
            for path in (self.folder, *self.folder.iterdir()):
                shutil.chown(path, USER, GROUP)
        self._log = open(self.folder / 'log', 'w')
        self.process = subprocess.Popen(
            ['linuxcnc', str(self.folder / 'machine.ini')], cwd=self.folder,
            env=os.environ | {'HOME': str(self.folder)}, stdin=subprocess.DEVNULL, stdout=self._log,
            stderr=subprocess.STDOUT, start_new_session=True, **as_whom)

    def wait(self) -> None:
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            assert self.process.poll() is None, (self.folder / 'log').read_text()
            try:
                socket.create_connection(('127.0.0.1', self.port), 1.0).close()
                return
            except OSError:
                time.sleep(0.2)
        pytest.fail('LinuxCNC does not listen: ' + (self.folder / 'log').read_text())

    def stop(self) -> None:
        """End its display; LinuxCNC's own script then takes the rest down."""
        try:
            os.kill(int((self.folder / 'pid').read_text()), signal.SIGTERM)
        except (FileNotFoundError, ProcessLookupError, ValueError):
            self.process.terminate()
        self.process.wait(60.0)
        self._log.close()
        self._lock.close()
        shutil.rmtree(self.folder)


@pytest.fixture(scope='module', params=['virtual', pytest.param('linuxcnc', marks=pytest.mark.linuxcnc)])
def control(request, tmp_path_factory):
    """A control that is ready, virtual and real."""
    if request.param == 'virtual':
        with CellProcess(DEMO, tmp_path_factory.mktemp('control')) as process:
            endpoints = process.start()
            yield from ready(LinuxCncRsh('127.0.0.1', endpoints['cnc']['port']))
        return
    if shutil.which('linuxcnc') is None or shutil.which('linuxcncrsh') is None:
        pytest.skip('LinuxCNC is not installed: apt-get install linuxcnc-uspace to test against it')
    machine = LinuxCnc()
    try:
        machine.wait()
        yield from ready(LinuxCncRsh('127.0.0.1', machine.port))
    finally:
        machine.stop()


def ready(client):
    client.connect()
    client.make_ready()
    yield client
    client.close()


def go(client, place) -> None:
    client.move(np.array(place), 0.1)
    end = time.monotonic() + 60.0
    while not client.in_position():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_ready_is_not_in_estop_on_homed_and_idle(control):
    assert control.state() == {'estop': False, 'on': True, 'homed': True, 'idle': True, 'mode': 'mdi'}


def test_a_zig_zag_arrives_everywhere(control):
    for place in ([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.05, 0.04, 0.0], [0.05, 0.04, 0.03],
                  [0.05, 0.04, 0.03], [0.2, 0.16, 0.12], [0.0123456, 0.1, 0.0]):
        go(control, place)
        np.testing.assert_allclose(control.position(), place, atol=1.1e-6)


def test_it_moves_while_it_is_not_in_position(control):
    go(control, [0.0, 0.0, 0.0])
    control.move(np.array([0.1, 0.0, 0.0]), 0.05)
    assert not control.in_position()
    seen = []
    while not control.in_position():
        seen.append(control.position()[0])
        time.sleep(0.02)
    assert any(0.01 < x < 0.09 for x in seen)
    assert np.all(np.diff(seen) > -1e-6)


def test_stop_leaves_the_machine_still_and_ready_for_more(control):
    go(control, [0.0, 0.0, 0.0])
    control.move(np.array([0.2, 0.1, 0.0]), 0.02)
    time.sleep(0.4)
    control.stop()
    place = control.position()
    assert 0.0 < place[0] < 0.15
    assert place[1] / place[0] == pytest.approx(0.5, rel=1e-3)
    time.sleep(0.2)
    np.testing.assert_allclose(control.position(), place, atol=2e-9)
    go(control, [0.05, 0.0, 0.0])
    np.testing.assert_allclose(control.position(), [0.05, 0.0, 0.0], atol=1.1e-6)


def test_beyond_the_limits_it_says_so(control):
    with pytest.raises(DeviceError, match="exceed X's positive limit"):
        control.move(np.array([0.5, 0.0, 0.0]), 0.1)
        # LinuxCNC may look ahead a moment later than it acknowledges.
        while not control.in_position():
            time.sleep(0.01)
    control.connect()
    go(control, [0.01, 0.0, 0.0])


def test_a_second_client_takes_over(control):
    port = control._link._address[1]
    other = LinuxCncRsh('127.0.0.1', port)
    other.connect()
    assert other.state()['homed']
    other.close()
    control.close()
    control.connect()
    assert control.position().shape == (3,)


def test_a_stop_finds_a_connection_of_its_own(control):
    go(control, [0.0, 0.0, 0.0])
    control.move(np.array([0.2, 0.0, 0.0]), 0.02)
    time.sleep(0.4)
    control._link.close()      # what a cut of the network leaves behind
    control.stop()
    place = control.position()
    assert 0.0 < place[0] < 0.15
    time.sleep(0.3)
    np.testing.assert_allclose(control.position(), place, atol=1.1e-6)
    go(control, [0.01, 0.0, 0.0])
