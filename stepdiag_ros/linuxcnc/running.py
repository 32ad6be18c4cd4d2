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
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from stepdiag_ros.errors import StepdiagError

USER, GROUP = 'nobody', 'nogroup'
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
WAIT_FOR_LOCK_S = 900.0
BEFORE_OTHERS = -10
"""Its niceness: ten times the share of ordinary work, and the processor as soon as it wakes."""
PREFIX = 'stepdiag-linuxcnc-'


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


def end_display(folder: Path) -> bool:
    """End the display of the LinuxCNC that runs in a folder, with which all of it ends; whether there was one."""
    try:
        os.kill(int((folder / 'pid').read_text()), signal.SIGTERM)
    except (OSError, ValueError):
        return False
    return True


def _runs_in(folder: Path) -> list[int]:
    """Processes whose command names a folder."""
    found = []
    for entry in Path('/proc').glob('[0-9]*'):
        try:
            command = (entry / 'cmdline').read_bytes()
        except OSError:
            continue
        if str(folder).encode() in command:
            found.append(int(entry.name))
    return found


def _lock() -> TextIO:
    """The file whose lock the one that runs has."""
    return open(Path(tempfile.gettempdir()) / f'stepdiag-linuxcnc-{os.getuid()}', 'a+')


def _take(lock: TextIO, say: Callable[[str], object]) -> None:
    """Wait for the lock."""
    end, said = time.monotonic() + WAIT_FOR_LOCK_S, False
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() > end:
                raise StepdiagError('another LinuxCNC runs on this computer, and only one can; '
                                    'end it') from None
            if not said:
                say('another LinuxCNC runs on this computer, and only one can; waiting for its end')
                said = True
            time.sleep(0.2)


def wait_until_free(say: Callable[[str], object] = lambda text: None) -> None:
    """Wait until none of ours runs on this computer, before anything is started that must not be kept waiting."""
    with _lock() as lock:
        _take(lock, say)


class LinuxCnc:
    """One LinuxCNC, run from a copy of ``configuration`` (a folder with ``machine.ini``); a context manager.

    ``port``: where its linuxcncrsh listens.  ``folder``: the copy, removed by :meth:`stop`.
    """

    def __init__(self, configuration: Path, port: int | None = None):
        lack = missing()
        if lack:
            raise StepdiagError(lack)
        self.port = free_port() if port is None else port
        self.folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        self._process: subprocess.Popen | None = None
        self._lock = _lock()
        try:
            shutil.copytree(configuration, self.folder, dirs_exist_ok=True)
            _take(self._lock, lambda text: None)
            self._clear_up()
        except BaseException:
            self._lock.close()
            shutil.rmtree(self.folder, ignore_errors=True)
            raise

    def _clear_up(self) -> None:
        """End a LinuxCNC whose owner was killed before it could: the lock's file says where it ran."""
        self._lock.seek(0)
        left = Path(self._lock.read().strip() or os.devnull)
        if left.is_dir() and left.name.startswith(PREFIX):
            end_display(left)
            until = time.monotonic() + STOP_TIMEOUT_S
            while _runs_in(left) and time.monotonic() < until:
                time.sleep(0.2)
            for pid in _runs_in(left):
                os.kill(pid, signal.SIGKILL)
            shutil.rmtree(left, ignore_errors=True)
        self._lock.truncate(0)
        self._lock.write(str(self.folder))
        self._lock.flush()

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
        self._before_others()
        end = time.monotonic() + START_TIMEOUT_S
        while True:
            if self._process.poll() is not None or time.monotonic() > end:
                raise StepdiagError(f'LinuxCNC does not start: {self.last_words()}')
            try:
                socket.create_connection(('127.0.0.1', self.port), 1.0).close()
                return
            except OSError:
                time.sleep(0.1)

    def _before_others(self) -> None:
        """A control has a computer of its own: here it goes before other work, where the system allows that.

        On a busy computer its servo cycles would come in bursts, some tens of milliseconds apart, and its drives with
        them.  What it starts inherits this.
        """
        try:
            os.setpriority(os.PRIO_PROCESS, self._process.pid, BEFORE_OTHERS)
        except OSError:
            pass    # root alone may

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
            if not end_display(self.folder):
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
