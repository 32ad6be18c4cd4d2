"""Twenty effects from outside the vocabulary as a works' service, metrology and electronics see them, written without
any look at the diagnosis.

They act at gibs, way covers, accumulators and magazines, in the control's tables, encoders and gains, on the mirror's
face, in panes and fibres before the laser, come from cranes, doors and coolers, and are made by detectors and drivers.
Nothing is remembered from call to call: what happened before follows from the times of the runs, from
where a run came from, from the order of the plan, or from the finished log.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from stepdiag_ros.blind.hidden import (
    PLACES,
    UP,
    Stage,
    chosen_axes,
    direction,
    ends_of_runs,
    place_of,
    run_of,
    turn_by,
    walk_of,
)
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.blind.outside_field import at_times, one_setup
from stepdiag_ros.blind.outside_shopfloor import stop_of
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import start_corner, stops
from stepdiag_ros.model.sensor import station

GRID_S = 0.25
"""Of tables over time."""


def grid_of(stage: Stage) -> np.ndarray:
    """Times (k,) [s] of a table over the whole log."""
    return np.arange(0.0, stage.span_s + 2.0 * GRID_S, GRID_S)


def followed(target: np.ndarray, tau: float, begin: float | None = None) -> np.ndarray:
    """What follows a table (k,) over time with a time constant [s], from where that begins or from ``begin``."""
    state, share = np.empty(len(target)), 1.0 - np.exp(-GRID_S / tau)
    state[0] = target[0] if begin is None else begin
    for i in range(1, len(target)):
        state[i] = state[i - 1] + share * (target[i] - state[i - 1])
    return state


def shown(log: CalibrationLog, of: Callable[[int, np.ndarray, np.ndarray], ArrayLike]) -> CalibrationLog:
    """The log with the spots that are shown, channel by channel k: ``of`` (k, the samples (m,) that have a reading, the
    readings (m,))."""
    values = log.spot.values.copy()
    for k in range(values.shape[1]):
        seen = np.flatnonzero(np.isfinite(values[:, k]))
        values[seen, k] = of(k, seen, values[seen, k])
    return replace(log, spot=replace(log.spot, values=values))


def step_s(stage: Stage) -> float:
    """How long [s] a step takes with its dwell, about."""
    description = stage.cell.description
    names = list(description.setups)
    count = np.array([len(stops(description, names[setup])) for setup in stage.run_setup])
    return float(np.median((stage.runs[:, 1] - stage.runs[:, 0]) / count))


def resting(stage: Stage, moment: Moment, axis: int, step: float) -> np.ndarray:
    """For how long (n,) [s] an axis has stood, about: what a plan's order says of the moves since its own."""
    order = stage.cell.description.plan.order
    place = np.array([order.index(letter) for letter in 'XYZ'])
    alone = moment.moved < 3
    since = np.where(alone, (place[np.where(alone, moment.moved, axis)] - place[axis]) % 3, 0)
    return np.maximum(moment.since_arrival + step * since, 0.0)


def strikes(moment: Moment, offset: tuple[float, float]) -> np.ndarray:
    """Where (n, 2) [m] a beam meets the mirror, along (u, v) from its reference point: the mirror goes by."""
    return np.array(offset) - walk_of(moment)


def walked(stage: Stage, setup: str) -> np.ndarray:
    """Where (k, 2) [m] a setup's first beam meets the mirror at its stops."""
    description = stage.cell.description
    machine, given = description.machine, description.setups[setup]
    away = stops(description, setup).positions - start_corner(machine, given)
    return np.array(given.beams[0]) - away @ station(machine, given).triad[:2].T


def reach(stage: Stage) -> float:
    """Longest way [m] of the machine."""
    return float(np.linalg.norm(stage.travel))


def table(rng: np.random.Generator, count: int) -> np.ndarray:
    """Values (count,) that wander at random, one from the least to the greatest."""
    values = np.cumsum(rng.standard_normal(count))
    return values / max(float(np.ptp(values)), 1e-3)


# ---- guideways, covers, weights ---------------------------------------------------------------------

class WornGib(Outside):
    """a gib is worn in one stretch: there another axis's thrust leaves the carriage askew, its own move frees it"""

    name, unit, typical, largest = 'worn_gib', 'rad', 3e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._pusher = (int(k) for k in rng.permutation(3)[:2])
        self._middle, self._width = rng.uniform(0.25, 0.75), rng.uniform(0.12, 0.3)
        self._freed, self._vector = rng.uniform(0.0, 0.5), direction(rng)
        self._arm = direction(rng) * rng.uniform(0.1, 0.5)
        self.facts = {'axis': self._axis, 'pusher': self._pusher, 'middle': self._middle, 'width': self._width}

    def before_pose(self, moment: Moment) -> None:
        away = (place_of(self.stage, moment, self._axis) - self._middle) / self._width
        # Wear has a long flat bottom, and ends where the lubrication groove does.
        play = np.exp(-0.5 * away ** 4) * np.where(moment.moved == self._axis, self._freed, 1.0)
        turn = (self.size * play * moment.approach[:, self._pusher])[:, None] * self._vector
        turn_by(moment, turn, self._arm)


class TelescopicCovers(Outside):
    """a telescopic cover drags: the farther it goes the more plates are hauled along, one after another"""

    name, typical, largest = 'telescopic_covers', 3e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._plates = int(rng.integers(3)), int(rng.integers(3, 7))
        self._out = float(rng.choice([-1.0, 1.0]))
        self._pulled = np.sort(rng.uniform(0.05, 0.95, self._plates))
        self._pushed = np.clip(self._pulled - rng.uniform(0.05, 0.3), 0.02, None)
        self._drag = rng.uniform(0.4, 1.0, self._plates)
        self._skew = rng.uniform(0.2, 1.0) * np.cross(UP if self._axis < 2 else np.eye(3)[0], np.eye(3)[self._axis])
        self.facts = {'axis': self._axis, 'pulled': self._pulled.tolist(), 'pushed': self._pushed.tolist()}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        way = (place if self._out > 0.0 else 1.0 - place)[:, None]
        approach = moment.approach[:, self._axis]
        # Going out a plate hangs on the hooks of those before it; going in only those that are still out are pushed.
        hauled = np.where((approach * self._out > 0.0)[:, None], way > self._pulled, way > self._pushed)
        drag = self.size * approach * (hauled @ self._drag) / self._plates
        moment.position = moment.position - drag[:, None] * np.eye(3)[self._axis]
        moment.turn = moment.turn + drag[:, None] * self._skew


class AccumulatorGas(Outside):
    """the weight's accumulator is short of gas: a stroke of Z heats or cools it, the head nods until that is even"""

    name, unit, typical, largest = 'accumulator_gas', 'rad', 5e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        tau = rng.uniform(8.0, 50.0)
        self._grid = grid_of(stage)
        height = np.interp(self._grid, stage.runs.ravel(), ends_of_runs(stage)[:, :, 2].ravel() / stage.travel[2])
        self._even = followed(height, tau)
        self._nod = np.append(direction(rng, 2), 0.0)
        self._stiff = rng.uniform(0.2, 0.8)
        self.facts = {'tau_s': tau, 'nod': self._nod.tolist()}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, 2)
        pressure = place - np.interp(moment.seconds, self._grid, self._even)
        # The column is the softer the higher the head hangs.
        turn = (self.size * pressure * (1.0 - self._stiff * (1.0 - place)))[:, None] * self._nod
        turn_by(moment, turn, np.array(moment.description.machine.tool) + moment.commanded[:, 2:] * UP)


class MagazineTurns(Outside):
    """the tool magazine on the column turns now and then, heavy on one side: the column leans here, then there"""

    name, unit, typical, largest = 'magazine_turns', 'rad', 3e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every = rng.uniform(20.0, 120.0)
        self._times = at_times(rng, stage, every)
        self._heavy = np.cos(rng.uniform(0.0, 2.0 * np.pi, len(self._times) + 1))
        self._lean, self._foot = np.append(direction(rng, 2), rng.normal(0.0, 0.2)), rng.uniform(0.1, 0.6)
        self.facts = {'every_s': every, 'foot': self._foot, 'lean': self._lean.tolist()}

    def before_pose(self, moment: Moment) -> None:
        heavy = self._heavy[np.searchsorted(self._times, moment.seconds, side='right')]
        bend = (self._foot + place_of(self.stage, moment, 2)) / (1.0 + self._foot)
        turn = (self.size * heavy * bend)[:, None] * self._lean
        turn_by(moment, turn, 0.5 * moment.commanded[:, 2:] * UP)


# ---- control and encoders ---------------------------------------------------------------------------

class WrongGridNode(Outside):
    """one node of the control's volumetric table was typed wrong: around it, and only there, all axes go astray"""

    name, typical, largest = 'wrong_grid_node', 3e-6, 2e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._cells = int(rng.integers(3, 6))
        # On one of the body diagonals, or no measurement of the volume would ever pass it.
        along = int(rng.integers(1, self._cells))
        self._node = np.where(rng.random(3) < 0.5, along, self._cells - along) / self._cells
        self._vector = direction(rng)
        self.facts = {'node': self._node.tolist(), 'cells': self._cells, 'vector': self._vector.tolist()}

    def before_pose(self, moment: Moment) -> None:
        away = np.abs(moment.commanded / self.stage.travel - self._node) * self._cells
        hat = np.prod(np.maximum(1.0 - away, 0.0), axis=1)
        moment.position = moment.position + self.size * hat[:, None] * self._vector


class SubdivisionDrifts(Outside):
    """an encoder divides its signal unevenly, and the control's thermal offset lets stops slide through its periods"""

    name, typical, largest = 'subdivision_drifts', 7e-7, 4e-6

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, (self._slides, kind) = int(rng.integers(3)), stage.profile(rng)
        # The offset itself does what it should and holds the place; only the reading that belongs to it wanders.
        self._period, self._periods = float(rng.choice([10e-6, 20e-6, 40e-6])), rng.uniform(0.6, 3.0)
        self._phase, self._second = rng.uniform(0.0, 2.0 * np.pi, PLACES), rng.uniform(0.0, 0.5)
        self.facts = {'axis': self._axis, 'period_m': self._period, 'periods': self._periods, 'profile': kind}

    def before_pose(self, moment: Moment) -> None:
        # Within a stop's reach the phase follows the true place; from stop to stop no one knows it, so it was drawn.
        off = (moment.position - moment.commanded)[:, self._axis] / self._period
        turn = 2.0 * np.pi * (off + self._periods * self._slides(moment.seconds)) \
            + self._phase[stop_of(self.stage, moment, self._axis)]
        error = self.size * (np.sin(turn) + self._second * np.sin(2.0 * turn))
        moment.position = moment.position + error[:, None] * np.eye(3)[self._axis]


class DualFeedback(Outside):
    """the control goes by the motor's encoder, the scale corrects it slowly: the screw's pitch errors fade"""

    name, typical, largest, inside = 'dual_feedback', 3e-6, 3e-4, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._step = int(rng.integers(3)), step_s(stage)
        self._tau = rng.uniform(0.4, 2.5) * self._step
        self._places = np.linspace(0.0, 1.0, int(rng.integers(5, 11)))
        self._pitch = table(rng, len(self._places))
        self._pitch -= self._pitch.mean()
        self.facts = {'axis': self._axis, 'tau_s': self._tau, 'pitch': self._pitch.tolist()}

    def before_pose(self, moment: Moment) -> None:
        pitch = np.interp(place_of(self.stage, moment, self._axis), self._places, self._pitch)
        left = np.exp(-resting(self.stage, moment, self._axis, self._step) / self._tau)
        moment.position = moment.position + (self.size * left * pitch)[:, None] * np.eye(3)[self._axis]


class StandstillGain(Outside):
    """drives save current: an axis that has stood for a while holds weakly, its cable chain draws it to one place"""

    name, typical, largest = 'standstill_gain', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._weight, self._step = chosen_axes(rng), step_s(stage)
        self._after = rng.uniform(0.5, 1.7) * self._step
        self._slack, self._stiffens = rng.uniform(0.0, 1.0, 3), rng.uniform(1.0, 2.2)
        self.facts = {'axes': self._weight.tolist(), 'after_s': self._after, 'slack': self._slack.tolist()}

    def before_pose(self, moment: Moment) -> None:
        position = moment.position.copy()
        for axis in np.flatnonzero(self._weight):
            rest = resting(self.stage, moment, int(axis), self._step) - self._after
            # The current is lowered within a fifth of a second.
            weak = np.clip(rest / 0.2, 0.0, 1.0)
            off = self._slack[axis] - place_of(self.stage, moment, int(axis))
            pull = np.sign(off) * np.abs(off) ** self._stiffens
            position[:, axis] += self.size * self._weight[axis] * weak * pull
        moment.position = position


# ---- mirror, panes, fibre ---------------------------------------------------------------------------

class TrefoilMirror(Outside):
    """three clamps press on the mirror's rim: its face is a trefoil, neither flat nor a sphere"""

    name, typical, largest = 'trefoil_mirror', 1e-8, 1e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        met = [np.abs(walked(stage, name) - setup.beams[0] + offset).max()
               for name, setup in stage.cell.description.setups.items() for offset in (*setup.beams, setup.psd_offset)]
        self._radius = max(float(np.max(met)), 5e-3)
        turn = rng.uniform(0.0, 2.0 * np.pi / 3.0)
        self._frame = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        # The clamps' middle is not where the beam meets the mirror first.
        self._middle = rng.normal(0.0, 0.3, 2)
        self.facts = {'radius_m': self._radius, 'turn_rad': turn}

    def _face(self, strike: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height (n,) [m] towards the light and its slopes (n, 2) along (u, v)."""
        x, y = ((strike / self._radius - self._middle) @ self._frame.T).T
        height = x ** 3 - 3.0 * x * y ** 2
        slope = np.stack([3.0 * (x ** 2 - y ** 2), -6.0 * x * y], axis=1) @ self._frame
        return self.size * height, self.size / self._radius * slope

    def after_light(self, moment: Moment) -> None:
        setup = moment.description.setups[moment.setup]
        heights = [self._face(strikes(moment, offset))[0] for offset in setup.beams]
        far = moment.length.mean(axis=1)
        moment.length = moment.length - np.stack(heights, axis=1)
        slope = self._face(strikes(moment, setup.psd_offset))[1]
        moment.spot = moment.spot - 2.0 * far[:, None] * slope


class DryingCoat(Outside):
    """half of the mirror was coated anew and still dries: beyond the edge of the coat lengths change as it shrinks"""

    name, typical, largest = 'drying_coat', 1e-6, 3e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        walk, self._across = walked(stage, one_setup(rng, stage)), direction(rng, 2)
        along = walk @ self._across
        self._edge = float(along.min() + rng.uniform(0.25, 0.75) * np.ptp(along))
        self._beam, (self._dries, kind) = rng.uniform(1e-3, 2.5e-3), stage.profile(rng)
        # Across the edge the light comes back in two halves that are not level.
        self._pulls = rng.uniform(2.0, 6.0)
        self.facts = {'edge_m': self._edge, 'across': self._across.tolist(), 'beam_m': self._beam, 'profile': kind}

    def after_light(self, moment: Moment) -> None:
        setup, dry = moment.description.setups[moment.setup], self._dries(moment.seconds)
        off = np.stack([(strikes(moment, offset) @ self._across - self._edge) / self._beam for offset in setup.beams],
                       axis=1)
        moment.length = moment.length + 0.5 * self.size * dry[:, None] * (1.0 + np.tanh(off))
        # A beam on the edge is two beams that are not in phase.
        moment.quality = moment.quality * (1.0 - 0.3 * np.exp(-off ** 2).max(axis=1))
        edge = (strikes(moment, setup.psd_offset) @ self._across - self._edge) / self._beam
        kick = self.size * self._pulls * dry * np.exp(-edge ** 2)
        moment.spot = moment.spot + kick[:, None] * self._across


class PaneOnCover(Outside):
    """the beam goes through a plastic pane that rides on an axis's cover: its thickness wanders, its wedge bends"""

    name, typical, largest = 'pane_on_cover', 2e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, waves = int(rng.integers(3)), int(rng.integers(2, 5))
        self._waves, self._phase = rng.uniform(0.3, 3.0, waves), rng.uniform(0.0, 2.0 * np.pi, waves)
        self._share = rng.uniform(0.3, 1.0, waves) / waves
        self._bent, self._beside = rng.uniform(0.3, 3.0) * direction(rng, 2), rng.normal(0.0, 0.03, 16)
        self.facts = {'axis': self._axis, 'waves': self._waves.tolist()}

    def after_light(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        length = moment.length.copy()
        for beam in range(length.shape[1]):
            turn = 2.0 * np.pi * (place + self._beside[beam % 16])[:, None] * self._waves + self._phase
            length[:, beam] += self.size * (np.sin(turn) @ self._share)
        turn = 2.0 * np.pi * place[:, None] * self._waves + self._phase
        wedge = np.cos(turn) @ (self._share * self._waves)
        far = moment.length.mean(axis=1) / reach(self.stage)
        moment.length = length
        moment.spot = moment.spot + (self.size * far * wedge)[:, None] * self._bent


class FibreSpeckle(Outside):
    """an axis tugs at the laser's fibre: with each of its moves the pattern of light in the beam changes"""

    name, typical, largest, random = 'fibre_speckle', 3e-6, 5e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis = int(rng.integers(3))
        self._pattern = np.clip(rng.standard_normal((len(stage.runs), PLACES, 2)), -2.5, 2.5)
        self._light = np.clip(rng.standard_normal((len(stage.runs), PLACES)), -2.5, 2.5)
        self._grows, self._flickers = rng.uniform(0.0, 1.0), rng.uniform(0.005, 0.04)
        self.facts = {'axis': self._axis, 'grows': self._grows}

    def after_light(self, moment: Moment) -> None:
        run, stop = run_of(self.stage, moment.seconds), stop_of(self.stage, moment, self._axis)
        far = moment.length.mean(axis=1) / reach(self.stage)
        wide = self.size * (1.0 - self._grows + 2.0 * self._grows * far)
        moment.spot = moment.spot + wide[:, None] * self._pattern[run, stop]
        flicker = self._flickers * min(self.size / self.typical, 2.0) * self._light[run, stop]
        moment.intensity = moment.intensity * (1.0 + flicker)


# ---- hall -------------------------------------------------------------------------------------------

class CranePasses(Outside):
    """a crane rolls by with its load: the floor tilts the laser's stand towards it, then after it, and is even again"""

    name, unit, typical, largest = 'crane_passes', 'rad', 5e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every = rng.uniform(40.0, 200.0)
        times = at_times(rng, stage, every)
        load, lasts = rng.lognormal(-0.2, 0.5, len(times)), rng.uniform(5.0, 20.0, len(times))
        load *= rng.choice([-1.0, 1.0], len(times))
        self._grid = grid_of(stage)
        self._towards, self._aside = np.zeros((2, len(self._grid)))
        for time, heavy, long in zip(times, load, lasts, strict=True):
            off = (self._grid - time) / long
            bell = np.exp(-0.5 * off ** 2)
            # Along its rails the tilt changes its sign, across them it does not.
            self._towards += heavy * 1.6 * off * bell
            self._aside += abs(heavy) * bell
        rails = np.append(direction(rng, 2), 0.0)
        self._along, self._across = np.cross(UP, rails), rng.uniform(-0.8, 0.8) * rails
        self.facts = {'every_s': every, 'rails': rails.tolist(), 'passes': len(times)}

    def before_light(self, moment: Moment) -> None:
        triad = station(moment.description.machine, moment.description.setups[moment.setup]).triad
        turn = np.interp(moment.seconds, self._grid, self._towards)[:, None] * self._along \
            + np.interp(moment.seconds, self._grid, self._aside)[:, None] * self._across
        moment.laser = moment.laser + self.size * turn @ triad[:2].T


class DoorDraught(Outside):
    """the hall's door opens now and then: cold air falls into the far part of the beam's way, and warms up again"""

    name, typical, largest = 'door_draught', 1e-6, 3e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        every = rng.uniform(60.0, 240.0)
        times = at_times(rng, stage, every)
        cold, opened = rng.lognormal(-0.2, 0.4, len(times)), rng.uniform(8.0, 45.0, len(times))
        falls, warms = rng.uniform(2.0, 8.0), rng.uniform(15.0, 60.0)
        self._grid = grid_of(stage)
        self._cold = np.zeros(len(self._grid))
        for time, much, lasts in zip(times, cold, opened, strict=True):
            since = np.maximum(self._grid - time, 0.0)
            self._cold += much * (1.0 - np.exp(-np.minimum(since, lasts) / falls)) \
                * np.exp(-np.maximum(since - lasts, 0.0) / warms)
        self._from, self._bends = rng.uniform(0.3, 0.65), rng.uniform(0.5, 4.0) * direction(rng, 2)
        self.facts = {'every_s': every, 'from': self._from, 'warms_s': warms}

    def after_light(self, moment: Moment) -> None:
        cold = self.size * np.interp(moment.seconds, self._grid, self._cold)
        within = np.maximum(moment.length / reach(self.stage) - self._from, 0.0)
        moment.spot = moment.spot + (cold * within.mean(axis=1) ** 2)[:, None] * self._bends
        moment.length = moment.length + cold[:, None] * within


class AirConditionerBends(Outside):
    """the air conditioner blows warm and cold by turns: layers of air bend the beam down and up, far ones more"""

    name, unit, typical, largest = 'air_conditioner_bends', 'm at full length', 8e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        period, tau = rng.uniform(40.0, 400.0), rng.uniform(5.0, 60.0)
        lasts = period * rng.uniform(0.35, 0.65, int(3.0 * (stage.span_s + period) / period) + 20)
        changes = np.cumsum(lasts) - rng.uniform(1.0, 2.0) * period
        self._grid = np.arange(-2.0 * tau, stage.span_s + 2.0 * GRID_S, GRID_S)
        blows = np.searchsorted(changes, self._grid) % 2 - 0.5
        self._layers = followed(blows, tau, begin=0.0)
        self._layers /= max(float(np.ptp(self._layers)), 1e-3)
        self.facts = {'period_s': period, 'tau_s': tau}

    def after_light(self, moment: Moment) -> None:
        triad = station(moment.description.machine, moment.description.setups[moment.setup]).triad
        far = (moment.length.mean(axis=1) / reach(self.stage)) ** 2
        bend = self.size * far * np.interp(moment.seconds, self._grid, self._layers)
        # Across the layers a beam is bent, along their gradient it is not.
        moment.spot = moment.spot + bend[:, None] * (triad[:2] @ UP)


# ---- electronics and drivers ------------------------------------------------------------------------

class UndividedSum(Outside):
    """the detector's driver does not divide by the sum: spots shrink with the light, over distance and time"""

    name, unit, typical, largest = 'undivided_sum', '1', 0.03, 0.8

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._power, kind = stage.profile(rng)
        self._far, self._waist = rng.uniform(0.6, 1.0), rng.uniform(0.3, 1.0) * reach(stage)
        self._fades = rng.uniform(0.2, 0.7) * rng.choice([-1.0, 1.0])
        self.facts = {'profile': kind, 'waist_m': self._waist, 'fades': self._fades}

    def after_light(self, moment: Moment) -> None:
        widened = (moment.length.mean(axis=1) / self._waist) ** 2
        lost = self._far * widened / (1.0 + widened) + self._fades * self._power(moment.seconds)
        light = np.clip(1.0 - self.size * lost, 0.05, 3.0)
        moment.spot = moment.spot * light[:, None]
        moment.intensity = moment.intensity * light


class TiltByCountedWay(Outside):
    """the driver takes tilt times an arm off the lengths, tilt being spot by way since the reset: wrong coming back"""

    name, typical, largest = 'tilt_by_counted_way', 5e-3, 0.3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._begins, self._arm = ends_of_runs(stage)[:, 0], direction(rng, 2)
        # What was typed in for the distance at the reset, whoever resets it and wherever.
        self._typed = rng.uniform(0.15, 0.6)
        self.facts = {'arm': self._arm.tolist(), 'typed_m': self._typed}

    def after_light(self, moment: Moment) -> None:
        triad = station(moment.description.machine, moment.description.setups[moment.setup]).triad
        way = (moment.commanded - self._begins[run_of(self.stage, moment.seconds)]) @ triad[2]
        # Without a detector there is no tilt to be taken.
        tilt = np.nan_to_num(moment.spot @ self._arm) / (2.0 * (np.abs(way) + self._typed))
        moment.length = moment.length - self.size * tilt[:, None]


class SpikeLimiter(Outside):
    """the detector's driver cuts spikes: the spot may change by only so much a sample and lags after moves"""

    name, unit, typical, largest = 'spike_limiter', 's/mm', 5.0, 500.0

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._slower = np.sort(rng.uniform(0.5, 1.0, 2))[::int(rng.choice([-1, 1]))]
        self.facts = {'slower': self._slower.tolist()}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        if len(log.spot) < 2:
            return log
        period = float(np.median(np.diff(log.spot.time_ns))) * 1e-9

        def limited(k: int, _: np.ndarray, values: np.ndarray) -> list[float]:
            most, result = 1e-3 * period / (self.size * self._slower[k % 2]), []
            for value in values.tolist():
                before = result[-1] if result else value
                result.append(min(max(value, before - most), before + most))
            return result

        return shown(log, limited)


class BlocksFilledIn(Outside):
    """blocks of the detector get lost on the net: its driver draws a straight line from what came to what follows"""

    name, unit, typical, largest, random = 'blocks_filled_in', '1', 0.1, 0.5, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        # Losses come in pairs and threes: a net is busy for a while.
        luck = rng.random(20000)
        self._luck = np.minimum(luck, 1.6 * np.roll(luck, 1) + rng.uniform(0.0, 0.2))
        self.facts = {}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        lost = self._luck[log.spot.block % len(self._luck)] < self.size
        seconds, values = (log.spot.time_ns - log.spot.time_ns[:1]) * 1e-9, log.spot.values.copy()
        for k in range(values.shape[1]):
            there = np.isfinite(values[:, k])
            kept, gone = there & ~lost, there & lost
            if kept.any():
                values[gone, k] = np.interp(seconds[gone], seconds[kept], values[kept, k])
        return replace(log, spot=replace(log.spot, values=values))


class RoundedIncrements(Outside):
    """lengths are sent as increments in whole counts and added up: what is rounded off adds up too, until the reset"""

    name, typical, largest, random = 'rounded_increments', 1e-7, 5e-5, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        # Each increment is rounded with an offset of the converter's own, which is the same throughout.
        self._offset = rng.uniform(-0.03, 0.03)
        self.facts = {'offset': self._offset}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        values, events = log.displacement.values.copy(), log.steps
        resets = [int(events.time_ns[events.run == run].min()) for run in range(len(log.steps.run_ids))
                  if np.any(events.run == run)]
        begins = np.unique([0, *np.searchsorted(log.displacement.time_ns, resets), len(values)])
        for first, last in zip(begins[:-1], begins[1:], strict=True):
            for k in range(values.shape[1]):
                seen = first + np.flatnonzero(np.isfinite(values[first:last, k]))
                if len(seen) > 1:
                    # Nothing moved is nothing sent.
                    change = np.diff(values[seen, k]) / self.size
                    counts = np.where(change != 0.0, np.rint(change + self._offset), 0.0)
                    values[seen[1:], k] = values[seen[0], k] + self.size * np.cumsum(counts)
        return replace(log, displacement=replace(log.displacement, values=values))


WORKS = (WornGib, TelescopicCovers, AccumulatorGas, MagazineTurns, WrongGridNode, SubdivisionDrifts, DualFeedback,
         StandstillGain, TrefoilMirror, DryingCoat, PaneOnCover, FibreSpeckle, CranePasses, DoorDraught,
         AirConditionerBends, UndividedSum, TiltByCountedWay, SpikeLimiter, BlocksFilledIn, RoundedIncrements)
