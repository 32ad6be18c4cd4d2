"""A cell in one YAML file: the machine that does not exist, its instruments, its air.

:func:`load_cell` reads and checks a file such as ``cells/demo.yaml``; every complaint
names the file, the line and the key.  What is *drawn* (geometry, misalignments) is
drawn here, from the seed alone, so that a cell is the same machine wherever it is
loaded.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stepdiag_ros.devices.registry import DEFAULT, drivers
from stepdiag_ros.devices.steering import Steering
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.model.description import (
    DIAGONALS,
    LINEAR,
    NAMING,
    OWN_NAME,
    Description,
    Machine,
    Noise,
    Plan,
    Setup,
    setup_problem,
)
from stepdiag_ros.model.machine import GeometricErrors
from stepdiag_ros.model.regulation import sight
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.model.way import TOGETHER, Way
from stepdiag_ros.virtual import drawn
from stepdiag_ros.virtual.noise import NoiseLaw, NoiseLaws, Spread
from stepdiag_ros.virtual.surroundings import BELIEVED, believed_air, budget, scales, stated, workpiece
from stepdiag_ros.virtual.yamlreader import Reader, parse_yaml, read_yaml

SCHEMA = 1
OWN_KEYS = ('from', 'to', 'moves', 'steps', 'targets', 'overrun', 'station', 'tool', 'regulated')


@dataclass(frozen=True)
class Air:
    """Ambient air at the start and how it drifts; ``period`` [s] of the environment's readings.

    ``compensated``: the interferometer divides the present index of air out of its
    readings (and says so); otherwise it reports vacuum lengths.  ``sensors`` names the
    quantities that are measured; ``scale`` are the temperatures of the axes' scales,
    ``scale_temperature`` [°C] of X, Y, Z at the start with ``scale_drift`` [°C/h].
    """

    temperature: float = 20.0
    pressure: float = 101325.0
    humidity: float = 0.5
    temperature_drift: float = 0.0   # °C/h
    pressure_drift: float = 0.0      # Pa/h
    humidity_drift: float = 0.0      # 1/h
    compensated: bool = True
    sensors: tuple[str, ...] = ('temperature', 'pressure', 'humidity')
    scale_temperature: tuple[float, float, float] = (20.0, 20.0, 20.0)
    scale_drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    period: float = 2.0


@dataclass(frozen=True)
class Motion:
    """How the control moves: limits [m/s, m/s², m/s³], window [m], servo time constant, times [s].

    The window is far below the sensors' noise: what creeps in afterwards is an effect, servo_settling.
    ``dwell`` is how long a stop is measured, ``stand`` how much longer the first one after a mounting
    (live only), ``mount`` how long a change of setup takes on the virtual clock (offline only; the
    operator's time is his own).
    """

    feed: float = 0.1
    acceleration: float = 1.0
    jerk: float = 20.0
    in_position: float = 1.0e-9
    settling: float = 0.004
    dwell: float = 0.5
    stand: float = 0.0
    mount: float = 60.0


@dataclass(frozen=True)
class Endpoint:
    """Where an instrument listens; port 0: the virtual cell picks a free one."""

    host: str = '127.0.0.1'
    port: int = 0


@dataclass(frozen=True)
class Detector:
    """The PSD behind its analogue inputs: edge length [m], sum signal [V], inputs, mounting.

    ``channels``: inputs of I1…I4; ``rotation`` [rad] from the detector's x to u, ``gain``
    along its x and y, ``zero`` [m] as the driver is configured to take them off.  ``mode``: ``stream`` or ``poll``.
    ``steering``: what turns a regulated beam.
    """

    length: float = 0.010
    sum_voltage: float = 8.0
    channels: tuple[int, int, int, int] = (0, 1, 2, 3)
    rotation: float = 0.0
    gain: tuple[float, float] = (1.0, 1.0)
    zero: tuple[float, float] = (0.0, 0.0)
    mode: str = 'stream'
    steering: Steering = field(default_factory=Steering)


@dataclass(frozen=True)
class Instruments:
    """Addresses and settings of the three instruments.

    ``namespace`` is the firmware's (``ids`` before 1.9, ``sen`` since); ``newline`` whether it ends
    an answer with one.  ``multiplexer`` names the machines that share the interferometer through an
    optical ``switch``, this one first (empty: it is this one's alone); ``machine_files`` are the cell
    files of the others.  ``setup_codes``: what has a real machine's mirror mounted, M-code by setup.
    ``watchdog`` [s]: the virtual control brakes when its client has said nothing for so long while the
    axes move.  ``control`` of a virtual cell: ``virtual``, or ``linuxcnc`` for a real one; ``config`` is the
    folder of its configuration, ``watch_port`` where its watchdog takes signs of life.  ``drivers``: name of the driver
    by instrument.
    """

    interferometer: Endpoint = Endpoint()
    psd: Endpoint = Endpoint()
    psd_stream: Endpoint = Endpoint()
    cnc: Endpoint = Endpoint()
    namespace: str = 'sen'
    newline: bool = True
    multiplexer: tuple[str, ...] = ()
    machine_files: tuple[str, ...] = ()
    switch: Endpoint = Endpoint()
    control: str = 'virtual'
    config: str = ''
    watch_port: int = 0
    detector: Detector = Detector()
    watchdog: float = 1.0
    setup_codes: Mapping[str, str] = field(default_factory=dict)
    drivers: Mapping[str, str] = field(default_factory=lambda: dict(DEFAULT))


@dataclass(frozen=True)
class Client:
    """Whoever commands a calibration must live: ``lease`` [s] that it renews, and what ends its run when it is lost.

    ``lost``: ``next_stop`` ends the run when the stop has been measured, ``at_once`` stops the axes too.
    """

    lease: float = 5.0
    lost: str = 'next_stop'


@dataclass(frozen=True)
class Sampling:
    """Sample rates [Hz] and length of a block [s]; ``in_motion``: sample while the axes move too."""

    interferometer: float = 1000.0
    psd: float = 1000.0
    block: float = 0.1
    in_motion: bool = True


@dataclass(frozen=True)
class Cell:
    """A virtual cell, everything drawn.

    ``description`` is what the log will say; the rest is the truth behind it.
    ``misalignments`` and ``psd_zero`` [m] are by setup; ``effects`` maps the contract's
    names to parameters; ``noise_law`` says how the noise falls, ``description.noise`` how large it is; ``faults`` are
    injected by the servers (tests).  ``network``: whom the nodes
    talk to, ``loopback`` (this computer alone) or ``open``.
    """

    source: str
    seed: int
    description: Description
    geometry: GeometricErrors
    misalignments: Mapping[str, Misalignment]
    psd_zero: Mapping[str, tuple[float, float]]
    air: Air = Air()
    motion: Motion = Motion()
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    instruments: Instruments = Instruments()
    sampling: Sampling = Sampling()
    faults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    client: Client = Client()
    network: str = 'loopback'
    noise_law: NoiseLaws = field(default_factory=NoiseLaws)

    @property
    def setup_names(self) -> tuple[str, ...]:
        return tuple(self.description.setups)

    def motion_in(self, setup: str) -> Motion:
        """How the axes move in a setup: no faster than it says."""
        feed = self.description.setups[setup].feed
        return self.motion if feed is None else replace(self.motion, feed=min(feed, self.motion.feed))


def load_cell(path: str | Path) -> Cell:
    """Read a cell file; :class:`~stepdiag_ros.errors.StepdiagError` names file, line and key."""
    return _cell(read_yaml(path))


def parse_cell(text: str, source: str = 'cell') -> Cell:
    """As :func:`load_cell`, from text."""
    return _cell(parse_yaml(text, source))


def _cell(top: Reader) -> Cell:
    keys = top.mapping(('schema', 'seed', 'machine', 'plan', 'setups', 'noise', 'geometry',
                        'misalignments', 'air', 'material', 'budget', 'motion', 'effects', 'instruments',
                        'sampling', 'faults', 'network', 'client', 'noise_law', 'test'))
    if 'schema' in keys and keys['schema'].count() != SCHEMA:
        raise keys['schema'].fail(f'must be {SCHEMA} for this version')
    for needed in ('machine', 'plan', 'setups'):
        if needed not in keys:
            raise top.fail(f'the key {needed!r} is missing; see cells/demo.yaml')
    seed = keys['seed'].count() if 'seed' in keys else 0
    machine = _machine(keys['machine'])
    plan = _plan(keys['plan'])
    setups = _setups(keys['setups'], machine, plan.steps)
    motion = _fill(Motion, keys.get('motion'), {
        'feed': {'above': 0.0, 'minimum': limits.SLOWEST, 'unit': 'm/s'},
        'acceleration': {'above': 0.0, 'minimum': limits.SLOWEST, 'unit': 'm/s²'},
        'jerk': {'above': 0.0, 'minimum': limits.SLOWEST, 'unit': 'm/s³'},
        'in_position': {'minimum': limits.IN_POSITION_M, 'unit': 'm'},
        'settling': {'minimum': 0.0, 'unit': 's'}, 'dwell': {'above': 0.0, 'unit': 's'},
        'stand': {'minimum': 0.0, 'maximum': 3600.0, 'unit': 's'}, 'mount': {'minimum': 0.0, 'unit': 's'}})
    description = Description(machine, plan, setups, _noise(keys.get('noise')),
                              believed_air(keys.get('air')), scales(keys.get('material')), budget(keys.get('budget')),
                              workpiece=workpiece(keys.get('material')),
                              statement=stated(keys.get('test'), motion.feed))
    misalignments, zero = drawn.misalignments(keys.get('misalignments'), seed, tuple(setups))
    instruments = _instruments(keys.get('instruments'), machine.name, tuple(setups))
    _check_steering(top, description, instruments.detector.steering)
    return Cell(source=top.source, seed=seed, description=description,
                geometry=drawn.geometry(keys.get('geometry'), seed, description),
                misalignments=misalignments, psd_zero=zero, air=_air(keys.get('air')),
                motion=motion, effects=_named_mappings(keys.get('effects')),
                instruments=instruments,
                sampling=_sampling(keys.get('sampling')),
                faults=_named_mappings(keys.get('faults')), client=_client(keys.get('client')),
                network=keys['network'].text(('loopback', 'open')) if 'network' in keys else 'loopback',
                noise_law=_noise_laws(keys.get('noise_law')))


def _machine(node: Reader) -> Machine:
    keys = node.mapping(('name', 'chain', 'volume', 'tool', 'origin'))
    if 'volume' not in keys:
        raise node.fail("the key 'volume' is missing; give the travels of X, Y, Z [m]")
    chain = keys['chain'].text().upper() if 'chain' in keys else 'FXYZ'
    if sorted(chain) != sorted('FXYZ'):
        raise keys['chain'].fail(f"is {chain!r}; write F, X, Y and Z once each, e.g. 'FXYZ'")
    tool = keys['tool'].vector(3) if 'tool' in keys else (0.0, 0.0, 0.0)
    name = keys['name'].text() if 'name' in keys else 'machine'
    if len(name) > limits.NAME_LETTERS:
        raise keys['name'].fail(f'has {len(name)} letters; give at most {limits.NAME_LETTERS}')
    origin = keys['origin'].vector(3, unit='m') if 'origin' in keys else None
    return Machine(name, chain, keys['volume'].vector(3, above=0.0), tool, origin)


def _plan(node: Reader) -> Plan:
    keys = node.mapping(('steps', 'order', 'repeats'))
    if 'steps' not in keys:
        raise node.fail("the key 'steps' is missing; give the number of steps an axis")
    order = keys['order'].text().upper() if 'order' in keys else 'XYZ'
    if sorted(order) != ['X', 'Y', 'Z']:
        raise keys['order'].fail(f'is {order!r}; name X, Y and Z once each')
    repeats = keys['repeats'].count(1, limits.REPEATS) if 'repeats' in keys else 1
    return Plan(keys['steps'].count(1, limits.STEPS), order, repeats)


def _setups(node: Reader, machine: Machine, steps: int) -> dict[str, Setup]:
    setups = {}
    for name, child in node.mapping().items():
        linear, short = name in LINEAR, name in DIAGONALS + LINEAR
        if not short and not OWN_NAME.fullmatch(name):
            raise child.fail(f'is no name of a setup; {NAMING}')
        keys = child.mapping(('standoff', 'psd_offset', 'beams', 'repeats', 'psd', 'feed')
                             + (('length', 'stops') if linear else () if short else OWN_KEYS))
        if not short and not {'from', 'to'} <= set(keys):
            raise child.fail(f'is not a short name and lacks from or to; {NAMING}')
        standoff = keys['standoff'].number(minimum=0.0, maximum=limits.LENGTH_M, unit='m') if 'standoff' in keys \
            else 0.0
        offset = keys['psd_offset'].vector(2) if 'psd_offset' in keys else (0.0, 0.0)
        beams = tuple(b.vector(2) for b in keys['beams'].items()) if 'beams' in keys \
            else ((0.0, 0.0),)
        if not 1 <= len(beams) <= 3:
            raise keys['beams'].fail(f'has {len(beams)} beams; an interferometer has 1 to 3')
        length = stops = None
        if linear:
            travel = machine.volume['xyz'.index(name[-1])]
            length = keys['length'].number(above=0.0, maximum=travel, unit='m') \
                if 'length' in keys else travel
            stops = keys['stops'].count(2, limits.STOPS) if 'stops' in keys else 2
        station, tool = (keys[key].vector(3, unit='m') if key in keys else None for key in ('station', 'tool'))
        setups[name] = Setup(name, standoff, offset, beams, length, stops, None if short else _way(keys),
                             keys['repeats'].count(1, limits.REPEATS) if 'repeats' in keys else None,
                             keys['psd'].boolean() if 'psd' in keys else True, station, tool,
                             keys['regulated'].boolean() if 'regulated' in keys else False,
                             keys['feed'].number(above=0.0, minimum=limits.SLOWEST, maximum=limits.LENGTH_M,
                                                 unit='m/s') if 'feed' in keys else None)
        if wrong := setup_problem(setups[name], machine, steps):
            raise keys.get(wrong[0], child).fail(wrong[1] if wrong[0] in keys else ' '.join(wrong))
    if not setups:
        raise node.fail(f'is empty; name at least one of {", ".join(DIAGONALS + LINEAR)}')
    return setups


def _way(keys: Mapping[str, Reader]) -> Way:
    """From where to where a setup without a short name goes, and how."""
    return Way(keys['from'].vector(3), keys['to'].vector(3), keys['moves'].text() if 'moves' in keys else TOGETHER,
               keys['steps'].count(1, limits.STEPS) if 'steps' in keys else None,
               tuple(item.number(unit='m') for item in keys['targets'].items()) if 'targets' in keys else (),
               keys['overrun'].number(minimum=0.0, unit='m') if 'overrun' in keys else 0.0)


def _noise(node: Reader | None) -> Noise:
    return _fill(Noise, node, {key: {'minimum': 0.0, 'maximum': limits.NOISE} for key in vars(Noise())})


SPREAD: dict[str, dict] = {'dof': {'above': 2.0}, 'correlation': {'minimum': -0.999, 'maximum': 0.999}}
SHARE = {'minimum': 0.0, 'maximum': 0.9}
SENSOR_LAW: dict[str, dict] = SPREAD | {
    'quantum': {'minimum': 0.0, 'unit': 'm'}, 'dropouts': SHARE, 'burst': {'minimum': 1}, 'spikes': SHARE,
    'spike_size': {'minimum': 0.0}, 'duplicates': SHARE, 'late': {'minimum': 0.0, 'maximum': 1.0},
    'delay': {'minimum': 0.0, 'maximum': 1.0, 'unit': 's'}}


def _noise_laws(node: Reader | None) -> NoiseLaws:
    if node is None or node.is_null:
        return NoiseLaws()
    laws: dict[str, Any] = {}
    for name, child in node.mapping(('displacement', 'spot', 'position', 'angle')).items():
        sensor = name in ('displacement', 'spot')
        rules = SENSOR_LAW if sensor else SPREAD
        given = {} if child.is_null else {
            key: value.count(**rules[key]) if key == 'burst' else value.number(**rules[key])
            for key, value in child.mapping(tuple(rules)).items()}
        laws[name] = NoiseLaw(**given) if sensor else Spread(**given)
    return NoiseLaws(**laws)


def _fill(kind: type, node: Reader | None, rules: dict[str, dict]) -> Any:
    """A dataclass of numbers from a mapping with the same keys."""
    if node is None or node.is_null:
        return kind()
    return kind(**{key: child.number(**rules[key])
                   for key, child in node.mapping(tuple(rules)).items()})


def _air(node: Reader | None) -> Air:
    if node is None or node.is_null:
        return Air()
    keys = node.mapping(('temperature', 'pressure', 'humidity', 'drift', 'compensated', 'sensors',
                         'scale_temperature', 'scale_drift', 'period', *BELIEVED))
    given: dict[str, Any] = {}
    for key, rule in {'temperature': {'minimum': -20.0, 'maximum': 60.0, 'unit': '°C'},
                      'pressure': {'minimum': 5.0e4, 'maximum': 1.2e5, 'unit': 'Pa'},
                      'humidity': {'minimum': 0.0, 'maximum': 1.0},
                      'period': {'minimum': 1.0e-3, 'unit': 's'}}.items():
        if key in keys:
            given[key] = keys[key].number(**rule)
    if 'drift' in keys:
        for key, child in keys['drift'].mapping(tuple(limits.AIR_DRIFT)).items():
            given[f'{key}_drift'] = child.number(minimum=-limits.AIR_DRIFT[key], maximum=limits.AIR_DRIFT[key])
    if 'compensated' in keys:
        given['compensated'] = keys['compensated'].boolean()
    if 'sensors' in keys:
        given['sensors'] = tuple(item.text(('temperature', 'pressure', 'humidity', 'scale'))
                                 for item in keys['sensors'].items())
    for key, unit in (('scale_temperature', '°C'), ('scale_drift', '°C/h')):
        if key in keys:
            given[key] = keys[key].vector(3, unit=unit)
    return Air(**given)


def _endpoint(keys: dict[str, Reader], port: str = 'port') -> Endpoint:
    host = keys['host'].text() if 'host' in keys else Endpoint.host
    return Endpoint(host, keys[port].count(0, 65535) if port in keys else 0)


def _instruments(node: Reader | None, name: str, setups: tuple[str, ...]) -> Instruments:
    if node is None or node.is_null:
        return Instruments()
    given: dict[str, Any] = {}
    top = node.mapping(tuple(DEFAULT))
    given['drivers'] = dict(DEFAULT)
    if 'interferometer' in top:
        keys = top['interferometer'].mapping(('host', 'port', 'namespace', 'newline', 'multiplexer', 'driver'))
        given['interferometer'] = _endpoint(keys)
        _driver(keys, 'interferometer', given)
        if 'namespace' in keys:
            given['namespace'] = keys['namespace'].text(('ids', 'sen'))
        if 'newline' in keys:
            given['newline'] = keys['newline'].boolean()
        if 'multiplexer' in keys:
            given |= _multiplexer(keys['multiplexer'], name)
    if 'psd' in top:
        keys = top['psd'].mapping(('host', 'port', 'stream_port', 'length', 'sum_voltage',
                                   'channels', 'rotation', 'gain', 'zero', 'mode', 'driver', 'steering'))
        _driver(keys, 'psd', given)
        given['psd'], given['psd_stream'] = _endpoint(keys), _endpoint(keys, 'stream_port')
        detector: dict[str, Any] = {}
        for key, unit in (('length', 'm'), ('sum_voltage', 'V')):
            if key in keys:
                detector[key] = keys[key].number(above=0.0, unit=unit)
        if 'mode' in keys:
            detector['mode'] = keys['mode'].text(('stream', 'poll'))
        if 'rotation' in keys:
            detector['rotation'] = keys['rotation'].number(minimum=-3.2, maximum=3.2, unit='rad')
        for key, unit in (('gain', '1'), ('zero', 'm')):
            if key in keys:
                detector[key] = keys[key].vector(2, unit=unit)
        if 'channels' in keys:
            channels = tuple(item.count(0, 13) for item in keys['channels'].items())
            if len(channels) != 4 or len(set(channels)) != 4:
                raise keys['channels'].fail('must name four different analogue inputs')
            detector['channels'] = channels
        if 'steering' in keys:
            detector['steering'] = _steering(keys['steering'], detector.get('channels', Detector.channels))
        given['detector'] = Detector(**detector)
    if 'cnc' in top:
        keys = top['cnc'].mapping(('host', 'port', 'watchdog', 'control', 'config', 'watch_port', 'setup_codes',
                                   'driver'))
        given['cnc'] = _endpoint(keys)
        _driver(keys, 'cnc', given)
        if 'watchdog' in keys:
            given['watchdog'] = keys['watchdog'].number(minimum=0.05, maximum=10.0, unit='s')
        if 'control' in keys:
            given['control'] = keys['control'].text(('virtual', 'linuxcnc'))
        if 'config' in keys:
            given['config'] = keys['config'].text()
        if 'watch_port' in keys:
            given['watch_port'] = keys['watch_port'].count(0, 65535)
        if 'setup_codes' in keys:
            given['setup_codes'] = {setup: _m_code(code) for setup, code
                                    in keys['setup_codes'].mapping(tuple(dict.fromkeys(
                                        (*DIAGONALS, *LINEAR, *setups)))).items()}
    return Instruments(**given)


def _driver(keys: Mapping[str, Reader], instrument: str, given: dict[str, Any]) -> None:
    if 'driver' in keys:
        name = keys['driver'].text()
        if name not in drivers(instrument):
            raise keys['driver'].fail(f'is {name!r}; there is no such driver, known are '
                                      f'{", ".join(sorted(drivers(instrument)))}')
        given['drivers'][instrument] = name


def _m_code(node: Reader) -> str:
    code = node.text()
    if not re.fullmatch(r'M1\d\d', code):
        raise node.fail(f"is {code!r}; give one of the control's own M-codes, M100 to M199")
    return code


def _multiplexer(node: Reader, name: str) -> dict[str, Any]:
    """An optical switch and the other machines behind it, each described by a cell file."""
    keys = node.mapping(('host', 'port', 'machines'))
    if 'machines' not in keys or not keys['machines'].items():
        raise node.fail("the key 'machines' is missing or empty; name the other machines' cell files")
    names, files = [name], []
    for item in keys['machines'].items():
        file = Path(node.source).parent / item.text()
        try:
            other = load_cell(file)
        except StepdiagError as error:
            raise item.fail(f'cannot be used: {error}') from None
        if other.instruments.multiplexer:
            raise item.fail('has a multiplexer itself; name it in one of the files only')
        if other.description.machine.name in names:
            raise item.fail(f'is a machine {other.description.machine.name!r} too; '
                            'give each machine a name of its own')
        names.append(other.description.machine.name)
        files.append(str(file))
    return {'multiplexer': tuple(names), 'machine_files': tuple(files), 'switch': _endpoint(keys)}


def _steering(node: Reader, channels: tuple[int, ...]) -> Steering:
    keys = node.mapping(('range', 'inputs'))
    given: dict[str, Any] = {}
    if 'range' in keys:
        given['range_rad'] = keys['range'].number(above=0.0, maximum=1.5, unit='rad')
    if 'inputs' in keys:
        inputs = tuple(item.count(0, 13) for item in keys['inputs'].items())
        if len(inputs) != 2 or len({*inputs, *channels}) != 2 + len(channels):
            raise keys['inputs'].fail('must name the inputs of both angles, two others than the photocurrents\'')
        given['inputs'] = inputs
    return Steering(**given)


def _check_steering(top: Reader, description: Description, steering: Steering) -> None:
    """A regulated beam must reach every stop."""
    for name, setup in description.setups.items():
        if setup.regulated and (most := float(abs(sight(description, name)[0]).max())) > steering.range_rad:
            raise top.fail(f'setups.{name}: its beam would turn by {most:.3g} rad and the mirrors turn it by '
                           f'{steering.range_rad:g} rad (instruments.psd.steering.range); let the station stand '
                           'farther off, or the way be shorter')


def _client(node: Reader | None) -> Client:
    if node is None or node.is_null:
        return Client()
    keys = node.mapping(('lease', 'lost'))
    given: dict[str, Any] = {}
    if 'lease' in keys:
        given['lease'] = keys['lease'].number(minimum=0.5, maximum=3600.0, unit='s')
    if 'lost' in keys:
        given['lost'] = keys['lost'].text(('next_stop', 'at_once'))
    return Client(**given)


def _sampling(node: Reader | None) -> Sampling:
    if node is None or node.is_null:
        return Sampling()
    keys = node.mapping(('interferometer', 'psd', 'block', 'in_motion'))
    given: dict[str, Any] = {}
    for key in ('interferometer', 'psd'):
        if key in keys:
            given[key] = keys[key].number(minimum=0.1, maximum=50_000.0, unit='Hz')
    if 'block' in keys:
        given['block'] = keys['block'].number(above=0.0, maximum=60.0, unit='s')
    if 'in_motion' in keys:
        given['in_motion'] = keys['in_motion'].boolean()
    return Sampling(**given)


def _named_mappings(node: Reader | None) -> dict[str, dict[str, Any]]:
    """``{name: {parameter: value}}``; a name without parameters gets an empty mapping."""
    if node is None or node.is_null:
        return {}
    return {name: {} if child.is_null else {k: v.plain() for k, v in child.mapping().items()}
            for name, child in node.mapping().items()}


