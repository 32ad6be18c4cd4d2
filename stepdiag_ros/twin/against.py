"""A log held against a cell: what that simulator knows already is taken off before the diagnosis."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import DWELL, CalibrationLog, Samples, StepEvents
from stepdiag_ros.twin.story import starts_in
from stepdiag_ros.virtual.acting import create_effects
from stepdiag_ros.virtual.cell import Cell, load_cell
from stepdiag_ros.virtual.replay import Replay, began

CLOSE_M = 1e-6
SAME_M = 1e-10
"""Less than this makes no difference to a stop."""


def without_known(log: CalibrationLog, cell_path: Path,
                  first: CalibrationLog | None = None) -> tuple[CalibrationLog, tuple[str, ...]]:
    """The log less what the cell's own effects do to every sample, and notes on what was done.

    ``first``: the log that this one goes on, with which the drifts began.
    Raises :class:`~stepdiag_ros.errors.StepdiagError` where the cell is another machine or plan than the log's.
    """
    cell = load_cell(cell_path)
    _same(log, cell.description, cell_path)
    notes = [f'held against {cell_path}']
    if cell.effects:
        log, starts = _less_effects(log, cell, began(cell, first or log))
        notes.append(
            f'known to the simulator and taken off first: {", ".join(cell.effects)}'
            + (', and how the axes came to the first stop of each setup, which no log tells' if starts else '')
            + ''.join(f'; {effect.name} has a phase that no cell knows, so it may still show'
                      for effect in create_effects(cell) if effect.by_chance))
    return log, tuple(notes)


def _same(log: CalibrationLog, cell: Description, path: Path) -> None:
    given = log.description
    pairs = [('machine.chain', given.machine.chain, cell.machine.chain),
             ('machine.volume', given.machine.volume, cell.machine.volume),
             ('machine.tool', given.machine.tool, cell.machine.tool),
             ('plan.steps', given.plan.steps, cell.plan.steps),
             ('plan.order', given.plan.order, cell.plan.order)]
    for name in dict.fromkeys(log.steps.setup_names):
        if name not in cell.setups:
            raise StepdiagError(f'{path}: has no setup {name}, which {log.source} was measured in; '
                                'give the cell file that belongs to the log')
        if name in given.setups:
            ours, theirs = given.setups[name], cell.setups[name]
            pairs += [(f'setups.{name}.standoff', ours.standoff, theirs.standoff),
                      (f'setups.{name}.psd_offset', ours.psd_offset, theirs.psd_offset)]
    for key, ours, theirs in pairs:
        same = ours == theirs if isinstance(ours, str | int) else \
            np.allclose(ours, theirs, rtol=0.0, atol=CLOSE_M)
        if not same:
            raise StepdiagError(f'{path}: {key} is {theirs}, the log {log.source} says {ours}; '
                                'give the cell file that belongs to the log')


def _less_effects(log: CalibrationLog, cell: Cell, began_ns: int) -> tuple[CalibrationLog, bool]:
    """Samples less the difference that the cell's effects make at each, their stamps put right; and whether what they
    do depends on how the axes came to the first stops, which then is taken off as the readings say."""
    replay = Replay(cell, log.steps, began_ns)
    acting, bare = replay.world(), replay.world([])
    lifted = Replay(cell, log.steps, began_ns, came=False).world()

    def less(samples: Samples, sensor: str, part: int) -> Samples:
        true = samples.time_ns - round(acting.clock_offset(sensor) * 1e9)
        run = _run_at(log.steps, true)
        inside = run >= 0
        with_it, without = (replay.seen(world, true[inside], run[inside])[part] for world in (acting, bare))
        values = samples.values.copy()
        values[inside] -= (with_it - without)[:, :values.shape[1]]
        return replace(samples, time_ns=true, values=values)

    less_log = replace(log, displacement=less(log.displacement, 'interferometer', 0), spot=less(log.spot, 'psd', 1))
    dwell = log.steps.phase == DWELL
    seen = [replay.seen(world, log.steps.time_ns[dwell], log.steps.run[dwell])[0] for world in (acting, lifted)]
    reach = float(np.nanmax(np.abs(seen[0] - seen[1])))
    return (less_log, False) if reach < SAME_M else _less_starts(less_log, reach)


def _less_starts(log: CalibrationLog, reach: float) -> tuple[CalibrationLog, bool]:
    """Samples less what the readings say of how the axes came to the first stops, and whether they do."""
    observation = observe(log)
    table, shift = observation.table, starts_in(observation, reach)
    if shift is None:
        return log, False

    def less(samples: Samples, part: np.ndarray) -> Samples:
        stop = np.searchsorted(table.dwell_ns, samples.time_ns, side='right') - 1
        return replace(samples, values=samples.values - np.where(stop[:, None] < 0, 0.0, part[np.maximum(stop, 0)]))

    return replace(log, displacement=less(log.displacement, shift[:, :-2]), spot=less(log.spot, shift[:, -2:])), True


def _run_at(steps: StepEvents, time_ns: np.ndarray) -> np.ndarray:
    """The run (n,) that a sample belongs to: the last whose first dwell had begun; −1 before any."""
    dwells = steps.phase == DWELL
    first = np.concatenate([[True], np.diff(steps.run[dwells]) != 0])
    begin, run = steps.time_ns[dwells][first], steps.run[dwells][first]
    place = np.searchsorted(begin, time_ns, side='right') - 1
    return np.where(place < 0, -1, run[np.maximum(place, 0)])
