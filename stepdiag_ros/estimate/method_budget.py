"""The cell's budget carried through any method of the literature.

A method takes the means of a setup's readings.  What repeats and the mirror's form do to each stop goes along its
own propagation, through the standard deviations of those means; what acts on many stops together (air, detector,
tool, beams) is put onto the readings, one cause after another, and the method run again: its answers move by that
cause's contribution.  So no method needs to know the budget.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from stepdiag_ros.estimate.evaluate import Evaluation, tied
from stepdiag_ros.estimate.planned import filled
from stepdiag_ros.estimate.propagate import STOPWISE, Cause, error_slopes
from stepdiag_ros.estimate.readings import CellReadings, SetupReadings, readings_of_stops
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.budget import MEASURED

IN_RUNS = ('dead_path', 'air_variation')
"""Kinds with variates for every run: the means of a setup over its runs see them together."""
DECLARED = 'no setup was run twice in a direction: the uncertainty rests on the noise that the cell declares'
Run = Callable[[CellReadings], Any]


@dataclass(frozen=True)
class Readings:
    """The readings of an evaluation's setups, and what they would be with each cause of the budget put onto them."""

    evaluation: Evaluation
    measured: CellReadings

    @classmethod
    def of(cls, evaluation: Evaluation) -> 'Readings':
        return cls(evaluation, readings_of_stops(evaluation.setting.description, evaluation.metres.table))

    @cached_property
    def moved(self) -> tuple[CellReadings, ...]:
        """The readings with one variate of one cause at one standard uncertainty, a variate after the other."""
        readings = self.evaluation.setting.readings
        sights = {name: setup.sight for name, setup in self.measured.setups.items()}
        return tuple(readings_of_stops(self.evaluation.setting.description,
                                       filled(self.evaluation.metres.table, readings + column.reshape(readings.shape))
                                       ).along(sights)
                     for cause in self.evaluation.uncertainty.causes for column in _columns(cause, self.evaluation))

    @property
    def declared(self) -> tuple[str, ...]:
        """The warning that all noise is declared, if it is."""
        return (f'{self.evaluation.source}: {DECLARED}',) if all(s.declared for s in self.measured.setups.values()) \
            else ()


def with_cell_budget(run: Run, readings: Readings) -> Any:
    """What ``run`` makes of the readings, with the uncertainty of the whole budget.

    A :class:`Solution` gets covariance, repeatability and traceability; a test with figures of merit gets
    ``sigma_m``, the standard uncertainty [m] of each figure.
    """
    evaluation = readings.evaluation
    own = run(readings.measured)
    stopwise = _with_stopwise(readings.measured, evaluation)
    if not isinstance(own, Solution):
        return _figures(own, stopwise, run, readings)
    covariance = run(stopwise).covariance.copy()
    for cause in evaluation.uncertainty.causes:
        if cause.errors:
            slopes = error_slopes(cause, own)
            covariance += slopes @ slopes.T
    for moved in readings.moved:
        change = run(moved).value - own.value
        covariance += np.outer(change, change)
    full = replace(own, covariance=covariance, repeatability=own.covariance,
                   warnings=(*own.warnings, *readings.declared), closure=evaluation.solution.closure)
    return tied(full, evaluation.source, evaluation.metres, evaluation.lines, evaluation.budget)


def _columns(cause: Cause, evaluation: Evaluation) -> Iterator[np.ndarray]:
    """What a cause does to all readings (n·c,) [m], a variate after the other; of runs, setup by setup."""
    kind = cause.contributor.kind
    if kind in MEASURED or kind in STOPWISE or cause.errors:
        return
    columns = cause.readings.toarray().T
    table = evaluation.metres.table
    if kind not in IN_RUNS:
        yield from (column for column in columns if np.any(column))
        return
    channels = columns.shape[1] // len(table)
    setup_of = np.repeat(table.setup, channels)
    alike = len(columns) // len(np.unique(table.run))
    for part in range(alike):
        together = columns[part::alike]
        for setup in np.unique(table.setup):
            mine = together[:, setup_of == setup]
            runs = np.any(mine, axis=1).sum()
            if runs:
                yield np.where(setup_of == setup, together.sum(axis=0), 0.0) / np.sqrt(runs)


def _with_stopwise(cell: CellReadings, evaluation: Evaluation) -> CellReadings:
    """The readings with what acts on single stops in their standard deviations.

    The scatter of a setup of few stops may be small by chance; what all repeats of the log say counts at least.
    """
    noise = evaluation.setting.noise
    standard = {c.contributor.kind: c.contributor.standard or 0.0 for c in evaluation.uncertainty.causes}
    length = np.hypot(standard.get('cyclic', 0.0), standard.get('mirror_flatness', 0.0))
    slope = standard.get('mirror_slope', 0.0)

    def more(setup: SetupReadings) -> SetupReadings:
        sight, spot = setup.sight, setup.spot_sigma_m
        path = sight.standoff + (sight.positions - sight.positions[0]) @ sight.direction
        runs = np.sqrt(max(len(setup.forward_m) + len(setup.backward_m), 1))
        own = np.maximum(setup.displacement_sigma_m, noise.position / runs)
        return replace(setup, displacement_sigma_m=np.hypot(own, length), spot_sigma_m=None if spot is None else
                       np.hypot(np.maximum(spot, 2.0 * path * noise.angle / runs), 2.0 * path * slope))
    return replace(cell, setups={name: more(setup) for name, setup in cell.setups.items()})


def _figures(own: Any, cell: CellReadings, run: Run, readings: Readings) -> Any:
    """A test's result with the standard uncertainty [m] of each of its figures, and what that rests on."""
    evaluation = readings.evaluation
    figures = own.figures()
    variance = {name: value**2 for name, value in own.repeat_sigma(cell).items()}
    for moved in readings.moved:
        for name, value in run(moved).figures().items():
            variance[name] += (value - figures[name])**2
    for cause in evaluation.uncertainty.causes:
        for name, value in own.slope_sigma(cause.errors, evaluation.setting.description.machine).items():
            variance[name] += value**2
    sigma: Mapping[str, float] = {name: float(np.sqrt(value)) for name, value in variance.items()}
    return replace(own, sigma_m=sigma, traceability=evaluation.solution.traceability, cautions=readings.declared)
