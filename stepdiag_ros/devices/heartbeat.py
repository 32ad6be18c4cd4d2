"""Signs of life for a machine control's watchdog.

Whoever moves a machine sends a byte with each command of motion and each look at its progress; without
them the control itself stops the move (``stepdiag_ros/linuxcnc/stepdiagwatch.c``).  They are sent by the
thread that waits for the move, never by one of their own: a thread would go on when the rest hangs.
"""

import socket

from stepdiag_ros.devices.base import DeviceError

PORT = 5008


class Heartbeat:
    """A connection to the control's watchdog."""

    def __init__(self, host: str, port: int, timeout_s: float = 5.0):
        self._where = f'watchdog of the machine control at {host}:{port}'
        self._address, self._timeout_s = (host, port), timeout_s
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect, anew where there was a connection."""
        self.close()
        try:
            self._socket = socket.create_connection(self._address, self._timeout_s)
        except OSError as error:
            raise DeviceError(f'{self._where}: cannot connect: {error.strerror or error}; '
                              'does the control run with its watchdog?') from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def beat(self) -> None:
        """One sign of life; never waits."""
        if self._socket is None:
            raise DeviceError(f'{self._where}: is not connected')
        try:
            self._socket.send(b'.')
        except OSError as error:
            raise DeviceError(f'{self._where}: the link is lost: {error.strerror or error}') from None

    def close(self) -> None:
        """Disconnect."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
