"""The cell description of the wire contract: which machine, which plan, which setups.

It travels in every log as YAML on ``cell_description`` (schema 1) and is all
that an evaluation knows about the cell besides the measurements.
"""

import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.model.budget import Budget
from stepdiag_ros.model.statement import Statement, statement_of
from stepdiag_ros.model.surroundings import (
    AirValues,
    Expansion,
    air_of,
    scales_of,
    scales_to_dict,
    workpiece_of,
)
from stepdiag_ros.model.way import AROUND, GRID, TOGETHER, Way, problem

NEAREST_M = 0.02
"""No interferometer follows a retroreflector that is nearer than this."""
MADE_UP = 'made_up'
"""What ``times`` of a description says where a table had none."""
SCHEMA = 1
DIAGONALS = ('ppp', 'npp', 'pnp', 'nnp')
LINEAR = ('lin_x', 'lin_y', 'lin_z')
OWN_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]{0,39}')
"""A name that a setup with a way of its own may bear; in a log of joined logs with a number after a point."""
NAMING = (f'the short names are {", ".join(DIAGONALS + LINEAR)}; any other setup needs the keys from and to, and a '
          'name of letters, digits and _ that begins with a letter')


def path_of(setup: str) -> str:
    """The diagonal or line that a setup measures: ``ppp.2`` is ``ppp`` once more, mounted and aligned anew."""
    base, _, number = setup.partition('.')
    return base if not number or number.isdecimal() else setup


@dataclass(frozen=True)
class Machine:
    """A three-axis machine: name, kinematic chain, working volume [m], tool vector [m].

    ``origin`` [m]: machine coordinates of the volume's lower corner; None: not said.
    """

    name: str
    chain: str
    volume: tuple[float, float, float]
    tool: tuple[float, float, float]
    origin: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Plan:
    """A calibration plan: steps an axis, order of the axes in one step, repeats."""

    steps: int
    order: str
    repeats: int


@dataclass(frozen=True)
class Setup:
    """One setup of base unit and mirror.

    ``standoff`` [m] from the base unit to the mirror's reference point at stop 0;
    ``psd_offset`` [m] of the PSD's beam and ``beams`` [m] of the interferometer's,
    each along (u, v).  ``length`` [m] and ``stops`` belong to ``lin_x``, ``lin_y``, ``lin_z`` only; ``way`` to a setup
    without a short name.  ``repeats``: of this setup, None: as many as the plan's.  ``psd``: whether it has a detector.
    ``station`` (3,) [m]: about where an interferometer stands that follows a retroreflector at the tool, instead of a
    base unit and a mirror; ``tool`` (3,) [m] to that retroreflector, None: the machine's tool vector.
    ``regulated``: a detector at the station shows by what the beam misses it, and holds it there.  ``feed`` [m/s]: the
    axes go no faster, None: as fast as ever.
    """

    name: str
    standoff: float
    psd_offset: tuple[float, float]
    beams: tuple[tuple[float, float], ...]
    length: float | None = None
    stops: int | None = None
    way: Way | None = None
    repeats: int | None = None
    psd: bool = True
    station: tuple[float, ...] | None = None
    tool: tuple[float, ...] | None = None
    regulated: bool = False
    feed: float | None = None

    @property
    def follows(self) -> bool:
        """Whether a beam follows a retroreflector; else it stands still and meets a mirror."""
        return self.station is not None

    @property
    def sees_tilt(self) -> bool:
        """Whether a detector shows how the mirror tilts."""
        return self.psd and not self.follows

    @property
    def sees_spot(self) -> bool:
        """Whether light on a detector is expected."""
        return self.sees_tilt or self.regulated

    @property
    def overrun(self) -> float:
        """[m] from beyond which each end is approached; 0: it is not."""
        return 0.0 if self.way is None else self.way.overrun

    def tool_of(self, machine: Machine) -> tuple[float, ...]:
        """The tool vector (3,) [m] to what the beam meets."""
        return machine.tool if self.tool is None else self.tool

    @property
    def is_linear(self) -> bool:
        """Whether it is a line by a short name, from the origin, with ``length`` and ``stops``."""
        return self.way is None and path_of(self.name) in LINEAR

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes that move."""
        if self.way is not None:
            return self.way.axes
        return ('xyz'.index(path_of(self.name)[-1]),) if self.is_linear else (0, 1, 2)

    @property
    def is_line(self) -> bool:
        """Whether a single axis moves."""
        return len(self.axes) == 1

    @property
    def is_straight(self) -> bool:
        """Whether the machine moves along the beam, so that the beam's own direction shows to second order only."""
        return self.is_linear if self.way is None else self.way.is_straight and not self.follows

    @property
    def kind(self) -> str:
        """``line``, ``face diagonal``, ``body diagonal``, the latter two with ``step``, or ``multilateration``."""
        if self.follows:
            return 'multilateration'
        if self.is_line:
            return 'line'
        return f'{"face" if len(self.axes) == 2 else "body"} {"" if self.is_straight else "step "}diagonal'


@dataclass(frozen=True)
class Noise:
    """What the maker of a log believes of its noise, one standard deviation [m, m, m, rad]."""

    displacement: float = 5.0e-9
    spot: float = 2.0e-7
    position_repeatability: float = 3.0e-7
    angle_repeatability: float = 2.0e-7


@dataclass(frozen=True)
class Description:
    """A whole cell description.

    ``air``: where no topic tells; ``scales``: their material by axis letter; ``budget``: the cell's own lines;
    ``timed``: whether the log's times were measured, not made up for a table without.  ``workpiece``: its material.
    ``statement``: what its owner states of the test.
    """

    machine: Machine
    plan: Plan
    setups: dict[str, Setup]
    noise: Noise = field(default_factory=Noise)
    air: AirValues | None = None
    scales: dict[str, Expansion] = field(default_factory=dict)
    budget: Budget | None = None
    timed: bool = True
    workpiece: Expansion | None = None
    statement: Statement = field(default_factory=Statement)

    def repeats_of(self, setup: str) -> int:
        """How often a setup is measured, forward and backward."""
        return self.setups[setup].repeats or self.plan.repeats

    @classmethod
    def from_yaml(cls, text: str, source: str = 'cell_description') -> 'Description':
        """Parse and check; ``source`` names the file in errors (:class:`StepdiagError`)."""
        return cls.from_dict(strict_yaml.load(text, source), source)

    @classmethod
    def from_dict(cls, data: Any, source: str = 'cell_description') -> 'Description':
        """Build from a parsed mapping; every complaint names the key."""
        get = _Getter(source)
        get.mapping(data, 'cell_description')
        schema = data.get('schema')
        if schema != SCHEMA:
            raise StepdiagError(f'{source}: cell_description schema is {schema!r}; '
                                f'this version reads schema {SCHEMA}')
        m = get.mapping(data.get('machine'), 'machine')
        chain = str(m.get('chain', 'FXYZ')).upper()
        if sorted(chain) != sorted('FXYZ'):
            raise StepdiagError(f'{source}: machine.chain is {chain!r}; '
                                "write the letters F, X, Y, Z once each, e.g. 'FXYZ'")
        machine = Machine(get.name(m, 'machine.name', 'machine'), chain,
                          get.vector(m, 'machine.volume', 3, positive=True),
                          get.vector(m, 'machine.tool', 3, default=(0.0, 0.0, 0.0)),
                          None if m.get('origin') is None else get.vector(m, 'machine.origin', 3))
        p = get.mapping(data.get('plan'), 'plan')
        order = str(p.get('order', 'XYZ')).upper()
        if sorted(order) != ['X', 'Y', 'Z']:
            raise StepdiagError(f'{source}: plan.order is {order!r}; name X, Y and Z once each')
        plan = Plan(get.count(p, 'plan.steps', 1, limits.STEPS), order,
                    get.count(p, 'plan.repeats', 1, limits.REPEATS, default=1))
        raw = get.mapping(data.get('setups'), 'setups')
        if not raw:
            raise StepdiagError(f'{source}: setups is empty; name at least one of '
                                f'{", ".join(DIAGONALS + LINEAR)}')
        if len(raw) > limits.SETUPS:
            raise StepdiagError(f'{source}: setups names {len(raw)} setups; at most {limits.SETUPS} are read')
        setups = {}
        for name, body in raw.items():
            own, short = isinstance(body, dict) and ('from' in body or 'to' in body), path_of(str(name))
            if own and short in DIAGONALS + LINEAR:
                raise StepdiagError(f'{source}: setups.{name} has from or to, but its short name says its way; leave '
                                    'them out or give it another name')
            if not own and short not in DIAGONALS + LINEAR or not OWN_NAME.fullmatch(short):
                raise StepdiagError(f'{source}: unknown setup {name!r} in setups; {NAMING}')
            setups[name] = _setup(get, name, get.mapping(body, f'setups.{name}'), machine, plan.steps)
        n = data.get('noise') or {}
        get.mapping(n, 'noise')
        noise = Noise(*(get.number(n, f'noise.{key}', default=value, minimum=0.0, maximum=limits.NOISE)
                        for key, value in vars(Noise()).items()))
        return cls(machine, plan, setups, noise, air_of(get, data.get('air')),
                   scales_of(get, data.get('material')), _budget(data.get('budget'), source),
                   data.get('times') != MADE_UP, workpiece_of(get, data.get('material')),
                   statement_of(get, data.get('test')))

    def to_dict(self) -> dict[str, Any]:
        """The mapping of the contract, plain lists and floats."""
        setups = {}
        for name, s in self.setups.items():
            setups[name] = {'standoff': s.standoff, 'psd_offset': list(s.psd_offset),
                            'beams': [list(b) for b in s.beams]}
            if s.is_linear:
                setups[name] |= {'length': s.length, 'stops': s.stops}
            if s.way is not None:
                setups[name] |= {'from': list(s.way.start), 'to': list(s.way.end), 'moves': s.way.moves}
                setups[name] |= {} if s.way.steps is None else {'steps': s.way.steps}
                setups[name] |= {} if not s.way.targets else {'targets': list(s.way.targets)}
                setups[name] |= {} if not s.way.overrun else {'overrun': s.way.overrun}
            setups[name] |= {key: list(value) for key, value in (('station', s.station), ('tool', s.tool))
                             if value is not None}
            if not s.psd:
                setups[name]['psd'] = False
            if s.regulated:
                setups[name]['regulated'] = True
            if s.feed is not None:
                setups[name]['feed'] = s.feed
            if s.repeats is not None:
                setups[name]['repeats'] = s.repeats
        machine = {'name': self.machine.name, 'chain': self.machine.chain,
                   'volume': list(self.machine.volume), 'tool': list(self.machine.tool)}
        if self.machine.origin is not None:
            machine['origin'] = list(self.machine.origin)
        whole = {'schema': SCHEMA, 'machine': machine,
                 'plan': {'steps': self.plan.steps, 'order': self.plan.order,
                          'repeats': self.plan.repeats},
                 'setups': setups,
                 'noise': dict(vars(self.noise))}
        if self.air is not None:
            whole['air'] = self.air.to_dict()
        material = ({'scales': scales_to_dict(self.scales)} if self.scales else {}) | (
            {} if self.workpiece is None else {'workpiece': self.workpiece.to_dict()})
        if material:
            whole['material'] = material
        if self.budget is not None:
            whole['budget'] = self.budget.to_list()
        if not self.timed:
            whole['times'] = MADE_UP
        if stated := self.statement.to_dict():
            whole['test'] = stated
        return whole

    def to_yaml(self) -> str:
        return yaml.safe_dump(self.to_dict(), sort_keys=False, default_flow_style=None)


def _setup(get: '_Getter', name: str, body: dict, machine: Machine, steps: int) -> Setup:
    path = f'setups.{name}'
    standoff = get.number(body, f'{path}.standoff', default=0.0, minimum=0.0, maximum=limits.LENGTH_M)
    offset = get.vector(body, f'{path}.psd_offset', 2, default=(0.0, 0.0))
    raw = body.get('beams', [[0.0, 0.0]])
    if not isinstance(raw, list) or not 1 <= len(raw) <= limits.BEAMS:
        raise StepdiagError(f'{get.source}: {path}.beams must be a list of 1 to {limits.BEAMS} [u, v] offsets '
                            'in metres')
    beams = tuple(get.vector({'beams': b}, f'{path}.beams', 2) for b in raw)
    psd, regulated = (_boolean(get, body, f'{path}.{key}', default) for key, default in (
        ('psd', True), ('regulated', False)))
    feed = None if body.get('feed') is None else get.number(
        body, f'{path}.feed', default=0.0, minimum=limits.SLOWEST, maximum=limits.LENGTH_M)
    repeats = None if body.get('repeats') is None else get.count(body, f'{path}.repeats', 1, limits.REPEATS)
    station, tool = (None if body.get(key) is None else get.vector(body, f'{path}.{key}', 3)
                     for key in ('station', 'tool'))
    own = 'from' in body or 'to' in body
    length = stops = None
    if not own and path_of(name) in LINEAR:
        length = get.number(body, f'{path}.length', minimum=0.0, maximum=limits.LENGTH_M,
                            default=machine.volume['xyz'.index(path_of(name)[-1])])
        stops = get.count(body, f'{path}.stops', 2, limits.STOPS, default=2)
    setup = Setup(name, standoff, offset, beams, length, stops, _way(get, path, body) if own else None, repeats, psd,
                  station, tool, regulated, feed)
    wrong = setup_problem(setup, machine, steps)
    if wrong is not None:
        raise StepdiagError(f'{get.source}: {path}.{wrong[0]} {wrong[1]}')
    return setup


def _boolean(get: '_Getter', body: dict, path: str, default: bool) -> bool:
    value = body.get(path.rpartition('.')[2], default)
    if not isinstance(value, bool):
        raise StepdiagError(f'{get.source}: {path} is {_short(value)}; write true or false')
    return value


def _way(get: '_Getter', path: str, body: dict) -> Way:
    targets = body.get('targets', [])
    if not isinstance(targets, list) or len(targets) > limits.STOPS:
        raise StepdiagError(f'{get.source}: {path}.targets is {_short(targets)}; give a list of distances [m]')
    return Way(get.vector(body, f'{path}.from', 3), get.vector(body, f'{path}.to', 3),
               str(body.get('moves', TOGETHER)),
               None if body.get('steps') is None else get.count(body, f'{path}.steps', 1, limits.STEPS),
               get.vector(body, f'{path}.targets', len(targets), default=()),
               get.number(body, f'{path}.overrun', default=0.0, minimum=0.0, maximum=limits.LENGTH_M))


def setup_problem(setup: Setup, machine: Machine, steps: int) -> tuple[str, str] | None:
    """The key of a setup and what is wrong with it; None where it can be measured.  ``steps``: the plan's."""
    way = setup.way
    if setup.regulated and not (setup.follows and setup.psd):
        return 'regulated', ('is for a beam that follows a retroreflector by a detector: it needs a station, and no '
                             'psd: false')
    if way is None and (setup.follows or setup.tool is not None):
        return 'station' if setup.follows else 'tool', \
            'needs a way with from and to; a short name has a base unit and a mirror'
    if way is None:
        return None
    if wrong := problem(way, machine.volume, steps):
        return wrong
    if way.moves in (GRID, AROUND) and not setup.follows:
        return 'moves', f'is {way.moves}; a mirror cannot be followed there: give a station, or another way'
    if setup.tool is not None and not setup.follows:
        return 'tool', 'is for the retroreflector of a station; a mirror is at machine.tool'
    if setup.follows:
        return _of_station(setup, machine, steps)
    return None


def _of_station(setup: Setup, machine: Machine, steps: int) -> tuple[str, str] | None:
    if len(setup.beams) > 1:
        return 'beams', f'has {len(setup.beams)} beams; one follows the retroreflector'
    stops = setup.way.stops(steps)[0] + np.array(setup.tool_of(machine))
    nearest = float(np.linalg.norm(stops - np.array(setup.station), axis=1).min())
    if nearest < NEAREST_M:
        return 'station', (f'stands {1e3 * nearest:.3g} mm from a place of the retroreflector; '
                           f'leave at least {1e3 * NEAREST_M:g} mm')
    return None


def _budget(raw: Any, source: str) -> Budget | None:
    if raw is None:
        return None
    if not isinstance(raw, list) or not raw:
        raise StepdiagError(f'{source}: budget is {raw!r}; give a list of contributors')
    return Budget.from_list(raw, lambda number, key, text: StepdiagError(
        f'{source}: budget[{number}].{key}: {text}'), source)


class _Getter:
    """Reads checked values out of a mapping; complaints carry source and key path."""

    def __init__(self, source: str):
        self.source = source

    def mapping(self, value: Any, path: str) -> dict:
        if not isinstance(value, dict):
            raise StepdiagError(f'{self.source}: {path} is missing or not a mapping')
        return value

    def number(self, body: dict, path: str, default: float | None = None,
               minimum: float = -math.inf, maximum: float = math.inf) -> float:
        value = body.get(path.rsplit('.', 1)[-1], default)
        try:
            number = float(value if value is not None else 'none')
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if isinstance(value, bool) or not math.isfinite(number) or not minimum <= number <= maximum:
            bound = '' if minimum == -math.inf else f' of at least {minimum:g}'
            bound += '' if maximum == math.inf else f' of at most {maximum:g}'
            raise StepdiagError(f'{self.source}: {path} is {_short(value)}; give a finite number{bound}')
        return number

    def name(self, body: dict, path: str, default: str) -> str:
        value = str(body.get(path.rsplit('.', 1)[-1], default))
        if not 1 <= len(value) <= limits.NAME_LETTERS:
            raise StepdiagError(f'{self.source}: {path} is {_short(value)}; give a name of 1 to '
                                f'{limits.NAME_LETTERS} letters')
        return value

    def count(self, body: dict, path: str, minimum: int, maximum: int, default: int | None = None) -> int:
        value = body.get(path.rsplit('.', 1)[-1], default)
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
            raise StepdiagError(f'{self.source}: {path} is {_short(value)}; '
                                f'give a whole number of at least {minimum} and at most {maximum}')
        return value

    def vector(self, body: dict, path: str, size: int, positive: bool = False,
               default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        value = body.get(path.rsplit('.', 1)[-1], default)
        if not isinstance(value, list | tuple) or len(value) != size:
            raise StepdiagError(f'{self.source}: {path} is {_short(value)}; give {size} numbers in metres')
        numbers = tuple(self.number({'_': v}, f'{path}._', minimum=-limits.LENGTH_M, maximum=limits.LENGTH_M)
                        for v in value)
        if positive and min(numbers) <= 0.0:
            raise StepdiagError(f'{self.source}: {path} is {value!r}; each must be above zero')
        return numbers


def _short(value: Any) -> str:
    """A value as a complaint shows it."""
    text = repr(value)
    return text if len(text) <= 80 else f'{text[:77]}…'
