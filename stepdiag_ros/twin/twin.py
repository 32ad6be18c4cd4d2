"""A cell that moves as a diagnosed log did, to be held against it."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.twin.story import unknown_starts
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.replay import Replay, began
from stepdiag_ros.virtual.world import World

NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Where in a bin readings are taken for its mean: what dies away inside it is no straight line."""


class Twin:
    """A cell without effects that moves as a diagnosed log did."""

    def __init__(self, diagnosis: Diagnosis, cell: Cell):
        self._diagnosis = diagnosis
        steps, table = diagnosis.log.steps, diagnosis.joint.observation.table
        self._replay = Replay(cell, steps, began(cell, diagnosis.log))
        middle = diagnosis.joint.observation.view.bin_time
        width = np.mean(np.diff(middle, axis=1), axis=1) if middle.shape[1] > 1 else 2.0 * middle[:, 0]
        time = middle[:, :, None] + 0.5 * width[:, None, None] * NODES
        self._shape = time.shape
        self._time = (table.dwell_ns[:, None, None] + np.rint(1e9 * time).astype(np.int64)).ravel()
        run = np.array([steps.run_ids.index(name) for name in table.run_ids])[table.run]
        self._run = np.repeat(run, time[0].size)

    @cached_property
    def bare(self) -> np.ndarray:
        """Readings (n, b, c) [m] without any effect, lengths counted from their runs' resets."""
        return self._seen(self._replay.world([]))

    def adds(self, effect: Effect) -> np.ndarray:
        """What an effect adds to the readings (n, b, c) [m] in the bins of the dwells."""
        return self._seen(self._replay.world([effect])) - self.bare

    def left(self, effects: Sequence[Effect]) -> tuple[np.ndarray, float]:
        """The log's stops less the cell's with ``effects`` (n, c) [m], and their reduced χ² in the log's noise.

        Free are the reset of each run, as for the laser, and how the axes came to the first stops.
        """
        joint = self._diagnosis.joint
        space, view = joint.parity, joint.observation.view
        difference = view.reading - self._seen(self._replay.world(effects)).mean(axis=1)
        resets = view.zeros(len(view.run_ids))
        for run in range(len(view.run_ids)):
            resets[run, view.run == run, :view.beams] = 1.0
        free = np.concatenate([resets, unknown_starts(view)])
        z, columns = joint.whitened(difference.ravel()), joint.whitened(free.reshape(len(free), -1).T)
        sizes, _, rank, _ = np.linalg.lstsq(columns, z, rcond=1e-9)
        white_left = z - columns @ sizes
        # The machine was fitted to the same stops.
        unknown = int(rank) - len(resets)
        return (difference - np.tensordot(sizes, free, axes=1),
                float(white_left @ white_left / (space.dof[0] - unknown)))

    def _seen(self, world: World) -> np.ndarray:
        length, spot = self._replay.seen(world, self._time, self._run)
        beams = self._diagnosis.joint.fit.model.beams
        readings = np.concatenate([length[:, :beams], spot], axis=1).reshape(*self._shape, -1)
        return 0.5 * np.einsum('nbkc,k->nbc', readings, WEIGHTS)

    def projected(self, readings: np.ndarray) -> np.ndarray:
        """Readings (n, b, c) in parity space (N,)."""
        mean = readings.mean(axis=1)
        form = Form('', mean[None], ('',), np.ones(1), inside=(readings - mean[:, None])[None])
        return self._diagnosis.joint.parity.project(form)[:, 0]
