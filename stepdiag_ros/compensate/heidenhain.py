"""Heidenhain TNC: a ``.COM`` table for each axis that moves, and the ``.CMA`` line that puts them in force.

Columns: *AXISPOS*, position from the machine datum; *BACKLASH*, the compensation value of the axis itself where it
moves in its negative direction; and one column for each axis to be compensated.  256 rows at most.

Sources: Technical Manual MANUALplus 620, *Entering compensation values* and *General relationship for CMA tables*
(columns, machine datum, backlash measured in the negative direction); TNC 407 Technical Manual, module 9095 (256
entries).  What is entered is the error curve (TNC 407, example *Error in Z*); the pages that we know do not say in so
many words to which side an entry moves the axis.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate.control import (
    MILLI,
    TRANSLATIONS,
    Control,
    Place,
    axis_of,
    even,
    number,
    numbers,
    trim_of,
)
from stepdiag_ros.compensate.taken import Taken, Trim, places
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES

MOST_ROWS = 256
CMA = 'CONFIG.CMA'
OPEN = ('sign of .COM entries NOT confirmed by a manual in so many words: the error curve is entered, actual minus '
        'nominal. Load one table, measure, then the others')


def write(taken: Taken, place: Place) -> dict[str, str]:
    """``X_AXIS.COM`` … and the ``.CMA`` that names them."""
    files = {}
    for base, letter in enumerate(AXES):
        curves = {moved: taken[name] for moved in AXES if (name := f'E{moved}{letter}') in taken}
        if not curves:
            continue
        grid = even(places(*(trim.position for trim in curves.values())), MOST_ROWS)
        columns = {moved: trim.at(grid) for moved, trim in curves.items()}
        own = columns.get(letter)
        values = [(grid + place.origin[base]) * MILLI]
        heads = ['AXISPOS']
        if own is not None and np.max(np.abs(own.forward - own.reverse)) > 0.5e-9:
            heads.append('BACKLASH')
            values.append(own.reverse * MILLI)
        heads += list(columns)
        values += [(trim.forward if moved == letter else trim.mean) * MILLI for moved, trim in columns.items()]
        lines = [f'BEGIN {letter}_AXIS.COM MM', f'{"NR":<6}' + ''.join(h.ljust(14) for h in heads)]
        lines += [f'{i:<6d}' + ''.join(number(v).ljust(14) for v in row)
                  for i, row in enumerate(np.column_stack(values))]
        files[f'{letter}_AXIS.COM'] = '\n'.join([*lines, '[END]']) + '\n'
    if files:
        axes = [name[0] for name in files]
        files[CMA] = '\n'.join([f'BEGIN {CMA} MM', f'{"NR":<6}{"ACTIVE":<8}' + ''.join(a.ljust(16) for a in axes),
                                f'{0:<6d}{"*":<8}' + ''.join(f'{a}_AXIS'.ljust(16) for a in axes), '[END]']) + '\n'
    return files


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What the tables take off; a table's name says its axis, ``X_AXIS.COM`` or ``X.COM``."""
    taken = {}
    for file, text in files.items():
        if not file.upper().endswith('.COM'):
            continue
        base = axis_of(file.split('/')[-1].upper().removesuffix('.COM').removesuffix('_AXIS'), file)
        lines = [line for line in text.splitlines() if line.strip()]
        if len(lines) < 3 or not lines[0].upper().startswith('BEGIN') or 'MM' not in lines[0].upper().split():
            raise StepdiagError(f'{file}: does not begin with "BEGIN … MM"; give the .COM table in mm')
        heads = lines[1].split()
        body = [line for line in lines[2:] if not line.strip().startswith('[')]
        rows = np.array([numbers(line, len(heads), f'{file}: row {i}') for i, line in enumerate(body)])
        table = dict(zip(heads, rows.T, strict=True))
        if 'AXISPOS' not in table:
            raise StepdiagError(f'{file}: has no column AXISPOS; give the .COM table of a NC with such tables')
        position = table['AXISPOS'] / MILLI - place.origin[base]
        for moved in AXES:
            if moved in table:
                forward = table[moved] / MILLI
                reverse = table['BACKLASH'] / MILLI if moved == AXES[base] and 'BACKLASH' in table else forward
                taken[f'E{moved}{AXES[base]}'] = trim_of(position, forward, reverse, file)
    return taken


CONTROL = Control(
    'heidenhain', 'Heidenhain .COM tables', TRANSLATIONS, write, read,
    'Heidenhain: positions from the machine datum, mm; BACKLASH as measured in the negative direction; error curve',
    OPEN,
    f'Copy the .COM tables and {CMA} (its first line active) to the control, restart, traverse the reference marks. '
    f'{CMA} puts these tables in force and no others: if the control holds tables of further axes, give them with '
    '--present, or add their names to that line.',
    'Make the former line of the .CMA active again, or copy the tables of before/ back, restart.',
    most_rows=MOST_ROWS, joined=TRANSLATIONS)
