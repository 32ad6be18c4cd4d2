"""Sinumerik 840D: ``$AA_ENC_COMP`` (an axis by its own position) and ``$AN_CEC`` (an axis by another's).

Both interpolate linearly between points of an even step.  ``$AA_ENC_COMP`` is altered onto the actual position:
*a positive compensation value causes the machine axis to move in the negative direction*, so the value is the
error.  It does not know directions; what a reversal needs goes into two ``$AN_CEC`` tables of the axis by itself, one
a direction (``$AN_CEC_DIRECTION`` 1 and −1).  The values of all tables of an axis are added.

Sources: Function Manual Basic Functions 808D/828D, leadscrew error compensation (the sentence above); Function
Manual Extended Functions 840D sl, K3, 4.4 (files, linear interpolation, ``CEC_DIRECTION``).  The sign of
``$AN_CEC`` is taken to be the same; the pages that we know do not say it.
"""

import re
from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate.control import (
    MILLI,
    OWN,
    TRANSLATIONS,
    Control,
    Place,
    axis_of,
    even,
    number,
    trim_of,
)
from stepdiag_ros.compensate.taken import Taken, Trim, added
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES

CEC_FILE = 'cec.mpf'
OPEN = ('sign of $AN_CEC NOT confirmed by a manual: taken as of $AA_ENC_COMP (a positive value moves the axis '
        'negative). Load one table, measure, then the others')
MOST_POINTS = 1000
LEAST_REVERSAL_M = 1e-9


def write(taken: Taken, place: Place) -> dict[str, str]:
    """A file of ``$AA_ENC_COMP`` for each axis, one of ``$AN_CEC`` for all that acts across or by direction."""
    files, tables = {}, []
    for name in TRANSLATIONS:
        if name not in taken:
            continue
        moved, base = AXES.index(name[1]), AXES.index(name[2])
        grid = even(taken[name].position, MOST_POINTS)
        trim = taken[name].at(grid)
        if moved != base:
            tables.append((name, moved, base, 0, grid, trim.mean))
            continue
        files[f'{AXES[base].lower()}_eec.mpf'] = _leadscrew(base, grid, trim.mean, place)
        half = 0.5 * (trim.forward - trim.reverse)
        if np.max(np.abs(half)) > LEAST_REVERSAL_M:
            tables += [(f'{name} reversal', base, base, direction, grid, direction * half) for direction in (1, -1)]
    if tables:
        lines = [f'; {OPEN}; machine {place.machine.name}, by stepdiag', '%_N_NC_CEC_INI', 'CHANDATA(1)']
        for number_, table in enumerate(tables):
            lines += _sag(number_, *table, place)
        files[CEC_FILE] = '\n'.join([*lines, 'M17']) + '\n'
    return files


def clear(files: Mapping[str, str], there: Mapping[str, str], every: bool) -> dict[str, str]:
    """Files of zeros for the tables that ``there`` assigns and ``files`` does not.

    Loading assigns what a file names and leaves the rest of the control's memory as it is: a table of a number that is
    not named goes on acting.  Without ``every`` the leadscrew tables of axes that ``files`` leaves alone stay.
    """
    own, other = ([_assignments(text, name) for name, text in some.items()] for some in (files, there))
    zeros: dict[str, str] = {}
    for leadscrew, _ in other if every else ():
        for axis, entries in leadscrew.items():
            if not any(axis in mine for mine, _ in own):
                zeros[_free(f'{axis[0].lower()}_eec.mpf', files)] = '\n'.join([
                    f'; zeros: no leadscrew error compensation of {axis}', f'%_N_{axis}_EEC_INI', 'CHANDATA(1)',
                    *_zeroed('AA', '0,', f',{axis}', entries), 'M17']) + '\n'
    rest: dict[int, dict] = {}
    for _, sag in other:
        rest |= {table: entries for table, entries in sag.items() if not any(table in mine for _, mine in own)}
    if rest:
        zeros[_free(CEC_FILE, files)] = '\n'.join([
            '; zeros: tables that are no longer used', '%_N_NC_CEC_INI', 'CHANDATA(1)',
            *(line for table, entries in sorted(rest.items()) for line in _zeroed('AN', f'{table},', '', entries)),
            'M17']) + '\n'
    return zeros


def _free(name: str, files: Mapping[str, str]) -> str:
    while name in files:
        name = f'zero_{name}'
    return name


def _zeroed(area: str, table: str, axis: str, entries: Mapping) -> list[str]:
    """The assignments of one table with every value zero."""
    lines = []
    for key, value in entries.items():
        if isinstance(key, tuple):
            lines.append(f'${area}_{key[0]}[{table}{key[1]}{axis}]={number(0.0)}')
        else:
            index = f'{table}{axis[1:]}' if axis else table.rstrip(',')
            lines.append(f'${area}_{key}[{index}]={value}')
    return lines


def _leadscrew(axis: int, grid: np.ndarray, value: np.ndarray, place: Place) -> str:
    name, position = f'{AXES[axis]}1', (grid + place.origin[axis]) * MILLI
    lines = [f'; leadscrew error compensation of {AXES[axis]}, mm; machine {place.machine.name}, by stepdiag',
             f'%_N_{name}_EEC_INI', 'CHANDATA(1)']
    lines += [f'$AA_ENC_COMP[0,{i},{name}]={number(v * MILLI)}' for i, v in enumerate(value)]
    lines += [f'$AA_ENC_COMP_STEP[0,{name}]={number(_step(position))}',
              f'$AA_ENC_COMP_MIN[0,{name}]={number(position[0])}',
              f'$AA_ENC_COMP_MAX[0,{name}]={number(position[-1])}',
              f'$AA_ENC_COMP_IS_MODULO[0,{name}]=0', 'M17']
    return '\n'.join(lines) + '\n'


def _sag(table: int, what: str, moved: int, base: int, direction: int, grid: np.ndarray, value: np.ndarray,
         place: Place) -> list[str]:
    position = (grid + place.origin[base]) * MILLI
    return [f'; table {table}: {what}, {AXES[moved]} by the position of {AXES[base]}, mm',
            *(f'$AN_CEC[{table},{i}]={number(v * MILLI)}' for i, v in enumerate(value)),
            f'$AN_CEC_INPUT_AXIS[{table}]=({AXES[base]}1)', f'$AN_CEC_OUTPUT_AXIS[{table}]=({AXES[moved]}1)',
            f'$AN_CEC_STEP[{table}]={number(_step(position))}', f'$AN_CEC_MIN[{table}]={number(position[0])}',
            f'$AN_CEC_MAX[{table}]={number(position[-1])}', f'$AN_CEC_DIRECTION[{table}]={direction}',
            f'$AN_CEC_MULT_BY_TABLE[{table}]=0', f'$AN_CEC_IS_MODULO[{table}]=0']


def _step(position: np.ndarray) -> float:
    return float(position[1] - position[0]) if len(position) > 1 else 1.0


def read(files: Mapping[str, str], place: Place) -> dict[str, Trim]:
    """What the tables take off; a table that multiplies another or is modulo is refused."""
    taken: dict[str, Trim] = {}
    for file, text in files.items():
        leadscrew, sag = _assignments(text, file)
        for axis, entries in leadscrew.items():
            number_ = axis_of(axis, file)
            taken = added(taken, {OWN[number_]: _curve(entries, 'ENC_COMP', place.origin[number_], 0, file)})
        for table, entries in sag.items():
            base, moved = (axis_of(entries.get(f'CEC_{kind}_AXIS', '').strip('()'), f'{file}, table {table}')
                           for kind in ('INPUT', 'OUTPUT'))
            if float(entries.get('CEC_MULT_BY_TABLE', '0')):
                raise StepdiagError(f'{file}: table {table} multiplies another ($AN_CEC_MULT_BY_TABLE); '
                                    'such tables cannot be added to, take them out first')
            direction = int(float(entries.get('CEC_DIRECTION', '0')))
            curve = _curve(entries, 'CEC', place.origin[base], direction, f'{file}, table {table}')
            taken = added(taken, {f'E{AXES[moved]}{AXES[base]}': curve})
    return taken


def _assignments(text: str, file: str) -> tuple[dict[str, dict], dict[int, dict]]:
    """Entries of ``$AA_ENC_COMP`` by axis and of ``$AN_CEC`` by table."""
    leadscrew: dict[str, dict] = {}
    sag: dict[int, dict] = {}
    for count, line in enumerate(text.splitlines(), 1):
        line = line.split(';', 1)[0].strip()
        if not line.startswith('$'):
            continue
        match = re.fullmatch(r'\$A[AN]_(\w+)\[([^\]]*)\]\s*=\s*(\S+)', line)
        if not match:
            raise StepdiagError(f'{file}: line {count}: {line!r} is no assignment of a table')
        key, index, value = match[1], [part.strip() for part in match[2].split(',')], match[3]
        if key.startswith('ENC_COMP'):
            leadscrew.setdefault(index[-1], {})[(key, int(index[1])) if key == 'ENC_COMP' else key] = value
        elif key.startswith('CEC'):
            sag.setdefault(int(index[0]), {})[(key, int(index[1])) if key == 'CEC' else key] = value
    return leadscrew, sag


def _curve(entries: Mapping, kind: str, origin: float, direction: int, where: str) -> Trim:
    """One table as the error that it takes off: from MIN in even steps, in the directions that it acts in."""
    try:
        value = np.array([float(entries[kind, i]) for i in range(sum(isinstance(k, tuple) for k in entries))])
        low, step = (float(entries[f'{kind}_{key}']) for key in ('MIN', 'STEP'))
        if float(entries.get(f'{kind}_IS_MODULO', '0')):
            raise StepdiagError(f'{where}: is a modulo table; linear axes have none')
    except (KeyError, ValueError) as error:
        raise StepdiagError(f'{where}: is not whole ({str(error)[:40]}); give all points with MIN and STEP') from None
    position = (low + step * np.arange(len(value))) / MILLI - origin
    value = value / MILLI
    return trim_of(position, value * (direction >= 0), value * (direction <= 0), where)


CONTROL = Control(
    'sinumerik', 'Sinumerik 840D leadscrew and sag compensation', TRANSLATIONS, write, read,
    'Siemens: a positive value of $AA_ENC_COMP moves the axis in the negative direction; mm; linear between points',
    OPEN,
    'MD32700 = 0 and MD32710 = 0 for these axes, load the files, MD38000 and MD18342 at least the number of points, '
    'switch both on again, NCK reset, reference the axes. Let the value at the reference point be zero where a jump on '
    'referencing would matter.',
    'MD32700 = 0 and MD32710 = 0, load the files of before/, switch on again, NCK reset, reference.',
    most_rows=MOST_POINTS, joined=tuple(name for name in TRANSLATIONS if name not in OWN), clear=clear)
