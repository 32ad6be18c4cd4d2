"""Starts and stops LinuxCNC without a screen.

LinuxCNC refuses to run as root; started by root it runs as ``nobody``, from a copy of its configuration.
Its shared memory allows one at a time on a computer.
"""

import fcntl
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

from stepdiag_ros.errors import StepdiagError

USER, GROUP = 'nobody', 'nogroup'
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
WAIT_FOR_LOCK_S = 300.0


def missing() -> str:
    """What has to be installed before LinuxCNC can run; empty when nothing is missing."""
    for program in ('linuxcnc', 'linuxcncrsh'):
        if shutil.which(program) is None:
            return f'{program} is not installed; on Debian: sudo apt-get install linuxcnc-uspace'
    return ''


def free_port() -> int:
    """A TCP port on the loopback interface that nobody listens on."""
    with socket.create_server(('127.0.0.1', 0)) as probe:
        return probe.getsockname()[1]


class LinuxCnc:
    """One LinuxCNC, run from a copy of ``configuration`` (a folder with ``machine.ini``); a context manager.

    ``port``: where its linuxcncrsh listens.  ``folder``: the copy; it goes with :meth:`stop`.
    """

    def __init__(self, configuration: Path, port: int | None = None):
        lack = missing()
        if lack:
            raise StepdiagError(lack)
        self.port = free_port() if port is None else port
        self.folder = Path(tempfile.mkdtemp(prefix='stepdiag-linuxcnc-'))
        self._process: subprocess.Popen | None = None
        self._lock = open(Path(tempfile.gettempdir()) / f'stepdiag-linuxcnc-{os.getuid()}', 'w')
        try:
            shutil.copytree(configuration, self.folder, dirs_exist_ok=True)
            self._wait_for_lock()
        except BaseException:
            self._lock.close()
            shutil.rmtree(self.folder, ignore_errors=True)
            raise

    def _wait_for_lock(self) -> None:
        end = time.monotonic() + WAIT_FOR_LOCK_S
        while True:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if time.monotonic() > end:
                    raise StepdiagError('another LinuxCNC runs on this computer, and only one can; '
                                        'end it') from None
                time.sleep(0.2)

    def start(self) -> None:
        """Start, and wait until the control listens."""
        whom = {}
        if os.getuid() == 0:
            whom = {'user': USER, 'group': GROUP, 'extra_groups': []}
            for path in (self.folder, *self.folder.rglob('*')):
                shutil.chown(path, USER, GROUP)
        with open(self.folder / 'log', 'w') as log:
            self._process = subprocess.Popen(
                ['linuxcnc', str(self.folder / 'machine.ini')], cwd=self.folder,
                env=os.environ | {'HOME': str(self.folder), 'STEPDIAG_PORT': str(self.port)},
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True, **whom)
        end = time.monotonic() + START_TIMEOUT_S
        while True:
            if self._process.poll() is not None or time.monotonic() > end:
                raise StepdiagError(f'LinuxCNC does not start: {self.last_words()}')
            try:
                socket.create_connection(('127.0.0.1', self.port), 1.0).close()
                return
            except OSError:
                time.sleep(0.1)

    def last_words(self) -> str:
        """The end of what LinuxCNC wrote."""
        try:
            lines = (self.folder / 'log').read_text(errors='replace').strip().splitlines()
        except OSError:
            return ''
        said = [line for line in lines if 'error' in line.lower() or 'wrong' in line] or lines
        return ' | '.join(said[-3:])

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def stop(self) -> None:
        """End its display; LinuxCNC's own script then takes the rest down."""
        if self._process is not None and self._process.poll() is None:
            try:
                os.kill(int((self.folder / 'pid').read_text()), signal.SIGTERM)
            except (FileNotFoundError, ProcessLookupError, ValueError):
                self._process.terminate()
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
        self._lock.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> 'LinuxCnc':
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *exception) -> None:
        self.stop()
