"""A virtual PSD behind a LabJack T7: Modbus registers, and stream packets on a second port.

The box's two outputs turn the beam of setups that regulate it.
"""

import asyncio
import struct
from pathlib import Path

import numpy as np

from stepdiag_ros.devices import t7
from stepdiag_ros.devices.psd_signal import SpotOptics
from stepdiag_ros.virtual.ahead import Ahead
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.faults import Faults
from stepdiag_ros.virtual.history import now_ns
from stepdiag_ros.virtual.modbus import ILLEGAL_VALUE, READ, ModbusServer
from stepdiag_ros.virtual.offline import DARK_V
from stepdiag_ros.virtual.serving import announce, open_world, serve
from stepdiag_ros.virtual.steering import SharedSteering
from stepdiag_ros.virtual.world import World

INPUTS = 14
TICK_S = 0.005
"""Shortest time between two looks for scans that are due; the next is when a packet is full."""
EARLY_S = 2e-4
"""By so much an event loop may wake too early."""
BACKLOG_BYTES = 1 << 22
"""What a client may leave unread before scans are skipped, as in the box's own buffer."""
BLOCKS = ((t7.AIN0, 2 * INPUTS), (t7.STREAM_SCANRATE_HZ, 26), (t7.CORE_TIMER, 2),
          (t7.STREAM_SCANLIST_ADDRESS0, 256), (t7.STREAM_ENABLE, 2), (t7.AIN0_RANGE, 2 * INPUTS),
          (t7.AIN0_NEGATIVE_CH, INPUTS), (t7.DAC0, 4), (t7.INTERNAL_FLASH_READ_POINTER, 2),
          (t7.INTERNAL_FLASH_READ, 82))
"""First register and number of registers of what is served."""


def core_timer(time_ns: int) -> int:
    """What the box's counter shows at a time."""
    return time_ns * int(t7.CORE_HZ) // 10**9 % 2**32


class Box:
    """Inputs, registers and stream of the box."""

    def __init__(self, cell: Cell, world: World, faults: Faults):
        self.cell, self.world, self.faults = cell, world, faults
        detector = cell.instruments.detector
        self._channels = detector.channels
        self._optics = SpotOptics(detector.length, detector.rotation, detector.gain, detector.zero)
        self._mirrors = detector.steering
        self._calibration = t7.Calibration()
        self._ahead = Ahead(world, round(world.clock_offset('psd') * 1e9))
        self._taken = 0            # scans so far: addresses their noise
        self.stream: Stream | None = None
        self.clients: set[asyncio.StreamWriter] = set()
        self.serving: set[asyncio.StreamWriter] = set()

    def volts(self, times: np.ndarray) -> np.ndarray:
        """(n, 14) [V]: all inputs at ``times`` (n,) [ns]."""
        self.world.history.follow()
        inputs = np.zeros((len(times), INPUTS))
        setup = self.world.setup_at(int(times[-1]))
        first, self._taken = self._taken, self._taken + len(times)
        inputs[:, self._channels] = DARK_V
        looks = setup is not None and self.cell.description.setups[setup].sees_spot
        if self._mirrors.inputs and self.world.steering is not None:
            inputs[:, self._mirrors.inputs] = self._mirrors.sensed_volts(self.world.steering.angles(times))
        if looks and self.faults.kind != 'no_signal':
            noise = self.world.spot
            reading = self._ahead.read(times - noise.delays_ns(first, len(times)), setup)
            spot = noise.readings(reading.spot, first)
            light = np.where(noise.dark(first, len(times)), 0.0, reading.intensity)
            inputs[:, self._channels] = np.maximum(self._optics.volts(spot, light), DARK_V)
        return inputs

    def raw(self, times: np.ndarray, channels: list[int]) -> np.ndarray:
        """(n, channels) raw readings, as streamed."""
        return self._calibration.raw(self.volts(times)[:, channels])

    async def access(self, function: int, address: int, registers: list[int], values: list[int] | None) -> int | None:
        """Before each access: bring registers up to date, act on what is written."""
        while self.faults.kind == 'stall':
            await asyncio.sleep(0.02)
        if function in READ:
            if address < t7.AIN0 + 2 * INPUTS:
                volts = self.volts(np.array([now_ns()]))[0].astype('>f4')
                registers[t7.AIN0:t7.AIN0 + 2 * INPUTS] = volts.view('>u2').tolist()
            elif address == t7.CORE_TIMER:
                registers[address:address + 2] = t7.uint_registers(core_timer(now_ns()))
            elif address == t7.INTERNAL_FLASH_READ:
                pointer = self._uint(registers, t7.INTERNAL_FLASH_READ_POINTER)
                if pointer != t7.CALIBRATION_ADDRESS:
                    return ILLEGAL_VALUE
                words = np.frombuffer(self._calibration.pack() * 8, '>u2').tolist()
                registers[address:address + len(words)] = words
        elif values and address == t7.STREAM_ENABLE:
            return self._enable(registers, values)
        elif values and address == t7.DAC0 and len(values) == 4 and isinstance(self.world.steering, SharedSteering):
            volts = t7.floats(values)
            if not np.isfinite(volts).all():
                return ILLEGAL_VALUE
            self.world.steering.steer(self._mirrors.commanded(volts))
        return None

    @staticmethod
    def _uint(registers: list[int], at: int) -> int:
        return (registers[at] << 16) | registers[at + 1]

    def _enable(self, registers: list[int], values: list[int]) -> int | None:
        if self.stream is not None:
            self.stream.task.cancel()
            self.stream = None
        if values[-1] == 0:
            return None

        def uint(address: int) -> int:
            return self._uint(registers, address)
        at = t7.STREAM_SCANRATE_HZ
        rate = struct.unpack('>f', struct.pack('>2H', *registers[at:at + 2]))[0]
        width, per_packet = uint(t7.STREAM_NUM_ADDRESSES), uint(t7.STREAM_SAMPLES_PER_PACKET)
        addresses = [uint(t7.STREAM_SCANLIST_ADDRESS0 + 2 * i) for i in range(min(width, 128))]
        if not (1 <= width <= 128 and 1.0e-3 < rate and rate * width <= 100_000.0
                and width <= per_packet <= t7.MAX_SAMPLES_PER_PACKET
                and uint(t7.STREAM_AUTO_TARGET) == t7.TARGET_ETHERNET
                and all(a % 2 == 0 and a < 2 * INPUTS for a in addresses)):
            return ILLEGAL_VALUE
        self.stream = Stream(self, rate, [a // 2 for a in addresses], per_packet // width)
        at = t7.STREAM_START_TIME_STAMP
        registers[at:at + 2] = t7.uint_registers(core_timer(self.stream.begin_ns))
        return None


class Stream:
    """Scans by the box's own clock, sent as packets to whoever listens on the stream port."""

    def __init__(self, box: Box, rate: float, channels: list[int], scans: int):
        self._box, self._rate, self._channels, self._scans = box, rate, channels, scans
        self.begin_ns = now_ns()
        self._done = self._sent = 0
        self.task = asyncio.ensure_future(self._run())

    async def _run(self) -> None:
        skipped = 0
        while True:
            full_s = (self._done + self._scans - 1) / self._rate - (now_ns() - self.begin_ns) * 1e-9
            await asyncio.sleep(max(TICK_S, full_s + EARLY_S))
            due = int((now_ns() - self.begin_ns) * 1e-9 * self._rate) + 1
            packets = (due - self._done) // self._scans
            if packets == 0:
                continue
            count = packets * self._scans
            fault = self._box.faults.kind
            if fault == 'stall' or any(c.transport.get_write_buffer_size() > BACKLOG_BYTES
                                       for c in self._box.clients):
                self._done += count
                skipped += count
                continue
            times = self.begin_ns + np.rint(
                (self._done + np.arange(count)) / self._rate * 1e9).astype(np.int64)
            raw = self._box.raw(times, self._channels).reshape(packets, -1)
            self._done += count
            self._send(raw, fault, skipped)
            skipped = 0

    def _send(self, raw: np.ndarray, fault: str | None, skipped: int) -> None:
        data = bytearray()
        for i, readings in enumerate(raw):
            status = t7.STATUS_RECOVERY_END if skipped and i == 0 else 0
            data += t7.pack_packet(self._sent, readings, status=status,
                                   additional=min(skipped, 0xFFFF) if status else 0)
            self._sent += 1
        for client in tuple(self._box.clients):
            if fault == 'drop':
                client.transport.abort()
            else:
                client.write(b'\xff' * 64 if fault == 'nonsense' else bytes(data))


async def main(cell: Cell, runtime: Path) -> None:
    world = await open_world(cell, runtime, steers=True)
    box = Box(cell, world, Faults(runtime, 'psd', cell.faults))

    async def listener(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        box.clients.add(writer)
        try:
            while await reader.read(4096):
                pass
        except (ConnectionError, asyncio.CancelledError):
            pass   # the client went, or we do
        finally:
            box.clients.discard(writer)
            writer.close()

    def tamper(answer: bytes) -> bytes:
        if box.faults.kind == 'drop':
            server.drop()
        return b'\xde\xad\xbe\xef' * 4 if box.faults.kind == 'nonsense' else answer

    where, stream_where = cell.instruments.psd, cell.instruments.psd_stream
    stream_server = await asyncio.start_server(listener, stream_where.host, stream_where.port)
    server = ModbusServer(BLOCKS, box.access, tamper)
    port = await server.start(where.host, where.port)
    announce(runtime, 'psd', {
        'host': where.host, 'port': port,
        'stream_port': stream_server.sockets[0].getsockname()[1]})
    try:
        async with stream_server:
            await stream_server.serve_forever()
    finally:
        server.close()


if __name__ == '__main__':
    raise SystemExit(serve('psd_server', main))
