"""Clients of a live virtual cell, connected and closed."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from stepdiag_ros.devices.ids3010 import Ids3010
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.devices.modbus_psd import ModbusPsd


@contextmanager
def clients(where: Mapping, setup: str) -> Iterator[tuple[LinuxCncRsh, Ids3010, ModbusPsd]]:
    """Control, interferometer and detector at the endpoints ``where``; the control ready for ``setup``."""
    cnc = LinuxCncRsh('127.0.0.1', where['cnc']['port'], setup_codes=where['cnc']['setup_codes'])
    meter = Ids3010('127.0.0.1', where['interferometer']['port'])
    # By request the inputs come as floats; a stream's 16 bits would add steps of 0.2 µm.
    detector = ModbusPsd('127.0.0.1', where['psd']['port'], mode='poll')
    try:
        for client in (cnc, meter, detector):
            client.connect()
        cnc.make_ready()
        cnc.select_setup(setup)
        yield cnc, meter, detector
    finally:
        for client in (cnc, meter, detector):
            client.close()
