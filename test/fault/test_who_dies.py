"""Who dies, and what the machine does: each row of docs/reference/who_dies.md, with real processes.

What the machine does is read from the virtual control's own record of its motion, or from what a HAL component sees of
the joints of a real LinuxCNC.
"""

import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.nodes import environment
from stepdiag_ros.nodes.patience import Patience
from test.some import some

environment.prepare()

from stepdiag_ros.errors import StepdiagError  # noqa: E402 - after the environment
from stepdiag_ros.linuxcnc import install  # noqa: E402
from stepdiag_ros.linuxcnc.running import missing  # noqa: E402
from stepdiag_ros.nodes.bringup import Bringup  # noqa: E402
from stepdiag_ros.virtual.history import SharedHistory, now_ns  # noqa: E402
from stepdiag_ros.virtual.sampled import SampledHistory  # noqa: E402
from stepdiag_ros.virtual.serving import MOTION_FILE  # noqa: E402

#: A move of lin_x takes ten seconds.
CELL = """
schema: 1
seed: 7
machine: {{name: slow, chain: FXYZ, volume: [0.20, 0.16, 0.12], tool: [0.0, 0.0, -0.10]}}
plan: {{steps: 1, order: XYZ, repeats: 1}}
setups:
  lin_x: {{standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.20, stops: 2}}
air: {{period: 1.0}}
motion: {{feed: 0.02, acceleration: 2.0, jerk: 100.0, in_position: 5.0e-8, settling: 0.002, dwell: 0.2}}
instruments: {{cnc: {{watchdog: {watchdog}, control: {control}}}}}
client: {{lease: {lease}, lost: {lost}}}
sampling: {{interferometer: 200.0, psd: 200.0, block: 0.05}}
"""
MOVE_S = 10.0
STEPDIAG = [sys.executable, '-m', 'stepdiag_ros.cli.main']


def write_cell(folder: Path, watchdog: float = 0.5, lease: float = 2.0, lost: str = 'next_stop',
               control: str = 'virtual') -> Path:
    path = folder / 'slow.yaml'
    path.write_text(CELL.format(watchdog=watchdog, lease=lease, lost=lost, control=control), encoding='utf-8')
    return path


class Machine:
    """The control's motion, as it was written down."""

    def __init__(self, runtime: Path, history: type[SharedHistory] | type[SampledHistory] = SharedHistory):
        self._history = history(runtime / MOTION_FILE)

    def x(self) -> float:
        """Where X is now [m]."""
        if not self._history.follow():
            return 0.0
        return float(self._history.locate(np.array([now_ns()]), 0.002)[1][0, 0])

    def seen(self) -> np.ndarray:
        """Where the joints of a LinuxCNC were seen, oldest first."""
        return self._history._seen[self._history._seen['time_ns'] > 0]

    def moving(self) -> bool:
        before = self.x()
        time.sleep(0.05)
        return abs(self.x() - before) > 1.0e-6

    def wait_mid_move(self) -> None:
        """Until X is well on its way, and far from its target."""
        patience, before = Patience(120.0), 1.0
        while not (0.02 < (now := self.x()) < 0.06 and now > before):
            assert not patience.over(), 'X never moved'
            time.sleep(0.05)
            before = now

    def stops_within(self, seconds: float) -> float:
        """After what time [s] it stands; it must be before ``seconds`` and before the move's end."""
        began = time.monotonic()
        while self.moving():
            assert time.monotonic() - began < seconds, f'still moving after {seconds} s, at {self.x()} m'
        took = time.monotonic() - began
        assert self.x() < 0.19, 'it went on to the end of the move'
        time.sleep(0.5)
        assert not self.moving(), 'it moves again'
        return took


class Wire:
    """A TCP relay before the control that can be cut on the client's side, or swallow everything."""

    def __init__(self, port: int):
        self._target = port
        self._listener = socket.create_server(('127.0.0.1', 0))
        self.port = self._listener.getsockname()[1]
        self.swallow = self.refuse = False
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self, seconds: float = 0.0) -> None:
        """Reset the client's side; the control's side stays open.  New connections only after ``seconds``."""
        self.refuse = True
        for client, _ in self._pairs:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b'\1\0\0\0\0\0\0\0')
            client.close()
        if seconds:
            threading.Timer(seconds, lambda: setattr(self, 'refuse', False)).start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        for pair in self._pairs:
            for end in pair:
                end.close()
        self._listener.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            open_pairs = [p for p in self._pairs if p[0].fileno() >= 0]
            ends = {a: b for c, s in open_pairs for a, b in ((c, s), (s, c))}
            try:
                ready, _, _ = select.select([self._listener, *ends], [], [], 0.02)
            except (OSError, ValueError):
                continue   # one was closed just now
            for one in ready:
                try:
                    if one is self._listener:
                        client, _ = one.accept()
                        if self.refuse or self.swallow:
                            self._pairs.append((client, socket.socket())) if self.swallow else client.close()
                            continue
                        self._pairs.append((client, socket.create_connection(('127.0.0.1', self._target))))
                    elif data := one.recv(65536):
                        if not self.swallow:
                            ends[one].sendall(data)
                except OSError:
                    pass


class Wired(Bringup):
    """A cell whose sequencer talks to the control through a :class:`Wire`."""

    wire: Wire | None = None     # until the cell is up

    def _endpoints(self):
        endpoints = super()._endpoints()
        self.wire = Wire(endpoints[self.namespace]['cnc']['port'])
        endpoints[self.namespace]['cnc']['port'] = self.wire.port
        return endpoints

    def stop(self):
        super().stop()
        if self.wire is not None:
            self.wire.close()


class Client:
    """A calibration by the facade, in a thread."""

    def __init__(self, cell: Bringup, **goal):
        self.outcome = None
        self._thread = threading.Thread(target=self._run, args=(cell, goal), daemon=True)
        self._thread.start()

    def _run(self, cell: Bringup, goal: dict) -> None:
        try:
            self.outcome = cell.operator.calibrate(**goal)
        except Exception as error:
            self.outcome = error

    def wait(self, seconds: float = 90.0):
        self._thread.join(seconds)
        assert not self._thread.is_alive(), 'the goal did not end'
        return self.outcome


def test_a_link_cut_for_a_moment_stops_the_machine_over_a_fresh_connection(ros_domain, tmp_path):
    # The control itself would let it go on: its side of the connection stays open, its watchdog is slow.
    with Wired(write_cell(tmp_path, watchdog=8.0), bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        client, machine = Client(cell), Machine(tmp_path / 'run')
        machine.wait_mid_move()
        cell.wire.cut(0.3)
        assert machine.stops_within(2.0) < 2.0
        outcome = client.wait()
        assert outcome.how == 'aborted' and 'could not be stopped' not in outcome.message, outcome.message


@pytest.mark.parametrize('how', some('swallowed', later=['cut']))
def test_a_link_that_is_gone_for_good_makes_the_control_stop(ros_domain, tmp_path, how):
    with Wired(write_cell(tmp_path), bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        client, machine = Client(cell), Machine(tmp_path / 'run')
        machine.wait_mid_move()
        if how == 'cut':
            cell.wire.cut()
        else:
            cell.wire.swallow = True
        assert machine.stops_within(1.5) < 1.5      # watchdog 0.5 s, braking, the looking itself
        outcome = client.wait()
        assert outcome.how == 'aborted' and 'emergency stop' in outcome.message


def test_a_killed_sequencer_stops_the_machine_by_the_control(ros_domain, tmp_path):
    with Bringup(write_cell(tmp_path), bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        Client(cell)
        machine = Machine(tmp_path / 'run')
        machine.wait_mid_move()
        os.kill(cell.pids()['step_sequencer'], signal.SIGKILL)
        assert machine.stops_within(1.5) < 1.5


def test_a_sequencer_that_stands_still_stops_the_machine_by_the_control(ros_domain, tmp_path):
    """Nor does it move when the sequencer wakes up: the calibration ends, and says why."""
    with Bringup(write_cell(tmp_path), bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        client, machine = Client(cell), Machine(tmp_path / 'run')
        machine.wait_mid_move()
        sequencer = cell.pids()['step_sequencer']
        os.kill(sequencer, signal.SIGSTOP)
        try:
            assert machine.stops_within(1.5) < 1.5
            time.sleep(4.0)
        finally:
            os.kill(sequencer, signal.SIGCONT)
        outcome = client.wait()
        assert outcome.how == 'aborted' and 'watchdog: nothing was received from its client' in outcome.message
        assert not machine.moving() and machine.x() < 0.19


def test_a_sequencer_that_starts_stops_what_it_finds_moving(ros_domain, tmp_path):
    with Wired(write_cell(tmp_path, watchdog=8.0), bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        Client(cell)
        machine = Machine(tmp_path / 'run')
        machine.wait_mid_move()
        os.kill(cell.pids()['step_sequencer'], signal.SIGKILL)
        time.sleep(0.3)
        assert machine.moving()      # the wire keeps the control's side open, its watchdog waits
        assert cell.watch() == ['step_sequencer']
        assert not machine.moving() and machine.x() < 0.19


CLIENT = """
import sys
from stepdiag_ros.nodes.operator import Operator
with Operator(sys.argv[1]) as operator:
    operator.calibrate()
"""


@pytest.mark.parametrize(('lost', 'to_the_stop'), some(('next_stop', True), later=[('at_once', False)]))
def test_a_killed_client_ends_the_run(ros_domain, tmp_path, lost, to_the_stop):
    with Bringup(write_cell(tmp_path, lost=lost), bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        machine = Machine(tmp_path / 'run')
        with subprocess.Popen([sys.executable, '-c', CLIENT, cell.namespace]) as client:
            machine.wait_mid_move()
            client.kill()
        killed = time.monotonic()
        said = ''
        while not said:
            assert time.monotonic() < killed + 60.0, 'the run did not end'
            said = next((v.value for v in cell.operator.health('step_sequencer').values
                         if v.key == 'last' and 'lease' in v.value), '')
            time.sleep(0.05)
        assert 'taken for lost' in said
        if to_the_stop:
            assert machine.x() == pytest.approx(0.2, abs=1e-6) and time.monotonic() - killed < MOVE_S + 5.0
        else:
            assert machine.x() < 0.19 and time.monotonic() - killed < 6.0
        time.sleep(1.0)
        assert not machine.moving()


def _running(folder: Path) -> bool:
    """Whether a process whose command line names the folder runs."""
    return any(str(folder) in text for text in (
        (entry / 'cmdline').read_bytes().decode(errors='replace') for entry in Path('/proc').glob('[0-9]*')
        if (entry / 'cmdline').exists()))


def test_a_killed_bringup_stops_the_machine(ros_domain, tmp_path):
    run = tmp_path / 'run'
    up = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'calibrate', str(write_cell(tmp_path)),
                           '--bag', str(tmp_path / 'log')], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                          env=os.environ | {'TMPDIR': str(tmp_path)})
    try:
        patience = Patience(60.0)
        while not (found := list(tmp_path.glob(f'stepdiag-*/{MOTION_FILE}'))):
            assert not patience.over() and up.poll() is None
            time.sleep(0.05)
        machine = Machine(found[0].parent)
        machine.wait_mid_move()
    finally:
        up.kill()
        up.wait()
    assert not run.exists()
    machine.stops_within(2.0)
    # The sequencer, whose control is gone too, tries to stop it over fresh connections before it ends.
    patience = Patience(120.0)
    while _running(tmp_path):
        assert not patience.over(), 'processes of the cell are left'
        time.sleep(0.1)


# -- on a real LinuxCNC, by the nodes that `stepdiag up` runs ---------------------------------------------------

class OnLinuxCnc:
    """``stepdiag up`` of the slow cell with a real LinuxCNC as its control; each test begins with a calibration."""

    def __init__(self, folder: Path):
        self.folder, self._clients = folder, []
        with open(folder / 'up.log', 'wb') as log:
            self.up = subprocess.Popen(
                [*STEPDIAG, 'up', str(write_cell(folder, lost='at_once', control='linuxcnc')), '--runtime',
                 str(folder / 'run'), '--bag-folder', str(folder)], stdout=log, stderr=subprocess.STDOUT)
        self._wait(lambda: 'calibrate with' in self.said())
        self.machine = Machine(folder / 'run', SampledHistory)

    def _wait(self, condition) -> None:
        patience = Patience(400.0)
        while not condition():
            assert not patience.over() and self.up.poll() is None, self.said()
            time.sleep(0.1)

    def said(self) -> str:
        return (self.folder / 'up.log').read_text(encoding='utf-8', errors='replace')

    def mid_move(self) -> subprocess.Popen:
        """A client of a calibration whose machine is in the middle of its move."""
        with open(self.folder / 'client.log', 'wb') as log:
            self._clients.append(subprocess.Popen([*STEPDIAG, 'calibrate', '/slow', '--repeats', '1'],
                                                  stdout=log, stderr=subprocess.STDOUT))
        self.machine.wait_mid_move()
        return self._clients[-1]

    def sequencer(self) -> int:
        return next(int(entry.name) for entry in Path('/proc').glob('[0-9]*')
                    if b'nodes.step_sequencer' in (words := (entry / 'cmdline').read_bytes())
                    and str(self.folder).encode() in words)

    def revived(self) -> None:
        """Wait until ``up`` has started the sequencer again."""
        self._wait(lambda: 'step_sequencer is active again' in self.said())

    def close(self) -> None:
        for process in (*self._clients, self.up):
            process.terminate()
            process.wait(60.0)


@pytest.fixture(scope='module')
def linuxcnc(module_domain, tmp_path_factory):
    if missing():
        pytest.skip(missing())
    try:
        install.install()
    except StepdiagError as error:
        if not all(map(install.installed, install.COMPONENTS)):
            pytest.skip(str(error))
    running = OnLinuxCnc(tmp_path_factory.mktemp('linuxcnc'))
    yield running
    running.close()


#: The watchdog that a virtual cell puts into LinuxCNC's HAL, braking, and the looking itself.
ON_LINUXCNC_S = 2.0


@pytest.mark.linuxcnc
def test_linuxcnc_stops_when_the_sequencer_is_killed(linuxcnc):
    client = linuxcnc.mid_move()
    linuxcnc.up.send_signal(signal.SIGSTOP)      # nobody starts it again
    try:
        os.kill(linuxcnc.sequencer(), signal.SIGKILL)
        assert linuxcnc.machine.stops_within(ON_LINUXCNC_S) < ON_LINUXCNC_S
    finally:
        client.kill()
        linuxcnc.up.send_signal(signal.SIGCONT)
    linuxcnc.revived()


@pytest.mark.linuxcnc
def test_linuxcnc_stops_when_the_sequencer_stands_still(linuxcnc):
    client, sequencer = linuxcnc.mid_move(), linuxcnc.sequencer()
    os.kill(sequencer, signal.SIGSTOP)
    try:
        assert linuxcnc.machine.stops_within(ON_LINUXCNC_S) < ON_LINUXCNC_S
    finally:
        os.kill(sequencer, signal.SIGCONT)
    assert client.wait(90.0) == 1 and 'watchdog' in (linuxcnc.folder / 'client.log').read_text()
    assert not linuxcnc.machine.moving() and linuxcnc.machine.x() < 0.19


@pytest.mark.linuxcnc
def test_linuxcnc_is_stopped_when_the_client_is_killed(linuxcnc):
    linuxcnc.mid_move().kill()
    assert linuxcnc.machine.stops_within(6.0) < 6.0     # lease 2 s, at once


@pytest.mark.linuxcnc
def test_linuxcnc_is_stopped_when_bringup_is_killed(linuxcnc):
    """The last one: nothing is left of the cell."""
    linuxcnc.mid_move()
    linuxcnc.up.kill()
    linuxcnc.up.wait()
    # The kernel ends the nodes, and LinuxCNC with them: where its joints were seen last they stand.
    patience = Patience(60.0)
    while _running(linuxcnc.folder / 'run') and not patience.over():
        time.sleep(0.1)
    assert not _running(linuxcnc.folder / 'run')
    seen = linuxcnc.machine.seen()
    assert 0.02 < seen['place'][-1, 0] < 0.19
