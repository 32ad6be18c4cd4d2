"""One namespace, one owner: a second cell, or a second sequencer, of the same name is refused.

Two sequencers of one name would answer to the same goal, and the wrong machine might move.  Two of other names, or in
other ROS domains, that command one control would take the machine out of each other's hands: a control has one owner,
too.  The owner holds an abstract socket, which every user of this computer sees and the kernel frees with the
process, however it ends.
"""

import errno
import ipaddress
import os
import socket
from pathlib import Path

from stepdiag_ros.errors import StepdiagError

CELL, SOURCE, SEQUENCER = 'cell', 'source', 'step_sequencer'


class Held:
    """Something on this computer that only one may have, until :meth:`release` or the process's end."""

    _socket: socket.socket

    def release(self) -> None:
        """Somebody else may have it."""
        self._socket.close()


class Ownership(Held):
    """Holds ``what`` of a namespace in the present ROS domain until :meth:`release` or the process's end.

    Raises :class:`StepdiagError` where somebody else does.
    """

    def __init__(self, namespace: str, what: str):
        self.namespace, self.domain = '/' + namespace.strip('/'), ros_domain()
        self._socket = _hold(
            f'{self.domain}{self.namespace}/{what}', self.namespace,
            f'{self.namespace} is up already in ROS domain {self.domain} on this computer; calibrate it with '
            f'stepdiag calibrate {self.namespace}, or end it, or choose another ROS_DOMAIN_ID')


class ControlOwnership(Held):
    """Holds the machine control at an address until :meth:`release` or the process's end, whatever the sequencer's
    namespace and ROS domain.  Raises :class:`StepdiagError` where another sequencer of this computer does."""

    def __init__(self, host: str, port: int):
        where = f'machine control at {host}:{port}'
        self._socket = _hold(f'control/{_address(host, port)}:{port}', where,
                             f'{where}: another sequencer on this computer commands it; end that one first')


class RuntimeOwnership(Held):
    """The folder of a cell's parameters and logs, in which a restarted node reads which instruments are its own."""

    def __init__(self, folder: Path):
        status = folder.stat()
        self._socket = _hold(f'runtime/{status.st_dev}/{status.st_ino}', str(folder),
                             f'{folder}: another cell that is up keeps its parameters there; name another --runtime')


def _hold(name: str, what: str, taken: str) -> socket.socket:
    """A socket that bears a name which nobody else has; :class:`StepdiagError` says ``taken``."""
    held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        held.bind(f'\0stepdiag_ros/{name}')
    except OSError as error:
        held.close()
        if error.errno != errno.EADDRINUSE:
            raise StepdiagError(f'{what}: its ownership cannot be marked: {error.strerror or error}') from None
        raise StepdiagError(taken) from None
    return held


def _address(host: str, port: int) -> str:
    """One word for each computer, under whatever name it is called; a name that nobody knows is its own."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][4][0]
        return 'loopback' if ipaddress.ip_address(found).is_loopback else str(found)
    except (OSError, ValueError):
        return host.lower()[:60]


def ros_domain() -> str:
    """The present ROS domain as one word: rcl reads C's number, so that 77, 0x4d and 0115 are the same."""
    text = os.environ.get('ROS_DOMAIN_ID', '').strip() or '0'
    try:
        return str(int(text, 8) if text.isdigit() and text.startswith('0') else int(text, 0))
    except ValueError:
        return text     # ROS will say what is wrong with it


def machines_up() -> list[str]:
    """Namespaces of the machines that are up in the present ROS domain on this computer."""
    mark = f'@stepdiag_ros/{ros_domain()}/'
    names = (line.split()[-1] for line in Path('/proc/net/unix').read_text(encoding='ascii').splitlines())
    return sorted('/' + name.removeprefix(mark).removesuffix(f'/{CELL}') for name in names
                  if name.startswith(mark) and name.endswith(f'/{CELL}'))
