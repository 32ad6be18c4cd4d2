"""Instruments on a bad day: each fault is one clear line, nothing hangs, and work goes on after it."""

import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.ids3010 import Ids3010
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.devices.modbus_psd import ModbusPsd
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.virtual import faults
from stepdiag_ros.virtual.cell_process import CellProcess

DEMO = Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml'
TIMEOUT_S = 2.0


@pytest.fixture(scope='module')
def bench(tmp_path_factory):
    runtime = tmp_path_factory.mktemp('faults')
    with CellProcess(DEMO, runtime) as process:
        yield runtime, process.start()


def client_of(name: str, endpoints: dict):
    where = endpoints['psd' if name.startswith('psd') else name]
    if name == 'interferometer':
        return Ids3010(where['host'], where['port'], timeout_s=TIMEOUT_S)
    if name == 'cnc':
        return LinuxCncRsh(where['host'], where['port'], setup_codes=where['setup_codes'],
                           timeout_s=TIMEOUT_S, ready_timeout_s=10.0)
    return ModbusPsd(where['host'], where['port'], where['stream_port'], timeout_s=TIMEOUT_S,
                     mode=name.removeprefix('psd_'))


def work(name: str, client) -> None:
    """One piece of everyday work."""
    if name == 'cnc':
        client.position()
    else:
        client.read_block(50, 1e-3)


def wait_for(condition) -> None:
    patience = Patience(30.0)
    while not condition():
        assert not patience.over()


def settle(runtime: Path) -> None:
    time.sleep(0.05)   # longer than the servers' interval of looking


@pytest.mark.parametrize('kind', ['drop', 'nonsense', 'stall'])
@pytest.mark.parametrize('name', ['interferometer', 'psd_stream', 'psd_poll', 'cnc'])
def test_a_fault_is_one_clear_line_and_work_goes_on_after_it(bench, name, kind):
    runtime, endpoints = bench
    instrument = name.split('_')[0]
    client = client_of(name, endpoints)
    client.connect()
    if name == 'cnc':
        client.make_ready()
    work(name, client)
    faults.inject(runtime, instrument, kind)
    settle(runtime)
    begin = time.monotonic()
    try:
        with pytest.raises(DeviceError) as caught:
            # What was sent before the fault may still be on its way.
            for _ in range(100):
                work(name, client)
        message = str(caught.value)
        assert '\n' not in message
        assert endpoints[instrument]['host'] in message and ';' in message
        assert time.monotonic() - begin < 30.0
        if kind == 'stall':
            assert 'stall' in message
        with pytest.raises(DeviceError):   # closed now, and says so rather than to hang
            work(name, client)
    finally:
        faults.clear(runtime, instrument)
    settle(runtime)
    client.close()
    client.connect()
    work(name, client)
    client.close()


def test_no_signal_is_quality_zero_and_a_dark_detector(bench):
    runtime, endpoints = bench
    cnc = client_of('cnc', endpoints)
    cnc.connect()
    cnc.make_ready()
    cnc.select_setup('ppp')
    meter, detector = client_of('interferometer', endpoints), client_of('psd_stream', endpoints)
    meter.connect()
    detector.connect()
    wait_for(lambda: meter.read_block(20, 1e-3).quality.max() > 50)
    for name in ('interferometer', 'psd'):
        faults.inject(runtime, name, 'no_signal')
    settle(runtime)
    try:
        wait_for(lambda: meter.read_block(20, 1e-3).quality.max() == 0)
        detector.read_block(50, 1e-3)      # what was still on its way
        dark = detector.read_block(50, 1e-3)
        assert dark.intensity_V.max() < 0.01 and np.isnan(dark.x_m).all()
    finally:
        for name in ('interferometer', 'psd'):
            faults.clear(runtime, name)
    settle(runtime)
    wait_for(lambda: meter.read_block(20, 1e-3).quality.max() > 50)
    for client in (meter, detector, cnc):
        client.close()


@pytest.mark.parametrize('name', ['interferometer', 'psd_stream', 'cnc'])
def test_nobody_there(name):
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
    endpoints = {n: {'host': '127.0.0.1', 'port': port, 'stream_port': port, 'setup_codes': {}}
                 for n in ('interferometer', 'psd', 'cnc')}
    with pytest.raises(DeviceError, match='cannot connect'):
        client_of(name, endpoints).connect()


@pytest.mark.parametrize('name', ['interferometer', 'psd_stream', 'cnc'])
def test_not_connected(name):
    endpoints = {n: {'host': '127.0.0.1', 'port': 9, 'stream_port': 9, 'setup_codes': {}}
                 for n in ('interferometer', 'psd', 'cnc')}
    client = client_of(name, endpoints)
    with pytest.raises(DeviceError, match='connect first'):
        work(name, client)
    client.close()


class Impostor:
    """A server that answers every read with the same bytes."""

    def __init__(self, answer: bytes):
        self._answer = answer
        self._socket = socket.create_server(('127.0.0.1', 0))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            while True:
                client, _ = self._socket.accept()
                with client:
                    while client.recv(4096):
                        client.sendall(self._answer)
        except OSError:
            pass

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join(5.0)


@pytest.mark.parametrize(('answer', 'words'), [
    (b'{"jsonrpc":"2.0","id":1,"result":["x"]}', 'does not start|nonsense|refuses'),
    (b'{"jsonrpc":"2.0","id":77,"result":[0]}', 'to request 1'),
    (b'{"jsonrpc":"2.0","id":1,"error":"broken"}', 'nonsense|refuses|knows neither'),
    (b'[1, 2, 3]', 'nonsense'), (b'\xff\xfe\xfd', 'nonsense'), (b'{"id":1}{"id":1}', 'nonsense'),
])
def test_something_else_listens_on_the_interferometer_s_port(answer, words):
    impostor = Impostor(answer)
    client = Ids3010('127.0.0.1', impostor.port, timeout_s=TIMEOUT_S)
    try:
        with pytest.raises(DeviceError, match=words) as caught:
            client.connect()
        assert '\n' not in str(caught.value)
    finally:
        client.close()
        impostor.close()


@pytest.mark.parametrize('answer', [b'220 smtp ready\r\n', b'HELLO NAK\r\n', b'\x00' * 40 + b'\r\n'])
def test_something_else_listens_on_the_control_s_port(answer):
    impostor = Impostor(answer)
    client = LinuxCncRsh('127.0.0.1', impostor.port, timeout_s=TIMEOUT_S)
    try:
        with pytest.raises(DeviceError) as caught:
            client.connect()
        assert '\n' not in str(caught.value)
    finally:
        client.close()
        impostor.close()


def test_faults_of_a_cell_file(tmp_path):
    text = DEMO.read_text(encoding='utf-8') + '\nfaults: {interferometer: {kind: nonsense}}\n'
    path = tmp_path / 'sick.yaml'
    path.write_text(text, encoding='utf-8')
    with CellProcess(path, tmp_path / 'runtime') as process:
        endpoints = process.start()
        with pytest.raises(DeviceError, match='nonsense'):
            client_of('interferometer', endpoints).connect()


def test_faults_that_do_not_exist(tmp_path):
    with pytest.raises(StepdiagError, match='no fault'):
        faults.inject(tmp_path, 'psd', 'fire')
