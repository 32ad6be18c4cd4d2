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
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import Cell, load_cell
from stepdiag_ros.virtual.history import SharedHistory
from stepdiag_ros.virtual.sampled import SampledHistory
from stepdiag_ros.virtual.world import World

MOTION_FILE = 'motion.bin'
FAULT_FILE = 'faults.yaml'
ENDPOINTS_FILE = 'endpoints.yaml'
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


async def open_world(cell: Cell, runtime: Path, timeout_s: float = 60.0) -> World:
    """The world of a running cell; waits for the control to have made the history."""
    path = runtime / MOTION_FILE
    for _ in range(int(timeout_s / 0.02)):
        if path.exists():
            # A real control is watched; the virtual one says what it will do.
            history = SampledHistory(path) if cell.instruments.control == 'linuxcnc' else SharedHistory(path)
            if history.follow():
                return World(cell, history, int(history.records['start_ns'][0]))
        await asyncio.sleep(0.02)
    raise StepdiagError(f'{path}: no motion history after {timeout_s:g} s; '
                        'the control did not start, see its message')


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
