"""Etalon's exchange format: all errors of a machine in one file, a section each.

``[EXY]`` and ``Gridpoints = { position value … }``, positions and translations in mm, rotations in rad; ``//`` begins a
comment; linear between the points.  It says what a machine's errors are; whoever reads it computes the deviation of the
whole chain and takes it off.  Squareness errors go in as the slopes of straightness.

Source: ISG kernel documentation FCT-C26, *Etalon Exchange Format* and *Units of measure*.
"""

import re
from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate.control import MILLI, Control, Place, number, numbers, trim_of
from stepdiag_ros.compensate.functional import in_machine_coordinates
from stepdiag_ros.compensate.taken import Taken, Trim
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES, CURVES

FILE = 'errors.txt'
OPEN = ('sign NOT confirmed by a manual: errors as of ISO 230-1, actual minus nominal, to be taken off by the reader, '
        'levers from machine coordinates')


def write(taken: Taken, place: Place) -> dict[str, str]:
    """One file with a section for each error that is known."""
    placed = in_machine_coordinates(taken, place.machine, place.origin)
    lines = [f'// {OPEN}; mm and rad; machine {place.machine.name}, by stepdiag']
    for name in CURVES:
        if name not in placed:
            continue
        trim, origin = placed[name], place.origin[AXES.index(name[2])]
        lines += [f'[{name}]', 'Gridpoints = {']
        lines += [f'{number((p + origin) * MILLI)} {v * (MILLI if name[1] in AXES else 1.0) + 0.0:.9e}'
                  for p, v in zip(trim.position, trim.mean, strict=True)]
        lines.append(f'}} // end of {name}')
    return {FILE: '\n'.join(lines) + '\n'} if len(lines) > 1 else {}


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What a reader of the file takes off; position errors given by ``VALUE`` are refused, their signs are not ours."""
    taken = {}
    for file, text in files.items():
        text = '\n'.join(line.split('//', 1)[0] for line in text.splitlines())
        for name, body in re.findall(r'\[(\w+)\]([^\[]*)', text):
            points = re.search(r'Gridpoints\s*=\s*\{([^}]*)\}', body)
            if name not in CURVES or points is None:
                raise StepdiagError(f'{file}: [{name}] is no error motion of a linear axis with Gridpoints; only such '
                                    'files can be added to')
            rows = np.array([numbers(line, 2, f'{file}: [{name}]') for line in points[1].splitlines() if line.strip()])
            value = rows[:, 1] / (MILLI if name[1] in AXES else 1.0)
            position = rows[:, 0] / MILLI - place.origin[AXES.index(name[2])]
            taken[name] = trim_of(position, value, value, f'{file}: [{name}]')
    return in_machine_coordinates(taken, place.machine, place.origin, back=True)


CONTROL = Control(
    'etalon', 'Etalon exchange format', CURVES, write, read,
    'ISG FCT-C26, Etalon Exchange Format: mm and rad, ISO 230-1 names', OPEN,
    'Read the file into the volumetric compensation of the control (variant "Vendor"), its kinematic chain as that of '
    'the machine.',
    'Read the file of before/ instead, or switch the volumetric compensation off.', reverses=False, joined=CURVES)
