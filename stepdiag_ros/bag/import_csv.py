"""A bidirectional positioning test as CSV becomes a contract log.

The table has a line a measurement, in order of time, and named columns whose unit
is part of the name: ``target_mm`` and ``measured_mm`` (or ``deviation_mm``); also
``cycle``, ``direction`` and ``time_s`` if known.  Units: m, mm, um, nm.

Three things a CSV does not say are chosen here and reported (decision 0015): stop 0 is
the lowest target, the whole table is one run, so that nothing is lost to resets, and
times are made up where no ``time_s`` is given.
"""

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.description import Description, Machine, Noise, Plan, Setup
from stepdiag_ros.model.log import DONE, DWELL, MOVE, NONE, CalibrationLog, Samples, StepEvents

UNITS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'µm': 1e-6, 'nm': 1e-9}
START_NS = 1_700_000_000_000_000_000    # synthetic logs begin here; the date means nothing
CADENCE_S = 10.0
STANDARD_AIR = (20.0, 101325.0, 0.5)
"""[°C, Pa, 1] Air whose index stands for the one that was divided out, where a table does not tell it."""
_NS = 1_000_000_000
_SPACING = 0.02     # targets may lie this share of a step off an even grid


@dataclass(frozen=True)
class Table:
    """Columns of a CSV, (n,): ``target``, ``measured`` [m], ``cycle``, ``direction``, ``time`` [s].

    ``resolution`` [m] is the last digit of the readings.  ``cycle``, ``direction`` and
    ``time`` are ``None`` where the file has no such column.
    """

    target: np.ndarray
    measured: np.ndarray
    cycle: np.ndarray | None
    direction: np.ndarray | None
    time: np.ndarray | None
    resolution: float


@dataclass(frozen=True)
class Import:
    """The log, and in ``notes`` every choice that was made, a line each."""

    log: CalibrationLog
    notes: tuple[str, ...]


def import_csv(path: str | Path, axis: str | None = None, cadence_s: float = CADENCE_S, corrected: bool = False
               ) -> Import:
    """Read ``path``; ``axis`` x, y or z (default: guessed from the file's name).

    ``corrected``: whoever measured took the index of air into account; else nobody is known to have.
    Raises :class:`StepdiagError` which names file, line and column.
    """
    path = Path(path)
    table = read_table(path)
    notes: list[str] = []
    letter = _axis(path, axis, notes)
    if not 0.0 < cadence_s <= limits.LOG_S:
        raise StepdiagError(f'--cadence is {cadence_s:g} s; give a number above 0 and of at most {limits.LOG_S:g}')
    return build(table, letter, path.name, cadence_s, notes, corrected)


def read_table(path: Path) -> Table:
    """Parse and check the columns of a CSV."""
    text = read_text(path, limits.TEXT_BYTES, 'table', 'utf-8-sig')
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1)
             if line.strip() and not line.lstrip().startswith('#')]
    if not lines:
        raise StepdiagError(f'{path}: is empty; the first line must name the columns, '
                            'e.g. cycle,direction,target_mm,measured_mm')
    head = lines[0][1]
    delimiter = max(',;\t', key=head.count)
    names = [name.strip().lower() for name in next(csv.reader([head], delimiter=delimiter))]
    columns = _columns(path, names)
    rows = []
    for number, line in lines[1:]:
        cells = next(csv.reader([line], delimiter=delimiter))
        if len(cells) != len(names):
            raise StepdiagError(f'{path}: line {number} has {len(cells)} columns, '
                                f'the first line names {len(names)}')
        rows.append([_number(path, number, name, cell) for name, cell in zip(names, cells, strict=True)])
    if len(rows) < 2:
        raise StepdiagError(f'{path}: has {len(rows)} measurement(s); at least 2 are needed')
    data = np.array(rows)
    pick = {kind: data[:, index] * scale for kind, (index, scale) in columns.items()}
    for kind, most, unit in (('target', limits.LENGTH_M, 'm'), ('measured', limits.LENGTH_M, 'm'),
                             ('deviation', limits.LENGTH_M, 'm'), ('time', limits.LOG_S, 's')):
        if kind in pick and not np.abs(pick[kind]).max() <= most:
            worst = lines[1 + int(np.abs(pick[kind]).argmax())][0]
            raise StepdiagError(f'{path}: line {worst}: {kind} is beyond {most:g} {unit}; check its unit')
    index, scale = columns['measured' if 'measured' in columns else 'deviation']
    digits = max((len(c.split('.')[1]) if '.' in c else 0 for c in
                  (next(csv.reader([line], delimiter=delimiter))[index].strip().lower().split('e')[0]
                   for _, line in lines[1:])), default=0)
    measured = pick['measured'] if 'measured' in pick else pick['target'] + pick['deviation']
    direction = pick.get('direction')
    if direction is not None and not np.isin(direction, (-1, 1)).all():
        worst = lines[1 + int(np.flatnonzero(~np.isin(direction, (-1, 1)))[0])][0]
        raise StepdiagError(f'{path}: line {worst}: direction must be +1 or -1')
    return Table(pick['target'], measured, pick.get('cycle'), direction, pick.get('time'),
                 scale * 10.0 ** -digits)


def _columns(path: Path, names: list[str]) -> dict[str, tuple[int, float]]:
    """Kind of column -> its number and the scale to SI."""
    found: dict[str, tuple[int, float]] = {}
    for index, name in enumerate(names):
        match = re.fullmatch(r'(target|measured|deviation)_(\w+)', name)
        if match and match[2] in UNITS:
            kind, scale = match[1], UNITS[match[2]]
        elif match or name in ('target', 'measured', 'deviation'):
            raise StepdiagError(f'{path}: column {name!r} has no unit that is known; end it with one of '
                                f'{", ".join("_" + u for u in UNITS if u.isascii())}')
        elif name in ('cycle', 'direction'):
            kind, scale = name, 1.0
        elif name == 'time_s':
            kind, scale = 'time', 1.0
        else:
            raise StepdiagError(f'{path}: column {name!r} is not known; known are cycle, direction, '
                                'time_s, target_<unit>, measured_<unit>, deviation_<unit>')
        if kind in found:
            raise StepdiagError(f'{path}: column {kind} is there twice')
        found[kind] = (index, scale)
    if 'target' not in found:
        raise StepdiagError(f'{path}: column target_<unit> is missing (e.g. target_mm)')
    if ('measured' in found) == ('deviation' in found):
        raise StepdiagError(f'{path}: wanted is one of the columns measured_<unit> and deviation_<unit>')
    return found


def _number(path: Path, line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise StepdiagError(f'{path}: line {line}: {name} is {cell.strip()!r}, not a number')
    return value


def _axis(path: Path, axis: str | None, notes: list[str]) -> str:
    if axis is not None:
        letter = axis.lower()
        if letter not in ('x', 'y', 'z'):
            raise StepdiagError(f'--axis is {axis!r}; give x, y or z')
        return letter
    letters = {part for part in re.split(r'[^a-z]+', path.stem.lower()) if part in ('x', 'y', 'z')}
    if len(letters) != 1:
        raise StepdiagError(f'{path}: the file name does not tell the axis; say it with --axis x, y or z')
    letter = letters.pop()
    notes.append(f'axis {letter.upper()}: guessed from the file name (--axis says otherwise)')
    return letter


def build(table: Table, letter: str, name: str, cadence_s: float, notes: list[str], corrected: bool = False) -> Import:
    """The log of a table; ``notes`` are continued."""
    grid = _grid(table.target, name)
    lowest, length = float(grid[0]), float(grid[-1] - grid[0])
    index = np.abs(table.target[:, None] - grid).argmin(axis=1)
    if lowest:
        notes.append(f'targets shifted by {-lowest * 1e3:+.6g} mm, so that stop 0 is the axis\' origin')
    direction = table.direction if table.direction is not None else _directions(index, notes)
    repeat = _repeats(table, index, direction, notes)
    measured = table.measured
    slope = float(np.polyfit(table.target - table.target.mean(), measured, 1)[0])
    if slope < 0:
        notes.append('readings fall where targets rise: turned round, '
                     'as for a reference that looks from the other end')
        measured = -measured
    if abs(abs(slope) - 1.0) > 0.02:
        notes.append(f'readings change by {abs(slope):.4f} of what targets do: check the units; '
                     'kept as they are')
    zero = float(measured[0])
    notes.append(f'readings counted from the first one ({zero * 1e3:.6g} mm), as after a reset; the '
                 'whole table is one run')
    times = _times(table, cadence_s, notes)
    repeats = int(repeat.max()) + 1
    noise = Noise(displacement=table.resolution / math.sqrt(12.0), spot=Noise().spot,
                  position_repeatability=_spread(measured - table.target, index, direction),
                  angle_repeatability=Noise().angle_repeatability)
    setup = f'lin_{letter}'
    stem = Path(name).stem
    description = Description(
        Machine(stem, 'FXYZ', (length, length, length), (0.0, 0.0, 0.0)),
        Plan(len(grid) - 1, 'XYZ', repeats),
        {setup: Setup(setup, 0.0, (0.0, 0.0), ((0.0, 0.0),), length, len(grid))}, noise,
        timed=table.time is not None)
    notes.append(f'the CSV says nothing of the machine: volume {length * 1e3:.6g} mm in each axis, '
                 'tool and standoff 0')
    notes.append('lengths taken as corrected for air by whoever measured (--corrected)' if corrected else
                 'nobody is known to have corrected the lengths for air (--corrected says that somebody did)')
    commanded = np.zeros((len(index), 3))
    commanded[:, 'xyz'.index(letter)] = table.target - lowest
    temperature, pressure, humidity = map(np.asarray, STANDARD_AIR)
    divided = float(refractive_index(temperature, pressure, humidity)) if corrected else 1.0
    log = CalibrationLog(description, _steps(setup, index, repeat, direction, commanded, times,
                                             'xyz'.index(letter)),
                         _samples(setup, measured - zero, times, divided), Samples.empty(2), {}, name, '/import')
    return Import(log, tuple(notes))


LEAST_TRAVEL_M = 1.0e-6
"""Of a positioning test: what is less is rounding, or another unit."""


def _grid(target: np.ndarray, name: str) -> np.ndarray:
    """Evenly spaced stops (n,) [m] behind the targets."""
    unique = np.unique(target)
    span = unique[-1] - unique[0]
    if not span > LEAST_TRAVEL_M:
        raise StepdiagError(f'{name}: all targets are alike to a micrometre; a positioning test needs at least two; '
                            'check their unit')
    # Targets a thousandth of the travel apart are one stop, written with other digits.
    levels = unique[np.concatenate([[True], np.diff(unique) > span * 1e-3])]
    grid = np.linspace(levels[0], levels[-1], len(levels))
    worst = int(np.abs(levels - grid).argmax())
    if abs(levels[worst] - grid[worst]) > _SPACING * span / (len(levels) - 1):
        raise StepdiagError(f'{name}: target {levels[worst] * 1e3:.6g} mm is off the even spacing of the '
                            f'others ({grid[worst] * 1e3:.6g} mm); a linear setup has evenly spaced stops')
    return grid


def _directions(index: np.ndarray, notes: list[str]) -> np.ndarray:
    """+1 where the target was approached from below, from the order of the lines."""
    notes.append('no column direction: taken from the order of the targets')
    change = np.sign(np.diff(index))
    result = np.ones(len(index))
    # A target that comes twice is the turn: the second visit belongs to what follows.
    result[1:] = change
    for k in range(len(index) - 1, 0, -1):
        if result[k] == 0:
            result[k] = result[k + 1] if k + 1 < len(index) else -result[k - 1]
    result[0] = result[1]
    return result


def _repeats(table: Table, index: np.ndarray, direction: np.ndarray, notes: list[str]) -> np.ndarray:
    """Number of the cycle from 0, (n,)."""
    if table.cycle is not None:
        return np.unique(table.cycle, return_inverse=True)[1]
    notes.append('no column cycle: a stop that comes again in the same direction begins the next')
    seen: dict[tuple[int, int], int] = {}
    result = np.zeros(len(index), np.intp)
    for k, key in enumerate(zip(index.tolist(), direction.tolist(), strict=True)):
        result[k] = seen.get(key, 0)
        seen[key] = int(result[k]) + 1
    return np.maximum.accumulate(result)


def _spread(deviation: np.ndarray, index: np.ndarray, direction: np.ndarray) -> float:
    """Pooled standard deviation [m] of the repeats at each stop and direction."""
    total = freedom = 0.0
    for key in {(i, d) for i, d in zip(index.tolist(), direction.tolist(), strict=True)}:
        values = deviation[(index == key[0]) & (direction == key[1])]
        total += float(((values - values.mean()) ** 2).sum())
        freedom += len(values) - 1
    return math.sqrt(total / freedom) if freedom and total > 0 else Noise().position_repeatability


def _times(table: Table, cadence_s: float, notes: list[str]) -> np.ndarray:
    """Time [ns] of each reading, (n,) int64."""
    if table.time is None:
        notes.append(f'no column time_s: times are made up, a stop every {cadence_s:g} s; '
                     'do not read drift against time from them')
        seconds = np.arange(len(table.target)) * cadence_s
    else:
        seconds = table.time - table.time[0]
        if (np.diff(seconds) <= 0).any():
            raise StepdiagError('column time_s must rise from line to line')
    return START_NS + _NS + np.rint(seconds * _NS).astype(np.int64)


def _steps(setup: str, index: np.ndarray, repeat: np.ndarray, direction: np.ndarray,
           commanded: np.ndarray, times: np.ndarray, axis: int) -> StepEvents:
    """``MOVE``, ``DWELL`` and ``DONE`` around every reading."""
    n = len(index)
    # A quarter of the shortest spacing on either side keeps neighbours apart.
    half = int(np.diff(times).min()) // 4
    at = np.stack([times - 2 * half + 1, times - half, times + half], axis=1).ravel()
    moved = np.full(n, axis)
    moved[0] = NONE
    zero = np.zeros(3 * n, np.intp)
    return StepEvents(at, (f'{setup}/0',), zero, (setup,), zero, np.repeat(repeat, 3).astype(np.int64),
                      np.repeat(direction, 3).astype(np.int64), np.repeat(index, 3).astype(np.int64),
                      np.repeat(moved, 3).astype(np.int64), np.repeat(commanded, 3, axis=0),
                      np.tile([MOVE, DWELL, DONE], n).astype(np.int64))


def _samples(setup: str, displacement: np.ndarray, times: np.ndarray, index: float) -> Samples:
    """One reading a stop, in a block of its own."""
    n = len(times)
    return Samples(times, displacement[:, None], np.full(n, 100.0), np.full(n, index), (setup,),
                   np.zeros(n, np.intp), np.arange(n))
