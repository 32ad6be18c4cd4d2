"""Compensation tables for controls, from an evaluation.

Every table is made so that, applied, the error shrinks; the signs are those of each control's own
documentation and a test applies each table as the control does.  Positions in mm, corrections in mm or
rad, as the formats want them.

- **LinuxCNC** ``COMP_FILE`` (``[JOINT_n]``, ``COMP_FILE_TYPE = 1``): rows *nominal forward-trim reverse-trim*,
  trim = nominal − actual; at most 256 rows.
- **Sinumerik 840D** ``$AA_ENC_COMP`` (leadscrew error): the value is taken off the axis's position, *a positive
  value moves the axis negative*; so the value is the error itself.  ``$AN_CEC`` (sag, squareness): one table a
  pair of axes, likewise the error.
- **Heidenhain** ``.COM``, a table a moving axis: *AXISPOS* (from the machine datum), *BACKLASH*, and a column an
  axis that errs there.  What is entered is the error curve (manuals: "the compensation points of the error
  curve"), so the error itself.
- **Etalon** exchange format: the errors themselves, in mm and rad, a section ``[EXY]`` each.
- **ISG**: a table an axis, *X EXX EYX EZX EAX EBX ECX*, columns parted by blanks, the errors themselves in mm
  and rad; the control takes them off.
"""

from collections.abc import Callable, Mapping

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, SQUARENESS_SHIFT

MOST_LINUXCNC = 256
MILLI = 1e3
NUMBER = '{:.6f}'


def tables(solution: Solution, kind: str, machine: str) -> dict[str, str]:
    """File names and contents of the tables of one control; ``kind`` is one of :data:`FORMATS`."""
    if kind not in FORMATS:
        raise StepdiagError(f'{kind!r}: no such table format; there are {", ".join(FORMATS)}')
    if not any(solution.has(f'E{a}{a}') for a in AXES):
        raise StepdiagError('the evaluation holds no positioning error EXX, EYY or EZZ; nothing to compensate')
    return FORMATS[kind](solution, machine)


def straightness(solution: Solution, name: str) -> tuple[np.ndarray, np.ndarray]:
    """A straightness curve with its squareness error put back as a slope: positions, values [m]."""
    position, value, _ = solution.curve(name)
    moved = AXES.index(name[1])
    for square in SQUARENESS:
        axis, per_metre = SQUARENESS_SHIFT[square]
        if AXES[axis] == name[2] and per_metre[moved] and solution.has(square):
            value = value + solution.squareness(square)[0] * per_metre[moved] * position
    return position, value


def _head(mark: str, machine: str, what: str, end: str = '') -> str:
    return f'{mark} {what}, machine {machine}, by stepdiag{end}\n'


def _linuxcnc(solution: Solution, machine: str) -> dict[str, str]:
    files = {}
    for joint, axis in enumerate(AXES):
        if not solution.has(f'E{axis}{axis}'):
            continue
        position, value, _ = solution.curve(f'E{axis}{axis}')
        if len(position) > MOST_LINUXCNC:
            raise StepdiagError(f'E{axis}{axis} has {len(position)} positions; LinuxCNC takes {MOST_LINUXCNC} at most')
        # LinuxCNC stops reading at a line that it does not understand, comments included: rows only.
        rows = [' '.join(NUMBER.format(v + 0.0) for v in (p * MILLI, -e * MILLI, -e * MILLI))
                for p, e in zip(position, value, strict=True)]
        files[f'{axis.lower()}.comp'] = '\n'.join(rows) + '\n'
        files.setdefault('README.ini', '# Lines for the INI file; positions and trims in mm.\n')
        files['README.ini'] += (f'[JOINT_{joint}]\nCOMP_FILE = {axis.lower()}.comp\nCOMP_FILE_TYPE = 1\n')
    return files


def _even(position: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The curve on an even grid that holds all its positions where there is one, else the finest step's."""
    step = float(np.min(np.diff(position)))
    count = max(1, int(np.ceil((position[-1] - position[0]) / step - 1e-6)))
    grid = np.linspace(position[0], position[-1], count + 1)
    return grid, np.interp(grid, position, value)


def _sinumerik(solution: Solution, machine: str) -> dict[str, str]:
    files = {}
    for axis in AXES:
        if not solution.has(f'E{axis}{axis}'):
            continue
        grid, value = _even(*solution.curve(f'E{axis}{axis}')[:2])
        name = f'{axis}1'
        lines = [_head(';', machine, f'leadscrew error compensation of {axis}').rstrip(), f'%_N_{name}_EEC_INI',
                 'CHANDATA(1)']
        lines += [f'$AA_ENC_COMP[0,{i},{name}]={NUMBER.format(v * MILLI + 0.0)}' for i, v in enumerate(value)]
        lines += [f'$AA_ENC_COMP_STEP[0,{name}]={NUMBER.format((grid[1] - grid[0]) * MILLI)}',
                  f'$AA_ENC_COMP_MIN[0,{name}]={NUMBER.format(grid[0] * MILLI)}',
                  f'$AA_ENC_COMP_MAX[0,{name}]={NUMBER.format(grid[-1] * MILLI)}',
                  f'$AA_ENC_COMP_IS_MODULO[0,{name}]=0', 'M17']
        files[f'{axis.lower()}_eec.mpf'] = '\n'.join(lines) + '\n'
    lines, table = [_head(';', machine, 'straightness and squareness (sag compensation)').rstrip(),
                    '%_N_NC_CEC_INI', 'CHANDATA(1)'], 0
    for base in AXES:
        for moved in AXES:
            name = f'E{moved}{base}'
            if moved == base or not solution.has(name):
                continue
            grid, value = _even(*straightness(solution, name))
            lines.append(f'; table {table}: {name}, {moved} corrected by the position of {base}')
            lines += [f'$AN_CEC[{table},{i}]={NUMBER.format(v * MILLI + 0.0)}' for i, v in enumerate(value)]
            lines += [f'$AN_CEC_INPUT_AXIS[{table}]=({base}1)', f'$AN_CEC_OUTPUT_AXIS[{table}]=({moved}1)',
                      f'$AN_CEC_STEP[{table}]={NUMBER.format((grid[1] - grid[0]) * MILLI)}',
                      f'$AN_CEC_MIN[{table}]={NUMBER.format(grid[0] * MILLI)}',
                      f'$AN_CEC_MAX[{table}]={NUMBER.format(grid[-1] * MILLI)}',
                      f'$AN_CEC_DIRECTION[{table}]=0', f'$AN_CEC_MULT_BY_TABLE[{table}]=0',
                      f'$AN_CEC_IS_MODULO[{table}]=0']
            table += 1
    if table:
        files['cec.mpf'] = '\n'.join([*lines, 'M17']) + '\n'
    return files


def _heidenhain(solution: Solution, machine: str) -> dict[str, str]:
    files = {}
    for axis in AXES:
        curves = {moved: solution.curve(f'E{moved}{axis}')[:2] if moved == axis
                  else straightness(solution, f'E{moved}{axis}')
                  for moved in AXES if solution.has(f'E{moved}{axis}')}
        if not curves:
            continue
        grid, _ = _even(*next(iter(curves.values())))
        heads = ['AXISPOS', 'BACKLASH', *AXES]
        lines = [f'BEGIN {axis}_AXIS.COM MM', f'{"NR":<6}' + ''.join(h.ljust(14) for h in heads)]
        for i, place in enumerate(grid):
            values = [place, 0.0, *(np.interp(place, *curves[m]) if m in curves else 0.0 for m in AXES)]
            lines.append(f'{i:<6d}' + ''.join(NUMBER.format(v * MILLI + 0.0).ljust(14) for v in values))
        files[f'{axis}_AXIS.COM'] = '\n'.join([*lines, '[END]']) + '\n'
    return files


def _etalon(solution: Solution, machine: str) -> dict[str, str]:
    lines = [_head(';', machine, 'geometric errors, mm and rad, as they are').rstrip()]
    for name in CURVES:
        if not solution.has(name):
            continue
        position, value, _ = solution.curve(name)
        factor = MILLI if name[1] in AXES else 1.0
        lines += [f'[{name}]', f'Gridpoints={len(position)}']
        lines += [f'{NUMBER.format(p * MILLI)} {v * factor:.9e}' for p, v in zip(position, value, strict=True)]
    for name in SQUARENESS:
        if solution.has(name):
            lines += [f'[{name}]', f'{solution.squareness(name)[0]:.9e}']
    return {'errors.txt': '\n'.join(lines) + '\n'}


def _isg(solution: Solution, machine: str) -> dict[str, str]:
    files = {}
    for axis in AXES:
        names = [f'E{motion}{axis}' for motion in 'XYZABC']
        present = [n for n in names if solution.has(n)]
        if not present:
            continue
        grid = solution.curve(present[0])[0]
        lines = [_head('//', machine, f'component errors of {axis}, mm and rad').rstrip(),
                 ' '.join([axis, *names])]
        for place in grid:
            row = [NUMBER.format(place * MILLI)]
            for name in names:
                if name not in present:
                    row.append('0')
                    continue
                translation = name[1] in AXES
                curve = straightness(solution, name) if translation and name[1] != axis else \
                    solution.curve(name)[:2]
                row.append(f'{np.interp(place, *curve) * (MILLI if translation else 1.0) + 0.0:.9e}')
            lines.append(' '.join(row))
        files[f'{axis.lower()}.csv'] = '\n'.join(lines) + '\n'
    return files


FORMATS: Mapping[str, Callable[[Solution, str], dict[str, str]]] = {
    'linuxcnc': _linuxcnc, 'sinumerik': _sinumerik, 'heidenhain': _heidenhain, 'etalon': _etalon, 'isg': _isg}
"""Table formats by the name that the command takes."""
