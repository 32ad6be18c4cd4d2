"""One laser over two machines."""

import time
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.ids3010 import Ids3010
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.devices.optical_switch import OpticalSwitch
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.cell_process import CellProcess
from stepdiag_ros.virtual.yamlreader import read_yaml

CELLS = Path(__file__).resolve().parents[3] / 'cells'


@pytest.fixture(scope='module')
def endpoints(tmp_path_factory):
    runtime = tmp_path_factory.mktemp('multiplex')
    with CellProcess(CELLS / 'multiplex.yaml', runtime) as process:
        yield process.start()
    assert list(runtime.iterdir()) == []


def ready(where: dict) -> LinuxCncRsh:
    cnc = LinuxCncRsh(where['host'], where['port'], setup_codes=where['setup_codes'])
    cnc.connect()
    cnc.make_ready()
    cnc.select_setup('ppp')
    return cnc


def go(cnc: LinuxCncRsh, *place: float) -> None:
    cnc.move(np.array(place), 0.5)
    while not cnc.in_position():
        time.sleep(0.002)


def test_the_laser_looks_at_the_machine_that_the_switch_chose(endpoints):
    there = read_yaml(endpoints['machines']['right']).plain()
    assert there['interferometer'] == endpoints['interferometer']
    assert there['cnc'] != endpoints['cnc'] and there['psd'] != endpoints['psd']
    left, right = ready(endpoints['cnc']), ready(there['cnc'])
    where = endpoints['switch']
    switch = OpticalSwitch(where['host'], where['port'], where['channels'])
    meter = Ids3010('127.0.0.1', endpoints['interferometer']['port'], switch=switch)
    meter.connect()
    for name, mine, other in (('left', left, right), ('right', right, left), ('left', left, right)):
        meter.select_machine(name)
        assert switch.selected() == name
        go(mine, 0.0, 0.0, 0.0)
        meter.reset()
        go(other, 0.1, 0.0, 0.0)
        assert np.abs(meter.read_block(20, 1e-3).displacement_m).max() < 1e-6
        go(mine, 0.1, 0.0, 0.0)
        assert meter.read_block(20, 1e-3).displacement_m.min() > 0.05
    with pytest.raises(DeviceError, match='no channel for machine'):
        meter.select_machine('middle')
    for client in (meter, left, right):
        client.close()


def test_a_channel_that_is_not_fitted(endpoints):
    where = endpoints['switch']
    switch = OpticalSwitch(where['host'], where['port'], {'ghost': 7}, timeout_s=2.0)
    switch.connect()
    with pytest.raises(DeviceError, match='does not switch to channel 7'):
        switch.select('ghost')


def test_something_else_is_no_switch(endpoints):
    where = endpoints['cnc']
    switch = OpticalSwitch(where['host'], where['port'], {'left': 1}, timeout_s=0.5)
    switch.connect()
    with pytest.raises(DeviceError, match=r'stalls|nonsense'):
        switch.select('left')


def test_the_cell_names_its_machines():
    cell = load_cell(CELLS / 'multiplex.yaml')
    assert cell.instruments.multiplexer == ('left', 'right')


@pytest.mark.parametrize(('machines', 'words'), [
    ('[]', 'missing or empty'), ('[nowhere.yaml]', 'cannot be used'),
    ('[left.yaml]', "machine 'left' too")])
def test_machines_that_cannot_be(tmp_path, machines, words):
    text = (CELLS / 'multiplex.yaml').read_text().replace('[multiplex_right.yaml]', machines)
    (tmp_path / 'cell.yaml').write_text(text)
    (tmp_path / 'left.yaml').write_text((CELLS / 'demo.yaml').read_text().replace('name: demo', 'name: left'))
    with pytest.raises(StepdiagError, match=words) as caught:
        load_cell(tmp_path / 'cell.yaml')
    assert 'multiplexer' in str(caught.value)
