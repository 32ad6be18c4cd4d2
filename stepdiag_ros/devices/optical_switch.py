"""A fibre-optic switch that routes one laser to several machines, by SCPI over TCP.

The commands are those that SCPI gives such switches: ``ROUT:CLOS (@n)`` closes the path
of channel n, ``ROUT:CLOS?`` tells which is closed.
"""

import re
from collections.abc import Mapping, Sequence

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.link import Link
from stepdiag_ros.errors import StepdiagError

PORT = 5025


class OpticalSwitch:
    """Client of a switch; ``channels`` maps a machine's name to its channel, 1 and up."""

    def __init__(self, host: str, port: int = PORT, channels: Mapping[str, int] | None = None,
                 timeout_s: float = 5.0):
        self._link = Link('optical switch', host, port, timeout_s)
        self._channels = dict(channels or {})
        self._rest = b''

    def connect(self) -> None:
        self._link.open()
        self._rest = b''

    def close(self) -> None:
        self._link.close()

    def select(self, machine: str) -> None:
        """Route the laser to ``machine``; returns when the switch says that it is so."""
        if machine not in self._channels:
            raise DeviceError(f'{self._link.where}: has no channel for machine {machine!r}; '
                              f'it has {", ".join(self._channels) or "none"}')
        wanted = self._channels[machine]
        self._link.send(b'ROUT:CLOS (@%d)\n' % wanted)
        if self._closed() != wanted:
            raise self._link.fail(f'does not switch to channel {wanted} of machine {machine!r}; '
                                  'is it fitted?')

    def selected(self) -> str | None:
        """The machine that has the laser; ``None`` on a channel without name."""
        channel = self._closed()
        return next((name for name, n in self._channels.items() if n == channel), None)

    def _closed(self) -> int:
        self._link.send(b'ROUT:CLOS?\n')
        data = self._rest
        while b'\n' not in data:
            data += self._link.receive()
            if len(data) > 4096:
                raise self._link.fail('answers nonsense (no end of line); is it an optical switch?')
        line, self._rest = data.split(b'\n', 1)
        found = re.fullmatch(r'\(@(\d{1,6})\)', line.decode('ascii', 'replace').strip())
        if found is None:
            raise self._link.fail(f'answers nonsense ({line[:40]!r}); is it an optical switch?')
        return int(found.group(1))


def channels(served: Sequence[str]) -> dict[str, int]:
    """``['left=1', 'right=2']`` -> topic prefixes and channels; nothing named: no prefix, channel 1."""
    found = {}
    for entry in filter(None, served):
        name, _, channel = entry.partition('=')
        if not name.strip('/') or not channel.isdigit():
            raise StepdiagError(f'parameter serves holds {entry!r}; write namespace=channel, e.g. left=1')
        found[f'/{name.strip("/")}/'] = int(channel)
    return found or {'': 1}
