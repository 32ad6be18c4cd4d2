"""A cell made to move as a log did: what it would have shown at that log's own times, without noise.

The plan that a cell runs by itself has times of its own.  What follows the clock, creeps after an arrival or depends
on how an axis came to a stop can only be held against a log along the log's own moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.model.cycle import cycle
from stepdiag_ros.model.description import Noise, path_of
from stepdiag_ros.model.log import DWELL, MOVE, CalibrationLog, StepEvents
from stepdiag_ros.virtual.cell import Cell, Motion
from stepdiag_ros.virtual.history import History
from stepdiag_ros.virtual.motion import Profile, point_to_point, settling_time, tabulate
from stepdiag_ros.virtual.offline import COMMAND_DELAY_NS, RESET_NS, move
from stepdiag_ros.virtual.world import World

LEAST_MOVE_NS = 50_000_000
"""A move that a log gives less time than this was not timed."""
AT_ONCE = (1e3, 1e6, 1e9)
"""Limits [m/s, m/s², m/s³] of a move that was not timed."""
SAME_S = 1e-3
"""Moves that took as long as the cell's, within this, are the cell's."""


class Replay:
    """``cell`` along the moves of ``steps``.

    ``began_ns``: when drifts began, see :func:`began`.  ``came``: whether the axes came to the first stop of a setup
    straight from the last one before, which no log tells; else as if they had been lifted there.
    """

    def __init__(self, cell: Cell, steps: StepEvents, began_ns: int, came: bool = True):
        self._cell = replace(cell, description=replace(cell.description, noise=Noise(0.0, 0.0, 0.0, 0.0)))
        stops = _stops(steps)
        self.began_ns = began_ns
        self._history = _history(cell, steps, stops, began_ns, came)
        # A run is reset where its first dwell begins.
        self._reset_ns = {stop.run: stop.dwell for stop in reversed(stops)}
        self._setup_of = {stop.run: _number(cell, steps.setup_names[stop.setup]) for stop in stops}

    def world(self, effects: Sequence[Effect] | None = None) -> World:
        """The cell with its own effects, or with ``effects`` instead."""
        return World(self._cell, self._history, self.began_ns, effects)

    def seen(self, world: World, time_ns: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (n, beams) counted from the reset of their run and spots (n, 2) [m] at true times (n,) of runs (n,),
        numbers in the log's ``run_ids``."""
        runs, mine = np.unique(run, return_inverse=True)
        resets = np.array([self._reset_ns[r] for r in runs])
        length, spot = self.read(world, np.concatenate([resets, time_ns]), np.concatenate([runs, run]))
        return length[len(runs):] - length[:len(runs)][mine], spot[len(runs):]

    def read(self, world: World, time_ns: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`seen`, lengths not counted from any reset."""
        names, beams = self._cell.setup_names, max(len(s.beams) for s in self._cell.description.setups.values())
        length, spot = np.full((len(time_ns), beams), np.nan), np.full((len(time_ns), 2), np.nan)
        setup = np.array([self._setup_of[r] for r in np.unique(run)])[np.unique(run, return_inverse=True)[1]]
        for number in np.unique(setup):
            mine = np.flatnonzero(setup == number)
            reading = world.read(time_ns[mine], names[number])
            length[mine, :reading.length.shape[1]], spot[mine] = reading.length, reading.spot
        return length, spot


def _number(cell: Cell, name: str) -> int:
    """Number of the cell's setup that a log's is, done once more or not."""
    return cell.setup_names.index(name if name in cell.setup_names else path_of(name))


def began(cell: Cell, log: CalibrationLog) -> int:
    """When drifts began [ns] if ``log`` is the first: with the environment's record, or as long before the first move
    as the cell takes for a mounting."""
    first = int(log.steps.time_ns[0])
    records = [int(series.time_ns[0]) for series in log.environment.values() if len(series.time_ns)]
    if records and min(records) <= first:
        return min(records)
    return first - round(cell.motion.mount * 1e9) - COMMAND_DELAY_NS


@dataclass(frozen=True)
class _Stop:
    """Times [ns] of the move to a stop and of its dwell, where it was commanded to, numbers of its setup and run, its
    index and the direction of its traverse."""

    moved: int
    dwell: int
    done: int
    target: np.ndarray
    setup: int
    run: int
    index: int
    direction: int


def _stops(steps: StepEvents) -> list[_Stop]:
    """The stops in order of time; a dwell whose end was not seen ends at once."""
    stops: list[_Stop] = []
    moved: int | None = None
    for k, now in enumerate(steps.time_ns.tolist()):
        if steps.phase[k] == MOVE:
            moved = now
        elif steps.phase[k] == DWELL:
            stops.append(_Stop(now if moved is None else moved, now, now, steps.commanded[k], int(steps.setup[k]),
                               int(steps.run[k]), int(steps.index[k]), int(steps.direction[k])))
            moved = None
        elif stops:
            stops[-1] = replace(stops[-1], done=now)
    return stops


def _history(cell: Cell, steps: StepEvents, stops: list[_Stop], began_ns: int,
             came: bool) -> History:
    """The moves, power-up and mountings among them, as the cell's own plan has them."""
    history, place, rest = History(), np.zeros(3), point_to_point(0.0, 1.0, 1.0, 1.0)
    history.append(began_ns, place, place, rest, -1)
    mounted = last = None
    free = began_ns
    beyond = {(number, visit.index, visit.direction): visit.beyond for number, name in enumerate(cell.setup_names)
              for part in cycle(cell.description, name) for visit in part.visits if visit.beyond is not None}
    for stop in stops:
        number = _number(cell, steps.setup_names[stop.setup])
        known = came or stop.setup == mounted
        if stop.setup != mounted:
            history.append(min(free + COMMAND_DELAY_NS, stop.moved), place, place, rest, number)
        origin, moved = place if known else stop.target, stop.moved
        passed = beyond.get((number, stop.index, stop.direction))
        if passed is not None:
            # No log tells when it was passed: at once, as early as it could.
            fast = point_to_point(float(np.linalg.norm(passed - origin)), *AT_ONCE)
            history.append(min(free + COMMAND_DELAY_NS, moved), origin, passed, fast, number)
            origin, free = passed, min(free + COMMAND_DELAY_NS, moved) + round(fast.total_time * 1e9)
            moved = max(moved, free)
        distance = float(np.linalg.norm(stop.target - origin))
        took = stop.dwell - moved
        if took >= LEAST_MOVE_NS:
            profile = _profile(cell.motion, distance, (took - (RESET_NS if stop.run != last else 0)) * 1e-9)
        else:
            # Where a log says nothing of a move, or that it took no time, it came at once, as early as it could.
            moved, profile = min(free + 2 * COMMAND_DELAY_NS, stop.dwell), point_to_point(distance, *AT_ONCE)
        history.append(moved, origin, stop.target, profile, number)
        mounted, last, place, free = stop.setup, stop.run, stop.target, stop.done
    return history


def _profile(motion: Motion, distance: float, took: float) -> Profile:
    """The cell's move over ``distance`` [m], stretched in time where the log's took longer or shorter [s]."""
    profile, settled = move(motion, distance)
    if distance <= 0.0 or abs(took - settled) < SAME_S:
        return profile
    stretched = profile
    for _ in range(3):    # how long the servo creeps in depends on how hard it was braked
        table = tabulate(stretched.duration[None], stretched.jerk[None], np.zeros(1), np.zeros(1))
        creeping = float(settling_time(table, motion.settling, motion.in_position)[0]) - stretched.total_time
        slower = max(took - creeping, SAME_S) / profile.total_time
        stretched = Profile(profile.duration * slower, profile.jerk / slower**3)
    return stretched
