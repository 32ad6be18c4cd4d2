"""The virtual cell as processes: ``python -m stepdiag_ros.virtual.cell_process CELL.yaml --runtime DIR``.

Starts interferometer, PSD and control, writes ``DIR/endpoints.yaml`` when all three
listen, and ends them on SIGTERM or Ctrl-C.  If one of them dies the others are ended
too and the exit status is 2.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.serving import (
    ENDPOINTS_FILE,
    FAULT_FILE,
    MOTION_FILE,
    write_atomically,
)
from stepdiag_ros.virtual.truth import truth

SERVERS = {'cnc': 'cnc_server', 'interferometer': 'interferometer_server', 'psd': 'psd_server'}
START_TIMEOUT_S = 60.0
GRACE_S = 3.0


class CellProcess:
    """The three servers of a cell; a context manager."""

    def __init__(self, cell_path: Path, runtime: Path):
        self._cell_path, self._runtime = Path(cell_path), Path(runtime)
        self._children: dict[str, subprocess.Popen] = {}

    def start(self) -> dict:
        """Start the servers; returns the endpoints once all listen."""
        load_cell(self._cell_path)   # complain here, in one line, and not from three children
        self._runtime.mkdir(parents=True, exist_ok=True)
        self._clean()
        for name, module in SERVERS.items():
            self._children[name] = subprocess.Popen(
                [sys.executable, '-m', f'stepdiag_ros.virtual.{module}', str(self._cell_path),
                 '--runtime', str(self._runtime), '--parent', str(os.getpid())])
        endpoints = {name: self._wait_for(name) for name in SERVERS}
        endpoints |= {'cell': str(self._cell_path.resolve()), 'pid': os.getpid()}
        write_atomically(self._runtime / ENDPOINTS_FILE, yaml.safe_dump(endpoints, sort_keys=False))
        return endpoints

    def _wait_for(self, name: str) -> dict:
        path, end = self._runtime / f'{name}.yaml', time.monotonic() + START_TIMEOUT_S
        while not path.exists():
            dead = self.dead()
            if dead:
                raise StepdiagError(f'{self._cell_path}: the virtual {dead} did not start; '
                                    'see its message above')
            if time.monotonic() > end:
                raise StepdiagError(f'{self._cell_path}: the virtual {name} does not listen after '
                                    f'{START_TIMEOUT_S:g} s; is the computer overloaded?')
            time.sleep(0.02)
        return yaml.safe_load(path.read_text(encoding='utf-8'))

    def dead(self) -> str | None:
        """The name of a server that has ended, if there is one."""
        return next((name for name, child in self._children.items()
                     if child.poll() is not None), None)

    def stop(self) -> None:
        """End the servers and take their files away."""
        for child in self._children.values():
            if child.poll() is None:
                child.terminate()
        end = time.monotonic() + GRACE_S
        for child in self._children.values():
            try:
                child.wait(max(0.01, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        self._children = {}
        self._clean()

    def _clean(self) -> None:
        for name in (ENDPOINTS_FILE, MOTION_FILE, FAULT_FILE, *(f'{n}.yaml' for n in SERVERS)):
            (self._runtime / name).unlink(missing_ok=True)

    def __enter__(self) -> 'CellProcess':
        return self

    def __exit__(self, *exception) -> None:
        self.stop()


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog='python -m stepdiag_ros.virtual.cell_process',
        description='Run a virtual cell: interferometer, PSD and control on loopback.')
    parser.add_argument('cell', type=Path, help='cell file, e.g. cells/demo.yaml')
    parser.add_argument('--runtime', type=Path,
                        help='directory for endpoints.yaml (default: a new temporary one)')
    parser.add_argument('--truth', type=Path, metavar='FILE',
                        help="write the machine's true errors there, as JSON")
    given = parser.parse_args(arguments)
    ended: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda received, _frame: ended.append(received))
    runtime = given.runtime or Path(tempfile.mkdtemp(prefix='stepdiag-cell-'))
    try:
        with CellProcess(given.cell, runtime) as cell:
            endpoints = cell.start()
            if given.truth is not None:
                write_atomically(given.truth, json.dumps(truth(load_cell(given.cell)), indent=1))
            print(yaml.safe_dump(endpoints, sort_keys=False), end='', flush=True)
            while not ended:
                time.sleep(0.1)
                if (dead := cell.dead()) and not ended:
                    raise StepdiagError(f'{given.cell}: the virtual {dead} ended by itself; '
                                        'the cell is stopped')
    except StepdiagError as error:
        print(f'stepdiag: {error}', file=sys.stderr)
        return 2
    finally:
        if given.runtime is None:
            try:
                runtime.rmdir()
            except OSError:
                pass   # somebody keeps something there
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
