"""Effects from outside the vocabulary, written without knowledge of the diagnosis.

They act at axes, carriages, guideways, scale, structure, spindle, laser, interferometer, counter, detector, its
amplifier and the air, and one is a mistake in the program.  Some hang on which axis moved last or on what came before,
some on place and time together, some on the fringe or the spot, some act within the dwells only.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.hidden import Stage, across, direction, place_of, run_of, turn_by
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.air import WAVELENGTH
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import setup_direction
from stepdiag_ros.model.sensor import station


def _moved(moment: Moment) -> np.ndarray:
    """Number (n,) of the axis that moved last, 3 where none did alone."""
    return np.where(moment.moved < 3, moment.moved, 3).astype(int)


def _approach_of(moment: Moment, moved: np.ndarray) -> np.ndarray:
    """Sign (n,) of the last motion of the axis that moved last, 0 where none did alone."""
    return np.where(moved < 3, moment.approach[np.arange(len(moved)), np.minimum(moved, 2)], 0.0)


class HangingAxisSinks(Outside):
    """a hanging axis is jolted down a little by each move of the others; its own next move lifts it again"""

    name, typical, largest = 'hanging_axis_sinks', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._memory = rng.uniform(0.6, 2.5)
        order = stage.cell.description.plan.order
        self._rank = np.array([order.index(letter) for letter in 'XYZ'] + [0])
        self.facts = {'memory_moves': self._memory}

    def before_pose(self, moment: Moment) -> None:
        moved = _moved(moment)
        sight = setup_direction(moment.description.machine, moment.description.setups[moment.setup])
        along = _approach_of(moment, moved) * np.append(sight, 0.0)[moved]
        behind = self._rank[moved] - self._rank[2]
        jolts = np.where(moved < 3, np.mod(np.where(along >= 0.0, behind, -behind), 3), 0)
        position = moment.position.copy()
        position[:, 2] -= self.size * (1.0 - np.exp(-jolts / self._memory))
        moment.position = position


class LateBrake(Outside):
    """an axis's brake closes only a moment after arrival and pushes the carriage aside"""

    name, typical, largest, inside = 'late_brake', 1e-6, 2e-4, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(3))
        self._push, self._roll = across(rng, self._axis), direction(rng) / rng.uniform(0.3, 1.0)
        self._delay = rng.uniform(0.25, 0.7) * stage.cell.motion.dwell
        self.facts = {'axis': self._axis, 'delay_s': self._delay}

    def before_pose(self, moment: Moment) -> None:
        closed = (moment.moved != self._axis) | (moment.since_arrival > self._delay)
        moment.shift = moment.shift + self.size * closed[:, None] * self._push
        moment.turn = moment.turn + self.size * closed[:, None] * self._roll


class GantryCrabbing(Outside):
    """friction drags a gantry askew: the side away from its drive lags, the other way round on the way back"""

    name, unit, typical, largest = 'gantry_crabbing', 'rad', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._gantry, self._cross = (int(a) for a in rng.permutation(3)[:2])
        self._drive = rng.uniform(0.3, 0.7)
        self.facts = {'gantry': self._gantry, 'cross': self._cross, 'drive': self._drive}

    def before_pose(self, moment: Moment) -> None:
        reach = self.stage.travel[self._cross]
        away = moment.commanded[:, self._cross] / reach - self._drive
        yaw = np.zeros((len(away), 3))
        yaw[:, 3 - self._gantry - self._cross] = self.size * moment.approach[:, self._gantry] * away
        moment.turn = moment.turn + yaw
        moment.shift = moment.shift + np.cross(yaw, reach * away[:, None] * np.eye(3)[self._cross])


class RollerCageCreep(Outside):
    """the rollers' cage creeps: the wave that uneven rollers give the carriage wanders along the guide run by run"""

    name, unit, typical, largest = 'roller_cage_creep', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(3))
        self._waves = rng.uniform(0.7, 1.6)
        self._phase = np.cumsum(rng.uniform(0.4, 2.4, len(stage.runs))) * rng.choice([-1.0, 1.0])
        self._second, self._turn = rng.uniform(0.1, 0.5), direction(rng)
        self._lever = rng.uniform(0.1, 0.4) * direction(rng)
        self.facts = {'axis': self._axis, 'waves': self._waves}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        phase = 2.0 * np.pi * self._waves * place + self._phase[run_of(self.stage, moment.seconds)]
        turn = self.size * (np.sin(phase) + self._second * np.sin(2.0 * phase + 1.0))[:, None] * self._turn
        turn_by(moment, turn, self._lever)


class ChipOnRail(Outside):
    """a chip lies on the rail for a while: the carriage rides over it with its front, then with its rear block"""

    name, typical, largest = 'chip_on_rail', 1e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(3))
        travel = float(stage.travel[self._axis])
        self._base = travel * rng.uniform(0.25, 0.45)
        self._place = rng.uniform(0.1, 0.9) * travel
        self._width = rng.uniform(0.35, 0.7) * travel / stage.cell.description.plan.steps
        first = stage.span_s * rng.uniform(-0.3, 0.5)
        self._there = (first, first + stage.span_s * rng.uniform(0.25, 0.5))
        if first < 0.0:
            self._there = (first, stage.span_s * rng.uniform(0.25, 0.7))
        self._lift = across(rng, self._axis)
        self._lever = rng.uniform(0.1, 0.4) * direction(rng)
        self.facts = {'axis': self._axis, 'place_m': self._place, 'from_s': self._there[0], 'to_s': self._there[1]}

    def before_pose(self, moment: Moment) -> None:
        here = moment.commanded[:, self._axis] - self._place
        front, rear = (np.exp(-0.5 * ((here + side * self._base) / self._width) ** 2) for side in (0.5, -0.5))
        there = (moment.seconds >= self._there[0]) & (moment.seconds < self._there[1])
        lift = self.size * there * (front + rear) / 2.0
        pitch = (self.size * there * (front - rear) / self._base)[:, None] \
            * np.cross(np.eye(3)[self._axis], self._lift)
        moment.turn = moment.turn + pitch
        moment.shift = moment.shift + lift[:, None] * self._lift + np.cross(pitch, self._lever)


class ScaleJointOpens(Outside):
    """a scale is glued of two tapes: their joint opens with time, and all places beyond it move away"""

    name, typical, largest = 'scale_joint_opens', 3e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profile, kind = stage.profile(rng)
        self._axis, self._sign = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
        self._joint = rng.uniform(0.1, 0.9) * float(stage.travel[self._axis])
        self.facts = {'profile': kind, 'axis': self._axis, 'joint_m': self._joint}

    def before_pose(self, moment: Moment) -> None:
        position = moment.position.copy()
        beyond = moment.commanded[:, self._axis] > self._joint
        position[:, self._axis] += self._sign * self.size * self._profile(moment.seconds) * beyond
        moment.position = position


class SpindleHunting(Outside):
    """the spindle's position control hunts: the mirror turns to and fro about the spindle's axis, in a ragged saw"""

    name, unit, typical, largest, random, inside = 'spindle_hunting', 'rad', 2e-6, 3e-4, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        period = 1.0 / rng.uniform(0.8, 4.0)
        count = int(1.3 * stage.span_s / period) + 10
        self._turns = np.cumsum(period * np.exp(0.25 * rng.standard_normal(count)))
        self._swing = np.exp(0.2 * rng.standard_normal(count)) * np.where(np.arange(count) % 2, 0.5, -0.5)
        self.facts = {'half_period_s': period}

    def before_pose(self, moment: Moment) -> None:
        turn = np.zeros_like(moment.turn)
        turn[:, 2] = self.size * np.interp(moment.seconds, self._turns, self._swing)
        moment.turn = moment.turn + turn


class OpticalFeedback(Outside):
    """light that comes straight back enters the laser and pulls its wavelength, the more the better it is aligned"""

    name, unit, typical, largest = 'optical_feedback', '1', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._width = float(np.exp(rng.uniform(np.log(2e-4), np.log(1.2e-3))))
        self._sign = float(rng.choice([-1.0, 1.0]))
        self.facts = {'width_m': self._width}

    def after_light(self, moment: Moment) -> None:
        walk = np.linalg.norm(np.nan_to_num(moment.spot), axis=1) / self._width
        moment.length = moment.length * (1.0 + self._sign * self.size / (1.0 + walk**2))[:, None]


class LockDither(Outside):
    """the lock of the laser dithers its frequency: the reading hums, in proportion to the distance"""

    name, unit, typical, largest, random, inside = 'lock_dither', '1', 2e-8, 1e-5, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._hertz, self._phase = rng.uniform(150.0, 950.0), rng.uniform(0.0, 2.0 * np.pi, 2)
        self._second = rng.uniform(0.0, 0.4)
        self.facts = {'frequency_Hz': self._hertz}

    def after_light(self, moment: Moment) -> None:
        angle = 2.0 * np.pi * self._hertz * moment.seconds
        hum = np.sin(angle + self._phase[0]) + self._second * np.sin(2.0 * angle + self._phase[1])
        moment.length = moment.length * (1.0 + self.size * hum)[:, None]


class StuckBit(Outside):
    """one bit of the counter's cable is stuck at zero: wherever it should be set the reading is short by its worth"""

    name, typical, largest = 'stuck_bit', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._preset = rng.uniform(0.0, 2.0)

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        counts = log.displacement.values / self.size + self._preset
        lost = np.where(np.mod(counts, 2.0) >= 1.0, self.size, 0.0)
        return replace(log, displacement=replace(log.displacement, values=log.displacement.values - lost))


class GhostFringes(Outside):
    """a ghost reflection meets the returning spot and interferes with it: the spot swings with each fringe"""

    name, typical, largest, random = 'ghost_fringes', 2e-6, 5e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector, self._phase = direction(rng, 2), rng.uniform(0.0, 2.0 * np.pi)

    def after_light(self, moment: Moment) -> None:
        fringe = np.cos(4.0 * np.pi * moment.length[:, :1] / WAVELENGTH + self._phase)
        moment.spot = moment.spot + self.size * fringe * self._vector


class DetectorMemory(Outside):
    """charge sits in the detector's layer: a share of the spot follows only after many seconds, from where it was"""

    name, unit, typical, largest = 'detector_memory', '1', 0.02, 0.7

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._tau = float(np.exp(rng.uniform(np.log(2.0), np.log(25.0))))
        self.facts = {'tau_s': self._tau}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        values, time = log.spot.values, log.spot.time_ns
        lit = np.isfinite(values).all(axis=1)
        fresh = 1.0 - np.exp(-np.diff(time, prepend=time[:1]) * 1e-9 / self._tau)
        fresh = np.where(lit, fresh, 0.0)
        if lit.any():
            fresh[np.argmax(lit)] = 1.0
        # y[i] = keep[i]·y[i-1] + add[i] for all i at once: the steps are joined two by two, four by four, …
        keep, add = (1.0 - fresh)[:, None], fresh[:, None] * np.where(lit[:, None], values, 0.0)
        reach = 1
        while reach < len(time):
            add = np.concatenate([add[:reach], add[reach:] + keep[reach:] * add[:-reach]])
            keep = np.concatenate([keep[:reach], keep[reach:] * keep[:-reach]])
            reach *= 2
        return replace(log, spot=replace(log.spot, values=values + self.size * (add - values)))


class DriveLeak(Outside):
    """the current of the drive that moved last leaks into the detector's amplifier, of either sign as it pushed"""

    name, typical, largest = 'drive_leak', 2e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        leak = rng.uniform(0.2, 1.0, (3, 1)) * np.array([direction(rng, 2) for _ in range(3)])
        self._leak = np.concatenate([leak / np.linalg.norm(leak, axis=1).max(), np.zeros((1, 2))])

    def after_light(self, moment: Moment) -> None:
        moved = _moved(moment)
        moment.spot = moment.spot + self.size * _approach_of(moment, moved)[:, None] * self._leak[moved]


class StirredAir(Outside):
    """each move stirs warm air into the beam, which clears within the dwell: the longer the path, the more"""

    name, unit, typical, largest, inside = 'stirred_air', '1', 3e-8, 2e-5, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._tau = rng.uniform(0.25, 1.2) * stage.cell.motion.dwell
        stirs = rng.uniform(0.2, 1.0, 3)
        self._stirs = np.append(stirs / stirs.max(), 0.0) * rng.choice([-1.0, 1.0], p=[0.8, 0.2])
        self.facts = {'tau_s': self._tau}

    def before_light(self, moment: Moment) -> None:
        left = np.exp(-np.maximum(moment.since_arrival, 0.0) / self._tau)
        moment.index = moment.index + self.size * left * self._stirs[_moved(moment)]


class LayeredAir(Outside):
    """the air is layered, warm above cold: beams bend, and each height has an index of its own"""

    name, unit, typical, largest = 'layered_air', '1/m', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._sign = float(rng.choice([-1.0, 1.0], p=[0.8, 0.2]))
        self._sensor = rng.uniform(0.0, 1.0) * float(stage.travel[2])

    def after_light(self, moment: Moment) -> None:
        machine, setup = moment.description.machine, moment.description.setups[moment.setup]
        base, gradient = station(machine, setup), self._sign * self.size
        length = moment.length
        height = base.origin[2] - machine.tool[2] + 0.5 * length * base.triad[2, 2] - self._sensor
        # There and back the beam falls by the square of the whole path, towards the denser air.
        moment.spot = moment.spot + 2.0 * gradient * length[:, :1] ** 2 * base.triad[:2, 2]
        moment.length = length * (1.0 + gradient * height)


class TypingErrorInProgram(Outside):
    """one line of one setup's program was typed wrong: there, on each pass, an axis stands beside its stop"""

    name, typical, largest = 'typing_error_in_program', 3e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        plan, setups = stage.cell.description.plan, stage.cell.description.setups
        stepped = [name for name, setup in setups.items() if setup.way is None and not setup.is_linear]
        self._setup = str(rng.choice(stepped or list(setups)))
        self._axis, self._sign = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
        self._step = float(stage.travel[self._axis]) / plan.steps
        self._line = int(rng.integers(1, max(plan.steps, 2)))
        self.facts = {'setup': self._setup, 'axis': self._axis, 'place_m': self._line * self._step}

    def before_pose(self, moment: Moment) -> None:
        if moment.setup != self._setup:
            return
        position = moment.position.copy()
        # Carried in and out along the move, as the control would go to another target.
        near = 1.0 - np.abs(moment.commanded[:, self._axis] / self._step - self._line)
        position[:, self._axis] += self._sign * self.size * np.clip(near, 0.0, 1.0)
        moment.position = position


UNSEEN = (HangingAxisSinks, LateBrake, GantryCrabbing, RollerCageCreep, ChipOnRail, ScaleJointOpens,
          SpindleHunting, OpticalFeedback, LockDither, StuckBit, GhostFringes, DetectorMemory, DriveLeak,
          StirredAir, LayeredAir, TypingErrorInProgram)
