"""A cell that moves as a diagnosed log did, to be held against it."""

from collections.abc import Sequence
from copy import copy
from functools import cached_property

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.course import Course
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.twin.story import unknown_starts
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.replay import Replay, began
from stepdiag_ros.virtual.world import World

NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Where in a bin readings are taken for its mean: what dies away inside it is no straight line."""


class Twin:
    """A cell without effects of its own that moves as a diagnosed log did."""

    def __init__(self, diagnosis: Diagnosis, cell: Cell):
        self._diagnosis = diagnosis
        self._before: list[Effect] = []
        self._behind: list[Effect] = []
        steps, table = diagnosis.log.steps, diagnosis.joint.observation.table
        self._replay = Replay(cell, steps, began(cell, diagnosis.log))
        middle = diagnosis.joint.observation.view.bin_time
        width = np.mean(np.diff(middle, axis=1), axis=1) if middle.shape[1] > 1 else 2.0 * middle[:, 0]
        # A bin of which samples are missing has its middle elsewhere and may reach beyond its dwell, into a move.
        stood = np.where(table.done_ns > table.dwell_ns, (table.done_ns - table.dwell_ns) * 1e-9, np.inf)
        time = np.clip(middle[:, :, None] + 0.5 * width[:, None, None] * NODES, 0.0, stood[:, None, None])
        self._shape = time.shape
        self._time = (table.dwell_ns[:, None, None] + np.rint(1e9 * time).astype(np.int64)).ravel()
        self.seconds = self.since_began(self._time)
        run = np.array([steps.run_ids.index(name) for name in table.run_ids])[table.run]
        self._run = np.repeat(run, time[0].size)

    def since_began(self, time_ns: np.ndarray) -> np.ndarray:
        """Seconds (n,) from the log's beginning to times (n,) [ns]."""
        return (time_ns - self._replay.began_ns) * 1e-9

    def beside(self, before: Sequence[Effect], behind: Sequence[Effect]) -> 'Twin':
        """The same cell in which some effects act, ``before`` another one and ``behind`` it."""
        other = copy(self)
        other.__dict__.pop('bare', None)
        other._before, other._behind = list(before), list(behind)
        return other

    @cached_property
    def bare(self) -> np.ndarray:
        """Readings (n, b, c) [m] with the effects beside which it is alone, lengths counted from their runs' resets."""
        return self._seen(self._with([]))

    def adds(self, *effects: Effect) -> np.ndarray:
        """What effects add to the readings (n, b, c) [m] in the bins of the dwells."""
        return self._seen(self._with(effects)) - self.bare

    def _with(self, effects: Sequence[Effect]) -> World:
        return self._replay.world([*self._before, *effects, *self._behind])

    def left(self, effects: Sequence[Effect]) -> tuple[np.ndarray, float]:
        """The log's stops less the cell's with ``effects`` (n, c) [m], and their reduced χ² in the log's noise.

        Free are the reset of each beam in each run, as for the laser, and how the axes came to the first stops.
        """
        joint = self._diagnosis.joint
        space, view = joint.parity, joint.observation.view
        difference = view.reading - self._seen(self._replay.world(effects)).mean(axis=1)
        resets = view.zeros(len(view.run_ids) * view.beams)
        for number, one in enumerate(resets):
            run, beam = divmod(number, view.beams)
            one[view.run == run, beam] = 1.0
        free = np.concatenate([resets, unknown_starts(view)])
        z, columns = joint.whitened(difference.ravel()), joint.whitened(free.reshape(len(free), -1).T)
        sizes, _, rank, _ = np.linalg.lstsq(columns, z, rcond=1e-9)
        white_left = z - columns @ sizes
        # The machine was fitted to the same stops.
        unknown = int(rank) - len(resets)
        return (difference - np.tensordot(sizes, free, axes=1),
                float(white_left @ white_left / (space.dof[0] - unknown)))

    def by_amounts(self, effect: Effect, course: Course, sizes: np.ndarray) -> np.ndarray:
        """Derivatives (k, t, c) [m per unit] of the readings at ``seconds`` (t,), not counted from a reset, by each of
        an effect's amounts there, about those of ``course``; by differences of ``sizes`` (k,)."""
        about, *moved = (self._read(self._with([effect.following(c)]), counted=False)
                         for c in (course, *(course.plus(step) for step in np.diag(sizes))))
        return np.array([(one - about) / size for one, size in zip(moved, sizes, strict=True)])

    def _read(self, world: World, counted: bool = True) -> np.ndarray:
        length, spot = (self._replay.seen if counted else self._replay.read)(world, self._time, self._run)
        return np.concatenate([length[:, :self._diagnosis.joint.fit.model.beams], spot], axis=1)

    def _seen(self, world: World) -> np.ndarray:
        return self.in_bins(self._read(world))

    def in_bins(self, readings: np.ndarray) -> np.ndarray:
        """Means (..., n, b, c) in the dwells' bins of readings (..., t, c) at ``seconds``."""
        return 0.5 * np.einsum('...nbkc,k->...nbc', readings.reshape(*readings.shape[:-2], *self._shape, -1), WEIGHTS)

    def projected(self, readings: np.ndarray) -> np.ndarray:
        """Readings (k, n, b, c) in parity space (N, k)."""
        mean = readings.mean(axis=2)
        form = Form('', mean, ('',) * len(mean), np.ones(len(mean)), inside=readings - mean[:, :, None])
        return self._diagnosis.joint.parity.project(form)

    def at_stops(self, stops: np.ndarray) -> np.ndarray:
        """Changes (k, n, c) of the stops in the noise of the readings (n·c, k), the machine's share with them."""
        return self._diagnosis.joint.freed(stops.reshape(len(stops), -1).T)
