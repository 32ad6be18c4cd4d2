"""Signs of life reach whoever takes them; a lost link is reported in one line."""

import socket
import threading

import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.heartbeat import Heartbeat
from stepdiag_ros.linuxcnc import heart
from stepdiag_ros.linuxcnc.running import free_port


def test_every_beat_arrives_and_the_newest_client_counts():
    port, beats, arrived = free_port(), [], threading.Event()

    def beat() -> None:
        beats.append(1)
        arrived.set()
    threading.Thread(target=heart.serve, args=('127.0.0.1', port, beat), daemon=True).start()
    for _ in range(2):
        client = _opened(port)
        for _ in range(3):
            arrived.clear()
            client.beat()
            assert arrived.wait(5.0)
        client.close()
    assert len(beats) == 6


def _opened(port: int) -> Heartbeat:
    client = Heartbeat('127.0.0.1', port)
    for attempt in range(100):
        try:
            client.open()
            return client
        except DeviceError:
            if attempt == 99:
                raise
            threading.Event().wait(0.02)
    raise AssertionError


def test_nobody_there_is_said():
    with pytest.raises(DeviceError, match='watchdog of the machine control at 127.0.0.1.*cannot connect'):
        Heartbeat('127.0.0.1', free_port()).open()


def test_a_link_that_was_lost_is_said():
    with socket.create_server(('127.0.0.1', 0)) as server:
        client = Heartbeat('127.0.0.1', server.getsockname()[1])
        client.open()
        near, _ = server.accept()
        near.close()
    with pytest.raises(DeviceError, match='link is lost'):
        for _ in range(100):
            client.beat()
            threading.Event().wait(0.01)
    client.close()
    with pytest.raises(DeviceError, match='not connected'):
        client.beat()
