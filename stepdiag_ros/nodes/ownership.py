"""One namespace, one owner: a second cell, or a second sequencer, of the same name is refused.

Two sequencers of one name would answer to the same goal, and the wrong machine might move.  The owner
holds an abstract socket, which every user of this computer sees and the kernel frees with the process,
however it ends.
"""

import errno
import os
import socket
from pathlib import Path

from stepdiag_ros.errors import StepdiagError

CELL, SOURCE, SEQUENCER = 'cell', 'source', 'step_sequencer'


class Ownership:
    """Holds ``what`` of a namespace in the present ROS domain until :meth:`release` or the process's end.

    Raises :class:`StepdiagError` where somebody else does.
    """

    def __init__(self, namespace: str, what: str):
        self.namespace, self.domain = '/' + namespace.strip('/'), os.environ.get('ROS_DOMAIN_ID') or '0'
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.bind(f'\0stepdiag_ros/{self.domain}{self.namespace}/{what}')
        except OSError as error:
            self._socket.close()
            if error.errno != errno.EADDRINUSE:
                raise StepdiagError(f'{self.namespace}: its ownership cannot be marked: {error.strerror}') from None
            raise StepdiagError(
                f'{self.namespace} is up already in ROS domain {self.domain} on this computer; calibrate it with '
                f'stepdiag calibrate {self.namespace}, or end it, or choose another ROS_DOMAIN_ID') from None

    def release(self) -> None:
        """Somebody else may have it."""
        self._socket.close()


def machines_up() -> list[str]:
    """Namespaces of the machines that are up in the present ROS domain on this computer."""
    mark = f'@stepdiag_ros/{os.environ.get("ROS_DOMAIN_ID") or "0"}/'
    names = (line.split()[-1] for line in Path('/proc/net/unix').read_text(encoding='ascii').splitlines())
    return sorted('/' + name.removeprefix(mark).removesuffix(f'/{CELL}') for name in names
                  if name.startswith(mark) and name.endswith(f'/{CELL}'))
