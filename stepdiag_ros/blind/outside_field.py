"""Twelve effects from outside the vocabulary as they are met in the field, written without any look at the diagnosis.

They act at drives, scales and guideways, at the control and its compensations, at supplies of current and air, on the
mirror's face, on the detector's light and in its driver.  Nothing is remembered from call to call: what happened before
follows from the times of the runs, from where a run came from, or from the finished log.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.hidden import PLACES, UP, Stage, chosen_axes, direction, place_of, run_of, turn_by, walk_of
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import start_corner
from stepdiag_ros.model.sensor import station


def travelled(stage: Stage, moment: Moment) -> np.ndarray:
    """Which part of its travel each axis has gone (n, 3) since it turned round last: a run goes from end to end."""
    place = moment.commanded / stage.travel
    return np.clip(np.where(moment.approach > 0.0, place, 1.0 - place), 0.0, 1.0)


def slanting(stage: Stage) -> np.ndarray:
    """Which runs (r,) move more than one axis."""
    names = list(stage.cell.description.setups)
    return np.array([not names[setup].startswith('lin') for setup in stage.run_setup])


def one_setup(rng: np.random.Generator, stage: Stage) -> str:
    """Name of a setup with slanting runs, if there is any."""
    among = stage.run_setup[slanting(stage)] if slanting(stage).any() else stage.run_setup
    return list(stage.cell.description.setups)[int(rng.choice(among))]


def at_times(rng: np.random.Generator, stage: Stage, every_s: float) -> np.ndarray:
    """Times [s] of something that happens now and then, from before the log's begin until after its end."""
    count = int(1.3 * (stage.span_s + 10.0 * every_s) / every_s) + 20
    return np.cumsum(every_s * (0.25 + rng.exponential(0.75, count))) - 3.0 * every_s


# ---- drives, scales, guideways ----------------------------------------------------------------------

class WindUp(Outside):
    """a drive winds up like a spring: after turning round an axis lags more and more, over a good part of its travel"""

    name, typical, largest = 'wind_up', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._weight = chosen_axes(rng)
        self._way, self._power = rng.uniform(0.08, 0.4), rng.uniform(0.7, 1.6)
        self.facts = {'axes': self._weight.tolist(), 'way': self._way, 'power': self._power}

    def before_pose(self, moment: Moment) -> None:
        wound = 1.0 - np.exp(-(travelled(self.stage, moment) / self._way) ** self._power)
        moment.position = moment.position - self.size * wound * moment.approach * self._weight


class ChainHooks(Outside):
    """one way round the cable chain hooks on a screw: it pulls the head askew the harder until it jumps free"""

    name, unit, typical, largest = 'chain_hooks', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        count = len(stage.runs)
        self._axis, self._sense = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
        self._hook = rng.uniform(0.1, 0.4)
        self._pull = rng.uniform(0.7, 1.0, count) * (rng.random(count) < rng.uniform(0.5, 1.0))
        self._free = self._hook + rng.uniform(0.25, 0.6, count)
        self._vector, self._arm = direction(rng), direction(rng) * rng.uniform(0.1, 0.4)
        self.facts = {'axis': self._axis, 'sense': self._sense, 'hook': self._hook, 'runs': int(np.sum(self._pull > 0))}

    def before_pose(self, moment: Moment) -> None:
        run = run_of(self.stage, moment.seconds)
        way = travelled(self.stage, moment)[:, self._axis]
        hooked = (moment.approach[:, self._axis] == self._sense) & (way > self._hook) & (way < self._free[run])
        turn = (self.size * self._pull[run] * hooked * (way - self._hook) / 0.4)[:, None] * self._vector
        turn_by(moment, turn, self._arm)


class MeasuringWheelSlips(Outside):
    """an axis is measured by a wheel that rolls along: oil makes it slip, in each run another share of the way"""

    name, typical, largest, random = 'measuring_wheel_slips', 3e-6, 5e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, runs = int(rng.integers(3)), len(stage.runs)
        self._steps = stage.cell.description.plan.steps
        ragged = rng.uniform(0.1, 0.5)
        slips = np.clip(rng.standard_normal((runs, 1)), -2.5, 2.5) / self._steps \
            + ragged * rng.standard_normal((runs, PLACES)) / self._steps ** 0.5
        self._lost = np.concatenate([np.zeros((runs, 1)), np.cumsum(slips, axis=1)], axis=1)
        self.facts = {'axis': self._axis, 'ragged': ragged}

    def before_pose(self, moment: Moment) -> None:
        moves = np.rint(travelled(self.stage, moment)[:, self._axis] * self._steps).astype(int)
        lost = self._lost[run_of(self.stage, moment.seconds), np.minimum(moves, PLACES)]
        lost = self.size * lost * moment.approach[:, self._axis]
        moment.position = moment.position + lost[:, None] * np.eye(3)[self._axis]


# ---- control ----------------------------------------------------------------------------------------

class LaggingCompensation(Outside):
    """the control corrects one axis by a table over another one, one block late: by where that one was before"""

    name, typical, largest = 'lagging_compensation', 2e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._over, self._corrected = (int(k) for k in rng.permutation(3)[:2])
        self._step = 1.0 / stage.cell.description.plan.steps
        self._places = np.linspace(0.0, 1.0, int(rng.integers(4, 9)))
        table = rng.normal(0.0, 0.5) * self._places + rng.normal(0.0, 2.0) * self._places ** 2 \
            + 0.3 * rng.standard_normal(len(self._places))
        self._table = table / np.ptp(table)
        self.facts = {'over': self._over, 'corrected': self._corrected, 'table': self._table.tolist()}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._over)
        before = np.clip(place - self._step * moment.approach[:, self._over], 0.0, 1.0)
        late = np.interp(before, self._places, self._table) - np.interp(place, self._places, self._table)
        error = self.size * late * (moment.moved == self._over)
        moment.position = moment.position + error[:, None] * np.eye(3)[self._corrected]


class BrokenTemperatureWire(Outside):
    """the wire of a control's own sensor is broken and touches now and then: it stretches an axis, at a limited rate"""

    name, typical, largest = 'broken_temperature_wire', 3e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._fixed = int(rng.integers(3)), rng.uniform(-0.3, 1.3)
        stay = stage.span_s * rng.uniform(0.03, 0.12)
        changes = np.cumsum(rng.exponential(stay, 300)) - stay * rng.random()
        values = np.where(np.arange(301) % 2 == 0, 0.0, rng.uniform(0.5, 1.0, 301))
        self._grid = np.linspace(0.0, 1.05 * stage.span_s, 8000)
        wanted, step = values[np.searchsorted(changes, self._grid)], self._grid[1] / (stay * rng.uniform(0.3, 1.0))
        self._applied = np.zeros(len(wanted))
        for i in range(1, len(wanted)):
            self._applied[i] = self._applied[i - 1] + np.clip(wanted[i] - self._applied[i - 1], -step, step)
        self.facts = {'axis': self._axis, 'fixed': self._fixed, 'stay_s': stay}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        error = self.size * np.interp(moment.seconds, self._grid, self._applied) * (place - self._fixed)
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


class BasicRotationLeftOn(Outside):
    """a probing cycle left a basic rotation on: in some runs the control walks the path turned in the X-Y plane"""

    name, unit, typical, largest = 'basic_rotation_left_on', 'rad', 5e-6, 3e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        count = len(stage.runs)
        # Of a setup that is turned in all of its runs the lengths say no more than that its mirror stands askew.
        within = np.flatnonzero((np.diff(stage.run_setup) == 0) & slanting(stage)[1:]) + 1
        self._on = int(rng.choice(within)) if len(within) else count // 2
        self._off = min(self._on + int(rng.integers(1, max(count // 3, 2) + 1)), count)
        self._datum = np.append(rng.uniform(0.0, 1.0, 2), 0.0) * stage.travel
        self.facts = {'runs': [self._on, self._off], 'datum_m': self._datum[:2].tolist()}

    def before_pose(self, moment: Moment) -> None:
        run = run_of(self.stage, moment.seconds)
        angle = self.size * ((run >= self._on) & (run < self._off))
        moment.position = moment.position + angle[:, None] * np.cross(UP, moment.commanded - self._datum)


# ---- supplies ---------------------------------------------------------------------------------------

class MainsSag(Outside):
    """the mains sag whenever a big machine starts: for a second the hanging axis gives way and the laser dims"""

    name, typical, largest, random, inside = 'mains_sag', 3e-6, 5e-4, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every = rng.uniform(5.0, 25.0)
        self._starts = at_times(rng, stage, every)
        count = len(self._starts)
        self._depth, self._lasts = rng.lognormal(-0.2, 0.4, count), rng.uniform(0.3, 2.5, count)
        self._gives, self._back, self._dims = rng.uniform(0.05, 0.3), rng.uniform(0.1, 0.6), rng.uniform(0.0, 0.1)
        self.facts = {'every_s': every, 'gives_s': self._gives, 'back_s': self._back}

    def _sag(self, seconds: np.ndarray) -> np.ndarray:
        last = np.maximum(np.searchsorted(self._starts, seconds, side='right') - 1, 0)
        since = np.maximum(seconds - self._starts[last], 0.0)
        down = 1.0 - np.exp(-np.minimum(since, self._lasts[last]) / self._gives)
        return self._depth[last] * down * np.exp(-np.maximum(since - self._lasts[last], 0.0) / self._back)

    def before_pose(self, moment: Moment) -> None:
        moment.position = moment.position - self.size * self._sag(moment.seconds)[:, None] * UP

    def after_light(self, moment: Moment) -> None:
        dim = self._dims * min(self.size / self.typical, 1.0) * np.minimum(self._sag(moment.seconds), 1.0)
        moment.intensity = moment.intensity * (1.0 - dim)


class AirPressureDips(Outside):
    """compressed air runs short at times: a carriage on air pads sinks on one side, and rises when the tank is full"""

    name, unit, typical, largest = 'air_pressure_dips', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every, fall, rise = rng.uniform(25.0, 120.0), rng.uniform(3.0, 9.0), rng.uniform(12.0, 50.0)
        times = at_times(rng, stage, every)
        depth = rng.lognormal(-0.2, 0.5, len(times))
        self._grid = np.arange(0.0, 1.05 * stage.span_s + 1.0, 0.5)
        self._dip = np.zeros(len(self._grid))
        for time, deep in zip(times, depth, strict=True):
            since = np.maximum(self._grid - time, 0.0)
            self._dip += deep * (np.exp(-since / rise) - np.exp(-since / fall))
        self._axis = int(rng.integers(2))
        self._tip = np.append(direction(rng, 2), rng.normal(0.0, 0.2))
        self._pads, self._lean = rng.uniform(0.1, 0.3), rng.uniform(-0.6, 0.6)
        self.facts = {'every_s': every, 'rise_s': rise, 'axis': self._axis}

    def before_pose(self, moment: Moment) -> None:
        place = moment.commanded / self.stage.travel
        dip = self.size * np.interp(moment.seconds, self._grid, self._dip)
        turn = (dip * (1.0 + self._lean * (2.0 * place[:, self._axis] - 1.0)))[:, None] * self._tip
        # The lower the head hangs the longer is its arm below the pads.
        arm = np.array(moment.description.machine.tool) + (moment.commanded - self.stage.travel) * UP - 0.1 * UP
        turn_by(moment, turn, arm)
        moment.shift = moment.shift - dip[:, None] * self._pads * UP


# ---- mirror, light, detector ------------------------------------------------------------------------

class TouchedMirror(Outside):
    """someone touched the mirror: where the beam meets the finger's print one side of it is lost, the spot moves"""

    name, typical, largest = 'touched_mirror', 5e-6, 2e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        description = stage.cell.description
        machine, steps = description.machine, stage.travel / description.plan.steps
        setup = description.setups[one_setup(rng, stage)]
        moved = steps * np.where(start_corner(machine, setup) > 0.0, -1.0, 1.0) * [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
        walk = moved[int(rng.integers(2))] @ station(machine, setup).triad[:2].T
        self._radius = rng.uniform(0.25, 0.5) * max(float(np.linalg.norm(walk)), 1e-3)
        self._middle = walk + 0.8 * self._radius * direction(rng, 2)
        self._run, self._swallows = int(rng.integers(1, max(len(stage.runs) // 2, 2))), rng.uniform(0.05, 0.4)
        self.facts = {'middle_m': self._middle.tolist(), 'radius_m': self._radius, 'run': self._run}

    def after_light(self, moment: Moment) -> None:
        out = (walk_of(moment) - self._middle) / self._radius
        there = (run_of(self.stage, moment.seconds) >= self._run) * np.exp(-0.5 * np.sum(out ** 2, axis=1))
        moment.spot = moment.spot + 1.6 * self.size * there[:, None] * out
        lost = self._swallows * min(self.size / self.typical, 1.0) * there
        moment.intensity = moment.intensity * (1.0 - lost)
        moment.quality = moment.quality * (1.0 - lost)


class CoolantDrops(Outside):
    """drops of coolant run down the mirror: each is a lens that passes the beams one by one, bends and delays them"""

    name, typical, largest, random = 'coolant_drops', 5e-6, 2e-3, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every = rng.uniform(15.0, 80.0)
        self._times = at_times(rng, stage, every)
        count = len(self._times)
        self._lasts, self._large = rng.uniform(1.0, 6.0, count), rng.lognormal(-0.2, 0.5, count)
        self._late, self._aside = rng.uniform(-20.0, 20.0, 16), rng.uniform(0.2, 1.0, 16)
        self._down, self._delay = direction(rng, 2), rng.uniform(0.005, 0.05)
        self.facts = {'every_s': every, 'delay': self._delay}

    def _passes(self, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Thickness of what the drops near in time leave before a beam (n,), and its slope."""
        thick, slope, middle = np.zeros(len(seconds)), np.zeros(len(seconds)), np.searchsorted(self._times, seconds)
        for k in range(-4, 4):
            drop = np.clip(middle + k, 0, len(self._times) - 1)
            valid = (middle + k >= 0) & (middle + k < len(self._times))
            off = (seconds - self._times[drop]) / self._lasts[drop]
            lens = valid * self._large[drop] * np.exp(-0.5 * off ** 2)
            thick, slope = thick + lens, slope + off * lens
        return thick, slope

    def after_light(self, moment: Moment) -> None:
        thick, slope = self._passes(moment.seconds)
        moment.spot = moment.spot + 1.6 * self.size * slope[:, None] * self._down
        moment.intensity = moment.intensity * (1.0 - 0.2 * min(self.size / 1e-3, 1.0) * np.minimum(thick, 1.0))
        length = moment.length.copy()
        for beam in range(length.shape[1]):
            late, aside = self._late[beam % 16], self._aside[beam % 16]
            length[:, beam] += self.size * self._delay * aside * self._passes(moment.seconds - late)[0]
        moment.length = length


class ChuckGlints(Outside):
    """a bright chuck glints: in one part of one setup's path its light falls beside the spot and draws it there"""

    name, typical, largest = 'chuck_glints', 5e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        description = stage.cell.description
        self._setup = one_setup(rng, stage)
        corner = start_corner(description.machine, description.setups[self._setup]) / stage.travel
        along = rng.uniform(0.2, 0.8)
        self._place = corner + along * (1.0 - 2.0 * corner) + rng.normal(0.0, 0.08, 3)
        self._width, self._there = rng.uniform(0.08, 0.25, 3), direction(rng, 2)
        self._bright = rng.uniform(0.01, 0.1)
        self.facts = {'setup': self._setup, 'along': along, 'direction': self._there.tolist()}

    def after_light(self, moment: Moment) -> None:
        if moment.setup != self._setup:
            return
        away = (moment.commanded / self.stage.travel - self._place) / self._width
        glint = np.exp(-0.5 * np.sum(away ** 2, axis=1))
        moment.spot = moment.spot + self.size * glint[:, None] * self._there
        moment.intensity = moment.intensity * (1.0 + self._bright * min(self.size / self.typical, 1.0) * glint)


class DriverHangs(Outside):
    """the detector's driver hangs now and then: for seconds it sends the last spot again and again, newly stamped"""

    name, unit, typical, largest, random = 'driver_hangs', 's', 2.0, 60.0, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        hangs = int(rng.integers(12, 50))
        begin, end = stage.runs.min(), stage.runs.max()
        self._hangs = np.sort(rng.uniform(begin, end, hangs)) - begin
        self._lasts = rng.lognormal(0.0, 0.5, hangs)
        self.facts = {'hangs': hangs}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        values, seconds = log.spot.values.copy(), (log.spot.time_ns - log.spot.time_ns[0]) * 1e-9
        for hang, lasts in zip(self._hangs, self._lasts, strict=True):
            first, last = np.searchsorted(seconds, [hang, hang + self.size * lasts])
            if 0 < first < last:
                values[first:last] = values[first - 1]
        return replace(log, spot=replace(log.spot, values=values))


FIELD = (WindUp, ChainHooks, MeasuringWheelSlips, LaggingCompensation, BrokenTemperatureWire, BasicRotationLeftOn,
         MainsSag, AirPressureDips, TouchedMirror, CoolantDrops, ChuckGlints, DriverHangs)
