"""Drivers by name: those that come along, and the one of the guide, registered as a package would."""

import re
import socketserver
import threading
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.ids3010 import Ids3010
from stepdiag_ros.devices.registry import GROUPS, SHIPPED, driver, drivers
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import load_cell, parse_cell

ROOT = Path(__file__).resolve().parents[3]
DEMO = (ROOT / 'cells' / 'demo.yaml').read_text(encoding='utf-8')


@pytest.fixture
def guide(tmp_path, monkeypatch):
    """The guide's package, installed: its code, and the entry point as its pyproject.toml says."""
    page = (ROOT / 'docs' / 'how-to' / 'add_a_driver.md').read_text(encoding='utf-8')
    code, toml = (page.split(f'```{kind}\n')[1].split('```')[0] for kind in ('python', 'toml'))
    package = tmp_path / 'my_lab'
    package.mkdir()
    (package / '__init__.py').write_text('')
    (package / 'line_laser.py').write_text(code, encoding='utf-8')
    group, name, where = re.search(r'entry-points."(.*)"]\n(\w+) = "(.*)"', toml).groups()
    info = tmp_path / 'my_lab-1.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: my_lab\nVersion: 1\n')
    (info / 'entry_points.txt').write_text(f'[{group}]\n{name} = {where}\nids3010 = my_lab.line_laser:line_laser\n')
    monkeypatch.syspath_prepend(str(tmp_path))
    return name


class Lengths(socketserver.StreamRequestHandler):
    """Answers each line with the next length in nanometres."""

    def handle(self) -> None:
        for number, _line in enumerate(self.rfile):
            self.wfile.write(b'%d\n' % (1000 * (number + 1)))


@pytest.mark.parametrize('instrument', GROUPS)
def test_what_comes_along_is_there(instrument):
    for name in SHIPPED[instrument]:
        assert callable(driver(instrument, name, 'here'))


def test_the_setup_registers_what_comes_along():
    text = (ROOT / 'setup.py').read_text(encoding='utf-8').replace('{NAME}', 'stepdiag_ros')
    for instrument, group in GROUPS.items():
        said = text.split(f"f'{group}': [")[1].split(']')[0]
        assert dict(re.findall(r"'(\w+) = ([\w.:]+)'", said)) == SHIPPED[instrument]


def test_an_unknown_name_lists_those_that_are_known():
    with pytest.raises(StepdiagError, match="driver is .gremlin.; there is no such driver, known are ids3010 "):
        driver('interferometer', 'gremlin', 'interferometer_driver: parameter driver')
    text = DEMO.replace('interferometer: {host', 'interferometer: {driver: gremlin, host')
    with pytest.raises(StepdiagError, match=r"interferometer.driver.* is 'gremlin'.* known are ids3010"):
        parse_cell(text, 'cell.yaml')
    assert load_cell(ROOT / 'cells' / 'demo.yaml').instruments.drivers['interferometer'] == 'ids3010'


def test_the_driver_of_the_guide_measures(guide):
    cell = parse_cell(DEMO.replace('interferometer: {host', f'interferometer: {{driver: {guide}, host'), 'cell.yaml')
    assert cell.instruments.drivers == {'interferometer': guide, 'psd': 'modbus', 'cnc': 'linuxcnc_rsh'}
    # A name that comes along is not taken by another package.
    assert isinstance(driver('interferometer', 'ids3010', 'here')(
        {'host': '127.0.0.1', 'port': 1, 'beams': 1, 'timeout': 1.0}), Ids3010)
    assert set(drivers('interferometer')) == {guide, 'ids3010'}
    with socketserver.ThreadingTCPServer(('127.0.0.1', 0), Lengths) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        client = driver('interferometer', guide, 'here')(
            {'host': '127.0.0.1', 'port': server.server_address[1], 'beams': 1, 'timeout': 10.0})
        client.connect()
        client.reset()
        block = client.read_block(3, 0.001)
        client.close()
        server.shutdown()
    np.testing.assert_allclose(block.displacement_m[:, 0], [1e-6, 2e-6, 3e-6], atol=1e-15)
    assert block.quality.tolist() == [100] * 3
    # Each was asked for when it was due, not before.
    assert np.all(block.accuracy.taken_ns >= np.array([0, 1e6, 2e6])) and block.accuracy.uncertainty_ns[0] > 0
    with pytest.raises(DeviceError, match='is it switched on'):
        client.connect()
