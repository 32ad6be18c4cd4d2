"""What the three instrument servers share: start, announce, watch the parent, end.

Each server is a process of its own.  It finds the cell and the motion history in the
runtime directory, writes ``<name>.yaml`` with its address there once it listens, and
ends when its parent does.
"""

import argparse
import asyncio
import ctypes
import os
import signal
import socket
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import yaml

from stepdiag_ros.devices.link import SO_TIMESTAMPNS, receive_stamped
from stepdiag_ros.devices.timing import go_first
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import Cell, load_cell
from stepdiag_ros.virtual.history import SharedHistory, now_ns
from stepdiag_ros.virtual.sampled import SampledHistory
from stepdiag_ros.virtual.steering import SharedSteering
from stepdiag_ros.virtual.world import World

MOTION_FILE = 'motion.bin'
STEERING_FILE = 'steering.bin'
FAULT_FILE = 'faults.yaml'
ENDPOINTS_FILE = 'endpoints.yaml'
MOST_LINE = 1 << 16
"""Bytes without an end of line after which a client is hung up on."""
_PR_SET_PDEATHSIG = 1


def write_atomically(path: Path, text: str) -> None:
    """A reader sees the whole text or no file."""
    part = path.with_name(f'{path.name}.{os.getpid()}')
    part.write_text(text, encoding='utf-8')
    part.replace(path)


def announce(runtime: Path, name: str, address: dict) -> None:
    """Say where instrument ``name`` listens."""
    write_atomically(runtime / f'{name}.yaml', yaml.safe_dump(address))


def die_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM when the parent process ends."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        sys.exit(1)   # it ended before the kernel knew


async def open_world(cell: Cell, runtime: Path, timeout_s: float = 60.0, steers: bool = False) -> World:
    """The world of a running cell; waits for the control to have made the history.  ``steers``: this process turns the
    beam of setups that regulate it."""
    path = runtime / MOTION_FILE
    for _ in range(int(timeout_s / 0.02)):
        if path.exists():
            # A real control is watched; the virtual one says what it will do.
            history = SampledHistory(path) if cell.instruments.control == 'linuxcnc' else SharedHistory(path)
            if history.follow():
                world = World(cell, history, int(history.records['start_ns'][0]))
                if any(setup.regulated for setup in cell.description.setups.values()):
                    world.steering = SharedSteering(runtime / STEERING_FILE, steers)
                return world
        await asyncio.sleep(0.02)
    raise StepdiagError(f'{path}: no motion history after {timeout_s:g} s; '
                        'the control did not start, see its message')


class PromptProtocol(asyncio.Protocol):
    """A connection whose ``requested(data, arrived_ns)`` learns when data arrived at the computer.

    An instrument answers when it is asked; this process does when it gets the processor.  What it says of the
    machine is therefore what was so when the request arrived, which the kernel notes.
    """

    def connection_made(self, transport) -> None:
        self._transport = transport
        given = transport.get_extra_info('socket')
        # asyncio reads without the kernel's times: it is left the writing, a second descriptor is read here.
        self._socket = socket.socket(fileno=os.dup(given.fileno()))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._loop = asyncio.get_running_loop()
        self._loop.call_soon(self._begin)   # after asyncio has begun to read

    def _begin(self) -> None:
        if not self._transport.is_closing():
            self._transport.pause_reading()
            self._loop.add_reader(self._socket.fileno(), self._readable)

    def _readable(self) -> None:
        try:
            data, ago = receive_stamped(self._socket)
        except BlockingIOError:
            return
        except OSError:
            data, ago = b'', 0.0
        if data:
            self.requested(data, now_ns() - round(ago * 1e9))
        else:
            self._transport.close()
        if self._transport.is_closing():
            self.connection_lost(None)

    def data_received(self, data: bytes) -> None:
        """What asyncio read before reading was paused."""
        self.requested(data, now_ns())

    def requested(self, data: bytes, arrived_ns: int) -> None:
        raise NotImplementedError

    def connection_lost(self, _error: Exception | None) -> None:
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()


def serve(name: str, main: Callable[[Cell, Path], Awaitable[None]],
          arguments: list[str] | None = None) -> int:
    """A server's command line: ``CELL.yaml --runtime DIR --parent PID``; runs until SIGTERM."""
    parser = argparse.ArgumentParser(prog=f'stepdiag_ros.virtual.{name}',
                                     description=f'Serves the {name} of a virtual cell.')
    parser.add_argument('cell', help='cell file')
    parser.add_argument('--runtime', required=True, type=Path, help='directory shared by the servers')
    parser.add_argument('--parent', type=int, default=os.getppid(),
                        help='process with which this one ends')
    given = parser.parse_args(arguments)
    die_with_parent(given.parent)
    go_first()   # an instrument has a processor of its own
    # Ctrl-C reaches the whole foreground group; the parent decides what ends when.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        asyncio.run(_until_terminated(main(load_cell(given.cell), given.runtime)))
    except StepdiagError as error:
        print(f'stepdiag: {error}', file=sys.stderr)
        return 2
    except OSError as error:
        print(f'stepdiag: virtual {name}: {error.strerror or error}; '
              'choose another port or 0 for a free one', file=sys.stderr)
        return 2
    return 0


async def _until_terminated(work: Awaitable[None]) -> None:
    task = asyncio.ensure_future(work)
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
    try:
        await task
    except asyncio.CancelledError:
        pass
