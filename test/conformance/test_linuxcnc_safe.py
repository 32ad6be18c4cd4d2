"""What the control does with a compensation that cannot be used, and with one that is taken back."""

import time

import numpy as np
import pytest
from drawn_machine import ORIGIN, TOOL, TRAVEL, drawn_errors
from linuxcnc_machine import Running, configured, need_components

from stepdiag_ros.linuxcnc import configuration, volume
from stepdiag_ros.linuxcnc.install import installed
from stepdiag_ros.linuxcnc.matrix import matrix, matrixkins_hal
from stepdiag_ros.model.machine import GeometricErrors
from stepdiag_ros.nodes.patience import Patience

pytestmark = pytest.mark.linuxcnc
CORNER = [0.2, 0.16, 0.12]


def joints_at(machine, place) -> np.ndarray:
    machine.client.move(np.array(place), 0.3)
    patience = Patience(60.0)
    while not machine.client.in_position():
        assert not patience.over()
        time.sleep(0.01)
    time.sleep(0.05)
    return machine.joints()


def test_a_damaged_file_moves_nothing(tmp_path):
    need_components()
    port = configured(tmp_path)
    text = volume.volume_file(drawn_errors(), 'test', TOOL, TRAVEL, ORIGIN)
    configuration.write(tmp_path, configuration.compensated((tmp_path / 'machine.ini').read_text(),
                                                            volume=text[:len(text) // 2]))
    with Running(tmp_path, port) as machine:
        assert machine.hal('getp', 'stepdiagkins.fault') == 'TRUE'
        np.testing.assert_allclose(joints_at(machine, CORNER), CORNER, atol=1.1e-9)


def test_squareness_as_a_matrix(tmp_path):
    """By matrixkins where this LinuxCNC has it (after 2.9.0~pre1), else by our component: the same joints."""
    need_components()
    port = configured(tmp_path)
    square = GeometricErrors({}, {'EC0Y': 3e-5, 'EB0Z': -2e-5, 'EA0Z': 4e-5})
    ini = (tmp_path / 'machine.ini').read_text()
    c = matrix(square)
    if installed('matrixkins'):
        configuration.write(tmp_path, configuration.compensated(ini, matrix_hal=matrixkins_hal(c)))
        # The matrix acts on machine coordinates: the volume's corner moves with it.
        expected = c @ (np.array(CORNER) + ORIGIN) - ORIGIN
    else:
        configuration.write(tmp_path, configuration.compensated(ini, volume=volume.volume_file(
            square, 'test', TOOL, TRAVEL, ORIGIN)))
        expected = c @ np.array(CORNER)
    with Running(tmp_path, port) as machine:
        np.testing.assert_allclose(joints_at(machine, CORNER), expected, atol=1.1e-9)
