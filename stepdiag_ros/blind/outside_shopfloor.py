"""Twenty effects from outside the vocabulary as a shop floor has them, written without any look at the diagnosis.

They act at scales, guideways, clamps, feet and bed, at the spindle and its head, the laser, the counter's interface,
the detector and its amplifier, come from the neighbourhood, from a pump, from who operates and from what was done to
the control.  Nothing is remembered from call to call: what happened before follows from the times of the runs, the
number of the arrival or the direction of the last motion.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.hidden import PLACES, UP, Stage, across, direction, place_of, run_of, turn_by
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import start_corner
from stepdiag_ros.model.sensor import station


def stop_of(stage: Stage, moment: Moment, axis: int) -> np.ndarray:
    """At which step (n,) of the plan an axis stands; within a run an axis comes to each but once."""
    steps = stage.cell.description.plan.steps
    return np.clip(np.rint(place_of(stage, moment, axis) * steps), 0, PLACES - 1).astype(int)


def rock(moment: Moment, turn: np.ndarray, pivot: np.ndarray) -> None:
    """Turn (n, 3) [rad] the tool, with all that carries it, about ``pivot`` (3,) [m]."""
    turn_by(moment, turn, moment.commanded + np.array(moment.description.machine.tool) - pivot)


def telegraph(rng: np.random.Generator, span_s: float, low_s: float, high_s: float) -> np.ndarray:
    """Times [s] at which something of two states changes over; it stays in one and the other for so long on average."""
    pairs = int(1.2 * span_s / (low_s + high_s)) + 20
    return np.cumsum(np.stack([rng.exponential(low_s, pairs), rng.exponential(high_s, pairs)], axis=1).ravel())


# ---- measuring systems, guideways, clamps -----------------------------------------------------------

class ResolverOffset(Outside):
    """a resolver's zero follows the cycle of the cabinet's cooler: positions swing with each turn of the screw"""

    name, typical, largest = 'resolver_offset', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, swing = int(rng.integers(3)), np.zeros(1)
        places = np.linspace(0.0, stage.travel[self._axis], stage.cell.description.plan.steps + 1)
        # A lead that divides the steps would be met in one phase everywhere.
        while np.ptp(swing) < 1.0:
            self._lead, self._phase = rng.uniform(3e-3, 2e-2), rng.uniform(0.0, 2.0 * np.pi)
            swing = np.sin(2.0 * np.pi * places / self._lead + self._phase)
        period = rng.uniform(40.0, 300.0)
        switched = np.cumsum(period * rng.uniform(0.25, 0.75, int(3.0 * stage.span_s / period) + 20))
        self._times, self._warm = switched - switched[0] - rng.uniform(0.0, period), np.arange(len(switched)) % 2
        self.facts = {'axis': self._axis, 'lead_m': self._lead, 'period_s': period}

    def before_pose(self, moment: Moment) -> None:
        turn = 2.0 * np.pi * moment.commanded[:, self._axis] / self._lead + self._phase
        error = self.size * np.interp(moment.seconds, self._times, self._warm) * np.sin(turn)
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


class ScratchedScale(Outside):
    """a scale is scratched in one place: there an axis arrives now here, now there, everywhere else as it should"""

    name, typical, largest, random = 'scratched_scale', 3e-6, 2e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        steps = stage.cell.description.plan.steps
        self._axis, self._stop = int(rng.integers(3)), int(rng.integers(1, steps))
        self._reach = rng.uniform(0.4, 0.8) + 0.08 * steps
        self._error = np.clip(rng.standard_normal((len(stage.runs), PLACES)), -2.5, 2.5)
        self.facts = {'axis': self._axis, 'place': self._stop / steps, 'reach': self._reach / steps}

    def before_pose(self, moment: Moment) -> None:
        stop = stop_of(self.stage, moment, self._axis)
        scratch = np.exp(-0.5 * ((stop - self._stop) / self._reach) ** 4)
        error = self.size * scratch * self._error[run_of(self.stage, moment.seconds), stop]
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


class CountHopping(Outside):
    """an axis's encoder is coarse: the servo hops at random between two neighbouring counts while it should stand"""

    name, typical, largest, random, inside = 'count_hopping', 5e-7, 5e-5, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(3))
        stays = np.exp(rng.uniform(np.log(0.08), np.log(0.8), 2))
        self._hops = telegraph(rng, stage.span_s, *stays)
        self.facts = {'axis': self._axis, 'stays_s': stays.tolist()}

    def before_pose(self, moment: Moment) -> None:
        count = np.searchsorted(self._hops, moment.seconds) % 2 - 0.5
        moment.position = moment.position + self.size * count[:, None] * np.eye(3)[self._axis]


class DentedLiner(Outside):
    """a carriage stood on its plastic liner while the mirror was mounted: there it sits in a dent that slowly fills"""

    name, typical, largest = 'dented_liner', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(2))
        self._width, self._length = rng.uniform(0.15, 0.4), rng.uniform(0.2, 0.6)
        self._pitch = np.cross(UP, np.eye(3)[self._axis])
        names = list(stage.cell.description.setups)
        self._begins = {name: float(stage.runs[stage.run_setup == k, 0].min())
                        for k, name in enumerate(names) if np.any(stage.run_setup == k)}
        one = float(np.diff(stage.runs, axis=1).max())
        self._tau = rng.uniform(0.5, 2.5) * one
        self.facts = {'axis': self._axis, 'width': self._width, 'tau_s': self._tau}

    def before_pose(self, moment: Moment) -> None:
        corner = start_corner(moment.description.machine, moment.description.setups[moment.setup])
        away = (moment.commanded - corner)[:, self._axis] / self.stage.travel[self._axis] / self._width
        left = np.exp(-np.maximum(moment.seconds - self._begins.get(moment.setup, 0.0), 0.0) / self._tau)
        dent = self.size * left * np.exp(-0.5 * away**2)
        moment.shift = moment.shift - dent[:, None] * UP
        moment.turn = moment.turn + (dent * (0.5 + away) / self._length)[:, None] * self._pitch


class LubricationShot(Outside):
    """after so many strokes a guideway gets a shot of oil: the carriage floats up and sinks again stroke by stroke"""

    name, typical, largest = 'lubrication_shot', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._every = int(rng.integers(3)), int(rng.integers(23, 90))
        self._first, self._strokes = int(rng.integers(self._every)), rng.uniform(2.0, 10.0)
        self._lift = across(rng, self._axis)
        self._tilt = across(rng, self._axis) / rng.uniform(0.4, 1.5)
        self.facts = {'axis': self._axis, 'every': self._every, 'strokes': self._strokes}

    def before_pose(self, moment: Moment) -> None:
        film = self.size * np.exp(-((moment.arrival - self._first) % self._every) / self._strokes)
        moment.shift = moment.shift + film[:, None] * self._lift
        moment.turn = moment.turn + film[:, None] * self._tilt


class ClampTips(Outside):
    """an axis is clamped whenever another one moves, and the clamp tips its carriage"""

    name, unit, typical, largest = 'clamp_tips', 'rad', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._vector = int(rng.integers(3)), direction(rng)
        self._arm = direction(rng) * rng.uniform(0.1, 0.5)
        self.facts = {'axis': self._axis, 'vector': self._vector.tolist()}

    def before_pose(self, moment: Moment) -> None:
        turn_by(moment, self.size * (moment.moved != self._axis)[:, None] * self._vector, self._arm)


# ---- bed and feet -------------------------------------------------------------------------------

class RockingFoot(Outside):
    """one foot of the bed hangs free: the machine rocks over when the carriages pass the middle, and back only later"""

    name, unit, typical, largest = 'rocking_foot', 'rad', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._weight = np.array([1.0, rng.uniform(0.3, 1.0), 0.0])[list(rng.permutation(2)) + [2]]
        self._weight[:2] *= rng.choice([-1.0, 1.0], 2)
        self._middle, self._play = rng.uniform(-0.15, 0.15), rng.uniform(0.05, 0.25)
        self._edge = np.cross(UP, self._weight)
        self._edge /= np.linalg.norm(self._edge)
        self.facts = {'weight': self._weight.tolist(), 'middle': self._middle, 'play': self._play}

    def before_pose(self, moment: Moment) -> None:
        place = (moment.commanded / self.stage.travel - 0.5) @ self._weight
        going = np.sign(moment.approach @ self._weight)
        over = place > self._middle + going * self._play
        rock(moment, self.size * over[:, None] * self._edge, self.stage.travel * [0.5, 0.5, -0.5])


class CreepingBed(Outside):
    """a bed of mineral cast creeps under its load: it stays bent to where the carriage was"""

    name, unit, typical, largest = 'creeping_bed', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(2))
        one = float(np.diff(stage.runs, axis=1).max())
        self._tau = one * rng.uniform(0.3, 3.0)
        self._pitch = np.cross(UP, np.eye(3)[self._axis]) + rng.normal(0.0, 0.3) * np.eye(3)[self._axis]
        times, places = self._stays()
        self._grid = np.linspace(0.0, 1.05 * stage.span_s, 6000)
        place, bent = np.interp(self._grid, times, places), np.zeros(len(self._grid))
        follow, bent[0] = 1.0 - np.exp(-(self._grid[1] - self._grid[0]) / self._tau), place[0]
        for i in range(1, len(bent)):
            bent[i] = bent[i - 1] + follow * (place[i] - bent[i - 1])
        self._bent = bent - 0.5
        self.facts = {'axis': self._axis, 'tau_s': self._tau}

    def _stays(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the axis is (2 r,), 0 to 1, when runs begin and end: forward first, back in every second."""
        description, places = self.stage.cell.description, []
        names, seen = list(description.setups), {}
        for setup in self.stage.run_setup:
            name = names[setup]
            begin = start_corner(description.machine, description.setups[name])[self._axis]
            begin /= self.stage.travel[self._axis]
            end = 1.0 - begin if not name.startswith('lin') or name[4] == 'xyz'[self._axis] else begin
            seen[setup] = seen.get(setup, 0) + 1
            places += [begin, end] if seen[setup] % 2 else [end, begin]
        return self.stage.runs.ravel(), np.array(places)

    def before_pose(self, moment: Moment) -> None:
        bent = self.size * np.interp(moment.seconds, self._grid, self._bent)
        rock(moment, bent[:, None] * self._pitch, 0.5 * self.stage.travel)


class RubberFeet(Outside):
    """the machine stands on rubber: each stop of a horizontal axis rocks it, and it comes back in a second or two"""

    name, unit, typical, largest, inside = 'rubber_feet', 'rad', 2e-6, 3e-4, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._tau = rng.uniform(0.3, 2.0)
        self._mass = np.array([1.0, rng.uniform(0.3, 1.5), 0.0])
        self._twist = rng.normal(0.0, 0.3, 2)
        self.facts = {'tau_s': self._tau, 'mass': self._mass.tolist()}

    def before_pose(self, moment: Moment) -> None:
        left = self.size * np.exp(-np.maximum(moment.since_arrival, 0.0) / self._tau)
        push = np.where(moment.moved[:, None] == np.arange(3), moment.approach * self._mass, 0.0)
        turn = np.cross(UP, push) + (push[:, :2] @ self._twist)[:, None] * UP
        rock(moment, left[:, None] * turn, self.stage.travel * [0.5, 0.5, -1.0])


# ---- spindle and head ---------------------------------------------------------------------------

class SpindleReorients(Outside):
    """the spindle is released between runs and oriented anew: the mirror turns about its axis from run to run"""

    name, unit, typical, largest = 'spindle_reorients', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._turn = np.clip(rng.standard_normal(len(stage.runs)), -2.5, 2.5)
        self._axis = UP + np.append(rng.normal(0.0, 0.03, 2), 0.0)
        self.facts = {'runs': len(stage.runs)}

    def before_light(self, moment: Moment) -> None:
        u, v, _ = station(moment.description.machine, moment.description.setups[moment.setup]).triad
        turn = self.size * self._turn[run_of(self.stage, moment.seconds)]
        moment.mirror = moment.mirror + np.outer(turn, [u @ self._axis, v @ self._axis])


class HeadUnclamped(Outside):
    """the clamp of a swivel head is open: each jolt of one axis leaves the head turned a little, until its next jolt"""

    name, unit, typical, largest, random = 'head_unclamped', 'rad', 3e-6, 3e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._swivel = int(rng.integers(3)), np.eye(3)[int(rng.integers(2))]
        self._turn = rng.laplace(0.0, 0.7, (len(stage.runs), PLACES))
        self._pivot = rng.uniform(0.1, 0.4)
        self.facts = {'axis': self._axis, 'swivel': self._swivel.tolist(), 'pivot_m': self._pivot}

    def before_pose(self, moment: Moment) -> None:
        arm = np.array(moment.description.machine.tool) - self._pivot * UP
        stop = stop_of(self.stage, moment, self._axis)
        turn_by(moment, self.size * self._turn[run_of(self.stage, moment.seconds), stop][:, None] * self._swivel, arm)


# ---- laser and counter --------------------------------------------------------------------------

class UnlockedLaser(Outside):
    """the laser never locked: as its tube warms it sweeps through mode after mode, slower and slower"""

    name, unit, typical, largest = 'unlocked_laser', '1', 1e-6, 5e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._sweeps, self._tau = rng.uniform(15.0, 80.0), stage.span_s * rng.uniform(0.2, 0.8)
        self._phase, self._sense = rng.random(), float(rng.choice([-1.0, 1.0]))
        self.facts = {'sweeps': self._sweeps, 'tau_s': self._tau}

    def after_light(self, moment: Moment) -> None:
        swept = self._phase + self._sweeps * (1.0 - np.exp(-moment.seconds / self._tau))
        moment.length = moment.length * (1.0 + self._sense * self.size * (swept % 1.0 - 0.5))[:, None]


class CutDigits(Outside):
    """lengths are sent as text with too few digits, and the rest is cut off towards zero"""

    name, typical, largest, random = 'cut_digits', 5e-6, 1e-4, True

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        sent = np.trunc(log.displacement.values / self.size) * self.size
        return replace(log, displacement=replace(log.displacement, values=sent))


# ---- detector -----------------------------------------------------------------------------------

class RangeSwitch(Outside):
    """the detector's amplifier changes its range when the spot is far out, and its ranges do not join"""

    name, typical, largest = 'range_switch', 5e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._column, self._vector = int(rng.integers(2)), direction(rng, 2)
        description, far = stage.cell.description, []
        for name, setup in description.setups.items():
            turns = stage.cell.misalignments[name]
            tilt = np.subtract(turns.mirror, turns.laser)
            reach = setup.standoff + float(np.linalg.norm(stage.travel))
            far.append(2.0 * reach * abs(tilt[1 - self._column]))
        self._switch = float(np.median(far)) * rng.uniform(0.3, 0.8)
        self.facts = {'switch_m': self._switch, 'column': self._column}

    def after_light(self, moment: Moment) -> None:
        out = np.abs(moment.spot[:, self._column]) > self._switch
        moment.spot = moment.spot + self.size * out[:, None] * self._vector


class PopcornNoise(Outside):
    """an operational amplifier of the detector has popcorn noise: the spot jumps to and fro, seconds in each place"""

    name, typical, largest, random = 'popcorn_noise', 2e-6, 3e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector, stays = direction(rng, 2), np.exp(rng.uniform(np.log(0.5), np.log(12.0), 2))
        self._jumps = telegraph(rng, stage.span_s, *stays)
        self.facts = {'direction': self._vector.tolist(), 'stays_s': stays.tolist()}

    def after_light(self, moment: Moment) -> None:
        state = np.searchsorted(self._jumps, moment.seconds) % 2 - 0.5
        moment.spot = moment.spot + self.size * state[:, None] * self._vector


class LooseConnector(Outside):
    """a plug of one of the detector's electrodes is loose: after a jolt its current fails for a moment"""

    name, typical, largest, random, inside = 'loose_connector', 2e-5, 2e-3, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector = direction(rng, 2)
        likely = rng.uniform(0.15, 0.6)
        self._fails = rng.random(8000) < likely
        self._begin, self._lasts = rng.exponential(0.1, 8000), 0.08 + rng.exponential(rng.uniform(0.05, 0.25), 8000)
        self._lost = rng.uniform(0.3, 1.0, 8000)
        self.facts = {'likely': likely, 'direction': self._vector.tolist()}

    def after_light(self, moment: Moment) -> None:
        jolt = moment.arrival % len(self._fails)
        late = moment.since_arrival - self._begin[jolt]
        failed = self._lost[jolt] * (self._fails[jolt] & (late >= 0.0) & (late < self._lasts[jolt]))
        moment.spot = moment.spot + self.size * failed[:, None] * self._vector
        moment.intensity = moment.intensity * (1.0 - 0.25 * failed * min(self.size / 1e-3, 1.0))


# ---- neighbours, supplies, people ---------------------------------------------------------------

class PressShocks(Outside):
    """a press in the next bay strikes every few seconds: the floor kicks the machine, which swings a few times"""

    name, typical, largest, random, inside = 'press_shocks', 1e-6, 2e-4, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every = rng.uniform(1.2, 6.0)
        count = int(1.3 * stage.span_s / every) + 20
        self._strikes = np.cumsum(every * np.abs(1.0 + 0.15 * rng.standard_normal(count)))
        self._force = rng.uniform(0.5, 1.0, len(self._strikes))
        self._hertz, self._tau = rng.uniform(3.0, 9.0), rng.uniform(0.08, 0.35)
        self._shift, self._turn = direction(rng), direction(rng) / rng.uniform(0.5, 3.0)
        self.facts = {'every_s': every, 'frequency_Hz': self._hertz, 'tau_s': self._tau}

    def before_pose(self, moment: Moment) -> None:
        last = np.searchsorted(self._strikes, moment.seconds, side='right') - 1
        since = np.where(last >= 0, moment.seconds - self._strikes[np.maximum(last, 0)], 1e3)
        swing = self.size * self._force[np.maximum(last, 0)] * np.exp(-since / self._tau) \
            * np.sin(2.0 * np.pi * self._hertz * since)
        moment.shift = moment.shift + swing[:, None] * self._shift
        moment.turn = moment.turn + swing[:, None] * self._turn


class CounterbalancePump(Outside):
    """the hydraulic counterbalance leaks until its pump fills it again: the head nods in a saw"""

    name, unit, typical, largest = 'counterbalance_pump', 'rad', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        period = rng.uniform(15.0, 120.0)
        count = int(1.4 * stage.span_s / period) + 20
        self._fills = np.cumsum(period * rng.uniform(0.85, 1.15, count)) - period * rng.uniform(0.0, 1.0) - period
        self._filling = rng.uniform(0.02, 0.12)
        self._axis = np.eye(3)[int(rng.integers(2))]
        self._overhang = np.append(rng.uniform(0.1, 0.5, 2) * rng.choice([-1.0, 1.0], 2), rng.uniform(-0.3, 0.3))
        self.facts = {'period_s': period, 'axis': self._axis.tolist()}

    def before_pose(self, moment: Moment) -> None:
        last = np.clip(np.searchsorted(self._fills, moment.seconds, side='right') - 1, 0, len(self._fills) - 2)
        share = np.clip((moment.seconds - self._fills[last]) / (self._fills[last + 1] - self._fills[last]), 0.0, 1.0)
        pressure = np.where(share < self._filling, share / self._filling,
                            (1.0 - share) / (1.0 - self._filling)) - 0.5
        # The lower the head hangs, the longer the column that the force bends.
        arm = 0.6 + 0.8 * place_of(self.stage, moment, 2)
        turn = self.size * (pressure * arm)[:, None] * self._axis
        turn_by(moment, turn, self._overhang)


class OperatorLeans(Outside):
    """the operator leans on the machine's table when he starts a run, and goes away after a few stops"""

    name, typical, largest = 'operator_leans', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        count = len(stage.runs)
        self._weight = rng.uniform(0.4, 1.0, count) * (rng.random(count) < rng.uniform(0.5, 1.0))
        self._goes = stage.runs[:, 0] + rng.uniform(0.1, 0.5, count) * np.diff(stage.runs, axis=1)[:, 0]
        self._shift, self._turn = direction(rng), direction(rng) / rng.uniform(0.3, 1.5)
        self.facts = {'runs': int(np.sum(self._weight > 0.0))}

    def before_pose(self, moment: Moment) -> None:
        run = run_of(self.stage, moment.seconds)
        leans = 1.0 / (1.0 + np.exp(np.clip((moment.seconds - self._goes[run]) / 0.3, -50.0, 50.0)))
        force = self.size * self._weight[run] * leans
        moment.shift = moment.shift + force[:, None] * self._shift
        moment.turn = moment.turn + force[:, None] * self._turn


class CompensationSwitched(Outside):
    """someone switches off the control's table of pitch errors of one axis between two runs, perhaps on again later"""

    name, typical, largest = 'compensation_switched', 2e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, count = int(rng.integers(3)), len(stage.runs)
        places = np.linspace(0.0, 1.0, int(rng.integers(6, 16)))
        table = np.cumsum(rng.standard_normal(len(places))) / np.sqrt(len(places)) \
            + rng.normal() * np.sin(np.pi * rng.uniform(1.0, 4.0) * places)
        table -= table[0]
        self._places, self._table = places, table / np.max(np.abs(table))
        off = int(rng.integers(count // 8, count // 2))
        on = int(rng.integers(off + 2, count)) if rng.random() < 0.4 and off + 2 < count else count
        self._off, self._on = off, on
        self.facts = {'axis': self._axis, 'runs': [off, on]}

    def before_pose(self, moment: Moment) -> None:
        run = run_of(self.stage, moment.seconds)
        error = self.size * ((run >= self._off) & (run < self._on)) \
            * np.interp(place_of(self.stage, moment, self._axis), self._places, self._table)
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


SHOPFLOOR = (ResolverOffset, ScratchedScale, CountHopping, DentedLiner, LubricationShot, ClampTips, RockingFoot,
             CreepingBed, RubberFeet, SpindleReorients, HeadUnclamped, UnlockedLaser, CutDigits, RangeSwitch,
             PopcornNoise, LooseConnector, PressShocks, CounterbalancePump, OperatorLeans, CompensationSwitched)
