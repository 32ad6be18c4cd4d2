"""What all tests share: a ROS domain of one's own, the shared data, no process left behind."""

import fcntl
import gc
import os
import signal
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(Path(__file__).resolve().parent))

import turns  # noqa: E402
from participants import participants  # noqa: E402
from standstill import Standstills  # noqa: E402

from stepdiag_ros.nodes.environment import LOOPBACK_PROFILE  # noqa: E402

LEFT_S = 10.0    # for which processes and participants that a module leaves behind may still be about to end
DOMAINS = range(1, 101)  # above, Fast DDS's ports run into those that the kernel hands out
LOCKS = Path('/tmp') / f'stepdiag-ros-domains-{os.getuid()}'

# Nothing leaves this machine, and no shared-memory segment outlives a killed process.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(LOOPBACK_PROFILE)
os.environ.pop('ROS_STATIC_PEERS', None)
os.environ['MPLBACKEND'] = 'Agg'
# One thread for each worker, as the package has it; a test that imports numpy first would have as many as processors.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# Every process that a test starts inherits this mark, however far down it is started.
MARK_NAME = 'STEPDIAG_TEST_MARK'
MARK = uuid.uuid4().hex
os.environ[MARK_NAME] = MARK


@contextmanager
def held_domain(log_folder: Path) -> Iterator[int]:
    """Sets a ROS_DOMAIN_ID that nobody else on this machine has while the context lasts.

    The lock dies with its holder, so a killed test run leaves no domain taken.
    """
    LOCKS.mkdir(exist_ok=True)
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline:
        for domain in DOMAINS:
            with open(LOCKS / str(domain), 'w') as lock, pytest.MonkeyPatch.context() as patch:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                patch.setenv('ROS_DOMAIN_ID', str(domain))
                patch.setenv('ROS_LOG_DIR', str(log_folder))
                yield domain
                return
        time.sleep(0.2)
    pytest.fail(f'all ROS domains {DOMAINS.start} to {DOMAINS.stop - 1} are taken; see {LOCKS}')


@pytest.fixture
def ros_domain(tmp_path: Path) -> Iterator[int]:
    """A ROS domain of the test's own, set in the environment; ROS's log files go to its folder."""
    with held_domain(tmp_path / 'ros_log') as domain:
        yield domain


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(turns, 'turns')
    config.pluginmanager.register(Standstills(), 'standstills')


@pytest.fixture(scope='module')
def module_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """As `ros_domain`, for a graph that runs for all tests of a module."""
    with held_domain(tmp_path_factory.mktemp('ros_log')) as domain:
        yield domain


@pytest.fixture(scope='session')
def shared() -> Path:
    """The folder with field logs, measured stages and papers, which is not part of the repository."""
    place = Path(os.environ.get('STEPDIAG_SHARED', ROOT.parent / 'shared'))
    if not place.is_dir():
        pytest.skip(f'shared data missing: no folder {place} (set STEPDIAG_SHARED)')
    return place


def environment_of(entry: Path) -> bytes:
    """What a process was started with; one that is just being started has nothing for a moment."""
    for _ in range(20):
        environment = (entry / 'environ').read_bytes()
        if environment or not os.path.exists(entry / 'exe'):  # the kernel's own and the dead have no program
            break
        time.sleep(0.01)
    return environment


def marked_processes() -> dict[int, str]:
    """Command lines of the living processes that carry the mark, without this one."""
    found = {}
    for entry in Path('/proc').iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            environment = environment_of(entry)
            command = (entry / 'cmdline').read_bytes().replace(b'\0', b' ').decode(errors='replace').strip()
        except OSError:
            continue
        # Python's own helper of multiprocessing lives as long as its parent.
        if f'{MARK_NAME}={MARK}'.encode() in environment.split(b'\0') and 'multiprocessing.' not in command:
            found[int(entry.name)] = command
    return found


@pytest.fixture(scope='module', autouse=True)
def no_process_left() -> Iterator[None]:
    """Fails when a process that the module's tests started is still alive after them, and ends it; or when a node of
    theirs in this process was closed and its DDS participant goes on to discover those of later tests."""
    yield
    left = marked_processes()
    deadline = time.monotonic() + LEFT_S
    if participants():
        gc.collect()    # nodes lie in circles of references
    while (left or participants()) and time.monotonic() < deadline:
        time.sleep(0.1)
        left = marked_processes()
    for process in left:
        try:
            os.kill(process, signal.SIGKILL)
        except ProcessLookupError:
            continue
    assert not left, f'processes left behind: {left}'
    assert not participants(), f'{participants()} participants of DDS are left in this process'
