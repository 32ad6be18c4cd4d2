"""A real LinuxCNC as the control of a virtual cell.

It runs from the cell's configuration folder (``instruments.cnc.config``), or from one that is made from the
cell's volume and motion; the virtual sensors look at its joints, so that whatever the control does about
the machine's errors is seen.  Mirrors are mounted by ``M68 E0 Qn``.
"""

import asyncio
import tempfile
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import configuration
from stepdiag_ros.linuxcnc.running import LinuxCnc, free_port
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.serving import MOTION_FILE, announce, serve

TRACK = 'track.bin'
WATCH_S = 0.2


def setup_codes(cell: Cell) -> dict[str, str]:
    """What mounts the mirror for each setup: an analogue output, which HAL carries to the sensors."""
    return {name: f'M68 E0 Q{i + 1}' for i, name in enumerate(cell.setup_names)}


def prepare(cell: Cell, folder: Path) -> None:
    """Make the configuration folder of the cell's control where there is none yet."""
    if (folder / 'machine.ini').exists():
        return
    machine, motion = cell.description.machine, cell.motion
    configuration.write(folder, configuration.simulated(
        machine.name, machine.volume, machine.origin or (0.0, 0.0, 0.0), motion.feed, motion.acceleration))


def config_folder(cell: Cell) -> Path | None:
    """The configuration folder that the cell names, relative to its file."""
    named = cell.instruments.config
    return Path(cell.source).parent / named if named else None


async def main(cell: Cell, runtime: Path) -> None:
    where = cell.instruments.cnc
    if where.host != '127.0.0.1':
        raise StepdiagError(f'{cell.source}: instruments.cnc.host is {where.host}; a virtual cell runs LinuxCNC on '
                            'this computer, write 127.0.0.1')
    with tempfile.TemporaryDirectory(prefix='stepdiag-config-') as scratch:
        folder = config_folder(cell) or Path(scratch)
        prepare(cell, folder)
        machine = LinuxCnc(folder, where.port or None)
    try:
        ini = (machine.folder / 'machine.ini').read_text(encoding='utf-8')
        heart = cell.instruments.watch_port or free_port()
        for files in (lambda text: configuration.watched(text, heart),
                      lambda text: configuration.followed(text, str(machine.folder / TRACK))):
            configuration.write(machine.folder, files(ini))
            ini = (machine.folder / 'machine.ini').read_text(encoding='utf-8')
        machine.start()
        (runtime / MOTION_FILE).symlink_to(machine.folder / TRACK)
        announce(runtime, 'cnc', {'host': '127.0.0.1', 'port': machine.port, 'watch_port': heart,
                                  'setup_codes': setup_codes(cell)})
        while machine.running:
            await asyncio.sleep(WATCH_S)
        raise StepdiagError(f'LinuxCNC ended by itself: {machine.last_words()}')
    finally:
        machine.stop()


if __name__ == '__main__':
    raise SystemExit(serve('linuxcnc_server', main))
