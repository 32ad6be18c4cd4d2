"""Starts, watches and stops a hall: many machines, one source of light.

Every machine is a cell with processes, namespace, bag and evaluation of its own; the source (interferometer driver and
multiplexer) stands in the hall's namespace.  A machine that cannot be kept alive is given up, and the others go on.
"""

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.bringup import Bringup, Part
from stepdiag_ros.nodes.brought_up import BroughtUp
from stepdiag_ros.nodes.graph import NODES, SOURCE_NODES, namespace_of
from stepdiag_ros.nodes.ownership import SOURCE
from stepdiag_ros.virtual.hall import load_hall, write_cells

MACHINE_NODES = tuple(name for name in NODES if name not in SOURCE_NODES)


class Hall(BroughtUp):
    """A running hall; a context manager.

    ``say(text)`` is told what happens; ``runtime`` holds a folder for each machine with logs and parameters; without it
    a temporary directory is made, and removed when all went well.
    """

    def __init__(self, path: str | Path, *, hardware: bool = False, bag_folder: Path = Path('.'),
                 runtime: Path | None = None, domain: int | None = None, nodes: tuple[str, ...] = MACHINE_NODES,
                 say: Callable[[str], None] = lambda text: None):
        self.file, self._say = load_hall(path), say
        self._own_runtime = runtime is None
        self.runtime = Path(tempfile.mkdtemp(prefix='stepdiag-hall-')) if runtime is None else runtime
        self.runtime.mkdir(parents=True, exist_ok=True)
        self.namespace = namespace_of(self.file.name)
        source, cells = write_cells(self.file, self.runtime)
        self.machines: dict[str, Bringup] = {}
        self.lost: dict[str, str] = {}
        for machine in self.file.machines:
            light = {'owner': self.namespace, 'host': '', 'port': 1, 'priority': machine.priority}
            self.machines[machine.name] = Bringup(
                cells[machine.name], hardware=hardware, bag_folder=bag_folder, runtime=self.runtime / machine.name,
                domain=domain, nodes=nodes, say=self._as(machine.name),
                part=Part(('cnc', 'psd'), {'switch': light, 'interferometer': {'host': '', 'port': 1}}))
        self.source = Bringup(
            source, hardware=hardware, namespace=self.file.name, runtime=self.runtime, domain=domain,
            nodes=SOURCE_NODES, say=self._as(self.file.name),
            part=Part(('interferometer',), {'switch': {'owner': self.namespace, 'lease': self.file.lease_s},
                                            'psd': {'host': '', 'port': 1, 'stream_port': 1},
                                            'cnc': {'host': '', 'port': 1}}, SOURCE))

    def _as(self, name: str) -> Callable[[str], None]:
        return lambda text: self._say(text if text.startswith('/') else f'{name}: {text}')

    def start(self) -> None:
        """Every machine up, then the source."""
        for part in (*self.machines.values(), self.source):   # the laser looks at machines that are there
            part.start()

    def watch(self) -> list[str]:
        """Look once; start again what has died; names of machines that were given up just now.

        :class:`StepdiagError` where the source cannot be kept alive, or no machine is left.
        """
        self.source.watch()
        gone = []
        for name, machine in list(self.machines.items()):
            try:
                machine.watch()
            except StepdiagError as error:
                self._say(f'{name} is given up, the others go on: {error}')
                self.lost[name] = str(error)
                self.machines.pop(name).stop()
                gone.append(name)
        if not self.machines:
            raise StepdiagError('no machine of the hall is left')
        return gone

    def stop(self) -> None:
        """End everything: the machines, then the source."""
        for part in (*self.machines.values(), self.source):
            part.stop()
        if self._own_runtime and not self.failed and not self.lost:
            shutil.rmtree(self.runtime, ignore_errors=True)
