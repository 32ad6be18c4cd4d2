"""What is loaded into LinuxCNC after a calibration: three levels, each on top of what the control holds.

``tables``: screw tables, which carry EXX, EYY and EZZ along the lines of the functional point.  ``matrix``: these
and squareness as a 3×3 matrix, by LinuxCNC's ``matrixkins`` where it is there, else by our component.  ``volume``: our
component with all 21 errors, and screw tables of what reverses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stepdiag_ros.compensate.applied import remaining
from stepdiag_ros.compensate.approach import NONE, Reversal
from stepdiag_ros.compensate.compensation import Compensation, compensation
from stepdiag_ros.compensate.control import Place
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.linuxcnc_matrix import FILE as MATRIX_FILE
from stepdiag_ros.compensate.linuxcnc_matrix import squareness
from stepdiag_ros.compensate.linuxcnc_volume import FILE as VOLUME_FILE
from stepdiag_ros.compensate.linuxcnc_volume import model
from stepdiag_ros.compensate.taken import Taken
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.linuxcnc import configuration
from stepdiag_ros.linuxcnc.ini import get
from stepdiag_ros.linuxcnc.volume import volume_file
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, GeometricErrors

CONTROL = {'tables': CONTROLS['linuxcnc'], 'matrix': CONTROLS['linuxcnc-matrix'],
           'volume': CONTROLS['linuxcnc-volume']}
LEVELS = tuple(CONTROL)


@dataclass(frozen=True)
class Present:
    """What a configuration folder holds: INI file, and by file name the texts of what compensates."""

    ini_name: str
    ini: str
    files: Mapping[str, str]

    @property
    def present(self) -> dict[str, str]:
        """As the tables' readers take it."""
        return {self.ini_name: self.ini, **self.files}

    @property
    def carries(self) -> str:
        """The level of what the control carries."""
        return 'volume' if VOLUME_FILE in self.files else 'matrix' if MATRIX_FILE in self.files else 'tables'

    def model(self, machine: Machine) -> Taken:
        """What the volumetric component takes off; nothing where it is not loaded."""
        if VOLUME_FILE not in self.files:
            return {}
        return model(self.files[VOLUME_FILE], VOLUME_FILE, Place(machine, np.array(machine.origin)))


@dataclass(frozen=True)
class Change:
    """What is to be written and what it does.

    ``files``: texts by name in the configuration folder, None for one that goes; empty where there are refusals.
    ``made``: the tables with their prediction.  ``applied``: what the volumetric component will take off, which the
    next evaluation has to put back.
    """

    level: str
    files: Mapping[str, str | None]
    made: Compensation
    applied: Taken
    notes: tuple[str, ...] = ()

    @property
    def refusals(self) -> tuple[str, ...]:
        """Why nothing may be written."""
        return self.made.refusals


def held(folder: Path) -> Present:
    """What the control is compensated with now; :class:`StepdiagError` for a machine that it cannot be added to."""
    ini, text = configuration.read_ini(folder)
    configuration.must_be_supported(text, ini.name)
    names = [name for joint in range(3) for name in get(text, f'JOINT_{joint}', 'COMP_FILE')]
    kinematics = get(text, 'KINS', 'KINEMATICS')[0].split()[0]
    if kinematics == configuration.COMPONENT:
        names.append(configuration.VOLUME)
    elif kinematics == 'matrixkins':
        if configuration.MATRIX_HAL not in get(text, 'HAL', 'HALFILE'):
            raise StepdiagError(f'{ini}: matrixkins is in force with a matrix that stepdiag did not write; take it out '
                                'first, so that the machine itself is measured')
        names.append(configuration.MATRIX_HAL)
    files = {}
    for name in names:
        try:
            files[Path(name).name] = (folder / name).read_text(encoding='utf-8')
        except OSError as error:
            raise StepdiagError(f'{folder / name}: is named by {ini.name} and cannot be read: '
                                f'{error.strerror}') from None
    return Present(ini.name, text, files)


def change(level: str, solution: Solution, machine: Machine, present: Present, *, partial: bool = False,
           air: str = '', matrixkins: bool = False,
           reversal: Reversal = NONE) -> Change:
    """What to write for a ``level``; ``solution`` is of the machine without its present volumetric compensation.

    ``air``: why lengths are not known to be metres; ``matrixkins``: LinuxCNC has that module; ``reversal``: lost
    motion of each axis with its U [m] by letter.
    """
    if machine.origin is None:
        raise StepdiagError('where the volume lies in machine coordinates is not known; put machine.origin into the '
                            'cell file')
    if LEVELS.index(present.carries) > LEVELS.index(level):
        raise StepdiagError(f'the control carries the level {present.carries}; take it back first (improve --undo) or '
                            f'keep --level {present.carries}')
    origin = np.array(machine.origin)
    made = compensation(remaining(solution, present.model(machine)), machine, CONTROL[level], origin, None,
                        present.present, partial, air=air, reversal=reversal)
    if made.refusals:
        return Change(level, {}, made, {})
    files, notes = made.files, []
    tables = {letter: files[f'{letter.lower()}.comp'] for letter in AXES if f'{letter.lower()}.comp' in files}
    volume, matrix = files.get(VOLUME_FILE), files.get(MATRIX_FILE)
    if level == 'matrix' and not matrixkins:
        notes.append('this LinuxCNC has no matrixkins; stepdiagkins carries the matrix')
        square = squareness(CONTROL[level].read(files, made.place))
        volume, matrix = volume_file(GeometricErrors({}, square), machine.name, machine.tool, machine.volume,
                                     machine.origin, machine.chain), None
    if level == 'volume':
        notes += ['screw tables that were there are taken up into the volumetric compensation'] * any(
            name.endswith('.comp') for name in present.files)
        notes += [f'the component does not know from where an axis comes: lost motion of {axis} goes into a screw table'
                  for axis in tables]
    written = configuration.compensated(present.ini, tables=tables, matrix_hal=matrix, volume=volume)
    applied = model(volume, VOLUME_FILE, made.place) if level == 'volume' and volume is not None else {}
    return Change(level, configuration.renamed(written, present.ini_name), made, applied, tuple(notes))
