"""Every method by name: what it needs of a log, where it comes from, and how to run it.

``stepdiag evaluate --method NAME`` and ``stepdiag compare`` go through this table.  What a log does not hold
(step diagonals, faces, parallel lines, stations) is said in words, so that a reader sees what exists.  Setups are
found by their ways, whatever they are called.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import (
    body_diagonal,
    enhanced_dahlem,
    face_diagonal,
    iso230_2,
    linear_lines,
    new_formulation,
    of_ways,
    squareness_diagonals,
    step_diagonal,
)
from stepdiag_ros.estimate.cautions import cautions
from stepdiag_ros.estimate.evaluate import evaluate as evaluate_enhanced
from stepdiag_ros.estimate.evaluate import evaluate_in_full
from stepdiag_ros.estimate.method_budget import Readings, with_cell_budget
from stepdiag_ros.estimate.readings import CellReadings, SetupReadings
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.stepwise import travel_signs
from stepdiag_ros.model.description import DIAGONALS
from stepdiag_ros.model.log import CalibrationLog


@dataclass(frozen=True)
class Method:
    """One method.  ``run(log, cell)`` gives a Solution or a result with ``to_json_dict()``.

    ``lacks(cell)`` says in words what a log is missing, or None where the method can run.
    """

    name: str
    title: str
    source: str
    needs: str
    lacks: Callable[[CellReadings], str | None]
    run: Callable[[CalibrationLog, CellReadings], Any]


# ---- what a log must hold ---------------------------------------------------------------------

def _diagonals(needed: int, words: str = "body step diagonals in the plan's steps", straight: bool = False
               ) -> Callable[[CellReadings], str | None]:
    def lacks(cell: CellReadings) -> str | None:
        have = [n for n in DIAGONALS if n in of_ways.short_names(cell, straight)]
        return None if len(have) >= needed else f'{needed} {words} (has {len(have)})'
    return lacks


def _tilts(cell: CellReadings) -> str | None:
    for short, name in of_ways.short_names(cell).items():
        setup = cell.setups[name]
        if short in DIAGONALS and setup.spot_m is None and len(setup.sight.beams) < 3:
            return f'psd/spot or three beams in setup {name}'
    return None


def _linear(cell: CellReadings) -> str | None:
    found = of_ways.short_names(cell)
    missing = [f'lin_{a}' for a in 'xyz' if f'lin_{a}' not in found]
    return f'linear setups {", ".join(missing)}' if missing else None


def _needs(text: str, found: Callable[[CellReadings], Any]) -> Callable[[CellReadings], str | None]:
    return lambda cell: None if found(cell) else text


def _short_diagonal(cell: CellReadings) -> str | None:
    return None if any(name in cell.setups for name in DIAGONALS) else f'one of the setups {", ".join(DIAGONALS)}'


def _both_ways(cell: CellReadings) -> str | None:
    if _bidirectional_lines(cell):
        return None
    return 'a linear setup run forward and backward'


def _all(*conditions: Callable[[CellReadings], str | None]) -> Callable[[CellReadings], str | None]:
    def lacks(cell: CellReadings) -> str | None:
        return next((text for condition in conditions if (text := condition(cell))), None)
    return lacks


# ---- adapters ---------------------------------------------------------------------------------

def corner_deviations(setup: SetupReadings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At a diagonal's complete steps: position along it (k,), forward and backward deviations (r, k)."""
    sight = setup.sight
    along = (sight.positions - sight.positions[0]) @ sight.direction
    beside = sight.positions - sight.positions[0] - along[:, None] * sight.direction
    corners = np.linalg.norm(beside, axis=1) < 1e-9 + 1e-9 * along[-1]
    forward, backward = ((runs.reshape(-1, len(along)) - along)[:, corners]
                         for runs in (setup.forward_m, setup.backward_m))
    return along[corners], forward, backward


def body_diagonal_test(cell: CellReadings) -> body_diagonal.DiagonalTest:
    """ISO 230-6 from the stops of a step diagonal that lie on the diagonal."""
    runs = {}
    for name in cell.diagonals('body_diagonal', 1):
        along, forward, backward = corner_deviations(cell.setups[name])
        if not len(forward):
            raise StepdiagError(f'body_diagonal: setup {name} has no complete forward run')
        runs[name] = (along, forward, backward if len(backward) else None)
    return body_diagonal.evaluate_runs(runs)


def diagonal_displacement(cell: CellReadings, method: str, kinds: tuple[str, ...]) -> body_diagonal.DiagonalTest:
    """E and B of the diagonals with ways of their own of these kinds, after ISO 230-6."""
    found, travel, cycles = {}, {}, {}
    for name in of_ways.of_kind(cell, *kinds):
        along, forward, backward = corner_deviations(cell.setups[name])
        if len(forward):
            found[name] = body_diagonal.diagonal(along, forward, backward if len(backward) else None)
            cycles[name] = body_diagonal.cycles_of(forward, backward)
            travel[name] = cell.setups[name].sight.positions[-1] - cell.setups[name].sight.positions[0]
    if not found:
        raise StepdiagError(f'{method}: no {" or ".join(kinds)} has a complete forward run')
    return body_diagonal.DiagonalTest(found, method, travel_m=travel, cycles=cycles)


def _diagonal_entry(name: str, space: str) -> Method:
    kinds = f'{space} diagonal', f'{space} step diagonal'
    return Method(name, f'{space.capitalize()} diagonal displacement along ways of their own',
                  'ISO 230-6 / ASME B5.54-2005', f'one {space} diagonal with from and to',
                  _needs(f'a {space} diagonal with a way of its own (from, to)',
                         lambda cell: of_ways.of_kind(cell, *kinds)),
                  lambda log, cell: diagonal_displacement(cell, name, kinds))


def _face_entry(plane: str) -> Method:
    def lacks(cell: CellReadings) -> str | None:
        missing = {f'{plane}_p', f'{plane}_n'} - set(of_ways.faces(cell).setups)
        return f'both step diagonals of the face {plane} at the origin (from, to, moves), in the plan\'s steps' \
            if missing else None
    return Method(f'face_diagonal_{plane}', f'Step diagonals of the face {plane}', 'Wang & Liotto 2003, eqs. 19-22',
                  'two stepped face diagonals', lacks,
                  lambda log, cell: face_diagonal.evaluate(of_ways.faces(cell), plane))


def _short_named(evaluate: Callable[[CellReadings], Solution]) -> Callable[[CalibrationLog, CellReadings], Solution]:
    """A method of body step diagonals and lines, which finds them whatever the log calls them."""
    def run(log: CalibrationLog, cell: CellReadings) -> Solution:
        found = of_ways.short_names(cell)
        own = evaluate(of_ways.by_short_names(cell))
        return replace(own, misalignments={found.get(name, name): value for name, value in own.misalignments.items()})
    return run


def squareness_test(cell: CellReadings) -> Solution:
    """Squareness from the total lengths of the four diagonals of a log, stepped or in one motion."""
    cell = of_ways.by_short_names(cell, straight=True)
    names = cell.diagonals('squareness_diagonals', 4)
    setups = {n: cell.setups[n] for n in names}
    return squareness_diagonals.body_squareness(
        cell.machine, {n: s.displacement_m[-1, 0] for n, s in setups.items()},
        {n: float(np.sqrt(2.0) * s.displacement_sigma_m[-1]) for n, s in setups.items()})


def _bidirectional_lines(cell: CellReadings) -> list[str]:
    return [n for n in (*(n for n in ('lin_x', 'lin_y', 'lin_z') if n in cell.setups), *of_ways.of_kind(cell, 'line'))
            if len(cell.setups[n].forward_m) and len(cell.setups[n].backward_m)]


def linear_test(cell: CellReadings) -> iso230_2.LinearTest:
    """ISO 230-2 of each linear setup that was run in both directions."""
    axes = {}
    for name in _bidirectional_lines(cell):
        setup = cell.setups[name]
        axis = int(np.argmax(np.abs(travel_signs(setup.sight))))
        target = setup.sight.positions[:, axis]
        travel = (target - target[0]) * travel_signs(setup.sight)[axis]
        runs = min(len(setup.forward_m), len(setup.backward_m))
        axes[name] = replace(iso230_2.evaluate(target, setup.forward_m[:runs] - travel,
                                               setup.backward_m[:runs] - travel, setup.zeroed), letter='XYZ'[axis])
    return iso230_2.LinearTest(axes)


def _entries() -> tuple[Method, ...]:
    return (
        Method('enhanced', 'Enhanced step diagonal, full model', 'Dahlem et al. 2018, extended',
               'distances; tilts for the angles; linear setups for the slopes',
               lambda cell: None, lambda log, cell: evaluate_enhanced(log)),
        Method('enhanced_dahlem', 'Enhanced step diagonal, closed form',
               'Dahlem et al. 2018, eqs. 1-6',
               'three body diagonals with PSD or three beams; linear setups for the slopes',
               _all(_diagonals(3), _tilts), _short_named(enhanced_dahlem.evaluate)),
        Method('step_diagonal', 'Sequential step diagonal (vector method)',
               'Wang & Liotto 2003, eqs. 5-16', 'three body diagonals', _diagonals(3),
               _short_named(step_diagonal.evaluate)),
        Method('step_diagonal_no_slopes', 'Vector method, slopes ascribed to the mirror',
               'practice described by Renishaw 2016', 'three body diagonals', _diagonals(3),
               _short_named(partial(step_diagonal.evaluate, slopes='removed'))),
        Method('new_formulation', 'New formulation of the step diagonal',
               'Ibaraki et al. 2006, in space', 'four body diagonals and three linear setups',
               _all(_diagonals(4), _linear), _short_named(new_formulation.evaluate)),
        Method('squareness_diagonals', 'Squareness from body diagonals', 'Renishaw 2016',
               'four body diagonals', _diagonals(4, 'whole body diagonals', straight=True),
               lambda log, cell: squareness_test(cell)),
        Method('body_diagonal', 'Body diagonal displacement', 'ISO 230-6 / ASME B5.54-2005',
               'one body diagonal', _short_diagonal, lambda log, cell: body_diagonal_test(cell)),
        Method('iso230_2', 'Linear displacement', 'ISO 230-2', 'a linear setup run both ways',
               _both_ways, lambda log, cell: linear_test(cell)),
        _diagonal_entry('body_displacement', 'body'), _diagonal_entry('face_displacement', 'face'),
        *(_face_entry(plane) for plane in face_diagonal.PLANES),
        Method('three_face', 'Three-face step diagonal', 'Bui et al. 2012',
               'stepped diagonals of three faces from one corner, and the lines between', of_ways.three_faces_lack,
               lambda log, cell: of_ways.three_faces(cell)),
        Method('linear_lines', 'Three lines with Abbe offsets', 'Wang & Liotto 2003, eqs. 23-25',
               'three parallel lines an axis',
               _needs('three parallel lines of an axis whose offsets are not in one line', of_ways.parallel),
               lambda log, cell: linear_lines.evaluate(of_ways.parallel(cell))),
        Method('multilateration', 'Multilateration', 'Ibaraki & Hiruya 2020, eq. 1',
               'distances from three (plane) or four (space) stations', of_ways.stations_lack,
               lambda log, cell: of_ways.multilaterated(cell)),
        Method('regulated_beam', 'Rectangular path, beam regulated',
               'Ibaraki & Hiruya 2020, eqs. 4-8', 'two linear runs and a tracking test', of_ways.rectangle_lacks,
               lambda log, cell: of_ways.regulated(cell)),
    )


CAUTIONED = ('step_diagonal', 'step_diagonal_no_slopes', 'new_formulation', 'squareness_diagonals', 'body_diagonal',
             'body_displacement', 'face_displacement', *(f'face_diagonal_{plane}' for plane in face_diagonal.PLANES))
"""Methods whose answers may need the cautions of a log (:mod:`stepdiag_ros.estimate.cautions`)."""
METHODS: dict[str, Method] = {method.name: method for method in _entries()}


def run_method(name: str, log: CalibrationLog) -> Any:
    """One method on one log; :class:`StepdiagError` says what is unknown or missing."""
    if name not in METHODS:
        raise StepdiagError(f'--method {name}: not known; choose from {", ".join(METHODS)}')
    method = METHODS[name]
    evaluation = evaluate_in_full(log)
    if name == 'enhanced':
        return evaluation.solution
    readings = Readings.of(evaluation)
    cell = readings.measured
    missing = method.lacks(cell)
    if missing:
        raise StepdiagError(f'{log.source}: method {name} needs {missing}{cell.why()}')
    result = with_cell_budget(partial(method.run, log), readings)
    warned = cautions(cell, evaluation.solution) if name in CAUTIONED else ()
    if isinstance(result, Solution):
        return replace(result, warnings=(*result.warnings, *warned))
    return replace(result, cautions=(*result.cautions, *warned)) if warned else result


def run_all(log: CalibrationLog, readings: Readings | None = None) -> tuple[dict[str, Any], dict[str, str]]:
    """Every method that fits the log: results by name, and for the others why not; ``readings``: the log's, where they
    are known already."""
    readings = readings or Readings.of(evaluate_in_full(log))
    evaluation, cell = readings.evaluation, readings.measured
    results, skipped = {}, {}
    for name, method in METHODS.items():
        missing = method.lacks(cell)
        if missing:
            skipped[name] = f'needs {missing}{cell.why()}'
            continue
        try:
            results[name] = evaluation.solution if name == 'enhanced' else \
                with_cell_budget(partial(method.run, log), readings)
        except StepdiagError as error:
            skipped[name] = str(error)
    return results, skipped
