"""The same client drives the virtual control and a real LinuxCNC, and both answer alike.

LinuxCNC (Debian's ``linuxcnc-uspace``) runs without a screen and without a real-time
kernel, as an ordinary user, its HAL looping commanded positions back; linuxcncrsh is its
display.  Where it is not installed its half is skipped, loudly.
"""

import time
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.linuxcnc import configuration
from stepdiag_ros.linuxcnc.running import LinuxCnc, missing
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.virtual.cell_process import CellProcess

DEMO = Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml'
TRAVEL = (0.2, 0.16, 0.12)


@pytest.fixture(scope='module', params=['virtual', pytest.param('linuxcnc', marks=pytest.mark.linuxcnc)])
def control(request, tmp_path_factory):
    """A control that is ready, virtual and real."""
    if request.param == 'virtual':
        with CellProcess(DEMO, tmp_path_factory.mktemp('control')) as process:
            endpoints = process.start()
            yield from ready(LinuxCncRsh('127.0.0.1', endpoints['cnc']['port']))
        return
    if missing():
        pytest.skip(missing())
    folder = tmp_path_factory.mktemp('linuxcnc')
    configuration.write(folder, configuration.simulated('test', TRAVEL, (0.0, 0.0, 0.0), 0.5, 2.0))
    with LinuxCnc(folder) as machine:
        yield from ready(LinuxCncRsh('127.0.0.1', machine.port))


def ready(client):
    client.connect()
    client.make_ready()
    yield client
    client.close()


def go(client, place) -> None:
    client.move(np.array(place), 0.1)
    patience = Patience(60.0)
    while not client.in_position():
        assert not patience.over()
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
