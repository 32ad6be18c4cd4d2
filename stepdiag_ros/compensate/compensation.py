"""From a solution to the tables of a control, with what the machine will be like under exactly these tables.

    compensation(solution, machine, CONTROLS['linuxcnc'], origin=…) → Compensation

Everything reported about the machine under its tables is computed from the files' text, read back as the control
reads it.  Tables are made only of what the log determines (:mod:`open_directions`), for a functional point
(:mod:`functional`), so that no place becomes worse (:mod:`harmless`), on top of what the control holds already.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stepdiag_ros.compensate.approach import NONE, Reversal, sides, sizes, standing_out
from stepdiag_ros.compensate.control import Control, Place
from stepdiag_ros.compensate.fit_to_act import unfit
from stepdiag_ros.compensate.functional import FunctionalPoint, functional_point, tables_of_line
from stepdiag_ros.compensate.harmless import best_of_volume, held_back
from stepdiag_ros.compensate.largest import largest
from stepdiag_ros.compensate.open_directions import openness, unknown, without
from stepdiag_ros.compensate.taken import Taken, Trim, added, as_measured, difference, errors_of, left_of
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.prediction import Prediction, deviation, predict
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, SQUARENESS_SHIFT, Curve, GeometricErrors

K = 2.0
"""Coverage factor of every U."""
ROOM = 0.5
"""Share of a place's U by which tables may let it become worse while they are made; a whole U refuses them."""
LEAST_GAIN = 0.01
"""Share by which the mean square of the deviations must fall, or the tables are not worth a change."""
LEAST_GROWTH_M = 5e-9
"""What rounding in the files may add to the largest deviation."""
MOST_KNOTS = 21
"""Positions an axis at most on which places are judged."""
UNIT = 1e-6
"""Size [m or rad] of an error by which is found what one of its values leaves: products with others do not count."""
BEFORE = 'before/'


@dataclass(frozen=True)
class Compensation:
    """Tables of one control and what they do.

    ``files``: texts by name, ready to write; ``before_files``: what takes them back; both empty where ``refusals``
    says why.  ``change`` is what the control will take off beyond what it takes off now.  ``before`` and ``after`` are
    predictions at the same points of the volume with the same covariance; ``predicted`` the 21 errors that a
    measurement will report afterwards.  ``not_carried``: largest deviation [m] in the volume that each error alone
    keeps under tables of this kind, by name; ``not_carried_spread`` its U (k = 2).

    ``line_alone`` the prediction with the tables of the line as they are, where these had to be held back, else None.
    ``reversal``: lost motion with its U (k = 2) [m] by letter, of the axes where it stands out of it, that the tables
    take off; ``reversal_left``: that this kind of table cannot.
    ``with_open``: ``solution`` with the errors that are left out: of value zero, with their whole uncertainty.
    """

    control: Control
    place: Place
    point: FunctionalPoint
    files: Mapping[str, str]
    before_files: Mapping[str, str]
    change: Taken
    before: Prediction
    after: Prediction
    predicted: GeometricErrors
    solution: Solution
    not_carried: Mapping[str, float]
    not_carried_spread: Mapping[str, float]
    line_alone: Prediction | None
    left_out: tuple[str, ...]
    unmeasured: tuple[str, ...]
    whole_volume: bool
    reversal: Reversal
    reversal_left: Reversal
    with_open: Solution
    refusals: tuple[str, ...] = ()

    @cached_property
    def worst_before(self) -> tuple[float, float, np.ndarray]:
        """Largest deviation, its U (95 %) and its place, all [m]."""
        return self.worst(self.before)

    @cached_property
    def worst_after(self) -> tuple[float, float, np.ndarray]:
        """The same with the tables in force."""
        return self.worst(self.after)

    def worst(self, field: Prediction) -> tuple[float, float, np.ndarray]:
        """The same of any field at these points: from the worst side, with the lost motion that ``before`` has, or that
        is left of it, what is taken off being as uncertain as it was."""
        return largest(self.with_open, self.place.machine, self.point.tool, field,
                       {**self.reversal, **self.reversal_left} if field is self.before else self.reversal_after)

    @property
    def reversal_after(self) -> Reversal:
        """Lost motion with the tables in force."""
        return {axis: (0.0, spread) for axis, (_, spread) in self.reversal.items()} | dict(self.reversal_left)

    def worse_alone(self) -> tuple[float, float]:
        """Share of the places that the tables of the line alone make worse beyond the U of their repeats, and by how
        much at most [m]; zeros where they were not held back."""
        if self.line_alone is None:
            return 0.0, 0.0
        repeated = predict(_repeats(self.solution), self.place.machine, self.before.points, self.point.tool)
        alone = replace(self.line_alone, covariance_m2=repeated.covariance_m2)
        stays = self.reversal_left
        more = sizes(alone.deviation_m, stays) - sizes(repeated.deviation_m, stays)
        return float(np.mean(worsened(repeated, alone, stays, stays) > 0.0)), float(more.max())

    @property
    def as_measured(self) -> Prediction:
        """What a measurement afterwards will show at the same points: the same machine from its own reference lines.

        ``after`` counts from the lines of the measurement before; tables across axes turn those lines.
        """
        shown = deviation(self.predicted, self.place.machine, self.after.points, self.point.tool)
        return Prediction(self.after.points, shown, self.after.covariance_m2)

    def checked(self) -> 'Compensation':
        """This, or :class:`StepdiagError` with every reason why nothing may be written."""
        if self.refusals:
            raise StepdiagError('no tables written: ' + '; '.join(self.refusals))
        return self


def worst(prediction: Prediction) -> tuple[float, float, np.ndarray]:
    """Largest deviation of a prediction, U (k = 2) at its place, and that place, all [m]."""
    row = int(np.argmax(prediction.size_m))
    return float(prediction.size_m[row]), K * float(prediction.size_sigma_m[row]), prediction.points[row]


def worsened(before: Prediction, after: Prediction, now: Reversal = NONE, then: Reversal = NONE) -> np.ndarray:
    """By how much each place becomes worse beyond its U (n,) [m], reached from the worst side with the lost motion
    ``now`` and ``then``; negative or zero: it does not."""
    return (sizes(after.deviation_m, then) - sizes(before.deviation_m, now)
            - K * np.maximum(before.size_sigma_m, after.size_sigma_m))


def place_of(machine: Machine, origin: np.ndarray | None) -> Place:
    """Where tables count from: ``origin`` (3,) [m], else the machine's own; :class:`StepdiagError` where neither is."""
    origin = machine.origin if origin is None else origin
    if origin is None:
        raise StepdiagError('where the volume lies in machine coordinates is not known; give the machine coordinates '
                            'of its lower corner with --origin X,Y,Z, or machine.origin in the cell')
    return Place(machine, np.asarray(origin, float))


def compensation(solution: Solution, machine: Machine, control: Control, origin: np.ndarray | None = None,
                 point: FunctionalPoint | None = None, present: Mapping[str, str] | None = None,
                 partial: bool = False, exact: bool = False, air: str = '', volume: bool = False,
                 reversal: Reversal = NONE) -> Compensation:
    """Tables for ``control`` from ``solution``, or in ``refusals`` why there are none.

    ``origin`` (3,) [m]: machine coordinates of the volume's corner (default: the machine's own; without any
    :class:`StepdiagError`).  ``point``: the functional point (default: the log's tool, lines through the middle of the
    volume).  ``present``: texts of the files that the control holds, by name.  ``partial`` leaves out what the log
    leaves open instead of refusing.  ``exact`` asks for the tables of the line even where they would have to be held
    back, which refuses them.  ``volume`` asks for tables by single axes that leave the least mean square in the whole
    volume, instead of those of a line.  ``air``: why lengths are not known to be metres, '' where they are.
    ``reversal``: lost motion of an axis and its U [m], by its letter, as the effect ``backlash`` counts it.
    """
    place = place_of(machine, origin)
    known = openness(solution)
    refusals = [air] if air else []
    refusals += unfit(solution)
    touched = _used(control, known.open, solution, known.unmeasured)
    if touched and not partial:
        refusals.append(f'the log leaves {", ".join(touched)} open ({"; ".join(known.runs)}); '
                        '--partial leaves them out')
    kept = without(solution, known.unmeasured + known.open)
    errors = kept.errors
    measured = [axis for axis in range(3) if any(kept.has(f'E{m}{AXES[axis]}') for m in AXES)]
    # Where no rotation of an axis is known, nothing is known beside the line on which it was measured.
    whole = bool(measured) and all(kept.has(f'E{turn}{AXES[axis]}') for axis in measured for turn in 'ABC')
    point = _point(machine, point, whole)
    place = place.of_tool(point.tool)
    held = control.read(present, place) if present else {}
    found = standing_out(reversal)

    if not any(kept.has(name) for name in control.carries):
        refusals.append('nothing that this kind of table carries is known')
    points = _places(kept, machine, point, measured, whole, MOST_KNOTS)
    before = predict(kept, machine, points, point.tool)
    line = _of_line(kept, machine, point, control)
    if control.straight and whole:
        # Straight lines are right on no line: they are those that leave least in the volume beside the tables.
        bent = {name: trim for name, trim in line.items() if name not in control.straight}
        rest = before.deviation_m - deviation(errors_of(bent), machine, points, point.tool)
        line = bent | best_of_volume({name: line[name] for name in line if name in control.straight}, points, rest)
    if volume and not control.whole_model:
        line = best_of_volume(line, points, before.deviation_m)
    lost = {axis: known_ for axis, known_ in found.items() if control.reverses and f'E{axis}{axis}' in line}
    stays = {axis: known_ for axis, known_ in found.items() if axis not in lost}
    # Taking lost motion off is no leave to make a place worse in the mean of both directions: only what stays counts.
    # Judged by what repeats leave open: a scale or a tool that is off is off before and after alike.
    repeated = predict(_repeats(kept), machine, points, point.tool)
    plain, alone = line, _after(before, errors, machine, point, line)
    if not control.whole_model and not exact and _harms(
            repeated, _after(repeated, errors, machine, point, line), stays):
        plain = _harmless(line, _repeats(kept), machine, point, measured, whole, stays)
    wanted = _with_reversal(plain, lost)
    files, change = _written(control, place, wanted, held, measured, present or {})
    after = _after(before, errors, machine, point, change)
    refusals += _harm(before, repeated, _after(repeated, errors, machine, point, change), files, exact, found, stays)
    undo = _undo(control, place, wanted, files, present or {})
    rest = _not_carried(kept, machine, point, control, points)
    return Compensation(
        control, place, point, {} if refusals else files, {} if refusals else undo, change, before, after,
        as_measured(left_of(errors, change), kept.positions), kept,
        {name: size for name, (size, _) in rest.items()}, {name: spread for name, (_, spread) in rest.items()},
        None if plain is line else alone, tuple(known.open),
        known.unmeasured, whole, lost, stays, unknown(without(solution, known.unmeasured), known.open), tuple(refusals))


def _used(control: Control, names: tuple[str, ...], solution: Solution, absent: tuple[str, ...]) -> list[str]:
    """Of open errors those that tables of this kind are made of: rotations over levers and squareness too."""
    axes = {name[2] for name in control.carries if solution.has(name) and name not in absent}
    moved = {name[1] for name in control.carries}
    return [name for name in names
            if name in control.carries or (name in CURVES and name[1] in 'ABC' and name[2] in axes)
            or (name in SQUARENESS and len(control.carries) > 3 and moved)]


def _point(machine: Machine, point: FunctionalPoint | None, whole: bool) -> FunctionalPoint:
    if whole:
        return point or functional_point(machine)
    measured = functional_point(machine, line=np.zeros(3))
    if point is not None and not (np.allclose(point.line, measured.line) and np.allclose(point.tool, measured.tool)):
        raise StepdiagError('rotations were not measured: tables hold on the line that was measured and for the '
                            "log's tool only; leave --line, --workpiece and --tool away")
    return measured


def _places(solution: Solution, machine: Machine, point: FunctionalPoint, measured: list[int], whole: bool,
            most: int) -> np.ndarray:
    """Where the machine is judged (n, 3) [m]: all knots, corners included; or the lines that were measured."""
    axes = []
    for axis in range(3):
        names = [f'E{m}{AXES[axis]}' for m in 'XYZABC' if solution.has(f'E{m}{AXES[axis]}')]
        knots = np.asarray(solution.positions[names[0]], float) if names else point.line[axis:axis + 1]
        fine = _finer(knots)
        axes.append(fine if len(fine) <= most else np.linspace(knots[0], knots[-1], most))
    if whole:
        return np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    lines = []
    for axis in measured:
        points = np.tile(point.line, (len(axes[axis]), 1))
        points[:, axis] = axes[axis]
        lines.append(points)
    return np.concatenate(lines) if lines else point.line[None, :]


def _finer(knots: np.ndarray) -> np.ndarray:
    """Positions with those half-way in between: there deviations pass through zero, and tables may do harm."""
    return np.sort(np.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])]))


def _of_line(solution: Solution, machine: Machine, point: FunctionalPoint, control: Control) -> dict[str, Trim]:
    """What the control should take off: along the lines of ``point``, or the whole model."""
    names = [name for name in control.carries if solution.has(name)]
    if not control.whole_model:
        return tables_of_line(solution.errors, machine, point, names, solution.positions, control.straight)
    taken = {}
    for name in names:
        position, value, _ = solution.curve(name)
        value = value + _slope(solution, name) * position
        taken[name] = Trim(np.asarray(position, float), value, value)
    return taken


def _slope(solution: Solution, name: str) -> float:
    """The squareness error that a straightness takes along as its slope [rad]."""
    slope = 0.0
    for square in SQUARENESS:
        axis, per_metre = SQUARENESS_SHIFT[square]
        if solution.has(square) and AXES[axis] == name[2] and name[1] in AXES:
            slope += solution.squareness(square)[0] * per_metre[AXES.index(name[1])]
    return float(slope)


def _harmless(line: dict[str, Trim], solution: Solution, machine: Machine, point: FunctionalPoint,
              measured: list[int], whole: bool, stays: Reversal) -> dict[str, Trim]:
    """The tables of the line, held back where places would become worse, at positions where places are judged: from no
    side that lost motion leaves may a place be worse than it is now from its worst."""
    points = _places(solution, machine, point, measured, whole, MOST_KNOTS)
    before = predict(solution, machine, points, point.tool)
    judged = {axis: np.unique(points[:, axis]) for axis in range(3)}
    line = {name: trim if len(trim.position) <= MOST_KNOTS else trim.at(judged[AXES.index(name[2])])
            for name, trim in line.items()}
    each = sides(stays)
    reached = (before.deviation_m + each[:, None]).reshape(-1, 3)
    room = np.tile(sizes(before.deviation_m, stays) + ROOM * K * before.size_sigma_m, len(each))
    return held_back(line, np.tile(points, (len(each), 1)), reached, room - np.linalg.norm(reached, axis=1))


def _with_reversal(taken: Mapping[str, Trim], lost: Mapping[str, tuple[float, float]]) -> dict[str, Trim]:
    """Half the lost motion on either side: an axis comes to stand short of where it goes."""
    result = dict(taken)
    for axis, (value, _) in lost.items():
        name = f'E{axis}{axis}'
        if name in result:
            trim = result[name]
            result[name] = Trim(trim.position, trim.forward - 0.5 * value, trim.reverse + 0.5 * value)
    return result


def _written(control: Control, place: Place, wanted: Taken, held: Taken, measured: list[int],
             present: Mapping[str, str]) -> tuple[dict[str, str], dict[str, Trim]]:
    """Files with the sum of ``wanted`` and what is ``held``, and by how much more they take off, read from them."""
    total = added(held, wanted)
    axes = {AXES[axis] for axis in measured}
    # What an axis does by direction shares the file of the joined tables.
    total = {name: trim for name, trim in total.items() if name[2] in axes or name in control.joined
             or (control.clear and np.any(trim.forward != trim.reverse))}
    files = control.write(total, place)
    if not files:
        return {}, {}
    if control.clear:
        files |= control.clear(files, present, False)
    again = control.read(files, place)
    return files, difference(again, {name: trim for name, trim in held.items() if name in total})


def _undo(control: Control, place: Place, wanted: Taken, files: Mapping[str, str], present: Mapping[str, str]
          ) -> dict[str, str]:
    """What puts the control back: the files that it holds, and tables of zeros for those that it does not."""
    held_files = {name.split('/')[-1]: text for name, text in present.items()}
    if control.clear:
        return {BEFORE + name: text for name, text in (held_files | control.clear(held_files, files, True)).items()}
    nothing = {name: Trim(t.position, 0.0 * t.forward, 0.0 * t.reverse) for name, t in wanted.items()}
    zeros = control.write(nothing, place)
    held = {name.lower() for name in held_files}
    undo = {BEFORE + name: text for name, text in held_files.items()}
    undo |= {BEFORE + name: text for name, text in zeros.items() if name in files and name.lower() not in held}
    return undo


def _after(before: Prediction, errors: GeometricErrors, machine: Machine, point: FunctionalPoint, change: Taken
           ) -> Prediction:
    left = left_of(errors, change)
    return Prediction(before.points, deviation(left, machine, before.points, point.tool), before.covariance_m2)


def _harms(before: Prediction, after: Prediction, stays: Reversal) -> bool:
    """Whether any place becomes worse beyond its U, or the largest deviation grows."""
    grown = sizes(after.deviation_m, stays).max() - sizes(before.deviation_m, stays).max()
    return bool(np.any(worsened(before, after, stays, stays) > 0.0) or grown > LEAST_GROWTH_M)


def _repeats(solution: Solution) -> Solution:
    """The solution with the covariance of its repeats alone, where it keeps that apart."""
    return solution if solution.repeatability is None else replace(solution, covariance=solution.repeatability)


def _harm(whole: Prediction, before: Prediction, after: Prediction, files: Mapping[str, str], exact: bool,
          lost: Reversal, left: Reversal) -> list[str]:
    """Reasons in the numbers themselves not to write tables; ``whole``: before, with the uncertainty of the budget;
    lost motion ``lost`` before and ``left`` after."""
    if not files:
        return []
    more = worsened(before, after, lost, left)
    now, then = sizes(whole.deviation_m, lost), sizes(after.deviation_m, left)
    row = int(np.argmax(more))
    if more[row] > 0.0:
        at = ', '.join(f'{1e3 * c:.0f}' for c in before.points[row])
        spread = K * max(before.size_sigma_m[row], after.size_sigma_m[row])
        return [f'the place ({at}) mm of the volume would become worse beyond its U, from '
                f'{1e6 * now[row]:.1f} to {1e6 * then[row]:.1f} µm '
                f'(U = {1e6 * spread:.1f} µm, k = 2, of the repeats), and {100.0 * np.mean(more > 0.0):.0f} % of '
                'all places with it' + ('; without --exact the tables are held back' if exact else '')]
    most = int(np.argmax(now))
    size, spread = float(now[most]), K * float(whole.size_sigma_m[most])
    if then.max() > size + LEAST_GROWTH_M:
        return [f'the largest deviation would grow, from {1e6 * size:.1f} to {1e6 * then.max():.1f} µm'
                + ('; without --exact the tables are held back' if exact else '')]
    if spread > size:
        own = K * float(before.size_sigma_m[most])
        return [f'the largest deviation, {1e6 * size:.1f} µm, is known to U = {1e6 * spread:.1f} µm (k = 2) only; '
                + ('measure with more repeats' if own > 0.5 * spread else
                   f'of it U = {1e6 * own:.1f} µm by repeats, the rest by what is not known: `stepdiag uncertainty` '
                   'names it')]
    if np.mean(then**2) > (1.0 - LEAST_GAIN) * np.mean(now**2):
        return ['no table of this kind makes this machine better without making some place worse beyond its U']
    return []


def _not_carried(solution: Solution, machine: Machine, point: FunctionalPoint, control: Control,
                 points: np.ndarray) -> dict[str, tuple[float, float]]:
    """Largest deviation [m] that each error alone keeps under the tables of its line, with its U (k = 2) there."""
    if control.whole_model:
        return {name: (0.0, 0.0) for name in (*CURVES, *SQUARENESS) if solution.has(name)}
    names, whole, rest = [n for n in control.carries if solution.has(n)], solution.errors, {}

    def left(single: GeometricErrors, at: np.ndarray) -> np.ndarray:
        taken = tables_of_line(single, machine, point, names, solution.positions, control.straight)
        curves = {n: Curve(t.position, t.mean) for n, t in taken.items()}
        return deviation(single, machine, at, point.tool) - \
            deviation(GeometricErrors(curves, {}), machine, at, point.tool)

    for name in (*CURVES, *SQUARENESS):
        if not solution.has(name):
            continue
        rows = [i for i, (n, _) in enumerate(solution.names) if n == name]
        if name in CURVES:
            position = whole.curves[name].position
            single = GeometricErrors({name: whole.curves[name]}, {})
            units = [GeometricErrors({name: Curve(position, UNIT * one)}, {}) for one in np.eye(len(position))]
        else:
            single = GeometricErrors({}, {name: whole.square[name]})
            units = [GeometricErrors({}, {name: UNIT})]
        field = left(single, points)
        worst_row = [int(np.argmax(np.linalg.norm(field, axis=1)))]
        effect = np.stack([left(unit, points[worst_row])[0] for unit in units], axis=1) / UNIT
        spread = effect @ solution.covariance[np.ix_(rows, rows)] @ effect.T
        size, own, _ = worst(Prediction(points[worst_row], field[worst_row], spread[None]))
        rest[name] = size, own
    return rest
