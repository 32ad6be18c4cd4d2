"""The virtual instruments' Modbus server, spoken to by pymodbus and by raw bytes over loopback."""

import asyncio
import inspect
import socket
import struct
import threading

import pytest
from pymodbus.client import ModbusTcpClient

from stepdiag_ros.virtual.modbus import ILLEGAL_VALUE, ModbusServer

UNIT = next(name for name in ('device_id', 'slave')
            if name in inspect.signature(ModbusTcpClient.read_holding_registers).parameters)


@pytest.fixture
def served():
    """``(port, server, seen)``: a server of registers 10…19 and 100…355 in a thread of its own."""
    seen, ready, stop, box = [], threading.Event(), threading.Event(), {}

    async def access(function, address, registers, values):
        seen.append((function, address, values))
        registers[12] = 4711
        return ILLEGAL_VALUE if values == [666] else None

    def tamper(answer):
        return box.get('instead') or answer

    async def main():
        server = ModbusServer(((10, 10), (100, 256)), access, tamper)
        box['server'], box['port'] = server, await server.start('127.0.0.1', 0)
        ready.set()
        while not stop.is_set():
            await asyncio.sleep(0.01)
        server.close()
        await asyncio.sleep(0.05)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    assert ready.wait(20.0)
    yield box['port'], box, seen
    stop.set()
    thread.join(20.0)
    assert not thread.is_alive()


@pytest.fixture
def client(served):
    client = ModbusTcpClient('127.0.0.1', port=served[0], timeout=20, retries=0)
    assert client.connect()
    yield client
    client.close()


def test_what_is_written_is_read(client, served):
    unit = {UNIT: 1}
    assert not client.write_registers(100, list(range(123)), **unit).isError()
    assert client.read_holding_registers(101, count=122, **unit).registers == list(range(1, 123))
    assert not client.write_register(10, 7, **unit).isError()
    assert client.read_input_registers(10, count=3, **unit).registers == [7, 0, 4711]
    assert served[2][0] == (16, 100, list(range(123))) and served[2][-1] == (4, 10, None)


@pytest.mark.parametrize(('request_', 'code'), [
    (lambda c, u: c.read_holding_registers(9, count=2, **u), 2),
    (lambda c, u: c.read_holding_registers(19, count=2, **u), 2),
    (lambda c, u: c.write_registers(10, [666], **u), ILLEGAL_VALUE),
    (lambda c, u: c.read_coils(10, count=1, **u), 1)])
def test_what_cannot_be_is_an_exception_of_the_protocol(client, request_, code):
    answer = request_(client, {UNIT: 1})
    assert answer.isError() and answer.exception_code == code


def exchange(port, data):
    """Everything that comes back for raw bytes until the server has answered or hung up."""
    with socket.create_connection(('127.0.0.1', port), timeout=20.0) as link:
        link.sendall(data)
        link.shutdown(socket.SHUT_WR)
        answer = b''
        while part := link.recv(4096):
            answer += part
    return answer


@pytest.mark.parametrize('data', [
    b'\xde\xad\xbe\xef' * 4,                       # another protocol
    struct.pack('>HHHB', 1, 0, 1, 0),              # nothing follows
    struct.pack('>HHHB', 1, 0, 255, 0) + b'\x03',  # longer than the protocol allows
    struct.pack('>HHHB', 1, 0, 6, 0) + b'\x03'])   # torn
def test_a_broken_frame_ends_the_connection_and_nothing_else(served, client, data):
    assert exchange(served[0], data) == b''
    assert client.read_holding_registers(12, count=1, **{UNIT: 1}).registers == [4711]


def test_a_short_request_is_an_illegal_value(served):
    answer = exchange(served[0], struct.pack('>HHHB', 5, 0, 3, 9) + b'\x03\x00')
    assert answer == struct.pack('>HHHB', 5, 0, 3, 9) + bytes([0x83, ILLEGAL_VALUE])


def test_a_fault_changes_the_answer(served):
    served[1]['instead'] = b'nonsense'
    assert exchange(served[0], struct.pack('>HHHBBHH', 1, 0, 6, 1, 3, 12, 1)) == b'nonsense'
