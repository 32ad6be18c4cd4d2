"""Compensation tables: applied as the control applies them, the errors shrink."""

import re

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, Curve, GeometricErrors, tool_pose
from stepdiag_ros.report.compensation import FORMATS, straightness, tables

VOLUME = (0.4, 0.3, 0.2)
SQUARE = (2.0e-5, -1.5e-5, 1.0e-5)
LARGE = 1.0e-6
"""Only errors of this size are asked to shrink: smaller ones are what rounding leaves."""


@pytest.fixture(scope='module')
def solution() -> Solution:
    """A made machine, known exactly; angles are zero, for a table of one axis cannot take them off."""
    rng = np.random.default_rng(5)
    names, values, positions = [], [], {}
    for name in CURVES:
        position = np.linspace(0.0, VOLUME[AXES.index(name[2])], 9)
        value = np.cumsum(rng.normal(0.0, 3e-6, 9))
        value = (value - value[0]) * (name[1] in AXES)
        positions[name] = position
        names += [(name, i) for i in range(9)]
        values += value.tolist()
    names += [(name, -1) for name in SQUARENESS]
    values += SQUARE
    return Solution('made', positions, tuple(names), np.array(values), np.eye(len(names)) * 1e-16)


def off(solution: Solution, command: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Where the machine goes for ``command``, minus the target (n, 3) [m]."""
    point, _ = tool_pose(solution.errors, command, np.zeros(3))
    return point - target


def targets() -> np.ndarray:
    rng = np.random.default_rng(8)
    return rng.uniform(0.0, 1.0, (200, 3)) * VOLUME


def rows(text: str) -> np.ndarray:
    return np.array([[float(v) for v in line.split()] for line in text.splitlines()])


# Each control, as its manual says that it applies its tables: targets (n, 3) [m] → commands [m].

def linuxcnc(files, target):
    command = target.copy()
    for axis in range(3):
        nominal, forward, reverse = rows(files[f'{"xyz"[axis]}.comp']).T
        assert np.array_equal(forward, reverse)
        command[:, axis] += np.interp(target[:, axis] * 1e3, nominal, forward) * 1e-3
    return command


def sinumerik(files, target):
    command = target.copy()
    for axis, letter in enumerate(AXES):
        text = files[f'{letter.lower()}_eec.mpf']
        value = np.array([float(v) for v in re.findall(rf'ENC_COMP\[0,\d+,{letter}1\]=(\S+)', text)])
        step, low, high = (float(re.search(rf'ENC_COMP_{k}\[0,{letter}1\]=(\S+)', text)[1])
                           for k in ('STEP', 'MIN', 'MAX'))
        assert low + step * (len(value) - 1) == pytest.approx(high)
        # "A positive value moves the axis negative."
        command[:, axis] -= np.interp(target[:, axis] * 1e3, low + step * np.arange(len(value)), value) * 1e-3
    text = files['cec.mpf']
    for table in sorted({int(t) for t in re.findall(r'CEC\[(\d+),', text)}):
        value = np.array([float(v) for v in re.findall(rf'CEC\[{table},\d+\]=(\S+)', text)])
        given, moved = (AXES.index(re.search(rf'CEC_{k}_AXIS\[{table}\]=\((\w)1\)', text)[1])
                        for k in ('INPUT', 'OUTPUT'))
        step, low = (float(re.search(rf'CEC_{k}\[{table}\]=(\S+)', text)[1]) for k in ('STEP', 'MIN'))
        command[:, moved] -= np.interp(target[:, given] * 1e3, low + step * np.arange(len(value)), value) * 1e-3
    return command


def heidenhain(files, target):
    command = target.copy()
    for axis, letter in enumerate(AXES):
        lines = files[f'{letter}_AXIS.COM'].splitlines()
        assert lines[0].startswith('BEGIN') and lines[-1] == '[END]'
        table = dict(zip(lines[1].split(), rows('\n'.join(lines[2:-1])).T, strict=True))
        for moved, name in enumerate(AXES):
            command[:, moved] -= np.interp(target[:, axis] * 1e3, table['AXISPOS'], table[name]) * 1e-3
    return command


def etalon(files, target):
    """An exchange of errors, not a table of corrections: its receiver takes the errors off."""
    command, sections = target.copy(), {}
    for part in re.split(r'^\[', files['errors.txt'], flags=re.M)[1:]:
        name, body = part.split(']', 1)
        sections[name] = body.strip().splitlines()
    for axis, letter in enumerate(AXES):
        for moved, name in enumerate(AXES):
            lines = sections[f'E{name}{letter}']
            assert lines[0] == f'Gridpoints={len(lines) - 1}'
            position, value = rows('\n'.join(lines[1:])).T
            command[:, moved] -= np.interp(target[:, axis] * 1e3, position, value) * 1e-3
    square = {name: float(sections[name][0]) for name in SQUARENESS}
    command[:, 0] -= -square['EC0Y'] * target[:, 1] + square['EB0Z'] * target[:, 2]
    command[:, 1] -= -square['EA0Z'] * target[:, 2]
    return command


def isg(files, target):
    command = target.copy()
    for axis, letter in enumerate(AXES):
        lines = [line for line in files[f'{letter.lower()}.csv'].splitlines() if not line.startswith('//')]
        table = dict(zip(lines[0].split(), rows('\n'.join(lines[1:])).T, strict=True))
        for moved, name in enumerate(AXES):
            command[:, moved] -= np.interp(target[:, axis] * 1e3, table[letter], table[f'E{name}{letter}']) * 1e-3
    return command


CONTROLS = {'linuxcnc': linuxcnc, 'sinumerik': sinumerik, 'heidenhain': heidenhain, 'etalon': etalon, 'isg': isg}


@pytest.mark.parametrize('kind', ['sinumerik', 'heidenhain', 'etalon', 'isg'])
def test_the_whole_deviation_shrinks(solution, kind):
    target = targets()
    before = off(solution, target, target)
    after = off(solution, CONTROLS[kind](tables(solution, kind, 'made'), target), target)
    assert np.abs(before).max(axis=0).min() > LARGE
    assert np.all(np.abs(after).max(axis=0) < 0.01 * np.abs(before).max(axis=0))


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_linuxcnc_takes_the_positioning_off(solution, axis):
    """LinuxCNC corrects an axis by itself only: the machine moved along one axis alone."""
    target = np.zeros((50, 3))
    target[:, axis] = np.linspace(0.0, VOLUME[axis], 50)
    before = off(solution, target, target)[:, axis]
    after = off(solution, linuxcnc(tables(solution, 'linuxcnc', 'made'), target), target)[:, axis]
    assert np.abs(before).max() > LARGE
    assert np.abs(after).max() < 0.01 * np.abs(before).max()


def test_linuxcnc_files_hold_rows_only(solution):
    """Its parser stops without a word at a line that it does not understand."""
    files = tables(solution, 'linuxcnc', 'made')
    for name in ('x.comp', 'y.comp', 'z.comp'):
        assert all(re.fullmatch(r'-?\d+\.\d+ -?\d+\.\d+ -?\d+\.\d+', line) for line in files[name].splitlines())
    assert files['README.ini'].count('COMP_FILE_TYPE = 1') == 3


def test_too_many_rows_for_linuxcnc():
    position = np.linspace(0.0, 0.4, 300)
    long = Solution('made', {'EXX': position}, tuple(('EXX', i) for i in range(300)), 1e-6 * position, np.eye(300))
    with pytest.raises(StepdiagError, match='256'):
        tables(long, 'linuxcnc', 'made')


def test_squareness_is_a_slope_of_the_straightness(solution):
    position, value = straightness(solution, 'EXY')
    assert value - solution.curve('EXY')[1] == pytest.approx(-SQUARE[0] * position, abs=1e-18)
    errors = GeometricErrors({'EXY': Curve(position, value)}, {})
    y = np.column_stack([0 * position, position, 0 * position])
    bent, _ = tool_pose(errors, y, np.zeros(3))
    whole, _ = tool_pose(solution.errors, y, np.zeros(3))
    assert bent[:, 0] == pytest.approx(whole[:, 0], abs=1e-12)


def test_what_cannot_be_written_is_said(solution):
    with pytest.raises(StepdiagError, match='linuxcnc'):
        tables(solution, 'fanuc', 'made')
    none = Solution('made', {}, (('EC0Y', -1),), np.zeros(1), np.eye(1))
    for kind in FORMATS:
        with pytest.raises(StepdiagError, match='nothing to compensate'):
            tables(none, kind, 'made')
