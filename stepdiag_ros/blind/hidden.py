"""Effects of the sealed world: their base, and how things change with time there.

The sealed world must not share its formulas with the diagnosis, or the check would only
show that a program can invert itself.  Its effects therefore are classes of their own
with forms of their own (two time constants, powers, random walks, …); the only thing they
share with :mod:`stepdiag_ros.effects` is the interface by which an effect acts on the
virtual cell, and the contract's names.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from stepdiag_ros.effects.base import Effect, Moment
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import start_corner, stops
from stepdiag_ros.model.sensor import station
from stepdiag_ros.virtual.cell import Cell

TimeProfile = Callable[[np.ndarray], np.ndarray]
UP = np.array([0.0, 0.0, 1.0])
PLACES = 64
"""Places of an axis that tables of random numbers keep apart."""
SLOW = {'log': 0.5, 'setup': 0.15, 'door': 0.15, 'rest': 0.2}
"""With what the time profile of what is warmed begins in wide worlds, and how often."""
ANY = {'log': 0.4, 'setup': 0.12, 'run': 0.18, 'door': 0.1, 'rest': 0.1, 'jump': 0.1}
"""The same of what may also begin anew in each run, or jump: a beam, a lamp, a tool point that is knocked."""


@dataclass(frozen=True)
class Stage:
    """What an effect may know when it is drawn: the cell, and when its runs take place.

    ``span_s`` [s]: length of the log; ``runs`` (r, 2) [s]: begin and end of each run;
    ``run_setup`` (r,): number of its setup.  ``wide``: time profiles may begin anew with each setup or run, wait for a
    door to open, follow work and rest, or jump; without, all begin with the log.
    """

    cell: Cell
    span_s: float
    runs: np.ndarray
    run_setup: np.ndarray
    wide: bool = False

    @property
    def travel(self) -> np.ndarray:
        """(3,) [m]."""
        return np.array(self.cell.description.machine.volume)

    def profiles(self, rng: np.random.Generator, count: int,
                 begins: Mapping[str, float] = SLOW) -> tuple[list[TimeProfile], list[str]]:
        """Several time profiles that are not correlated, and their kinds; they begin alike."""
        if not self.wide:
            both = [profile(rng, self.span_s) for _ in range(count)]
        else:
            with_what = str(rng.choice(list(begins), p=list(begins.values())))
            both = [_beginning(rng, self, with_what) for _ in range(count)]
        return [c for c, _ in both], [kind for _, kind in both]

    def profile(self, rng: np.random.Generator, begins: Mapping[str, float] = SLOW) -> tuple[TimeProfile, str]:
        """One of them."""
        (one,), (kind,) = self.profiles(rng, 1, begins)
        return one, kind


class Hidden(Effect):
    """An effect of the sealed world.

    A subclass draws its shape in ``__init__(stage, rng)`` and acts in proportion to ``size``
    (in ``unit``), which the sealer sets so that the effect is seen as well as was drawn.
    ``inside``: ``'coherent'`` or ``'random'`` if it acts inside the dwells, alike in all of them or
    with other phases in each; ``'stamps'`` if it changes no sample but when it seems taken.
    ``random``: the stops' means are changed at random.
    ``drawn``: sizes between which one is drawn, for an effect whose visibility follows no plausible
    size (stamps that are off by less than a control's own delays are nobody's concern).
    """

    outside = False
    unit = 'm'
    typical = 1e-6
    largest = 1e-4
    inside: str | None = None
    random = False
    drawn: tuple[float, float] | None = None

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__()
        self.stage = stage
        self.size = self.typical
        self.facts: dict[str, Any] = {}

    def describe(self) -> dict[str, Any]:
        """The truth about it, for the sealed file."""
        return {'size': self.size, 'unit': self.unit, 'form': type(self).__doc__.splitlines()[0],
                **self.facts}

    def weather(self, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Change of air temperature [°C], pressure [Pa], humidity [0..1] that sensors would show."""
        return None

    def warming(self, seconds: np.ndarray) -> np.ndarray | None:
        """Change of the scales' temperatures (n, 3) [°C] that sensors would show."""
        return None

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        """Change the finished log (stamps, quantisation)."""
        return log


def profile(rng: np.random.Generator, span_s: float) -> tuple[TimeProfile, str]:
    """A random profile over ``span_s`` seconds, about one from its least to its greatest; its kind."""
    kind = str(rng.choice(['two_time_constants', 'ramp_and_swing', 'power', 'logarithm', 'walk',
                           'warm_and_cool']))
    if kind == 'two_time_constants':
        fast, slow = span_s * rng.uniform(0.03, 0.2), span_s * rng.uniform(0.3, 1.5)
        share = rng.uniform(0.2, 0.8) * rng.choice([-1.0, 1.0], p=[0.2, 0.8])

        def raw(t):
            return share * (1.0 - np.exp(-t / fast)) + (1.0 - abs(share)) * (1.0 - np.exp(-t / slow))
    elif kind == 'ramp_and_swing':
        period, phase = span_s * rng.uniform(0.15, 0.6), rng.uniform(0.0, 2.0 * np.pi)
        ramp = rng.uniform(-1.0, 1.0)

        def raw(t):
            return ramp * t / span_s + 0.5 * np.sin(2.0 * np.pi * t / period + phase)
    elif kind == 'power':
        power = rng.choice([rng.uniform(0.3, 0.7), rng.uniform(1.4, 2.5)])

        def raw(t):
            return (t / span_s) ** power
    elif kind == 'logarithm':
        early = span_s * rng.uniform(0.01, 0.1)

        def raw(t):
            return np.log1p(t / early)
    elif kind == 'walk':
        knots = np.linspace(0.0, 1.2 * span_s, 50)
        walk = PchipInterpolator(knots, np.cumsum(rng.standard_normal(50)))

        def raw(t):
            return walk(np.minimum(t, knots[-1]))
    else:
        turn, up, down = span_s * rng.uniform(0.2, 0.7), rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.4)

        def raw(t):
            warm = 1.0 - np.exp(-np.minimum(t, turn) / (up * span_s))
            return warm * np.exp(-np.maximum(t - turn, 0.0) / (down * span_s))

    def at(t):
        return raw(np.maximum(np.asarray(t, float), 0.0))
    grid = at(np.linspace(0.0, span_s, 400))
    reach, begin = max(float(np.ptp(grid)), 1e-12), float(grid[0])
    return (lambda t: (at(t) - begin) / reach), kind


def _beginning(rng: np.random.Generator, stage: Stage, begins: str) -> tuple[TimeProfile, str]:
    """A random profile that begins with the log, each setup or run, or a door; that follows work and rest; a jump."""
    starts = stage.runs[:, 0]
    if begins in ('run', 'setup'):
        first = starts if begins == 'run' else starts[np.diff(stage.run_setup, prepend=-1) != 0]
        base, kind = profile(rng, float(np.diff(first, append=stage.span_s).max()))
        while kind == 'walk':   # which would wander within a dwell
            base, kind = profile(rng, float(np.diff(first, append=stage.span_s).max()))
        strength = 1.0 + 0.25 * rng.uniform(-1.0, 1.0, len(first))

        def along(t):
            part = np.maximum(np.searchsorted(first, np.asarray(t, float), side='right') - 1, 0)
            return strength[part] * base(t - first[part])
    elif begins == 'door':
        opened = stage.span_s * rng.uniform(0.15, 0.7)
        base, kind = profile(rng, stage.span_s - opened)

        def along(t):
            return base(np.asarray(t, float) - opened)
    elif begins == 'rest':
        # First order: towards one while the axes run, towards zero while they rest.
        kind, tau, grid = 'first order', stage.span_s * rng.uniform(0.02, 0.2), np.linspace(0.0, stage.span_s, 2000)
        running = np.sum(grid[:, None] >= starts, axis=1) > np.sum(grid[:, None] > stage.runs[:, 1], axis=1)
        state = np.zeros(len(grid))
        for i in range(1, len(grid)):
            state[i] = state[i - 1] + (running[i] - state[i - 1]) * (1.0 - np.exp(-(grid[1] - grid[0]) / tau))
        state /= max(float(np.ptp(state)), 1e-12)

        def along(t):
            return np.interp(t, grid, state)
    elif begins == 'jump':
        kind, at = 'jump', stage.span_s * rng.uniform(0.1, 0.9)

        def along(t):
            return (np.asarray(t, float) >= at).astype(float)
    else:
        return profile(rng, stage.span_s)
    return along, f'{kind}, {begins}'


def direction(rng: np.random.Generator, size: int = 3) -> np.ndarray:
    """A random unit vector (size,)."""
    vector = rng.standard_normal(size)
    return vector / np.linalg.norm(vector)


def across(rng: np.random.Generator, axis: int) -> np.ndarray:
    """A random unit vector (3,) across an axis."""
    return np.insert(direction(rng, 2), axis, 0.0)


def place_of(stage: Stage, moment: Moment, axis: int) -> np.ndarray:
    """Where an axis stands (n,), 0 to 1 of its travel."""
    return moment.commanded[:, axis] / stage.travel[axis]


def walk_of(moment: Moment) -> np.ndarray:
    """How far (n, 2) [m] the mirror has gone across the beam, along (u, v), since the setup's first stop."""
    machine, setup = moment.description.machine, moment.description.setups[moment.setup]
    return (moment.commanded - start_corner(machine, setup)) @ station(machine, setup).triad[:2].T


def ends_of_runs(stage: Stage) -> np.ndarray:
    """Where [m] each run begins and ends (r, 2, 3): a setup is walked to and fro."""
    names, seen, ends = list(stage.cell.description.setups), dict[int, int](), []
    for setup in stage.run_setup.tolist():
        there = stops(stage.cell.description, names[setup]).positions[[0, -1]]
        seen[setup] = seen.get(setup, -1) + 1
        ends.append(there if seen[setup] % 2 == 0 else there[::-1])
    return np.array(ends)


def turn_by(moment: Moment, turn: np.ndarray, arm: np.ndarray) -> None:
    """Turn (n, 3) [rad] the tool at the end of an ``arm`` (3,) or (n, 3) [m]."""
    moment.turn = moment.turn + turn
    moment.shift = moment.shift + np.cross(turn, arm)


def run_of(stage: Stage, seconds: np.ndarray) -> np.ndarray:
    """Number (n,) of the run that lasts, or that ended last."""
    return np.maximum(np.searchsorted(stage.runs[:, 0] - 1e-6, seconds, side='right') - 1, 0)


def chosen_axes(rng: np.random.Generator) -> np.ndarray:
    """Weights (3,) of the axes: one, two or all take part, the strongest with weight ±1."""
    count = rng.choice([1, 2, 3], p=[0.45, 0.2, 0.35])
    weight = np.zeros(3)
    picked = rng.permutation(3)[:count]
    weight[picked] = rng.uniform(0.3, 1.0, count) * rng.choice([-1.0, 1.0], count)
    return weight / np.abs(weight).max()
