"""Nineteen effects from outside the vocabulary as a machine builder and a metrologist on his rounds tell of them,
written without any look at the diagnosis.

They act in oil films, bolted joints and counterweights, in screws, encoders' cables and the control's smoothing, in the
interferometer's averaging, at the mirror's spindle, hose and glass, in detectors, drivers and historians, and
come from the sun, from jets of air and from the machine next door.  Nothing is remembered from call to call: what
happened before follows from the times of the runs, from where a run came from, from the order of the plan, or from
the finished log.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.hidden import (
    PLACES,
    UP,
    Stage,
    direction,
    ends_of_runs,
    place_of,
    profile,
    run_of,
    turn_by,
)
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.blind.outside_field import one_setup
from stepdiag_ros.blind.outside_shopfloor import stop_of
from stepdiag_ros.blind.outside_works import GRID_S, followed, grid_of, reach, resting, shown, step_s, strikes, walked
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.sensor import station


def on_and_off(rng: np.random.Generator, stage: Stage, on_s: float, off_s: float) -> np.ndarray:
    """A table (k,) over time of what is switched on and off again and again: 0 or 1."""
    count = int(3.0 * stage.span_s / (on_s + off_s)) + 20
    lasts = np.stack([on_s * rng.uniform(0.4, 1.6, count), off_s * rng.uniform(0.4, 1.6, count)], axis=1).ravel()
    changes = np.cumsum(lasts) - rng.uniform(0.0, 2.0) * (on_s + off_s)
    return np.searchsorted(changes, grid_of(stage), side='right') % 2.0


# ---- structure and guideways ------------------------------------------------------------------------

class SqueezeFilm(Outside):
    """a carriage glides up on its oil while it moves; once it stands the film is squeezed out slower and slower"""

    name, typical, largest, inside = 'squeeze_film', 2e-6, 1e-4, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._step = int(rng.integers(3)), step_s(stage)
        self._tau, self._long = rng.uniform(0.1, 1.0) * self._step, rng.uniform(0.2, 0.6)
        along = np.eye(3)[self._axis]
        self._up = UP if self._axis < 2 else np.append(direction(rng, 2), 0.0)
        self._pitch = rng.uniform(0.1, 0.8) / self._long * np.cross(along, self._up)
        self.facts = {'axis': self._axis, 'tau_s': self._tau, 'carriage_m': self._long}

    def before_pose(self, moment: Moment) -> None:
        rest = resting(self.stage, moment, self._axis, self._step)
        # Stefan's law: what is squeezed out of a gap goes with the cube of its height.
        film = self.size / np.sqrt(1.0 + rest / self._tau)
        moment.shift = moment.shift + film[:, None] * self._up
        # Oil is drawn in in front: there the wedge is the thicker.
        nose = film * moment.approach[:, self._axis]
        moment.turn = moment.turn + nose[:, None] * self._pitch


class BoltedJointTicks(Outside):
    """the column's bolted foot sticks while the machine warms, and gives way in ticks: it leans in steps of its own"""

    name, unit, typical, largest = 'bolted_joint_ticks', 'rad', 4e-6, 6e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        strain, kind = profile(rng, stage.span_s)
        self._grid = grid_of(stage)
        wanted, holds = strain(self._grid), rng.uniform(0.06, 0.25, 2000)
        gives, held, tick = rng.uniform(0.6, 1.3, 2000), float(wanted[0]), 0
        self._leans = np.empty(len(self._grid))
        for i, value in enumerate(wanted.tolist()):
            if abs(value - held) > holds[tick % 2000]:
                held, tick = held + gives[tick % 2000] * (value - held), tick + 1
            self._leans[i] = held
        self._lean = np.append(direction(rng, 2), rng.normal(0.0, 0.5))
        self._foot = np.append(rng.uniform(0.0, 1.0, 2) * stage.travel[:2], -rng.uniform(0.1, 0.8))
        self.facts = {'profile': kind, 'ticks': tick, 'lean': self._lean.tolist()}

    def before_pose(self, moment: Moment) -> None:
        # Between two of the table's times the joint does not slide, it stands or has jumped.
        now = np.clip((moment.seconds / GRID_S).astype(int), 0, len(self._grid) - 1)
        turn = (self.size * self._leans[now])[:, None] * self._lean
        turn_by(moment, turn, moment.commanded + np.array(moment.description.machine.tool) - self._foot)


class CounterweightSwings(Outside):
    """the head's counterweight hangs in the column and swings after cross moves, the slower the longer its rope is"""

    name, unit, typical, largest, inside = 'counterweight_swings', 'rad', 3e-6, 2e-4, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._step = int(rng.integers(2)), step_s(stage)
        self._rope, self._tau = rng.uniform(0.25, 0.6), rng.uniform(0.7, 3.0) * self._step
        self._phase, self._height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 1.5)
        # It hangs beside the column's middle and twists it a little, too.
        self._vector = np.cross(UP, np.eye(3)[self._axis]) + rng.normal(0.0, 0.3) * UP
        self.facts = {'axis': self._axis, 'rope_m': self._rope, 'tau_s': self._tau}

    def before_pose(self, moment: Moment) -> None:
        rest = resting(self.stage, moment, self._axis, self._step)
        # The head goes up, the weight goes down.
        rope = self._rope + moment.commanded[:, 2]
        swing = np.exp(-rest / self._tau) * np.cos(np.sqrt(9.81 / rope) * rest + self._phase)
        turn = (self.size * moment.approach[:, self._axis] * swing)[:, None] * self._vector
        turn_by(moment, turn, (self._height + moment.commanded[:, 2:]) * UP)


class SunPatch(Outside):
    """a patch of sun wanders over the bed, clouds between: where it lies the guideway swells, and cools behind it"""

    name, typical, largest = 'sun_patch', 3e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._width = int(rng.integers(2)), rng.uniform(0.15, 0.3)
        begin, end = rng.uniform(-0.3, 0.4), rng.uniform(0.6, 1.3)
        self._begin, self._end = (begin, end) if rng.random() < 0.5 else (end, begin)
        self._grid = grid_of(stage)
        sunny = on_and_off(rng, stage, stage.span_s * rng.uniform(0.1, 0.4), stage.span_s * rng.uniform(0.03, 0.15))
        self._warm = followed(np.append(0.0, sunny[1:]), stage.span_s * rng.uniform(0.03, 0.15))
        self.facts = {'axis': self._axis, 'width': self._width, 'from': self._begin, 'to': self._end}

    def before_pose(self, moment: Moment) -> None:
        middle = self._begin + (self._end - self._begin) * moment.seconds / self.stage.span_s
        away = (place_of(self.stage, moment, self._axis) - middle) / self._width
        height = self.size * np.interp(moment.seconds, self._grid, self._warm) * np.exp(-0.5 * away ** 2)
        slope = -height * away / (self._width * self.stage.travel[self._axis])
        moment.shift = moment.shift + height[:, None] * UP
        moment.turn = moment.turn + slope[:, None] * np.cross(np.eye(3)[self._axis], UP)


# ---- encoders, control, drives ----------------------------------------------------------------------

class EncoderCrosstalk(Outside):
    """two axes' encoder cables lie side by side: one's signal leaks into the other's and errs by where both stand"""

    name, typical, largest = 'encoder_crosstalk', 5e-7, 3e-6

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._other = (int(k) for k in rng.permutation(3)[:2])
        self._period = float(rng.choice([20e-6, 40e-6]))
        # Where in its period an axis stands at a stop no one knows, but it is the same each time.
        self._phase, self._second = rng.uniform(0.0, 2.0 * np.pi, (2, PLACES)), rng.uniform(0.0, 0.4)
        self.facts = {'axis': self._axis, 'other': self._other, 'period_m': self._period}

    def before_pose(self, moment: Moment) -> None:
        off = 2.0 * np.pi * (moment.position - moment.commanded) / self._period
        own, other = (off[:, axis] + phase[stop_of(self.stage, moment, axis)]
                      for axis, phase in zip((self._axis, self._other), self._phase, strict=True))
        error = self.size * (np.sin(other - own) - self._second * np.sin(2.0 * (other - own)))
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


class WholeDegrees(Outside):
    """the control makes up for a screw's growth, but its PLC hands on whole degrees: the growth jumps back again"""

    name, unit, typical, largest = 'whole_degrees', 'm at full travel', 4e-6, 6e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, (self._warms, kind) = int(rng.integers(3)), stage.profile(rng)
        self._degrees, self._begin = rng.uniform(1.5, 5.0), rng.uniform(0.0, 1.0)
        self._fixed, self._cut = float(rng.choice([0.0, 1.0])) + rng.normal(0.0, 0.1), bool(rng.random() < 0.4)
        self.facts = {'axis': self._axis, 'profile': kind, 'degrees': self._degrees, 'fixed': self._fixed}

    def before_pose(self, moment: Moment) -> None:
        warm = self._begin + self._degrees * self._warms(moment.seconds)
        left = warm - (np.floor(warm) if self._cut else np.rint(warm))
        grown = self.size * left * (place_of(self.stage, moment, self._axis) - self._fixed)
        moment.position = moment.position + grown[:, None] * np.eye(3)[self._axis]


class CornersSmoothed(Outside):
    """the control's smoothing is left on: it cuts the zig-zag's corners, one axis is short, the next on its way"""

    name, typical, largest = 'corners_smoothed', 2e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        description = stage.cell.description
        self._ends, order = ends_of_runs(stage), ['XYZ'.index(letter) for letter in description.plan.order]
        names = list(description.setups)
        self._way = np.sign(np.round(self._ends[:, 1] - self._ends[:, 0], 9))
        self._next = np.full((len(self._ends), 3), -1)
        for run, setup in enumerate(stage.run_setup.tolist()):
            begin = stops(description, names[setup]).positions[0]
            turn = 1 if np.allclose(begin, self._ends[run, 0]) else -1
            going = [axis for axis in order[::turn] if self._way[run, axis]]
            if len(going) > 1:
                self._next[run, going] = np.roll(going, -1)
        self._ahead, self._loose = rng.uniform(0.3, 1.0), rng.uniform(0.5, 1.0, 3)
        self.facts = {'ahead': self._ahead, 'axes': self._loose.tolist()}

    def before_pose(self, moment: Moment) -> None:
        run, position = run_of(self.stage, moment.seconds), moment.position.copy()
        # Where the way ends there is no corner.
        ends = np.all(np.abs(moment.commanded - self._ends[run, 1]) < 1e-6, axis=1)
        for axis in range(3):
            then = self._next[run, axis]
            cuts = np.flatnonzero((moment.moved == axis) & (then >= 0) & ~ends)
            cut = self.size * self._loose[axis]
            position[cuts, axis] -= cut * self._way[run[cuts], axis]
            position[cuts, then[cuts]] += cut * self._ahead * self._way[run[cuts], then[cuts]]
        moment.position = position


class ThrustFacesWobble(Outside):
    """a screw's thrust bearing has two faces, each wobbles its way: the screw leans on one going, the other coming"""

    name, typical, largest = 'thrust_faces_wobble', 2e-6, 5e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(3))
        step = stage.travel[self._axis] / stage.cell.description.plan.steps
        self._lead = float(rng.choice([10e-3, 12e-3, 16e-3, 20e-3, 25.4e-3, 32e-3])) * rng.uniform(1.0, 1.6)
        # A step of whole turns would never show a wobble.
        while abs((step / self._lead + 0.5) % 1.0 - 0.5) < 0.1:
            self._lead *= 1.03
        self._phase, self._wobble = rng.uniform(0.0, 2.0 * np.pi, (2, 2)), rng.uniform(0.2, 1.0, 2)
        self._second = rng.uniform(0.0, 0.6)
        self.facts = {'axis': self._axis, 'lead_m': self._lead, 'wobble': self._wobble.tolist()}

    def before_pose(self, moment: Moment) -> None:
        angle, face = 2.0 * np.pi * moment.commanded[:, self._axis] / self._lead, moment.approach[:, self._axis]
        waves = [wobble * (np.sin(angle + first) + self._second * np.sin(2.0 * angle + second))
                 for wobble, (first, second) in zip(self._wobble, self._phase, strict=True)]
        error = self.size * np.where(face > 0.0, waves[0], np.where(face < 0.0, waves[1], 0.0))
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


class TwinScrewSlips(Outside):
    """two screws lift the cross beam and one's coupling slips under load: the beam rolls more with each way up"""

    name, unit, typical, largest = 'twin_screw_slips', 'rad', 3e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._along, self._down = int(rng.integers(2)), rng.uniform(-0.5, 0.4)
        self._roll = np.cross(np.eye(3)[self._along], UP) * rng.choice([-1.0, 1.0])
        ends = ends_of_runs(stage)[:, :, 2] / stage.travel[2]
        self._begins, way = ends[:, 0], ends[:, 1] - ends[:, 0]
        self._rate = np.where(way > 0.0, 1.0, self._down) * rng.lognormal(0.0, 0.3, len(way))
        # From the end of a run to the begin of the next the beam is driven with care.
        self._before = np.append(0.0, np.cumsum(self._rate * np.abs(way))[:-1])
        self._master = float(rng.choice([0.0, 1.0])) * stage.travel[self._along]
        self.facts = {'along': self._along, 'down': self._down}

    def before_pose(self, moment: Moment) -> None:
        run = run_of(self.stage, moment.seconds)
        gone = np.abs(place_of(self.stage, moment, 2) - self._begins[run])
        turn = (self.size * (self._before[run] + self._rate[run] * gone))[:, None] * self._roll
        arm = (moment.commanded[:, self._along] - self._master)[:, None] * np.eye(3)[self._along]
        turn_by(moment, turn, arm + np.array(moment.description.machine.tool))


# ---- laser and its way ------------------------------------------------------------------------------

class SealingAirJet(Outside):
    """the spindle's sealing air comes on now and then: its cold jet crosses the beams before the mirror, near or far"""

    name, typical, largest = 'sealing_air_jet', 3e-7, 5e-6

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        on, off = rng.uniform(15.0, 90.0, 2)
        self._grid = grid_of(stage)
        self._blows = followed(on_and_off(rng, stage, on, off), rng.uniform(0.5, 4.0))
        # The beams do not all go through the jet's middle.
        self._meets, self._bends = rng.uniform(0.4, 1.0, 16), rng.uniform(1.0, 8.0) * direction(rng, 2)
        self.facts = {'on_s': on, 'off_s': off, 'bends': self._bends.tolist()}

    def after_light(self, moment: Moment) -> None:
        cold = self.size * np.interp(moment.seconds, self._grid, self._blows)
        far = moment.length.mean(axis=1) / reach(self.stage)
        moment.spot = moment.spot + (cold * far)[:, None] * self._bends
        moment.length = moment.length + cold[:, None] * self._meets[np.arange(moment.length.shape[1]) % 16]


class GrinderNextDoor(Outside):
    """a surface grinder next door sends its heavy table to and fro: the floor under the laser's stand tilts with it"""

    name, unit, typical, largest, random, inside = 'grinder_next_door', 'rad', 2e-6, 2e-4, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._period, self._phase = rng.uniform(2.5, 9.0), rng.uniform(0.0, 1.0)
        self._steep, self._grid = rng.uniform(1.3, 4.0), grid_of(stage)
        # Between two parts it stands where it is loaded, at one end.
        self._works = followed(on_and_off(rng, stage, rng.uniform(60.0, 300.0), rng.uniform(20.0, 90.0)), 2.0)
        self._tilt = np.append(direction(rng, 2), 0.0)
        self.facts = {'period_s': self._period, 'tilt': self._tilt.tolist()}

    def before_light(self, moment: Moment) -> None:
        triad = station(moment.description.machine, moment.description.setups[moment.setup]).triad
        saw = np.abs(2.0 * ((moment.seconds / self._period + self._phase) % 1.0) - 1.0)
        place = np.clip(self._steep * (2.0 * saw - 1.0), -1.0, 1.0)
        works = np.interp(moment.seconds, self._grid, self._works)
        turn = (self.size * (works * place + (1.0 - works)))[:, None] * self._tilt
        moment.laser = moment.laser + turn @ triad[:2].T


# ---- mirror and what holds it -----------------------------------------------------------------------

class TautHose(Outside):
    """an air hose hangs from the mirror's holder to the enclosure: far from there it is taut and tilts the mirror"""

    name, unit, typical, largest = 'taut_hose', 'rad', 1e-5, 2e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._hook = np.append(rng.uniform(-0.3, 1.3, 2), rng.uniform(0.8, 1.5)) * stage.travel
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * stage.travel
        farthest = float(np.linalg.norm(corners - self._hook, axis=1).max())
        self._slack, self._stiffens = rng.uniform(0.35, 0.65) * farthest, rng.uniform(1.0, 2.0)
        self._rest, self._arm = farthest - self._slack, direction(rng)
        self.facts = {'hook_m': self._hook.tolist(), 'slack_m': self._slack, 'stiffens': self._stiffens}

    def before_light(self, moment: Moment) -> None:
        triad = station(moment.description.machine, moment.description.setups[moment.setup]).triad
        away = self._hook - moment.commanded
        far = np.linalg.norm(away, axis=1)
        pull = (np.maximum(far - self._slack, 0.0) / self._rest) ** self._stiffens
        turn = np.cross(self._arm, away / np.maximum(far, 1e-3)[:, None]) * (self.size * pull)[:, None]
        moment.mirror = moment.mirror + turn @ triad[:2].T


class CrackedMirror(Outside):
    """the mirror's glass is cracked: beyond the crack its face is still flat, but leans another way"""

    name, unit, typical, largest = 'cracked_mirror', 'rad', 3e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        walk, self._across = walked(stage, one_setup(rng, stage)), direction(rng, 2)
        along = walk @ self._across
        self._crack = float(along.min() + rng.uniform(0.25, 0.75) * np.ptp(along))
        self._beam, self._lip = rng.uniform(0.5e-3, 2e-3), rng.uniform(-3e-3, 3e-3)
        self._lean = self._across + rng.normal(0.0, 0.4) * self._across[::-1] * [-1.0, 1.0]
        self.facts = {'crack_m': self._crack, 'across': self._across.tolist(), 'lip_m_per_rad': self._lip}

    def _beyond(self, strike: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How much (n,) of a beam's light falls beyond the crack, and the height (n,) [m per rad] there."""
        off = strike @ self._across - self._crack
        share = 0.5 + 0.5 * np.tanh(off / self._beam)
        return share, share * (self._lip + strike @ self._lean - self._crack * (self._lean @ self._across))

    def after_light(self, moment: Moment) -> None:
        setup = moment.description.setups[moment.setup]
        far, shares = moment.length.mean(axis=1), [self._beyond(strikes(moment, offset)) for offset in setup.beams]
        moment.length = moment.length - self.size * np.stack([height for _, height in shares], axis=1)
        split = np.stack([4.0 * share * (1.0 - share) for share, _ in shares], axis=1).max(axis=1)
        moment.quality = moment.quality * (1.0 - 0.4 * split)
        share = self._beyond(strikes(moment, setup.psd_offset))[0]
        moment.spot = moment.spot - (2.0 * self.size * far * share)[:, None] * self._lean


class SpindlePlay(Outside):
    """the spindle's bearings have play: the mirror leans the way of the last move, one up or down rights it"""

    name, unit, typical, largest = 'spindle_play', 'rad', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        # The bearings are worn more one way than the other.
        self._play, self._rights = rng.uniform(0.4, 1.0, 2), rng.uniform(-0.3, 0.3, 2)
        self._nose = -rng.uniform(0.1, 0.4) * UP
        self.facts = {'play': self._play.tolist(), 'rights': self._rights.tolist()}

    def before_pose(self, moment: Moment) -> None:
        last = np.where(moment.moved[:, None] == np.arange(3), moment.approach, 0.0)
        lean = np.zeros((len(last), 3))
        # What hangs goes on when the axis stops.
        lean[:, :2] = last[:, :2] * self._play + last[:, 2:] * self._rights
        turn_by(moment, self.size * np.cross(lean, UP), self._nose)


# ---- detector, drivers, logs ------------------------------------------------------------------------

class BatteryRail(Outside):
    """the detector's amplifier runs on a battery: as it runs down spots far out are cut off, nearer and nearer in"""

    name, unit, typical, largest = 'battery_rail', '1/mm', 0.3, 10.0

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._falls, self._full = rng.uniform(1.0, 3.0), rng.uniform(0.0, 0.5)
        # The battery's two halves are not equally full.
        self._sides = rng.uniform(0.6, 1.0, 2)
        self.facts = {'falls': self._falls, 'full': self._full, 'sides': self._sides.tolist()}

    def after_light(self, moment: Moment) -> None:
        part = np.clip(moment.seconds / self.stage.span_s, 0.0, 1.0)
        run_down = self._full + (1.0 - self._full) * part ** self._falls
        nearer = self.size / 1e-3 * run_down[:, None] * np.where(moment.spot > 0.0, *self._sides)
        moment.spot = moment.spot / (1.0 + np.abs(nearer * moment.spot) ** 3) ** (1.0 / 3.0)


class ZeroTracking(Outside):
    """the detector's readout tracks its zero, as scales do: whatever spot stands there is slowly taken for nothing"""

    name, unit, typical, largest = 'zero_tracking', 'm/s', 3e-8, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._slower = np.array([1.0, rng.uniform(0.5, 1.0)])[::int(rng.choice([-1, 1]))]
        self.facts = {'slower': self._slower.tolist()}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        if len(log.spot) < 2:
            return log
        seconds = (log.spot.time_ns - log.spot.time_ns[0]) * 1e-9
        step = np.diff(seconds, prepend=seconds[0])
        # While the spot runs the zero waits; for a new setup the readout is switched on anew.
        step = np.clip(step, 0.0, 2.0 * float(np.median(step)))
        anew = np.diff(log.spot.setup, prepend=log.spot.setup[0]) != 0

        def tracked(k: int, seen: np.ndarray, values: np.ndarray) -> list[float]:
            zero, result, rates = 0.0, [], (self.size * self._slower[k % 2] * step[seen]).tolist()
            for value, most, new in zip(values.tolist(), rates, anew[seen].tolist(), strict=True):
                zero = 0.0 if new else zero
                zero += min(max(value - zero, -most), most)
                result.append(value - zero)
            return result

        return shown(log, tracked)


class ReportByException(Outside):
    """spots come by a historian that reports by exception: it keeps the last one until it is off by more than a band"""

    name, typical, largest, random = 'report_by_exception', 5e-6, 1e-3, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._bands = rng.uniform(0.6, 1.0, 2)
        self.facts = {'bands': self._bands.tolist()}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        def reported(k: int, _: np.ndarray, values: np.ndarray) -> list[float]:
            result, band = [], self.size * self._bands[k % 2]
            for value in values.tolist():
                result.append(value if not result or abs(value - result[-1]) > band else result[-1])
            return result

        return shown(log, reported)


class TornReads(Outside):
    """the detector's count is read in two halves and not latched: near a carry old high bits go with new low ones"""

    name, typical, largest, random = 'torn_reads', 2e-6, 1e-3, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        share = rng.uniform(0.1, 0.5)
        self._torn, self._zero = rng.random((20011, 2)) < share, rng.random(2)
        self.facts = {'share': share}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        def read(k: int, seen: np.ndarray, values: np.ndarray) -> np.ndarray:
            high = np.floor(values / self.size + self._zero[k % 2])
            # Between two samples of one stop it is a carry or none; over a move the high half may be far behind.
            before = np.append(high[:1], high[:-1])
            torn = self._torn[seen % len(self._torn), k % 2] & (np.abs(high - before) < 1.5)
            return values + self.size * np.where(torn, before - high, 0.0)

        return shown(log, read)


class LengthsSmoothed(Outside):
    """the interferometer's averaging was left at long: lengths come smoothed, and still creep when the stop is read"""

    name, unit, typical, largest, inside = 'lengths_smoothed', 's', 0.1, 3.0, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._stages = int(rng.integers(1, 3))
        self.facts = {'stages': self._stages}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        if len(log.displacement) < 2:
            return log
        events, values, time = log.steps, log.displacement.values.copy(), log.displacement.time_ns
        step = np.diff(time, prepend=time[:1]) * 1e-9
        # Of a move that was not logged the way's middle stands for all of it.
        step = np.where(step > 3.0 * np.median(step), 0.5 * step, step)
        share = 1.0 - np.exp(-np.maximum(step, 0.0) * self._stages / self.size)
        resets = [int(events.time_ns[events.run == run].min()) for run in range(len(events.run_ids))
                  if np.any(events.run == run)]
        begins = np.unique([0, *np.searchsorted(time, resets), len(values)])
        for first, last in zip(begins[:-1], begins[1:], strict=True):
            for k in range(values.shape[1]):
                seen = first + np.flatnonzero(np.isfinite(values[first:last, k]))
                for _ in range(self._stages):
                    smooth = values[seen, k].tolist()
                    for i, part in enumerate(share[seen].tolist()):
                        smooth[i] = smooth[i - 1] + part * (smooth[i] - smooth[i - 1]) if i else smooth[i]
                    values[seen, k] = smooth
        return replace(log, displacement=replace(log.displacement, values=values))


WORKSHOP = (SqueezeFilm, BoltedJointTicks, CounterweightSwings, SunPatch, EncoderCrosstalk, WholeDegrees,
            CornersSmoothed, ThrustFacesWobble, TwinScrewSlips, SealingAirJet, GrinderNextDoor,
            TautHose, CrackedMirror, SpindlePlay, BatteryRail, ZeroTracking, ReportByException, TornReads,
            LengthsSmoothed)
