"""A log held against a cell: what that simulator knows already is taken off before the diagnosis."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog, Samples

CLOSE_M = 1e-6


def without_known(log: CalibrationLog, cell_path: Path) -> tuple[CalibrationLog, tuple[str, ...]]:
    """The log less what the cell's own effects do at each stop, and notes on what was done.

    Raises :class:`~stepdiag_ros.errors.StepdiagError` where the cell is another machine or plan than the log's.
    """
    from stepdiag_ros.virtual.cell import load_cell

    cell = load_cell(cell_path)
    _same(log, cell.description, cell_path)
    notes = [f'held against {cell_path}']
    if cell.effects:
        log = _less_effects(log, cell)
        notes.append(f'known to the simulator and taken off first: {", ".join(cell.effects)}; at the stops\' '
                     'means, so that their course inside a stop may still show')
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


def _less_effects(log: CalibrationLog, cell) -> CalibrationLog:
    """Samples less the difference that the cell's effects make, stop by stop, without noise."""
    from stepdiag_ros.estimate.reduce import reduce_log
    from stepdiag_ros.model.description import Noise
    from stepdiag_ros.virtual.offline import simulate_log

    quiet = replace(cell, description=replace(cell.description, noise=Noise(0.0, 0.0, 0.0, 0.0)))
    setups = tuple(dict.fromkeys(reduce_log(log).setup_names))
    known = reduce_log(simulate_log(quiet, setups=setups, in_motion=False))
    bare = reduce_log(simulate_log(quiet, setups=setups, in_motion=False, effects=[]))
    place = {_key(known, i): i for i in range(len(known))}
    seen = reduce_log(log)
    displacement, spot = log.displacement.values.copy(), log.spot.values.copy()
    for i in range(len(seen)):
        k = place.get(_key(seen, i))
        if k is None:
            raise StepdiagError(f'{log.source}: run {seen.run_ids[seen.run[i]]} stop {seen.index[i]} is not in the '
                                "cell's plan; its effects cannot be taken off, remove them from the cell file")
        lo, hi = seen.displacement_rows[i]
        displacement[lo:hi] -= known.displacement[k] - bare.displacement[k]
        lo, hi = seen.spot_rows[i]
        spot[lo:hi] -= known.spot[k] - bare.spot[k]
    return replace(log, displacement=_with(log.displacement, displacement), spot=_with(log.spot, spot))


def _key(table, i: int) -> tuple:
    return (table.setup_names[table.setup[i]], int(table.repeat[i]), int(table.direction[i]), int(table.index[i]))


def _with(samples: Samples, values: np.ndarray) -> Samples:
    return replace(samples, values=values)
