"""Instruments that answer what no instrument answers: sampling is broken off, said, and goes on when they are sound.

A relay stands between the client and the virtual cell's servers; while it is told to, it exchanges what they answer.
"""

import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.ids3010 import Ids3010
from stepdiag_ros.devices.modbus_psd import ModbusPsd
from stepdiag_ros.devices.optical_switch import OpticalSwitch
from stepdiag_ros.nodes import acquisition
from stepdiag_ros.nodes.acquisition import Acquisition
from stepdiag_ros.virtual.cell_process import CellProcess

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'fuzz'))
from wires import Relay

from stepdiag_ros.nodes.patience import Patience

DEMO = Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml'
DEEP = 100_000

#: What stands in the place of an answer's ``result`` or of the whole answer; ``%d`` is the request's number.
ANSWERS = {
    'empty list': b'[]', 'empty object': b'{}', 'null': b'null', 'a list of one': b'[1]',
    'result empty list': b'{"id":%d,"result":[]}', 'result empty object': b'{"id":%d,"result":{}}',
    'result null': b'{"id":%d,"result":null}', 'result short': b'{"id":%d,"result":[0]}',
    'result of nulls': b'{"id":%d,"result":[0,null,null]}', 'result of texts': b'{"id":%d,"result":[0,"x","y"]}',
    'result infinite': b'{"id":%d,"result":[0,1e999,1e999]}',
    'result not a number': b'{"id":%d,"result":[0,NaN,NaN]}',
    'result beyond floats': b'{"id":%d,"result":[0,' + b'9' * 400 + b',' + b'9' * 400 + b']}',
    'result of too many digits': b'{"id":%d,"result":[0,' + b'9' * 6000 + b']}',
    'error null': b'{"id":%d,"error":null}', 'error list': b'{"id":%d,"error":[[]]}',
    'error number': b'{"id":%d,"error":7}',
    'deep lists': b'[' * DEEP, 'deep and closed': b'[' * DEEP + b']' * DEEP, 'deep objects': b'{"a":' * DEEP,
    'deep result': b'{"id":%d,"result":' + b'[' * 5000 + b']' * 5000 + b'}', 'no text': b'\xff\x00\xfe',
}


@pytest.fixture(scope='module')
def endpoints(tmp_path_factory):
    with CellProcess(DEMO, tmp_path_factory.mktemp('hostile')) as process:
        yield process.start()


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(acquisition, 'RETRY_S', 0.05)


def wait_for(condition, why=lambda: '') -> None:
    patience = Patience(60.0)
    while not condition():
        assert not patience.over(), why()
        time.sleep(0.01)


def survives(client, relay: Relay, spoil, samples: int = 20) -> None:
    """Sampling goes on, meets the spoilt answers, says so in one line, and goes on when they are over."""
    blocks: list = []
    said: list[str] = []
    work = Acquisition(client, lambda: client.read_block(samples, 1e-3), lambda block: samples, blocks.append,
                       said.append)
    client.connect()
    work.start()
    try:
        wait_for(lambda: len(blocks) > 2, lambda: work.error)
        relay.spoil = spoil
        wait_for(lambda: work.error, lambda: 'nothing was noticed')
        assert work.running and '\n' not in work.error and work.error in said[-1]
        time.sleep(0.3)   # connecting again is tried meanwhile, and answered alike
        assert work.running, 'the thread has ended'
        relay.spoil = None
        before = len(blocks)
        wait_for(lambda: len(blocks) > before + 2, lambda: f'{work.error} {said}')
        assert not work.error and said[-1] == 'connected again' and work.reconnects >= 1
    finally:
        relay.spoil = None
        work.stop()
        client.close()


def numbered(answer: bytes):
    """Each answer of a group exchanged for one with the number that is waited for."""
    def spoil(data: bytes) -> bytes:
        lines = []
        for line in data.splitlines():
            number = line.split(b'"id":')[1].split(b',')[0].strip(b'}') if b'"id":' in line else b'1'
            lines.append(answer.replace(b'%d', number))
        return b'\n'.join(lines) + b'\n'
    return spoil


@pytest.mark.parametrize('kind', list(ANSWERS))
def test_an_interferometer_that_answers_nonsense(endpoints, kind):
    relay = Relay(endpoints['interferometer']['port'])
    try:
        survives(Ids3010('127.0.0.1', relay.port, timeout_s=1.0), relay, numbered(ANSWERS[kind]))
    finally:
        relay.close()


MODBUS = {
    'cut short': lambda data: data[:-3], 'function of another kind': lambda data: data[:7] + b'\x11' + data[8:],
    'a byte count that lies': lambda data: data[:8] + b'\xff' + data[9:],
    'no length': lambda data: data[:4] + b'\x00\x00',
    'empty registers': lambda data: data[:4] + b'\x00\x03' + data[6:8] + b'\x00',
    'zeros': lambda data: bytes(len(data)),
    'an error without code': lambda data: data[:4] + b'\x00\x02' + data[6:7] + bytes([data[7] | 0x80]),
    'one register': lambda data: data[:4] + b'\x00\x05' + data[6:8] + b'\x02\x00\x00',
    'not a number': lambda data: data[:9] + b'\x7f\xc0\x00\x00' * ((len(data) - 9) // 4),
    'text': lambda data: b'220 smtp\r\n',
}


@pytest.mark.parametrize('kind', list(MODBUS))
def test_a_detector_that_answers_nonsense_when_asked(endpoints, kind):
    relay = Relay(endpoints['psd']['port'])
    try:
        survives(ModbusPsd('127.0.0.1', relay.port, endpoints['psd']['stream_port'], mode='poll', timeout_s=0.5),
                 relay, MODBUS[kind], samples=5)
    finally:
        relay.close()


@pytest.mark.parametrize('kind', ['cut short', 'zeros', 'text'])
def test_a_detector_that_streams_nonsense(endpoints, kind):
    relay = Relay(endpoints['psd']['stream_port'])
    try:
        survives(ModbusPsd('127.0.0.1', endpoints['psd']['port'], relay.port, timeout_s=1.0), relay, MODBUS[kind])
    finally:
        relay.close()


@pytest.mark.parametrize('answer', [b'(@' + b'9' * 5000 + b')\n', b'\n', b'(@)\n', b'\xff\n', b'x' * 300_000])
def test_a_switch_that_answers_nonsense(answer):
    with socket.create_server(('127.0.0.1', 0)) as server:
        def serve() -> None:
            client, _ = server.accept()
            # The client may hang up before it has heard all of it.
            with client, suppress(OSError):
                client.recv(4096)
                client.sendall(answer)
                client.recv(4096)
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        switch = OpticalSwitch('127.0.0.1', server.getsockname()[1], {'demo': 1}, timeout_s=1.0)
        switch.connect()
        with pytest.raises(DeviceError) as caught:
            switch.select('demo')
        assert '\n' not in str(caught.value)
        switch.close()
        thread.join(10.0)
