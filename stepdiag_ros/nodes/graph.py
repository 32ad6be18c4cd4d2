"""A cell's graph: which nodes, with which parameters.  No ROS, no processes.

From a cell file and the instruments' addresses follow the parameters of every node,
as a ROS parameter file that ``ros2 run … --params-file`` takes too.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.regulation import aim_of, told
from stepdiag_ros.virtual.cell import Cell

#: Nodes that keep the log: they receive all of it or the sequencer does not begin.
LISTENERS = ('recorder', 'evaluation_solver', 'gap_monitor')
#: Nodes of a machine, in the order in which they are made active: those that listen
#: first, the sequencer last.
NODES = (*LISTENERS, 'interferometer_driver', 'psd_driver', 'step_sequencer')
#: Nodes of an interferometer that machines share; they stand in the namespace of its owner.
LEASE_S = 5.0
SOURCE_NODES = ('interferometer_driver', 'multiplexer')
PARAMETERS = 'parameters.yaml'
DESCRIPTION_FILE = 'cell_description.yaml'


@dataclass(frozen=True)
class Graph:
    """What to start for one machine: its namespace, nodes, and the parameter file."""

    namespace: str
    nodes: tuple[str, ...]
    parameters_file: Path


def namespace_of(machine: str) -> str:
    """A machine's name as a ROS namespace: ``cell 1`` -> ``/cell_1``."""
    name = re.sub(r'[^A-Za-z0-9_]+', '_', machine).strip('_') or 'machine'
    return '/' + (name if not name[0].isdigit() else f'm{name}')


def hardware_endpoints(cell: Cell, wanted: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """Addresses of real instruments as the cell file gives them; each (of the ``wanted``) needs a port."""
    instruments = cell.instruments
    found = {'interferometer': {'host': instruments.interferometer.host,
                                'port': instruments.interferometer.port},
             'psd': {'host': instruments.psd.host, 'port': instruments.psd.port,
                     'stream_port': instruments.psd_stream.port},
             'cnc': {'host': instruments.cnc.host, 'port': instruments.cnc.port,
                     'setup_codes': dict(instruments.setup_codes),
                     **({'watch_port': instruments.watch_port} if instruments.watch_port else {})}}
    if instruments.multiplexer:
        found['switch'] = {'host': instruments.switch.host, 'port': instruments.switch.port,
                           'channels': {m: i + 1 for i, m in enumerate(instruments.multiplexer)},
                           'owner': namespace_of(cell.description.machine.name)}
    for name, where in found.items():
        for key in ('port', 'stream_port'):
            if where.get(key) == 0 and (not wanted or name in wanted):
                raise StepdiagError(f'{cell.source}: instruments.{name}.{key} is 0; '
                                    'give the port of the real instrument')
    return found


def parameters(cell: Cell, endpoints: Mapping[str, Mapping[str, Any]], description_file: Path,
               bag: Path | None, bag_folder: Path, steps: int = 0) -> dict[str, dict[str, Any]]:
    """Parameters by node; ``steps`` of an axis, 0: the cell's."""
    sampling, motion, detector = cell.sampling, cell.motion, cell.instruments.detector
    first = cell.setup_names[0]
    where = {name: dict(endpoints[name]) for name in ('interferometer', 'psd', 'cnc')}
    codes = where['cnc'].get('setup_codes') or {}
    drivers = cell.instruments.drivers
    beams = max(len(setup.beams) for setup in cell.description.setups.values())

    switch = endpoints.get('switch') or {}
    serves = [f'{namespace_of(machine).strip("/")}={channel}' for machine, channel
              in switch.get('channels', {}).items()] or ['']

    def rate(value: float) -> dict[str, Any]:
        return {'sample_rate': float(value), 'block_samples': max(1, round(value * sampling.block))}

    return {
        'recorder': {'bag': '' if bag is None else str(bag), 'bag_folder': str(bag_folder.absolute())},
        'evaluation_solver': {},
        'gap_monitor': {},
        'interferometer_driver': {
            'driver': drivers['interferometer'],
            'host': where['interferometer']['host'], 'port': where['interferometer']['port'],
            'setup': first, 'beams': beams, 'environment_period': max(0.5, float(cell.air.period)),
            'serves': serves, **rate(sampling.interferometer)},
        **({'multiplexer': {'host': switch['host'], 'port': switch['port'],
                            'lease': switch.get('lease', LEASE_S), 'serves': [*serves]}} if switch else {}),
        'psd_driver': {
            'driver': drivers['psd'],
            'host': where['psd']['host'], 'port': where['psd']['port'],
            'stream_port': where['psd']['stream_port'], 'setup': first,
            'channels': list(detector.channels), 'length': float(detector.length),
            'rotation': float(detector.rotation), 'gain': [float(g) for g in detector.gain],
            'zero': [float(z) for z in detector.zero], 'mode': detector.mode, **rate(sampling.psd),
            'regulated': told({name: aim_of(cell.description, name)
                               for name, setup in cell.description.setups.items() if setup.regulated}),
            'steering_range': float(detector.steering.range_rad),
            'steering_inputs': [*detector.steering.inputs] or [-1]},
        'step_sequencer': {
            'driver': drivers['cnc'],
            'host': where['cnc']['host'], 'port': where['cnc']['port'],
            'watch_port': where['cnc'].get('watch_port', 0),
            'origin': [float(c) for c in cell.description.machine.origin or (0.0, 0.0, 0.0)],
            'description_file': str(description_file), 'feed': float(motion.feed),
            'dwell': float(motion.dwell), 'stand': float(motion.stand), 'steps': steps,
            'setup_codes': [f'{setup}={code}' for setup, code in codes.items()] or [''],
            'lease': float(cell.client.lease), 'lost_client': cell.client.lost,
            # Where no code mounts the mirrors, as on most machines, a person does.
            'ask_operator': not codes,
            **({'light': f'{switch["owner"]}/use_source',
                'light_priority': switch.get('priority', 0)} if switch else {})},
    }


def write_graph(cell: Cell, endpoints: Mapping[str, Mapping[str, Any]], runtime: Path,
                namespace: str | None = None, bag: Path | None = None,
                bag_folder: Path = Path('.'), nodes: tuple[str, ...] = NODES,
                steps: int = 0) -> Graph:
    """Write description and parameter file into ``runtime``; what is to be started."""
    runtime.mkdir(parents=True, exist_ok=True)
    description_file = (runtime / DESCRIPTION_FILE).absolute()
    description_file.write_text(cell.description.to_yaml(), encoding='utf-8')
    space = namespace_of(cell.description.machine.name) if namespace is None \
        else '/' + namespace.strip('/')
    wanted = parameters(cell, endpoints, description_file, bag, bag_folder, steps)
    wanted['step_sequencer']['listeners'] = [name for name in nodes if name in LISTENERS] or ['']
    # Whatever namespace the nodes are started in, as by `ros2 launch`, these are theirs.
    content = {f'/**/{name}': {'ros__parameters': wanted[name]} for name in nodes if wanted[name]}
    file = (runtime / PARAMETERS).absolute()
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
    return Graph(space, nodes, file)
