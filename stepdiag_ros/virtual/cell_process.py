"""The virtual cell as processes: ``python -m stepdiag_ros.virtual.cell_process CELL.yaml --runtime DIR``.

Starts interferometer, PSD and control, writes ``DIR/endpoints.yaml`` when all three
listen, and ends them on SIGTERM or Ctrl-C.  Where machines share the interferometer
(``multiplexer``), the others' controls and PSDs are started too, each in ``DIR/<machine>``
with its own ``endpoints.yaml``; ``--instruments`` starts some of them alone, as a hall does.
If one of them dies the others are ended too and the exit status is 2.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.files import real
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.linuxcnc.running import wait_until_free
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.serving import (
    ENDPOINTS_FILE,
    FAULT_FILE,
    MOTION_FILE,
    STEERING_FILE,
    write_atomically,
)
from stepdiag_ros.virtual.truth import truth

SERVERS = {'cnc': 'cnc_server', 'interferometer': 'interferometer_server', 'psd': 'psd_server'}
OWN = ('cnc', 'psd')
"""What each of several machines has to itself."""
START_TIMEOUT_S = 240.0
GRACE_S = 3.0
LINUXCNC_GRACE_S = 12.0
"""A real control takes its own time to end."""


class CellProcess:
    """The servers of a cell; a context manager."""

    def __init__(self, cell_path: Path, runtime: Path, instruments: tuple[str, ...] = tuple(SERVERS)):
        self._cell_path, self._runtime = Path(cell_path), Path(runtime)
        self._children: dict[str, subprocess.Popen] = {}
        self._grace_s = GRACE_S
        self._servers = {name: SERVERS[name] for name in instruments}
        self._beside: dict[str, Path] = {}    # runtime directories of the machines that share

    def start(self) -> dict:
        """Start the servers; returns the endpoints once all listen."""
        # Complain here, in one line, and not from three children.
        instruments = load_cell(self._cell_path).instruments
        whole = len(self._servers) == len(SERVERS)
        if instruments.control == 'linuxcnc' and 'cnc' in self._servers:
            self._servers['cnc'], self._grace_s = 'linuxcnc_server', LINUXCNC_GRACE_S
            wait_until_free(lambda text: print(f'stepdiag: {text}', file=sys.stderr, flush=True))
        self._beside = {name: self._runtime / name for name in instruments.multiplexer[1:]} if whole else {}
        for folder in (self._runtime, *self._beside.values()):
            folder.mkdir(parents=True, exist_ok=True)
            self._clean(folder)
        for name in self._servers:
            self._spawn(name, name, self._cell_path, self._runtime)
        for file, (machine, folder) in zip(instruments.machine_files, self._beside.items(),
                                           strict=whole):
            for name in OWN:
                self._spawn(f'{name} of {machine}', name, Path(file), folder)
        endpoints = {name: self._wait_for(name, self._runtime) for name in self._servers}
        if instruments.multiplexer and 'interferometer' in self._servers:
            endpoints['switch'] = self._wait_for('switch', self._runtime)
        for file, (machine, folder) in zip(instruments.machine_files, self._beside.items(),
                                           strict=whole):
            shared = {name: endpoints[name] for name in ('interferometer', 'switch')}
            self._tell(folder, shared | {name: self._wait_for(name, folder) for name in OWN}, file)
            endpoints.setdefault('machines', {})[machine] = str(folder / ENDPOINTS_FILE)
        return self._tell(self._runtime, endpoints, self._cell_path)

    def _spawn(self, title: str, name: str, cell: Path, runtime: Path) -> None:
        self._children[title] = subprocess.Popen(
            [sys.executable, '-m', f'stepdiag_ros.virtual.{self._servers[name]}', str(cell),
             '--runtime', str(runtime), '--parent', str(os.getpid())])

    def _tell(self, runtime: Path, endpoints: dict, cell: str | Path) -> dict:
        stated = endpoints | {'cell': str(real(cell)), 'pid': os.getpid()}
        write_atomically(runtime / ENDPOINTS_FILE, yaml.safe_dump(stated, sort_keys=False))
        return stated

    def _wait_for(self, name: str, runtime: Path) -> dict:
        path, end = runtime / f'{name}.yaml', time.monotonic() + START_TIMEOUT_S
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
        end = time.monotonic() + self._grace_s
        for child in self._children.values():
            try:
                child.wait(max(0.01, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        self._children = {}
        self._clean(self._runtime)
        for folder in self._beside.values():
            self._clean(folder)
            try:
                folder.rmdir()
            except OSError:
                pass   # somebody keeps something there, or it was never made
        self._beside = {}

    @staticmethod
    def _clean(runtime: Path) -> None:
        for name in (ENDPOINTS_FILE, MOTION_FILE, STEERING_FILE, FAULT_FILE, 'switch.yaml',
                     *(f'{n}.yaml' for n in SERVERS)):
            (runtime / name).unlink(missing_ok=True)

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
    parser.add_argument('--instruments', nargs='+', choices=tuple(SERVERS), default=tuple(SERVERS),
                        help='those to start (default: all)')
    parser.add_argument('--truth', type=Path, metavar='FILE',
                        help="write the machine's true errors there, as JSON")
    given = parser.parse_args(arguments)
    ended: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda received, _frame: ended.append(received))
    runtime = given.runtime or Path(tempfile.mkdtemp(prefix='stepdiag-cell-'))
    try:
        with CellProcess(given.cell, runtime, tuple(given.instruments)) as cell:
            endpoints = cell.start()
            if given.truth is not None:
                write_atomically(given.truth, to_json(truth(load_cell(given.cell))))
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
