"""The control itself stops when its remote client dies or is cut off: who dies, and where the machine stands then."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager

import numpy as np
import pytest
from drawn_machine import ORIGIN
from linuxcnc_machine import Running, configured, need_components

from stepdiag_ros.linuxcnc.configuration import SILENCE_S

pytestmark = pytest.mark.linuxcnc
FEED = 0.04
"""[m/s]; the move would take four seconds."""
ALLOWED_S = SILENCE_S + 0.15
"""Silence, braking at 2 m/s², and the ways of a sign of life."""
CLIENT = """
import sys, time
import numpy as np
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
client = LinuxCncRsh('127.0.0.1', int(sys.argv[1]), {origin}, watch_port=int(sys.argv[2]))
client.connect()
client.move(np.array([0.16, 0.0, 0.0]), {feed})
print('moving', flush=True)
while True:
    client._beat()      # and asks nothing: linuxcncrsh mixes up two clients that ask at the same instant
    time.sleep(0.05)
"""


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    need_components()
    folder = tmp_path_factory.mktemp('watch')
    port = configured(folder)
    with Running(folder) as machine:    # its own client gives no signs of life and watches only
        machine.port = port
        yield machine


@pytest.fixture(autouse=True)
def at_the_start(running):
    running.client.connect()    # who enables last commands
    running.client.move(np.zeros(3), 0.4)
    while not running.client.in_position():
        time.sleep(0.01)


@contextmanager
def moving_client(running, rsh_port=None, watch_port=None):
    """A process that moves the machine and waits for the move's end, as a sequencer does."""
    child = subprocess.Popen(
        [sys.executable, '-c', CLIENT.format(origin=ORIGIN, feed=FEED), str(rsh_port or running.machine.port),
         str(watch_port or running.port)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert child.stdout.readline().strip() == 'moving'
        while running.client.position()[0] < 0.02:
            time.sleep(0.02)
        yield child
    finally:
        child.kill()
        child.communicate()


def after(running, cut: Callable[[], object]) -> tuple[float, float]:
    """Do what silences the client; when [s] that was done, and where the machine was then.

    The control tells its place when its task gets to it, which on a busy computer may be late: the freshest of several
    answers counts, carried on at the feed.
    """
    told = []
    for _ in range(8):
        place = running.client.position()[0]
        told.append((time.monotonic(), place))
        time.sleep(0.02)
    cut()
    began = time.monotonic()
    return began, max(place + FEED * (began - at) for at, place in told)


def stands_after(running, began: float, place: float) -> None:
    """Where the machine comes to rest, and that it is idle and goes nowhere later."""
    time.sleep(max(0.0, began + ALLOWED_S + 1.0 - time.monotonic()))
    rest = running.client.position()[0]
    assert rest - place < FEED * ALLOWED_S + 0.004, f'{1e3 * (rest - place):.1f} mm further'
    time.sleep(0.5)
    assert running.client.position()[0] == rest
    assert running.client._idle()


def test_the_client_is_killed(running):
    with moving_client(running) as child:
        began, place = after(running, lambda: child.send_signal(signal.SIGKILL))
        stands_after(running, began, place)
        assert running.client.position()[0] < 0.1


def test_the_client_hangs(running):
    with moving_client(running) as child:
        began, place = after(running, lambda: child.send_signal(signal.SIGSTOP))
        stands_after(running, began, place)


class Cable:
    """Forwards TCP connections until it is cut; then it neither forwards nor closes: a pulled plug."""

    def __init__(self, port: int):
        self._server = socket.create_server(('127.0.0.1', 0))
        self.port, self._to, self.cut = self._server.getsockname()[1], port, threading.Event()
        self._open = [self._server]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        near, _ = self._server.accept()
        far = socket.create_connection(('127.0.0.1', self._to))
        self._open += [near, far]
        for one, other in ((near, far), (far, near)):
            threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    def _carry(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while data := one.recv(4096):
                if self.cut.is_set():
                    return
                other.sendall(data)
        except OSError:
            pass

    def close(self) -> None:
        for link in self._open:
            try:
                link.shutdown(socket.SHUT_RDWR)    # whoever waits for data wakes up
            except OSError:
                pass
            link.close()


def test_the_link_is_cut(running):
    cables = Cable(running.machine.port), Cable(running.port)
    try:
        with moving_client(running, *(cable.port for cable in cables)):
            began, place = after(running, lambda: [cable.cut.set() for cable in cables])
            stands_after(running, began, place)
    finally:
        for cable in cables:
            cable.close()


def test_a_move_without_signs_of_life_is_somebodys_at_the_machine(running):
    running.client.move(np.array([0.03, 0.0, 0.0]), 0.06)
    while not running.client.in_position():
        time.sleep(0.01)
    assert running.client.position()[0] == pytest.approx(0.03, abs=1e-8)


def test_the_component_that_takes_the_signs_of_life_is_killed(running):
    """Its pin stands still then, which is silence too.  (It comes last: the component stays dead.)"""
    with moving_client(running):
        pid = next(line.split()[0] for line in subprocess.run(
            ['ps', '-eo', 'pid,args'], capture_output=True, text=True, check=True).stdout.splitlines()
            if 'heart.py' in line and str(running.port) in line)
        began, place = after(running, lambda: os.kill(int(pid), signal.SIGKILL))
        stands_after(running, began, place)
