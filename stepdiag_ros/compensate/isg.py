"""ISG kernel (also Beckhoff TF5280): the tabular CSV of volumetric compensation, a file for each axis.

The head names the columns, ``X EXX EYX EZX EAX EBX ECX``; rows follow; ``//`` begins a comment; positions and
translations in mm, rotations in rad; linear between rows of a grid.  The control computes the deviation of the whole
chain for its own tool and takes it off, so nothing depends on a line; squareness errors go in as the slopes of
straightness, for which no sign of their own is needed.

Source: ISG kernel documentation FCT-C26, *ISG CSV format*, *Units of measure*, *Interpolation*.  The signs of the
errors follow ISO 230-1; whether the control takes them off or adds them is set by its parameter ``negate``
(P-VOLC-00009), whose default the pages that we know do not explain.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate.control import MILLI, Control, Place, number, numbers, trim_of
from stepdiag_ros.compensate.functional import in_machine_coordinates
from stepdiag_ros.compensate.taken import Taken, Trim, places
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES, CURVES

OPEN = ('sign NOT confirmed by a manual: errors as of ISO 230-1, actual minus nominal, to be taken off (see '
        'P-VOLC-00009, negate), levers from machine coordinates. Load with one axis, measure, then the others')


def write(taken: Taken, place: Place) -> dict[str, str]:
    """``x.csv`` … of the axes that something is known of."""
    files = {}
    placed = in_machine_coordinates(taken, place.machine, place.origin)
    for axis, letter in enumerate(AXES):
        names = [f'E{motion}{letter}' for motion in 'XYZABC']
        known = [placed[name] for name in names if name in placed]
        if not known:
            continue
        grid = places(*(trim.position for trim in known))
        columns = [placed[name].at(grid).mean if name in placed else np.zeros(len(grid)) for name in names]
        lines = [f'// {OPEN}; machine {place.machine.name}, by stepdiag', ' '.join([letter, *names])]
        for i, position in enumerate(grid):
            row = [number((position + place.origin[axis]) * MILLI)]
            row += [number(column[i] * MILLI) if k < 3 else f'{column[i] + 0.0:.9e}'
                    for k, column in enumerate(columns)]
            lines.append(' '.join(row))
        files[f'{letter.lower()}.csv'] = '\n'.join(lines) + '\n'
    return files


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What the files take off."""
    taken = {}
    for file, text in files.items():
        lines = [line.split('//', 1)[0].strip() for line in text.splitlines()]
        lines = [line for line in lines if line]
        if not lines or not file.lower().endswith('.csv'):
            continue
        heads = lines[0].replace(',', ' ').split()
        if heads[0] not in AXES or any(head not in CURVES or head[2] != heads[0] for head in heads[1:]):
            raise StepdiagError(f'{file}: the head is {lines[0]!r}; tables by one axis can be added to, such as '
                                '"X EXX EYX EZX EAX EBX ECX"')
        rows = np.array([numbers(line, len(heads), f'{file}: row {i}') for i, line in enumerate(lines[1:])])
        position = rows[:, 0] / MILLI - place.origin[AXES.index(heads[0])]
        for k, name in enumerate(heads[1:], 1):
            value = rows[:, k] / (MILLI if name[1] in AXES else 1.0)
            taken[name] = trim_of(position, value, value, file)
    return in_machine_coordinates(taken, place.machine, place.origin, back=True)


CONTROL = Control(
    'isg', 'ISG / Beckhoff TF5280 volumetric compensation', CURVES, write, read,
    'ISG FCT-C26: mm and rad, ISO 230-1 names, linear on a grid',
    OPEN,
    'Name the files in the configuration of the volumetric compensation (file[i], file_format CSV), its kinematic '
    'chain as that of the machine, restart the CNC, switch on with #VOLCOMP ON.',
    'Name the files of before/ instead, or #VOLCOMP OFF.', reverses=False)
