"""Starts, watches and stops a cell: ``stepdiag up CELL.yaml`` and ``ros2 run … bringup``.

Every node and the virtual cell are processes of their own.  A node that dies is
started again and brought to the state it had; on Ctrl-C or SIGTERM all end in order,
the recorder last, so that the bag is whole and no process is left.  Should this
process itself be killed, the kernel ends its children.
"""

import argparse
import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.missing import missing
from stepdiag_ros.guard.show import escaped
from stepdiag_ros.linuxcnc.running import wait_until_free
from stepdiag_ros.nodes import environment
from stepdiag_ros.nodes.brought_up import BroughtUp
from stepdiag_ros.nodes.graph import (
    LISTENERS,
    NODES,
    PARAMETERS,
    hardware_endpoints,
    namespace_of,
    write_graph,
)
from stepdiag_ros.nodes.ownership import CELL as CELL_OWNER
from stepdiag_ros.nodes.ownership import Held, Ownership, RuntimeOwnership, machines_up
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.virtual.acting import allow_effect_files
from stepdiag_ros.virtual.cell import Cell, load_cell

CELL = 'virtual cell'
#: Whatever lives is waited for so long: what ends is noticed at once, and a computer that is busy takes its time.
START_TIMEOUT_S = 300.0
#: Parameters that belong to one process: who starts it again gives it its own.
OF_ONE_LIFE = ('bag', 'go_on')
#: So long one question whether a node is up may take.
ANSWER_S = 2.0
#: A node ends itself before (ENDS_S in nodes/base.py); this is for what is stuck where no signal reaches it.
GRACE_S = 20.0
#: So long the graph is looked at for nodes of the same name before any is started.
LOOK_AROUND_S = 1.5
#: A node that dies this often within a minute is left alone.
RESTARTS_A_MINUTE = 5
#: Measured by bench/bench_machines.py: one that measures at 1 kHz takes 0.8 of a processor.
MACHINES_A_PROCESSOR = 1
#: Of machines that share a laser one measures at a time.
SHARING_A_PROCESSOR = 2
#: Measured (docs/bench/hall.md): what a virtual machine's processes take of the memory [bytes], and what they share.
MACHINE_BYTES, SHARED_BYTES = 431 << 20, 246 << 20
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


def _end_with_parent() -> None:
    """In the child, before it becomes another program: SIGTERM when the parent ends."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


@dataclass
class _Child:
    """A process: ``node`` of the machine at ``namespace``, or the virtual cell."""

    name: str
    command: list[str]
    process: subprocess.Popen | None
    namespace: str = ''
    node: str = ''
    deaths: list[float] = field(default_factory=list)

    @property
    def called(self) -> str:
        """Its name in a sentence."""
        return self.name if self.node else f'the {self.name}'


@dataclass(frozen=True)
class _Machine:
    """One machine of the cell: its cell file's content, namespace, nodes, runtime directory, bag."""

    cell: Cell
    namespace: str
    nodes: tuple[str, ...]
    runtime: Path
    bag: Path | None


@dataclass(frozen=True)
class Part:
    """What one bringup starts of a hall: virtual ``instruments``; ``endpoints`` that others of the hall serve;
    ``owner`` is the mark that its namespace bears."""

    instruments: tuple[str, ...]
    endpoints: dict[str, dict[str, Any]]
    owner: str = CELL_OWNER


class Bringup(BroughtUp):
    """A running cell; a context manager.

    ``say(text)`` reports what happens.  ``runtime`` holds logs, parameters and the
    instruments' addresses; without it a temporary directory is made, and removed when
    all went well.  ``steps``: of each axis along a diagonal, 0: the cell's.  Machines that
    share the laser (``multiplexer`` in the cell file) come up together, each in its own
    namespace.  ``part``: what is started of a cell that stands in a hall.
    """

    def __init__(self, cell_path: str | Path, *, hardware: bool = False, namespace: str | None = None,
                 bag: Path | None = None, bag_folder: Path = Path('.'), runtime: Path | None = None,
                 domain: int | None = None, nodes: tuple[str, ...] = NODES, steps: int = 0,
                 part: Part | None = None, say: Callable[[str], None] = lambda text: None):
        if find_spec('stepdiag_msgs') is None:
            raise StepdiagError(f'bringup needs {missing("stepdiag_msgs")}')
        self.cell_path = Path(cell_path)
        cell = load_cell(cell_path)
        others = [load_cell(file) for file in cell.instruments.machine_files] if part is None else []
        self._part = part
        if others and namespace is not None:
            raise StepdiagError(f'{cell_path}: --namespace cannot be given where machines share a laser; '
                                "their namespaces are the machines' names")
        self.hardware = hardware
        self.namespace = namespace_of(cell.description.machine.name) if namespace is None \
            else '/' + namespace.strip('/')
        self._bag_folder, self._steps = bag_folder, steps
        self._own_runtime = runtime is None
        self.runtime = Path(tempfile.mkdtemp(prefix='stepdiag-')) if runtime is None else runtime
        self.runtime.mkdir(parents=True, exist_ok=True)
        own = (*nodes, 'multiplexer') if others else nodes
        self.machines = [_Machine(cell, self.namespace, own, self.runtime, bag)]
        for other in others:
            name = other.description.machine.name
            self.machines.append(_Machine(
                other, namespace_of(name), tuple(n for n in nodes if n != 'interferometer_driver'),
                self.runtime / name, None if bag is None else bag.with_name(f'{bag.name}_{name}')))
        self._say = say
        self._network = cell.network
        self._owned: list[Held] = []
        self._children: dict[str, _Child] = {}
        self.restarts = 0
        network = environment.prepare(cell.network)
        if network:
            say(network)
        if domain is not None:
            os.environ['ROS_DOMAIN_ID'] = str(domain)
        self._operators: dict = {}

    @property
    def operator(self):
        """The facade to the (first) machine's nodes."""
        return self.operator_of(self.namespace)

    def operator_of(self, namespace: str):
        """The facade to one machine's nodes."""
        from stepdiag_ros.nodes.operator import Operator
        if namespace not in self._operators:
            self._operators[namespace] = Operator(namespace)
        return self._operators[namespace]

    @property
    def truth_file(self) -> Path:
        """Where a virtual cell writes its true errors."""
        return self.runtime / 'truth.json'

    def pids(self) -> dict[str, int]:
        """Process of the virtual cell and of each node; a second machine's are ``<machine>/<node>``."""
        return {name: child.process.pid for name, child in self._children.items()}

    # -- start -------------------------------------------------------------------

    def start(self) -> None:
        """All processes up, all nodes active."""
        self._own()
        endpoints = self._endpoints()
        for machine in self.machines:
            graph = write_graph(machine.cell, endpoints[machine.namespace], machine.runtime,
                                machine.namespace, machine.bag, self._bag_folder, machine.nodes,
                                self._steps)
            for node in machine.nodes:
                name = node if machine is self.machines[0] else f'{graph.namespace.strip("/")}/{node}'
                self._spawn(_Child(name, self._command(machine, node), None, machine.namespace, node))
        for child in list(self._children.values()):
            if child.node:
                self._activate(child)
        for machine in self.machines:
            self._say(f'{machine.namespace}: all nodes active')

    def _own(self) -> None:
        """Take the namespaces; :class:`StepdiagError` if somebody has one."""
        self._say(f'network: {self._network}')
        self._owned.append(RuntimeOwnership(self.runtime))
        for machine in self.machines:
            self._owned.append(Ownership(machine.namespace, CELL_OWNER if self._part is None
                                         else self._part.owner))
        # Nodes that were started otherwise, or on another computer of an open network.
        operator, end = self.operator, time.monotonic() + LOOK_AROUND_S
        spaces = {machine.namespace for machine in self.machines}
        while time.monotonic() < end:
            strangers = [f'{space}/{name}' for name, space in operator.node.get_node_names_and_namespaces()
                         if space in spaces and name in NODES]
            if strangers:
                raise StepdiagError(f'{strangers[0]} runs already and is not of this cell; end it, or choose '
                                    'another --namespace or ROS_DOMAIN_ID')
            time.sleep(0.1)

    def _endpoints(self) -> dict[str, dict]:
        """The instruments' addresses by machine; a virtual cell is started for them."""
        if self._part is not None:
            return {self.namespace: self._part_endpoints(self._part)}
        if self.hardware:
            found = {m.namespace: hardware_endpoints(m.cell) for m in self.machines[:1]}
            for machine in self.machines[1:]:
                found[machine.namespace] = found[self.namespace] | {
                    k: v for k, v in hardware_endpoints(machine.cell).items() if k in ('psd', 'cnc')}
            return found
        first = self._virtual()
        self._say(f'virtual cell {self.machines[0].cell.description.machine.name} is up')
        found = {self.namespace: first} | {
            namespace_of(name): yaml.safe_load(Path(path).read_text(encoding='utf-8'))
            for name, path in first.get('machines', {}).items()}
        for endpoints in found.values():
            if 'switch' in endpoints:
                endpoints['switch']['owner'] = self.namespace
        return found

    def _part_endpoints(self, part: Part) -> dict[str, Any]:
        if self.hardware:
            switch = ('switch',) if 'interferometer' in part.instruments else ()
            own = hardware_endpoints(self.machines[0].cell, (*part.instruments, *switch))
        else:
            own = self._virtual('--instruments', *part.instruments)
        own = {name: where for name, where in own.items() if isinstance(where, dict)}
        return {name: own.get(name, {}) | part.endpoints.get(name, {}) for name in (*own, *part.endpoints)}

    def _virtual(self, *options: str) -> dict[str, Any]:
        """Start the virtual cell; the addresses of its instruments."""
        file = self.runtime / 'endpoints.yaml'
        file.unlink(missing_ok=True)
        if self.machines[0].cell.instruments.control == 'linuxcnc' and (not options or 'cnc' in options):
            wait_until_free(self._say)
        self._spawn(_Child(CELL, [sys.executable, '-m', 'stepdiag_ros.virtual.cell_process',
                                  str(self.cell_path), '--runtime', str(self.runtime),
                                  '--truth', str(self.truth_file), *options], None))
        self._await(file.exists, self._children[CELL])
        return yaml.safe_load(file.read_text(encoding='utf-8'))

    def _command(self, machine: _Machine, node: str) -> list[str]:
        return [sys.executable, '-m', f'stepdiag_ros.nodes.{node}', '--ros-args',
                '-r', f'__ns:={machine.namespace}', '--params-file', str(machine.runtime / PARAMETERS)]

    def _spawn(self, child: _Child) -> None:
        with open(self.log_file(child.name), 'ab') as log:
            # A session of its own: Ctrl-C reaches this process alone, which ends the others
            # in order.
            child.process = subprocess.Popen(child.command, stdout=log, stderr=subprocess.STDOUT,
                                             stdin=subprocess.DEVNULL, start_new_session=True,
                                             preexec_fn=_end_with_parent)
        self._children[child.name] = child

    def log_file(self, name: str) -> Path:
        """What a process wrote."""
        return self.runtime / f'{name.replace(" ", "_").replace("/", "_")}.log'

    def _await(self, ready: Callable[[], bool], child: _Child) -> None:
        """Wait for a process that is being started, as long as it lives: one that ends has a reason to give."""
        if not Patience(START_TIMEOUT_S, ANSWER_S).until(ready, lambda: self._must_live(child)):
            raise StepdiagError(f'{child.called} is not up after {START_TIMEOUT_S:g} s; '
                                f'see {self.log_file(child.name)}')

    def _must_live(self, child: _Child) -> None:
        if child.process.poll() is not None:
            raise StepdiagError(f'{child.called} ended while it was being started: {self._last_words(child.name)}')

    def _last_words(self, name: str) -> str:
        lines = self.log_file(name).read_text(encoding='utf-8', errors='replace').strip().splitlines()
        return lines[-1].removeprefix('stepdiag: ') if lines else 'without a word'

    def _activate(self, child: _Child) -> None:
        """Configure and activate one node, with the parameters that its predecessor was given while it lived."""
        from stepdiag_ros.nodes.operator import ACTIVE
        operator = self.operator_of(child.namespace)
        self._await(lambda: operator.answers(child.node, ANSWER_S), child)
        try:
            operator.restore_parameters(child.node, START_TIMEOUT_S, but=OF_ONE_LIFE)
            operator.bring(child.node, ACTIVE, START_TIMEOUT_S)
        finally:
            self._must_live(child)     # its last words say more than that it does not answer

    # -- watch -------------------------------------------------------------------

    def watch(self) -> list[str]:
        """Look once; start again what has died.  Names of what was started again."""
        revived = []
        for child in list(self._children.values()):
            status = child.process.poll()
            if status is None:
                continue
            now = time.monotonic()
            child.deaths = [t for t in child.deaths if now - t < 60.0] + [now]
            how = f'was killed by signal {-status}' if status < 0 else f'ended with status {status}'
            if child.name == CELL:
                raise StepdiagError(f'the virtual cell {how}: {self._last_words(CELL)}')
            if len(child.deaths) > RESTARTS_A_MINUTE:
                raise StepdiagError(f'{child.name} died {len(child.deaths)} times within a minute: '
                                    f'{self._last_words(child.name)}')
            self._say(f'{child.name} {how}; starting it again')
            if child.node == 'recorder':
                self._keep_bag(child)
            self._spawn(child)
            self._activate(child)
            self.restarts += 1
            self._say(f'{child.name} is active again')
            revived.append(child.name)
        return revived

    def _keep_bag(self, recorder: _Child) -> None:
        """A recorder that is started again goes on in the bag that its death tore, once that is mended."""
        machine = next(m for m in self.machines if m.namespace == recorder.namespace)
        status = self.operator_of(recorder.namespace).recorder
        torn = Path(status.bag) if status is not None and status.bag else machine.bag
        if torn is None:
            return
        if not torn.exists():
            return
        self._say(f'{torn} is torn; it is mended, and recording goes on in it')
        recorder.command = [*self._command(machine, 'recorder'), '-p', f'bag:={torn}', '-p', 'go_on:=true']

    # -- stop --------------------------------------------------------------------

    def stop(self) -> None:
        """End everything: sequencers first (the machines stand), recorders after the sources,
        the virtual cell last."""
        for wanted in (lambda n: n == 'step_sequencer', lambda n: n and n not in LISTENERS,
                       lambda n: n in LISTENERS, lambda n: not n):
            self._end([child for child in self._children.values()
                       if child.process.poll() is None and wanted(child.node)])
        self._children.clear()
        for operator in self._operators.values():
            operator.close()
        self._operators.clear()
        for owned in self._owned:
            owned.release()
        self._owned.clear()
        if self._own_runtime and not self.failed:
            shutil.rmtree(self.runtime, ignore_errors=True)

    def _end(self, children: list[_Child]) -> None:
        for child in children:
            child.process.terminate()
        patience = Patience(GRACE_S)
        for child in children:
            while child.process.poll() is None:
                if patience.over():
                    self._say(f'{child.name} does not end; killing it')
                    child.process.kill()
                    child.process.wait()
                time.sleep(0.05)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('cell', type=Path, help='cell file, e.g. cells/demo.yaml')
    parser.add_argument('--hardware', action='store_true',
                        help="start no virtual cell: the file's instruments are real")
    parser.add_argument('--namespace', help="the machine's namespace (default: its name)")
    parser.add_argument('--bag', type=Path, help='rosbag2 directory to write (default: a new one)')
    parser.add_argument('--bag-folder', type=Path, default=Path('.'),
                        help='where new bags are made (default: here)')
    parser.add_argument('--runtime', type=Path, metavar='DIR',
                        help='directory for logs and parameters (default: a temporary one)')
    add_most(parser)
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='let the cell file name this Python file with an effect of your own; it is run, so '
                             'give only files that you trust')


def machines_carried(sharing: bool = False) -> int:
    """How many machines this computer carries by what was measured of processors and memory; ``sharing``: that share a
    laser."""
    by_processor = (SHARING_A_PROCESSOR if sharing else MACHINES_A_PROCESSOR) * len(os.sched_getaffinity(0))
    by_memory = len(machines_up()) + max(free_bytes() - SHARED_BYTES, 0) // MACHINE_BYTES
    return max(1, min(by_processor, by_memory))


def free_bytes(meminfo: Path = Path('/proc/meminfo')) -> int:
    """Memory [bytes] that new processes can have without anything being moved out."""
    lines = dict(line.split(':', 1) for line in meminfo.read_text(encoding='ascii').splitlines())
    return int(lines['MemAvailable'].split()[0]) << 10


def add_most(parser: argparse.ArgumentParser, sharing: bool = False) -> None:
    carried = machines_carried(sharing)
    parser.add_argument('--most', type=int, metavar='N', default=carried,
                        help='refuse to have more machines up on this computer (default: what one of its processors '
                             f'was measured to carry{" of those that share a laser" if sharing else ""}, times its '
                             'processors, or what its free memory holds if that is less: %(default)s)')


def refuse_too_many(more: int, most: int, what: str) -> None:
    """:class:`StepdiagError` where ``more`` machines beside those that are up are more than ``most``."""
    up = machines_up()
    if len(up) + more > most:
        beside = f' beside {len(up)} that are up' if up else ''
        raise StepdiagError(f'{what}: {more} machine{"s" if more > 1 else ""}{beside} are more than the {most} that '
                            'this computer carries; samples would be lost.  Take fewer, or give --most')


def run(arguments: argparse.Namespace) -> int:
    """Bring up and watch until Ctrl-C or SIGTERM."""
    allow_effect_files(arguments.effect)
    refuse_too_many(1 + len(load_cell(arguments.cell).instruments.machine_files), arguments.most, str(arguments.cell))
    asked: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda got, _frame: asked.append(got))

    def say(text: str) -> None:
        print(escaped(f'stepdiag: {text}'), flush=True)

    with Bringup(arguments.cell, hardware=arguments.hardware, namespace=arguments.namespace,
                 bag=arguments.bag, bag_folder=arguments.bag_folder, runtime=arguments.runtime,
                 say=say) as cell:
        for machine in cell.machines:
            say(f'calibrate with: stepdiag calibrate {machine.namespace}   (Ctrl-C ends)')
        while not asked:
            cell.watch()
            time.sleep(0.2)
        say('ending')
    say('all processes have ended')
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(prog='bringup', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    from rclpy.utilities import remove_ros_args
    try:
        return run(parser.parse_args(remove_ros_args(sys.argv)[1:]))
    except StepdiagError as error:
        print(escaped(f'stepdiag: {error}'), file=sys.stderr)
        return 2


if __name__ == '__main__':
    sys.exit(main())
