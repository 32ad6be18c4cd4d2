"""Screw tables and LinuxCNC's kinematics module ``matrixkins``: three straight lines across axes beside the tables.

``joint = C · axis`` (matrixkins(9), in LinuxCNC after 2.9.0~pre1).  The machine puts the tool point at
``p = (I + M) · joint`` with the slopes of EXY, EXZ and EYZ in ``M``, so that ``C = (I + M)⁻¹`` puts it where the axes
say.  These are the squareness errors, with what rotations add to them along the lines of the functional point.  The
matrix acts on machine coordinates: with the volume's corner elsewhere than at zero it shifts the whole volume by a
constant, which no measurement of lengths sees.
"""

import re
from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate import linuxcnc
from stepdiag_ros.compensate.control import OWN, TRANSLATIONS, Control, Place
from stepdiag_ros.compensate.taken import Taken, Trim, added
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc.matrix import LETTERS, matrixkins_hal
from stepdiag_ros.model.machine import AXES

STRAIGHT = ('EXY', 'EXZ', 'EYZ')
ACROSS = tuple(name for name in TRANSLATIONS if name not in OWN)
"""All that a matrix may hold beside scales; one that is there already may turn the machine."""
MOST = 0.01
"""No machine's scale or squareness is off by as much."""
FILE = 'matrix.hal'
KINEMATICS = ('# Lines for the INI file of the machine, in place of those that are there.\n[KINS]\n'
              f'KINEMATICS = matrixkins\n[HAL]\n# after the other HALFILE lines\nHALFILE = {FILE}\n')


def write(taken: Taken, place: Place) -> dict[str, str]:
    """Screw tables, the HAL lines of the matrix, and the lines of the INI file."""
    error = np.eye(3)
    for name in ACROSS:
        if name in taken:
            error[AXES.index(name[1]), AXES.index(name[2])] = _slope(taken[name])
    tables = linuxcnc.write(taken, place)
    return tables | {FILE: matrixkins_hal(np.linalg.inv(error)),
                     linuxcnc.INI: KINEMATICS + tables.get(linuxcnc.INI, '')}


def _slope(trim: Trim) -> float:
    return float((trim.mean[-1] - trim.mean[0]) / (trim.position[-1] - trim.position[0]))


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What the tables and the matrix take off."""
    taken = linuxcnc.read({name: text for name, text in files.items() if not name.lower().endswith('.hal')}, place)
    for file, text in files.items():
        if file.lower().endswith('.hal') and 'matrixkins.C_' in text:
            taken = added(taken, _lines(text, file, place))
    return taken


def _lines(text: str, file: str, place: Place) -> dict[str, Trim]:
    c = np.eye(3)
    for row, column, value in re.findall(r'setp\s+matrixkins\.C_([xyz])([xyz])\s+(\S+)', text):
        try:
            c[LETTERS.index(row), LETTERS.index(column)] = float(value)
        except ValueError:
            raise StepdiagError(f'{file}: matrixkins.C_{row}{column} is {value!r}; give a number') from None
    if not np.max(np.abs(c - np.eye(3))) < MOST:
        raise StepdiagError(f'{file}: the matrix of matrixkins differs from unity by {MOST:g} or more; only one of '
                            'small errors can be added to')
    error = np.linalg.inv(c) - np.eye(3)
    taken = {}
    for axis, letter in enumerate(AXES):
        ends = np.array([0.0, place.machine.volume[axis]])
        for k, moved in enumerate(AXES):
            if abs(error[k, axis]) > 1e-12 or f'E{moved}{letter}' in STRAIGHT:
                taken[f'E{moved}{letter}'] = Trim(ends, error[k, axis] * ends, error[k, axis] * ends)
    return taken


def squareness(taken: Taken) -> dict[str, float]:
    """The slopes of EXY, EXZ and EYZ as squareness errors [rad]."""
    return {name: _slope(taken[curve]) * sign for name, curve, sign in
            (('EC0Y', 'EXY', -1.0), ('EB0Z', 'EXZ', 1.0), ('EA0Z', 'EYZ', -1.0)) if curve in taken}


CONTROL = Control(
    'linuxcnc-matrix', 'LinuxCNC screw compensation and matrixkins', (*OWN, *STRAIGHT), write, read,
    'LinuxCNC source: trim = nominal - actual, added to the motor position (motion/control.c), units of the INI file; '
    'joint = C axis, matrixkins(9)',
    '',
    f'As of `linuxcnc`; besides copy {FILE} beside the INI file and put the lines of {linuxcnc.INI} into its '
    'sections in place of those that are there. matrixkins comes with LinuxCNC after 2.9.0~pre1. `stepdiag improve '
    '--level matrix` does all this.',
    'Put the INI file back as it was (KINEMATICS, HALFILE, COMP_FILE), restart LinuxCNC, home.',
    most_rows=linuxcnc.MOST_ROWS, straight=STRAIGHT, joined=ACROSS)
