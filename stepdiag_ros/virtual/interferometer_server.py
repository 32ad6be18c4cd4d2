"""A virtual attocube IDS3010: JSON-RPC 2.0 over TCP, with and without newlines.

A position is that of the moment at which its request arrived; requests that wait for the process together are answered
with the position when the last of them arrived, as an instrument with a queue does.

Where a cell shares its interferometer, an optical switch on a port of its own (SCPI)
routes the laser to one machine's world or another's.
"""

import asyncio
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from stepdiag_ros.devices.jsonstream import JsonStream
from stepdiag_ros.virtual.ahead import Ahead
from stepdiag_ros.virtual.air import environment
from stepdiag_ros.virtual.cell import Cell, load_cell
from stepdiag_ros.virtual.draw import normals
from stepdiag_ros.virtual.faults import Faults
from stepdiag_ros.virtual.history import now_ns
from stepdiag_ros.virtual.offline import SENSOR_SIGMA
from stepdiag_ros.virtual.serving import MOST_LINE, PromptProtocol, announce, open_world, serve
from stepdiag_ros.virtual.world import World

AXES = 3
METHOD_NOT_FOUND = {'code': -32601, 'message': 'Method not found'}
INVALID_REQUEST = {'code': -32600, 'message': 'Invalid Request'}
NO_SIGNAL_WARNING = 1001
ECU_ERROR = 1002


class Instrument:
    """The state of the instrument, whoever is connected."""

    def __init__(self, cell: Cell, world: World, faults: Faults):
        self.cell, self.world, self.faults = cell, world, faults
        self._ahead = Ahead(world, round(world.clock_offset('interferometer') * 1e9))
        self._measuring = False
        self._taken = 0                # samples so far: addresses their noise
        self._ecu_read = 0
        self._arrived_ns = now_ns()
        self._reference = np.zeros(AXES)
        prefix = f'com.attocube.{cell.instruments.namespace}.'
        self.fast = prefix + 'displacement.getAbsolutePositions'
        self._methods = {
            prefix + 'system.getCurrentMode': self._mode,
            prefix + 'system.startMeasurement': self._start,
            prefix + 'system.stopMeasurement': self._stop,
            prefix + 'system.resetAxes': self._reset,
            prefix + 'displacement.getAxesDisplacement':
                lambda params: [*self._positions(1, self._reference)[0]],
            prefix + 'displacement.getReferencePositions':
                lambda params: [0, *np.rint(self._reference).astype(int).tolist()],
            prefix + 'displacement.getAxisSignalQuality': self._quality,
            prefix + 'adjustment.getContrastInPermille': lambda params: [*self._quality(params), 0],
            'com.attocube.ecu.getConnected': lambda params: [0, bool(cell.air.sensors)],
            'com.attocube.ecu.getTemperatureInDegrees':
                lambda params: self._ecu('temperature', 'air_temperature', 1.0),
            'com.attocube.ecu.getPressureInHPa':
                lambda params: self._ecu('pressure', 'air_pressure', 0.01),
            'com.attocube.ecu.getHumidityInPercent':
                lambda params: self._ecu('humidity', 'humidity', 100.0),
            'com.attocube.ecu.getRefractiveIndex': lambda params: [0, self._index()],
            'com.attocube.ecu.getRefractiveIndexForCompensation':
                lambda params: [0, self._index() if cell.air.compensated else 1.0],
            'com.attocube.system.getDeviceType': lambda params: [0, 'IDS3010'],
            'com.attocube.system.getFirmwareVersion':
                lambda params: [0, '1.9.0' if cell.instruments.namespace == 'sen' else '1.8.0'],
        }

    def route(self, world: World) -> None:
        """From now on look at another machine."""
        self.world, self.cell = world, world.cell
        self._ahead = Ahead(world, round(world.clock_offset('interferometer') * 1e9))

    def answer(self, requests: list[Any], arrived_ns: int) -> list[dict]:
        """Responses to requests of which the last arrived at ``arrived_ns``, in their order."""
        self._arrived_ns = arrived_ns
        answers, pending = [], []
        for request in requests:
            if isinstance(request, dict) and request.get('method') == self.fast:
                pending.append(request.get('id'))
                continue
            answers += self._sampled(pending)
            pending = []
            answers.append(self._one(request))
        return answers + self._sampled(pending)

    def _one(self, request: Any) -> dict:
        if not isinstance(request, dict) or not isinstance(request.get('method'), str):
            number = request.get('id') if isinstance(request, dict) else None
            return {'jsonrpc': '2.0', 'id': number, 'error': INVALID_REQUEST}
        method = self._methods.get(request['method'])
        reply = {'jsonrpc': '2.0', 'id': request.get('id')}
        if method is None:
            return reply | {'error': METHOD_NOT_FOUND}
        try:
            return reply | {'result': method(request.get('params') or [])}
        except (TypeError, ValueError, LookupError, OverflowError):
            return reply | {'error': {'code': -32602, 'message': 'Invalid params'}}

    def _sampled(self, numbers: list) -> list[dict]:
        if not numbers:
            return []
        return [{'jsonrpc': '2.0', 'id': number, 'result': row}
                for number, row in zip(numbers, self._positions(len(numbers)), strict=True)]

    def _positions(self, count: int, zero: np.ndarray | None = None) -> list[list[int]]:
        """``[warning, pm, pm, pm]`` of ``count`` samples, absolute or from ``zero`` [pm]."""
        self.world.history.follow()
        times = np.full(count, self._arrived_ns)
        setup = self.world.setup_at(int(times[-1]))
        first, self._taken = self._taken, self._taken + count
        rows = np.zeros((count, 1 + AXES))
        if setup is None or not self._measuring or self.faults.kind == 'no_signal':
            rows[:, 0] = NO_SIGNAL_WARNING
            return rows.astype(np.int64).tolist()
        noise = self.world.displacement
        reading = self._ahead.read(times - noise.delays_ns(first, count), setup)
        beams = reading.length.shape[1]
        rows[:, 1:1 + beams] = noise.readings(reading.length, first) * 1e12
        if zero is not None:
            rows[:, 1:1 + beams] -= zero[:beams]
        rows[:, 0] = np.where((reading.quality < 1.0) | noise.dark(first, count), NO_SIGNAL_WARNING, 0)
        return np.rint(rows).astype(np.int64).tolist()

    def _now(self) -> np.ndarray:
        self.world.history.follow()
        return np.array([self._arrived_ns])

    def _mode(self, params: list) -> list:
        return [0, 'measurement running' if self._measuring else 'system idle']

    def _start(self, params: list) -> list:
        self._measuring = True
        return [0]

    def _stop(self, params: list) -> list:
        self._measuring = False
        return [0]

    def _reset(self, params: list) -> list:
        now = self._now()
        setup = self.world.setup_at(int(now[0]))
        if setup is not None:
            length = self._ahead.read(now, setup).length[0]
            self._reference[:len(length)] = length * 1e12
        return [0]

    def _quality(self, params: list) -> list:
        """``[warning, contrast, baseline]`` in per mille."""
        if int(params[0]) not in range(AXES):
            raise ValueError('axis')
        now = self._now()
        setup = self.world.setup_at(int(now[0]))
        if setup is None or self.faults.kind == 'no_signal':
            return [NO_SIGNAL_WARNING, 0, 0]
        contrast = round(10.0 * float(self._ahead.read(now, setup).quality[0]))
        return [0, contrast, (1000 - contrast) // 2]

    def _seconds(self) -> float:
        return (now_ns() - self.world.epoch_ns) * 1e-9

    def _ecu(self, sensor: str, stream: str, scale: float) -> list:
        if sensor not in self.cell.air.sensors:
            return [ECU_ERROR]
        value = float(environment(self.cell.air, self._seconds(), self.world.effects)[stream][0])
        value += SENSOR_SIGMA[stream] * normals(self.cell.seed, f'ecu/{stream}', self._ecu_read,
                                                1)[0, 0]
        self._ecu_read += 1
        return [0, value * scale]

    def _index(self) -> float:
        if not self.cell.air.sensors:
            return 1.0
        return float(self.world.index(np.array([self._seconds()]))[0])


class Connection(PromptProtocol):
    """One client."""

    def __init__(self, instrument: Instrument):
        self._instrument = instrument
        self._stream = JsonStream()
        self._end = '\n' if instrument.cell.instruments.newline else ''

    def requested(self, data: bytes, arrived_ns: int) -> None:
        fault = self._instrument.faults.kind
        if fault == 'stall':
            return
        if fault == 'drop':
            self._transport.abort()
            return
        if fault == 'nonsense':
            self._transport.write(b'HTTP/1.1 418 I am a teapot\r\n\r\n')
            return
        try:
            requests = self._stream.feed(data)
        except ValueError:
            self._transport.abort()   # as the device does with what is not JSON
            return
        self._transport.write(''.join(
            _encode(answer) + self._end for answer in self._instrument.answer(requests, arrived_ns)).encode())


def _encode(answer: dict) -> str:
    result = answer.get('result')
    if result is not None and len(result) == 1 + AXES and type(result[1]) is int:
        return f'{{"jsonrpc":"2.0","result":{result},"id":{_json(answer["id"])}}}'
    return _json(answer)


def _json(value: Any) -> str:
    return json.dumps(value, separators=(',', ':'))


class Switch(asyncio.Protocol):
    """One client of the optical switch: channel n is the n-th machine."""

    def __init__(self, instrument: Instrument, worlds: list[World]):
        self._instrument, self._worlds = instrument, worlds
        self._rest = b''

    def connection_made(self, transport) -> None:
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b'\n')
        if len(self._rest) > MOST_LINE:
            self._transport.abort()
            return
        for line in lines:
            self._command(line.decode('ascii', 'replace').strip().upper())

    def _command(self, line: str) -> None:
        wanted = re.fullmatch(r'ROUT(?:E)?:CLOS(?:E)?\s*\(@(\d{1,6})\)', line)
        if wanted and 1 <= int(wanted.group(1)) <= len(self._worlds):
            self._instrument.route(self._worlds[int(wanted.group(1)) - 1])
        elif re.fullmatch(r'ROUT(?:E)?:CLOS(?:E)?\?', line):
            channel = self._worlds.index(self._instrument.world) + 1
            self._transport.write(b'(@%d)\n' % channel)
        elif line == '*IDN?':
            self._transport.write(b'stepdiag_ros,virtual optical switch,0,1\n')


async def open_switch(cell: Cell, runtime: Path, instrument: Instrument) -> None:
    """Serve the optical switch in front of the machines that share the instrument."""
    worlds = [instrument.world]
    for file in cell.instruments.machine_files:
        other = load_cell(file)
        worlds.append(await open_world(other, runtime / other.description.machine.name))
    where = cell.instruments.switch
    server = await asyncio.get_running_loop().create_server(
        lambda: Switch(instrument, worlds), where.host, where.port)
    announce(runtime, 'switch', {
        'host': where.host, 'port': server.sockets[0].getsockname()[1],
        'channels': {name: i + 1 for i, name in enumerate(cell.instruments.multiplexer)}})


async def main(cell: Cell, runtime: Path) -> None:
    # In a hall every machine has a folder of its own, the first too.
    own = runtime / cell.description.machine.name
    world = await open_world(cell, own if own.is_dir() else runtime)
    instrument = Instrument(cell, world, Faults(runtime, 'interferometer', cell.faults))
    if cell.instruments.multiplexer:
        await open_switch(cell, runtime, instrument)
    where = cell.instruments.interferometer
    server = await asyncio.get_running_loop().create_server(
        lambda: Connection(instrument), where.host, where.port)
    port = server.sockets[0].getsockname()[1]
    announce(runtime, 'interferometer', {'host': where.host, 'port': port})
    async with server:
        await server.serve_forever()


if __name__ == '__main__':
    raise SystemExit(serve('interferometer_server', main))
