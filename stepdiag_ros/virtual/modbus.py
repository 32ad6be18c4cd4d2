"""A Modbus TCP server for a virtual instrument: 16-bit registers, read and written in blocks.

Served are the functions 3 and 4 (read registers), 6 (write one) and 16 (write several) of *MODBUS
Application Protocol Specification V1.1b3*; everything else is answered by an exception, a broken header
ends the connection.  Of its own, because the library that the driver uses changes its servers with every
minor version, and an instrument must not change with the environment.
"""

import asyncio
import struct
from collections.abc import Awaitable, Callable, Sequence

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
READ = (3, 4)
WRITE_ONE, WRITE = 6, 16
MOST_READ, MOST_WRITTEN = 125, 123
HEADER = struct.Struct('>HHHB')
"""Transaction, protocol (0), length of what follows, unit."""
MOST_BYTES = 254

Access = Callable[[int, int, list[int], list[int] | None], Awaitable[int | None]]
"""``access(function, address, registers, values)`` before each access, all 65,536 ``registers`` at hand and to be
brought up to date; ``values`` are about to be written.  Returns an exception's code, or None."""


class ModbusServer:
    """Registers of ``blocks`` (first, number), each 0 at first.  ``tamper(data)`` may change each answer."""

    def __init__(self, blocks: Sequence[tuple[int, int]], access: Access, tamper: Callable[[bytes], bytes]):
        self.registers = [0] * 65536
        self._blocks, self._access, self._tamper = tuple(blocks), access, tamper
        self._connections: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None

    async def start(self, host: str, port: int) -> int:
        """Listen; returns the port (0 asks for a free one)."""
        self._server = await asyncio.start_server(self._serve, host, port)
        return self._server.sockets[0].getsockname()[1]

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
        self.drop()

    def drop(self) -> None:
        """End all connections at once."""
        for writer in tuple(self._connections):
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections.add(writer)
        try:
            while True:
                transaction, protocol, length, unit = HEADER.unpack(await reader.readexactly(HEADER.size))
                if protocol != 0 or not 2 <= length <= MOST_BYTES:
                    return
                answer = await self._answer(await reader.readexactly(length - 1))
                writer.write(self._tamper(HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer))
                await writer.drain()
        except (ConnectionError, asyncio.IncompleteReadError, asyncio.CancelledError):
            pass   # the client went, or we do
        finally:
            self._connections.discard(writer)
            writer.close()

    async def _answer(self, request: bytes) -> bytes:
        function = request[0]
        try:
            code, answer = await self._act(function, request[1:])
        except struct.error:
            code, answer = ILLEGAL_VALUE, b''
        return bytes([function | 0x80, code]) if code else bytes([function]) + answer

    async def _act(self, function: int, body: bytes) -> tuple[int | None, bytes]:
        """Code of an exception or None, and the answer's body."""
        if function not in (*READ, WRITE_ONE, WRITE):
            return ILLEGAL_FUNCTION, b''
        address, count = struct.unpack('>HH', body[:4])
        values = None
        if function == WRITE_ONE:
            values, count = [count], 1
        elif function == WRITE:
            values = list(struct.unpack(f'>{count}H', body[5:]))
        if not 1 <= count <= (MOST_READ if values is None else MOST_WRITTEN):
            return ILLEGAL_VALUE, b''
        if not any(first <= address and address + count <= first + number for first, number in self._blocks):
            return ILLEGAL_ADDRESS, b''
        code = await self._access(function, address, self.registers, values)
        if code is not None:
            return code, b''
        if values is None:
            return None, struct.pack(f'>B{count}H', 2 * count, *self.registers[address:address + count])
        self.registers[address:address + count] = values
        return None, body[:4]
