"""The functional point: for which tool, and along which lines, tables of single axes are right.

A table by the position of one axis knows nothing of where the others stand; what an angle does depends on it, for
it acts over a lever.  So such a table is right along one line for each axis, where the others stand at
``line``, and for one tool.  Along that line everything goes in: the error motion itself, rotations times lever,
squareness.

    g_m,a(x) = d_m(x, the others at the line) − d_m(0, the others at the line)

with d the deviation of the whole chain (:func:`stepdiag_ros.estimate.prediction.deviation`), a the axis that
moves, m the direction.  Counted from the volume's corner, as the errors are, so that the tables leave that corner
where it is.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.compensate.taken import Trim, places
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.prediction import deviation, levers
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, GeometricErrors


@dataclass(frozen=True)
class FunctionalPoint:
    """Tool vector ``tool`` (3,) [m] and the place ``line`` (3,) [m, in the volume] through which the lines go."""

    tool: np.ndarray
    line: np.ndarray


def functional_point(machine: Machine, tool: np.ndarray | None = None, line: np.ndarray | None = None,
                     workpiece: np.ndarray | None = None) -> FunctionalPoint:
    """The point for ``tool`` [m] (default: the log's) with lines through ``line`` [m, in the volume].

    ``workpiece`` (3,) [m, in the volume's coordinates] names the lines by where the tool's tip works: the axes then
    stand a tool vector back.  Default: through the middle of the volume.  :class:`StepdiagError` for a place
    outside the volume, where nothing was measured.
    """
    tool = np.asarray(machine.tool if tool is None else tool, float)
    volume = np.asarray(machine.volume)
    if workpiece is not None:
        line = np.asarray(workpiece, float) - tool
    line = 0.5 * volume if line is None else np.asarray(line, float)
    for axis, (place, length) in enumerate(zip(line, volume, strict=True)):
        if not -1e-9 <= place <= length + 1e-9:
            raise StepdiagError(f'the reference line lies at {AXES[axis]} = {1e3 * place:.3f} mm of the volume, which '
                                f'was measured from 0 to {1e3 * length:.3f} mm; name a line inside')
    return FunctionalPoint(tool, np.clip(line, 0.0, volume))


def tables_of_line(errors: GeometricErrors, machine: Machine, point: FunctionalPoint, names: Iterable[str],
                   positions: Mapping[str, np.ndarray], straight: Iterable[str] = ()) -> dict[str, Trim]:
    """Tables of the translations ``names`` at ``positions`` [m] that are right along the lines of ``point``.

    Of those in ``straight`` the straight line through the first position that comes nearest to them.
    """
    tables = {}
    for name in names:
        moved, axis = AXES.index(name[1]), AXES.index(name[2])
        position = np.asarray(positions[name], float)
        points = np.tile(point.line, (len(position), 1))
        points[:, axis] = position
        value = deviation(errors, machine, points, point.tool)[:, moved]
        value = value - value[0]
        if name in straight:
            way = position - position[0]
            position, value = position[[0, -1]], way[[0, -1]] * (way @ value) / (way @ way)
        tables[name] = Trim(position, value, value)
    return tables


def in_machine_coordinates(taken: Mapping[str, Trim], machine: Machine, origin: np.ndarray,
                           back: bool = False) -> dict[str, Trim]:
    """Translations of a whole model counted from the machine's zero instead of the volume's corner, or ``back``.

    A control that computes levers from machine coordinates has ``origin`` more of them; what the rotations do over
    that much is a function of their own axis and is taken out of its translations: ``t′ = t − ω × lever(origin)``.
    Positions stay in the volume.
    """
    sign = 1.0 if back else -1.0
    arms = levers(machine, np.asarray(origin, float)[None, :], np.zeros(3))[:, 0]
    result = dict(taken)
    for axis, letter in enumerate(AXES):
        turns = [taken.get(f'E{motion}{letter}') for motion in 'ABC']
        if all(trim is None for trim in turns):
            continue
        moves = [taken.get(f'E{motion}{letter}') for motion in AXES]
        position = places(*(trim.position for trim in (*turns, *moves) if trim is not None))
        none = Trim(position, np.zeros(len(position)), np.zeros(len(position)))
        turn = np.stack([(none if trim is None else trim.at(position)).mean for trim in turns], axis=1)
        shift = sign * np.cross(turn, arms[axis])
        for k, motion in enumerate(AXES):
            own = none if moves[k] is None else moves[k].at(position)
            result[f'E{motion}{letter}'] = Trim(position, own.forward + shift[:, k], own.reverse + shift[:, k])
    return result
