"""The one machine that every virtual instrument looks at.

From the history of moves and a set of times follow the axes' positions (servo lag,
repeatability), the tool pose (21 geometric errors), and, by tracing rays, what the
sensors see.  The cell's effects act on the way.  The world keeps no state between calls
but a cache: what it says of a time and a sample number depends on the cell's seed, the
history and those alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Moment
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Setup
from stepdiag_ros.model.log import NONE
from stepdiag_ros.model.machine import compose, rotation
from stepdiag_ros.model.regulation import steered, steering_frame
from stepdiag_ros.model.sensor import turned_frame
from stepdiag_ros.virtual.acting import Draws, create_effects
from stepdiag_ros.virtual.air import environment, index_at
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.history import History
from stepdiag_ros.virtual.motion import settling_time, tabulate
from stepdiag_ros.virtual.noise import Numbers, SensorNoise
from stepdiag_ros.virtual.scene import SensorScene
from stepdiag_ros.virtual.steering import SteeringHistory

WALK_LIMIT = 4.0e-3
"""Return beam's walk [m] at which the interferometer's contrast has fallen to 1/e."""
UNTOLD_STANDOFF = 0.1
"""Standoff [m] where a description has none."""
CONTRAST = 96.0
"""Signal quality of a beam that returns into itself."""


@dataclass(frozen=True)
class Reading:
    """What the sensors see at ``n`` times, without noise and before any reset.

    ``length`` (n, beams) [m], as the interferometer would report it; ``spot`` (n, 2) [m]
    as the detector has it; ``quality`` (n,) 0..100; ``intensity`` (n,) [V]; ``index`` (n,)
    refractive index that was divided out.
    """

    length: np.ndarray
    spot: np.ndarray
    quality: np.ndarray
    intensity: np.ndarray
    index: np.ndarray


def _scene(cell: Cell, setup: Setup) -> SensorScene:
    # A standoff of 0 was not stated: no mirror stands in the laser.
    try:
        return SensorScene.of_setup(cell.description.machine,
                                    replace(setup, standoff=setup.standoff or UNTOLD_STANDOFF))
    except ValueError as error:
        raise StepdiagError(f'{cell.source}: setups.{setup.name}: {error}') from None


class World:
    """A cell in motion.  ``epoch_ns`` is the time at which drifts begin; ``effects`` act instead of
    those that the cell names.  ``displacement``, ``spot``: what the sensors add (:class:`SensorNoise`).  ``steering``:
    where a regulated beam was turned to; None: it meets the retroreflector's centre."""

    def __init__(self, cell: Cell, history: History, epoch_ns: int,
                 effects: Sequence[Effect] | None = None):
        self.cell, self.history, self.epoch_ns = cell, history, epoch_ns
        self.steering: SteeringHistory | None = None
        description = cell.description
        self._scenes = {name: _scene(cell, setup) for name, setup in description.setups.items() if not setup.follows}
        self.effects = create_effects(cell) if effects is None else list(effects)
        self._draws = {effect.name: Draws(cell.seed, effect.name) for effect in self.effects}
        self._known = 0
        self._error = np.zeros((1, 3))      # position error after each arrival, [0]: before any
        self._angle = np.zeros((1, 3))
        self._approach = np.zeros((1, 3))
        self._moved = np.full(1, NONE)
        self._settled_ns = np.zeros(0, np.int64)   # when each move was in position
        self._mounted_ns = np.zeros(0, np.int64)   # when the setup of each move was mounted
        self._mounted = -2
        noise, laws, seed = description.noise, cell.noise_law, cell.seed
        self.displacement = SensorNoise(laws.displacement, noise.displacement, seed, 'displacement')
        self.spot = SensorNoise(laws.spot, noise.spot, seed, 'spot')
        self._positions = Numbers(laws.position, seed, 'position')
        self._angles = Numbers(laws.angle, seed, 'angle')

    def clock_offset(self, sensor: str) -> float:
        """Seconds that the stamps of ``sensor`` are late."""
        return sum(effect.clock_offset(sensor) for effect in self.effects)

    def _catch_up(self) -> None:
        """Draw what the arrivals since the last call bring."""
        count = len(self.history)
        if count == self._known:
            return
        first, fresh = self._known, count - self._known
        records = self.history.records[first:]
        noise, motion = self.cell.description.noise, self.cell.motion
        draws = noise.position_repeatability * self._positions.draw(first, fresh, 3)
        angle = noise.angle_repeatability * self._angles.draw(first, fresh, 3)
        sign = np.sign(records['direction'])
        error, approach = np.empty((fresh, 3)), np.empty((fresh, 3))
        moved, mounted = np.empty(fresh, int), np.empty(fresh, np.int64)
        last_error, last_approach, last_moved = self._error[-1], self._approach[-1], self._moved[-1]
        last_mounted = self._mounted_ns[-1] if first else 0
        for i in range(fresh):
            moving = np.flatnonzero(sign[i])
            # The first arrival sets all axes: before it nobody knows where they stood.
            error[i] = last_error = np.where((sign[i] != 0.0) | (first + i == 0), draws[i], last_error)
            approach[i] = last_approach = np.where(sign[i] != 0.0, sign[i], last_approach)
            if len(moving):
                last_moved = moving[0] if len(moving) == 1 else NONE
            moved[i] = last_moved
            if records['setup'][i] != self._mounted:
                self._mounted, last_mounted = records['setup'][i], records['start_ns'][i]
            mounted[i] = last_mounted
        table = tabulate(records['duration'], records['jerk'], records['speed'],
                         records['acceleration'])
        settled = records['start_ns'] + np.rint(settling_time(
            table, motion.settling, motion.in_position) * 1e9).astype(np.int64)
        for i in range(fresh):
            # A move of no length disturbs nothing: the axes stand as long as they stood before.
            if first + i and not sign[i].any():
                settled[i] = settled[i - 1] if i else self._settled_ns[-1]
                angle[i] = angle[i - 1] if i else self._angle[-1]
        self._error = np.concatenate([self._error, error])
        self._approach = np.concatenate([self._approach, approach])
        self._angle = np.concatenate([self._angle, angle])
        self._moved = np.concatenate([self._moved, moved])
        self._settled_ns = np.concatenate([self._settled_ns, settled])
        self._mounted_ns = np.concatenate([self._mounted_ns, mounted])
        self._known = count

    def stands_from(self, time_ns: int) -> bool:
        """As long as no move is announced all axes stand from ``time_ns`` on, and no effect or steered beam acts."""
        self._catch_up()
        return not self.effects and self.steering is None and self._known > 0 and time_ns > self._settled_ns[-1]

    def moment(self, time_ns: np.ndarray, setup: str) -> tuple[Moment, np.ndarray]:
        """The machine at ``time_ns`` (n,) before any effect acts, and the tool's irreproducible
        turn (n, 3) [rad]."""
        self._catch_up()
        cell = self.cell
        time_ns = np.asarray(time_ns, np.int64)
        arrival, commanded, actual, share = self.history.locate(time_ns, cell.motion.settling)
        share = share[:, None]
        error = self._error[arrival] * (1.0 - share) + self._error[arrival + 1] * share
        angle = self._angle[arrival] * (1.0 - share) + self._angle[arrival + 1] * share
        n = len(time_ns)
        seconds = (time_ns - self.epoch_ns) * 1e-9
        index, air = index_at(cell.air, seconds), environment(cell.air, seconds, self.effects)
        return Moment(
            description=cell.description, setup=setup, seconds=seconds,
            mount_seconds=(time_ns - self._mounted_ns[arrival]) * 1e-9, arrival=arrival,
            since_arrival=(time_ns - self._settled_ns[arrival]) * 1e-9,
            moved=self._moved[arrival + 1], commanded=commanded,
            approach=self._approach[arrival + 1],
            scale_temperature=np.stack([air[f'scale_temperature/{axis}'] for axis in 'xyz'], axis=1),
            rng=None,
            position=actual + error, shift=np.zeros((n, 3)), turn=np.zeros((n, 3)),
            laser=np.zeros((n, 2)), mirror=np.zeros((n, 2)),
            index=np.ones(n) if cell.air.compensated else index,
            divided=index if cell.air.compensated else np.ones(n)), angle

    def _act(self, stage: str, moment: Moment) -> None:
        for effect in self.effects:
            moment.rng = self._draws[effect.name]
            getattr(effect, stage)(moment)

    def pose(self, moment: Moment, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mirror's reference point (n, 3) [m] and attitude (n, 3, 3)."""
        machine = self.cell.description.machine
        tool = self.cell.description.setups[moment.setup].tool_of(machine)
        motions = [self.cell.geometry.motions(axis, moment.position[:, axis]) for axis in range(3)]
        point, attitude = compose(machine.chain, np.array([shift for shift, _ in motions]),
                                  np.array([turn for _, turn in motions]), tool)
        return point + moment.shift, rotation(angle + moment.turn) @ attitude

    def read(self, time_ns: np.ndarray, setup: str) -> Reading:
        """What the base unit of ``setup`` reports at the true times ``time_ns`` (n,)."""
        cell = self.cell
        moment, angle = self.moment(time_ns, setup)
        self._act('before_pose', moment)
        point, attitude = self.pose(moment, angle)
        self._act('before_light', moment)
        misalignment = cell.misalignments[setup]
        if cell.description.setups[setup].follows:
            return self._followed(moment, point, time_ns)
        seen = self._scenes[setup].measure(
            point, attitude, beam_tilt=moment.laser + np.array(misalignment.laser),
            mirror_tilt=moment.mirror + np.array(misalignment.mirror), mirror_form=moment.form,
            psd_zero=cell.psd_zero[setup], ambient=moment.index)
        walk = np.linalg.norm(seen.spot - np.array(cell.psd_zero[setup]), axis=1)
        moment.length, moment.spot = seen.distance, seen.spot
        # What is turned away so far that it never meets the detector's plane is no light there, and none comes back.
        lit = np.isfinite(walk)
        moment.quality = CONTRAST * np.exp(-np.where(lit, walk / WALK_LIMIT, np.inf) ** 2)
        moment.intensity = np.where(lit, cell.instruments.detector.sum_voltage, 0.0)
        self._act('after_light', moment)
        return Reading(moment.length, moment.spot, moment.quality, moment.intensity, moment.divided)

    def arm(self, time_ns: np.ndarray, setup: str) -> np.ndarray:
        """From the station of ``setup`` to the centre of the retroreflector (n, 3) [m] at ``time_ns`` (n,)."""
        moment, angle = self.moment(time_ns, setup)
        self._act('before_pose', moment)
        return self.pose(moment, angle)[0] - self._place(setup)

    def _place(self, setup: str) -> np.ndarray:
        return np.add(self.cell.description.setups[setup].station, self.cell.misalignments[setup].station)

    def frame(self, setup: str) -> np.ndarray:
        """The rows u, v, d (3, 3) from which a steered beam's angles count, the station mounted a little askew."""
        given = self.cell.description.setups[setup]
        return turned_frame(steering_frame(self.cell.description.machine, given), self.cell.misalignments[setup].laser)

    def _followed(self, moment: Moment, point: np.ndarray, time_ns: np.ndarray) -> Reading:
        """What a beam reads that follows the retroreflector at ``point`` (n, 3) from the setup's station."""
        setup, cell = moment.setup, self.cell
        arm = point - self._place(setup)
        regulated = cell.description.setups[setup].regulated
        length, spot = np.linalg.norm(arm, axis=1), np.zeros((len(arm), 2))
        if regulated and self.steering is not None:
            length, spot = steered(self.frame(setup), self.steering.angles(time_ns), arm)
        moment.length, moment.spot = (moment.index * length)[:, None], spot + np.array(cell.psd_zero[setup]) * regulated
        moment.quality = CONTRAST * np.exp(-(np.linalg.norm(spot, axis=1) / WALK_LIMIT) ** 2)
        moment.intensity = np.full(len(arm), cell.instruments.detector.sum_voltage * regulated)
        self._act('after_light', moment)
        return Reading(moment.length, moment.spot, moment.quality, moment.intensity, moment.divided)

    def index(self, seconds: np.ndarray) -> np.ndarray:
        """Index of air (n,) after ``seconds`` (n,)."""
        return index_at(self.cell.air, seconds)

    def setup_at(self, time_ns: int) -> str | None:
        """The setup that is mounted at a time; ``None`` when there is none."""
        if len(self.history) == 0:
            return None
        number = int(self.history.records['setup'][self.history.segment_at(np.array([time_ns]))[0]])
        return self.cell.setup_names[number] if number >= 0 else None
