"""A TCP connection with deadlines, whose every trouble is a :class:`DeviceError`."""

import socket
import struct
import time

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.hostclock import HOST

FIRST_PAUSE_S = 0.1
"""Pause before the second attempt to connect; it doubles with each further one."""
SO_TIMESTAMPNS = 35
"""Linux's option by which data carry the time at which they arrived; Python's ``socket`` does not name it."""
MOST_AGO_S = 5.0
TIMESPEC = struct.Struct('qq')


def receive_stamped(connection: socket.socket) -> tuple[bytes, float]:
    """What has arrived on a socket with :data:`SO_TIMESTAMPNS`, and how long ago [s]: by the kernel, not by us.

    A process that waits for the processor sees data later than they came.
    """
    data, more, _, _ = connection.recvmsg(1 << 18, socket.CMSG_SPACE(TIMESPEC.size))
    now, ago = time.time(), 0.0
    for level, kind, value in more:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(value) >= TIMESPEC.size:
            seconds, nanoseconds = TIMESPEC.unpack_from(value)
            ago = now - (seconds + 1e-9 * nanoseconds)
    # A clock that was set meanwhile tells nothing.
    return data, ago if 0.0 < ago < MOST_AGO_S else 0.0


class Link:
    """A client's end of one TCP connection.

    ``name`` begins every complaint.  Connecting is tried ``attempts`` times with
    growing pauses, because an instrument that was just switched on, or that a moment
    ago dropped its client, needs a little time.
    """

    def __init__(self, name: str, host: str, port: int, timeout_s: float = 5.0, attempts: int = 4):
        self.where = f'{name} at {host}:{port}'
        self._address = (host, port)
        self._timeout_s = timeout_s
        self._attempts = attempts
        self._socket: socket.socket | None = None
        self.arrived_s = 0.0   # when what was received last arrived, host's time

    @property
    def is_open(self) -> bool:
        return self._socket is not None

    def set_timeout(self, timeout_s: float) -> None:
        """Another deadline [s] from the next call on."""
        self._timeout_s = timeout_s

    def open(self) -> None:
        """Connect; does nothing when connected."""
        if self._socket is not None:
            return
        pause, reason = FIRST_PAUSE_S, ''
        for attempt in range(self._attempts):
            if attempt:
                time.sleep(pause)
                pause *= 2.0
            try:
                connection = socket.create_connection(self._address, self._timeout_s)
            except OSError as error:
                reason = error.strerror or str(error)
                continue
            # Requests are small and each waits for its answer: never hold one back.
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket = connection
            return
        raise DeviceError(f'{self.where}: cannot connect ({reason}) after {self._attempts} attempts; '
                          'check that it is switched on and that host and port are right')

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def fail(self, what: str) -> DeviceError:
        """Close, and the error to raise."""
        self.close()
        return DeviceError(f'{self.where}: {what}')

    def send(self, data: bytes) -> None:
        if self._socket is None:
            raise DeviceError(f'{self.where}: is not connected; connect first')
        self._socket.settimeout(self._timeout_s)
        try:
            self._socket.sendall(data)
        except TimeoutError:
            raise self.fail(f'does not take data for {self._timeout_s:g} s; restart it') from None
        except OSError as error:
            raise self.fail(f'dropped the connection ({error.strerror or error}); '
                            'reconnect') from None

    def receive(self, wait_s: float | None = None) -> bytes:
        """What has arrived, waiting for at least one byte; with ``wait_s`` empty after that time, 0: at once.

        Without ``wait_s`` silence for the connection's timeout is an error.  ``arrived_s`` says when it arrived.
        """
        if self._socket is None:
            raise DeviceError(f'{self.where}: is not connected; connect first')
        self._socket.settimeout(self._timeout_s if wait_s is None else wait_s)
        try:
            data, ago = receive_stamped(self._socket)
            self.arrived_s = HOST.now() - ago
        except (TimeoutError, BlockingIOError):
            if wait_s is not None:
                return b''
            raise self.fail(f'stalls: no answer for {self._timeout_s:g} s; restart it') from None
        except OSError as error:
            raise self.fail(f'dropped the connection ({error.strerror or error}); '
                            'reconnect') from None
        if not data:
            raise self.fail('closed the connection; reconnect')
        return data
