"""The one machine that every virtual instrument looks at.

From the history of moves and a set of times follow the axes' positions (servo lag,
repeatability), the tool pose (21 geometric errors), and what the sensors see.  The
world keeps no state between calls but a cache: what it says of a time and a sample
number depends on the cell's seed, the history and those alone.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.model.machine import compose, rotation
from stepdiag_ros.virtual.air import index_at
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.draw import normals
from stepdiag_ros.virtual.history import History
from stepdiag_ros.virtual.optics import sight

WALK_LIMIT = 4.0e-3
"""Return beam's walk [m] at which the interferometer's contrast has fallen to 1/e."""


@dataclass(frozen=True)
class State:
    """The machine at ``n`` times.

    ``time_ns`` (n,); ``seconds`` (n,) since the world began; ``arrival`` (n,) number of the
    move under way or last finished; ``commanded`` and ``position`` (n, 3) [m]: where the
    axes should be and are; ``approach`` (n, 3) sign of each axis's last motion, 0 before
    the first; ``angle`` (n, 3) [rad] irreproducible turn of the tool.
    """

    time_ns: np.ndarray
    seconds: np.ndarray
    arrival: np.ndarray
    commanded: np.ndarray
    position: np.ndarray
    approach: np.ndarray
    angle: np.ndarray


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


class World:
    """A cell in motion.  ``epoch_ns`` is the time at which drifts begin."""

    def __init__(self, cell: Cell, history: History, epoch_ns: int):
        self.cell, self.history, self.epoch_ns = cell, history, epoch_ns
        self._known = 0
        self._error = np.zeros((1, 3))      # position error after each arrival, [0]: before any
        self._angle = np.zeros((1, 3))
        self._approach = np.zeros((1, 3))

    def _catch_up(self) -> None:
        """Draw what the arrivals since the last call bring."""
        count = len(self.history)
        if count == self._known:
            return
        first, fresh = self._known, count - self._known
        noise, seed = self.cell.description.noise, self.cell.seed
        draws = noise.position_repeatability * normals(seed, 'position', first, fresh, 3)
        turns = noise.angle_repeatability * normals(seed, 'angle', first, fresh, 3)
        sign = np.sign(self.history.records['direction'][first:])
        error, approach = np.empty((fresh, 3)), np.empty((fresh, 3))
        last_error, last_approach = self._error[-1], self._approach[-1]
        for i in range(fresh):
            # The first arrival sets all axes: before it nobody knows where they stood.
            moved = (sign[i] != 0.0) | (first + i == 0)
            error[i] = last_error = np.where(moved, draws[i], last_error)
            approach[i] = last_approach = np.where(sign[i] != 0.0, sign[i], last_approach)
        self._error = np.concatenate([self._error, error])
        self._approach = np.concatenate([self._approach, approach])
        self._angle = np.concatenate([self._angle, turns])
        self._known = count

    def state(self, time_ns: np.ndarray) -> State:
        """The machine at ``time_ns`` (n,)."""
        self._catch_up()
        time_ns = np.asarray(time_ns, np.int64)
        arrival, commanded, actual, share = self.history.locate(
            time_ns, self.cell.motion.settling)
        share = share[:, None]
        error = self._error[arrival] * (1.0 - share) + self._error[arrival + 1] * share
        angle = self._angle[arrival] * (1.0 - share) + self._angle[arrival + 1] * share
        return State(time_ns, (time_ns - self.epoch_ns) * 1e-9, arrival, commanded,
                     actual + error, self._approach[arrival + 1], angle)

    def pose(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Mirror's reference point (n, 3) [m] and attitude (n, 3, 3)."""
        machine = self.cell.description.machine
        motions = [self.cell.geometry.motions(axis, state.position[:, axis]) for axis in range(3)]
        point, attitude = compose(machine.chain, np.array([shift for shift, _ in motions]),
                                  np.array([turn for _, turn in motions]), machine.tool)
        return point, rotation(state.angle) @ attitude

    def read(self, time_ns: np.ndarray, setup: str) -> Reading:
        """What the base unit of ``setup`` reports at ``time_ns`` (n,)."""
        cell = self.cell
        state = self.state(time_ns)
        length, spot = sight(cell.description.machine, cell.description.setups[setup],
                             cell.misalignments[setup], *self.pose(state))
        index = self.index(state.seconds)
        if cell.air.compensated:
            divided = index
        else:
            divided = np.ones_like(index)
            length = length * index[:, None]
        walk = np.linalg.norm(spot, axis=1)
        quality = 96.0 * np.exp(-(walk / WALK_LIMIT) ** 2)
        intensity = np.full(len(spot), cell.instruments.detector.sum_voltage)
        return Reading(length, spot + np.array(cell.psd_zero[setup]), quality, intensity, divided)

    def index(self, seconds: np.ndarray) -> np.ndarray:
        """Index of air (n,) after ``seconds`` (n,)."""
        return index_at(self.cell.air, seconds)

    def displacement_noise(self, first: int, count: int, beams: int) -> np.ndarray:
        """(count, beams) [m]: noise of samples number ``first`` and following."""
        scale = self.cell.description.noise.displacement
        return scale * normals(self.cell.seed, 'displacement', first, count, beams)

    def spot_noise(self, first: int, count: int) -> np.ndarray:
        """(count, 2) [m]: noise of PSD samples number ``first`` and following."""
        return self.cell.description.noise.spot * normals(self.cell.seed, 'spot', first, count, 2)

    def setup_at(self, time_ns: int) -> str | None:
        """The setup that is mounted at a time; ``None`` when there is none."""
        if len(self.history) == 0:
            return None
        number = int(self.history.records['setup'][self.history.segment_at(np.array([time_ns]))[0]])
        return self.cell.setup_names[number] if number >= 0 else None
