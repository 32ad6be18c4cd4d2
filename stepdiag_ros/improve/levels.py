"""What is loaded into LinuxCNC after a calibration: three levels, each on top of what the control holds.

``tables``: screw tables, which carry EXX, EYY and EZZ along the lines of the functional point.  ``matrix``: these
and the three squareness errors as a 3×3 matrix, by LinuxCNC's ``matrixkins`` where it is there, else by our
component.  ``volume``: our component with all 21 errors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stepdiag_ros.compensate.compensation import Compensation, K, compensation, worsened, worst
from stepdiag_ros.compensate.control import Place
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.open_directions import openness, unknown, without
from stepdiag_ros.compensate.taken import Taken, left_of, scaled
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.prediction import Prediction, deviation, predict
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.linuxcnc import configuration
from stepdiag_ros.linuxcnc.ini import get
from stepdiag_ros.linuxcnc.matrix import matrix, matrixkins_hal
from stepdiag_ros.linuxcnc.volume import Volume, read_volume, volume_file
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, SQUARENESS, GeometricErrors

LEVELS = ('tables', 'matrix', 'volume')
PER_AXIS = 9
"""Places an axis at which the volume is judged, corners included."""
CONTROL = CONTROLS['linuxcnc']
SHARES = (1.0, 0.75, 0.5, 0.25)
"""Shares of the squareness errors that are tried."""


@dataclass(frozen=True)
class Present:
    """What a configuration folder holds: INI file, texts of the screw tables by file name, our volume file."""

    ini_name: str
    ini: str
    tables: Mapping[str, str]
    volume: Volume | None

    @property
    def present(self) -> dict[str, str]:
        """As the tables' reader takes it."""
        return {self.ini_name: self.ini, **self.tables}


@dataclass(frozen=True)
class Change:
    """What is to be written and what it does.

    ``files``: texts by name in the configuration folder, None for one that goes.  ``before`` and ``after``:
    predictions at the same places; ``applied``: the volumetric compensation that the next evaluation has to put
    back, or None.  ``refusals``: why nothing may be written.
    """

    level: str
    files: Mapping[str, str | None]
    before: Prediction
    after: Prediction
    applied: Volume | None
    refusals: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def worst_before(self) -> tuple[float, float, np.ndarray]:
        """Largest deviation, its U (k = 2), its place, all [m]."""
        return worst(self.before)

    @property
    def worst_after(self) -> tuple[float, float, np.ndarray]:
        return worst(self.after)


def held(folder: Path) -> Present:
    """What the control is compensated with now."""
    ini = configuration.ini_file(folder)
    text = ini.read_text(encoding='utf-8')
    tables = {}
    for joint in range(3):
        for name in get(text, f'JOINT_{joint}', 'COMP_FILE'):
            try:
                tables[Path(name).name] = (folder / name).read_text(encoding='utf-8')
            except OSError as error:
                raise StepdiagError(f'{folder / name}: is named by {ini.name} and cannot be read: '
                                    f'{error.strerror}') from None
    volume = None
    kinematics = get(text, 'KINS', 'KINEMATICS')
    if kinematics and kinematics[0].split()[0] == configuration.COMPONENT:
        path = folder / configuration.VOLUME
        try:
            volume = read_volume(path.read_text(encoding='utf-8'), str(path))
        except OSError as error:
            raise StepdiagError(f'{path}: cannot be read: {error.strerror}') from None
    elif kinematics and kinematics[0].split()[0] == 'matrixkins':
        raise StepdiagError(f'{ini}: matrixkins is in force; take its matrix out first (improve --undo), so that the '
                            'machine itself is measured')
    return Present(ini.name, text, tables, volume)


def places(machine: Machine) -> np.ndarray:
    """Where the machine is judged (n, 3) [m]."""
    axes = [np.linspace(0.0, length, PER_AXIS) for length in machine.volume]
    return np.stack(np.meshgrid(*axes, indexing='ij'), -1).reshape(-1, 3)


def remaining(errors: GeometricErrors, machine: Machine, points: np.ndarray, volume: Volume | None) -> np.ndarray:
    """Deviation (n, 3) [m] of the machine's own errors less what a volumetric compensation takes off."""
    left = deviation(errors, machine, points)
    return left if volume is None else left - volume.taken_off(points)


def change(level: str, solution: Solution, machine: Machine, present: Present, *, partial: bool = False,
           air: str = '', matrixkins: bool = False,
           reversal: Mapping[str, tuple[float, float]] | None = None) -> Change:
    """What to write for a ``level``; ``solution`` is of the machine without its present volumetric compensation.

    ``air``: why lengths are not known to be metres; ``matrixkins``: LinuxCNC has that module; ``reversal``: lost
    motion of each axis with its U [m] by letter, which screw tables take off and the component does not.
    """
    if machine.origin is None:
        raise StepdiagError('where the volume lies in machine coordinates is not known; put machine.origin into the '
                            'cell file')
    known = openness(solution)
    refusals = [air] if air else []
    touched = known.open if level == 'volume' else ()
    if touched and not partial:
        refusals.append(f'the log leaves {", ".join(touched)} open ({"; ".join(known.runs)}); '
                        '--partial leaves them out')
    kept = without(solution, known.unmeasured + known.open)
    points = places(machine)
    before = predict(kept, machine, points)
    before = replace(before, deviation_m=remaining(kept.errors, machine, points, present.volume))
    # What is left out is of value zero and as uncertain as it is; whether places become worse is judged without it.
    whole = predict(unknown(without(solution, known.unmeasured), known.open), machine, points).covariance_m2
    if level == 'volume':
        result = _volume(kept, machine, present, before, reversal or {})
    elif present.volume is not None:
        raise StepdiagError('the control carries the volumetric compensation; take it back first (improve --undo) or '
                            'keep --level volume')
    else:
        # Squareness and what it hides may cancel somewhere: as much of it as leaves no place worse.
        for share in SHARES if level == 'matrix' else (0.0,):
            result = _tables(level, solution, kept, machine, present, before, partial, matrixkins, share,
                             reversal or {})
            if not _harm(before, result.after):
                break
    harm = _harm(before, result.after)
    return replace(result, refusals=tuple(refusals) + result.refusals + harm,
                   before=replace(result.before, covariance_m2=whole), after=replace(result.after, covariance_m2=whole))


def _volume(solution: Solution, machine: Machine, present: Present, before: Prediction,
            reversal: Mapping[str, tuple[float, float]]) -> Change:
    """All 21 errors in the component; screw tables that are there are taken up into it."""
    origin = machine.origin or (0.0, 0.0, 0.0)
    taken: Taken = CONTROL.read(present.present, Place(machine, np.array(origin)))
    own = left_of(solution.errors, scaled(taken, -1.0))
    text = volume_file(own, machine.name, machine.tool, machine.volume, origin, machine.chain)
    volume = read_volume(text)
    after = Prediction(before.points, deviation(own, machine, before.points) - volume.taken_off(before.points),
                       before.covariance_m2)
    files = configuration.compensated(present.ini, volume=text)
    notes = ('screw tables that were there are taken up into the volumetric compensation',) if taken else ()
    notes += tuple(f'lost motion of {axis}, {1e6 * value:.2f} µm, U = {1e6 * spread:.2f} µm (k = 2), stays: the '
                   f'component does not know from where an axis comes; give it to [JOINT_{AXES.index(axis)}]BACKLASH'
                   for axis, (value, spread) in reversal.items() if abs(value) > spread)
    return Change('volume', configuration.renamed(files, present.ini_name), before, after, volume, (), notes)


def _tables(level: str, solution: Solution, kept: Solution, machine: Machine, present: Present, before: Prediction,
            partial: bool, matrixkins: bool, share: float, reversal: Mapping[str, tuple[float, float]]) -> Change:
    origin = np.array(machine.origin)
    square = {name: share * kept.squareness(name)[0] for name in SQUARENESS if kept.has(name)} if share else {}
    made: Compensation = compensation(_squared(solution, square), machine, CONTROL, origin, None, present.present,
                                      partial, reversal=reversal)
    tables = {letter: made.files[f'{letter.lower()}.comp'] for letter in AXES if f'{letter.lower()}.comp' in made.files}
    rest = {name: value - square.get(name, 0.0) for name, value in kept.errors.square.items()}
    left = left_of(GeometricErrors(kept.errors.curves, rest), made.change)
    after = Prediction(before.points, deviation(left, machine, before.points), before.covariance_m2)
    ours = GeometricErrors({}, square)
    if level == 'tables':
        files = configuration.compensated(present.ini, tables=tables)
    elif matrixkins:
        files = configuration.compensated(present.ini, tables=tables, matrix_hal=matrixkins_hal(matrix(ours)))
    else:
        files = configuration.compensated(present.ini, tables=tables, volume=volume_file(
            ours, machine.name, machine.tool, machine.volume, tuple(origin), machine.chain))
    notes = () if level == 'tables' or matrixkins else (
        'this LinuxCNC has no matrixkins; stepdiagkins carries the matrix',)
    if 0.0 < share < 1.0:
        notes += (f'{100.0 * share:.0f} % of the squareness errors are taken off; more would make some place worse',)
    return Change(level, configuration.renamed(files, present.ini_name), before, after, None, made.refusals, notes)


def _squared(solution: Solution, square: Mapping[str, float]) -> Solution:
    """The solution of the machine whose squareness errors are taken off."""
    value = solution.value.copy()
    for i, (name, _) in enumerate(solution.names):
        value[i] -= square.get(name, 0.0)
    return replace(solution, value=value)


def _harm(before: Prediction, after: Prediction) -> tuple[str, ...]:
    more = worsened(before, after)
    row = int(np.argmax(more))
    if more[row] <= 0.0:
        return ()
    at = ', '.join(f'{1e3 * c:.0f}' for c in before.points[row])
    return (f'the place ({at}) mm of the volume would become worse beyond its U, from '
            f'{1e6 * before.size_m[row]:.1f} to {1e6 * after.size_m[row]:.1f} µm '
            f'(U = {1e6 * K * after.size_sigma_m[row]:.1f} µm, k = 2)',)
