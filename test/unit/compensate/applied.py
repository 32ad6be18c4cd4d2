"""Made machines, known exactly or to a stated σ, and each control as an implementation of its own."""

import re
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, tool_pose

VOLUME = (0.4, 0.3, 0.2)
ORIGIN = np.array([-0.35, 0.1, -0.25])


def machine_of(chain: str = 'FXYZ', tool: tuple[float, float, float] = (0.01, -0.02, -0.12)) -> Machine:
    return Machine('made', chain, VOLUME, tool)


def made(seed: int, sigma: float = 2e-8, knots: int = 9, angle: float = 1.5e-5, **given: np.ndarray) -> Solution:
    """A drawn machine of all 21 errors; ``given`` replaces curves, ``angle`` [rad] is the size of the rotations."""
    rng = np.random.default_rng(seed)
    names, values, positions, spread = [], [], {}, []
    for name in CURVES:
        position = np.linspace(0.0, VOLUME[AXES.index(name[2])], knots)
        size = 2.5e-6 if name[1] in AXES else angle / 3.0
        value = np.cumsum(rng.normal(0.0, size, knots))
        value = given.get(name, value - value[0])
        positions[name] = position
        names += [(name, i) for i in range(knots)]
        values += list(value)
        spread += [0.0] + [sigma if name[1] in AXES else 5.0 * sigma] * (knots - 1)
    names += [(name, -1) for name in SQUARENESS]
    values += [float(given.get(name, rng.normal(0.0, 1.5e-5))) for name in SQUARENESS]
    spread += [5.0 * sigma] * 3
    return Solution('made', positions, tuple(names), np.array(values), np.diag(np.array(spread)**2))


def only(sigma: float = 2e-8, **given: np.ndarray) -> Solution:
    """A machine that has the errors ``given`` (values at nine even positions) and no other."""
    zero = dict.fromkeys(CURVES, np.zeros(9)) | dict.fromkeys(SQUARENESS, 0.0)
    return made(0, sigma, **(zero | given))


def goes(solution: Solution, machine: Machine, command: np.ndarray, tool: np.ndarray | None = None) -> np.ndarray:
    """Where the tool gets to (n, 3) [m] for ``command``, by the whole kinematic chain."""
    point, _ = tool_pose(solution.errors, command, np.asarray(machine.tool if tool is None else tool), machine.chain)
    return point


# Each control applies its files to targets (n, 3) [m, in the volume], approached in ``direction`` of every axis;
# written against the manuals, sharing nothing with the package but the names of the axes.

def rows(text: str) -> np.ndarray:
    return np.array([[float(v) for v in line.split()] for line in text.splitlines()])


def linuxcnc(files: Mapping[str, str], target: np.ndarray, direction: int, **_) -> np.ndarray:
    command = target.copy()
    for axis in range(3):
        if f'{"xyz"[axis]}.comp' in files:
            nominal, forward, reverse = rows(files[f'{"xyz"[axis]}.comp']).T
            trim = forward if direction > 0 else reverse
            command[:, axis] += 1e-3 * np.interp(1e3 * (target[:, axis] + ORIGIN[axis]), nominal, trim)
    return command


def linuxcnc_matrix(files: Mapping[str, str], target: np.ndarray, direction: int, **_) -> np.ndarray:
    """joint = C · axis in machine coordinates; that this shifts the whole volume is nobody's error."""
    c = np.eye(3)
    for row, column, value in re.findall(r'setp matrixkins.C_(.)(.) (\S+)', files['matrix.hal']):
        c['xyz'.index(row), 'xyz'.index(column)] = float(value)
    joints = (target + ORIGIN) @ c.T - ORIGIN @ c.T
    return joints + linuxcnc(files, joints, direction) - joints


def linuxcnc_volume(files: Mapping[str, str], target: np.ndarray, direction: int, machine: Machine, **more
                    ) -> np.ndarray:
    """The component's file, read by its own words; levers are counted from the volume's corner."""
    curves, said, letter = {}, {}, ''
    for line in files['volume.txt'].splitlines()[2:-1]:
        key, *values = line.split()
        if key == 'axis':
            letter = values[0]
        elif letter:
            for name, value in zip([f'E{m}{letter}' for m in 'XYZABC'], map(float, values), strict=True):
                for column, number in zip(curves.setdefault(name, ([], [])), (float(key), value), strict=True):
                    column.append(number)
        else:
            said[key] = values
    assert 1e-3 * np.array(said['origin'], float) == pytest.approx(ORIGIN) and said['chain'] == [machine.chain]
    joints = model(curves, target, machine, 1e-3 * np.array(said['tool'], float), np.zeros(3))
    return joints + linuxcnc(files, joints, direction) - joints


def sinumerik(files: Mapping[str, str], target: np.ndarray, direction: int, **_) -> np.ndarray:
    command = target.copy()
    machine = 1e3 * (target + ORIGIN)
    for axis, letter in enumerate(AXES):
        text = files.get(f'{letter.lower()}_eec.mpf', '')
        value = np.array([float(v) for v in re.findall(rf'ENC_COMP\[0,\d+,{letter}1\]=(\S+)', text)])
        if len(value):
            step, low, high = (float(re.search(rf'ENC_COMP_{k}\[0,{letter}1\]=(\S+)', text)[1])
                               for k in ('STEP', 'MIN', 'MAX'))
            assert low + step * (len(value) - 1) == pytest.approx(high, abs=2e-5)
            # "A positive compensation value causes the machine axis to move in the negative direction."
            command[:, axis] -= 1e-3 * np.interp(machine[:, axis], low + step * np.arange(len(value)), value)
    text = files.get('cec.mpf', '')
    for table in sorted({int(t) for t in re.findall(r'CEC\[(\d+),', text)}):
        value = np.array([float(v) for v in re.findall(rf'CEC\[{table},\d+\]=(\S+)', text)])
        given, moved = (AXES.index(re.search(rf'CEC_{k}_AXIS\[{table}\]=\((\w)1\)', text)[1])
                        for k in ('INPUT', 'OUTPUT'))
        step, low, way = (float(re.search(rf'CEC_{k}\[{table}\]=(\S+)', text)[1]) for k in ('STEP', 'MIN', 'DIRECTION'))
        if way in (0, direction):
            command[:, moved] -= 1e-3 * np.interp(machine[:, given], low + step * np.arange(len(value)), value)
    return command


def heidenhain(files: Mapping[str, str], target: np.ndarray, direction: int, **_) -> np.ndarray:
    command = target.copy()
    for axis, letter in enumerate(AXES):
        if f'{letter}_AXIS.COM' not in files:
            continue
        lines = files[f'{letter}_AXIS.COM'].splitlines()
        assert lines[0] == f'BEGIN {letter}_AXIS.COM MM' and lines[-1] == '[END]'
        heads = lines[1].split()
        table = dict(zip(heads, rows('\n'.join(lines[2:-1])).T, strict=True))
        for moved, name in enumerate(AXES):
            if name in table:
                back = direction < 0 and moved == axis and 'BACKLASH' in table
                value = table['BACKLASH' if back else name]
                command[:, moved] -= 1e-3 * np.interp(1e3 * (target[:, axis] + ORIGIN[axis]), table['AXISPOS'], value)
    return command


def model(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], target: np.ndarray, machine: Machine,
          tool: np.ndarray | None = None, origin: np.ndarray = ORIGIN) -> np.ndarray:
    """A control that takes a model off: shifts and small turns, tool to foundation, in machine coordinates."""
    place = target + origin
    point = np.tile(np.asarray(machine.tool if tool is None else tool, float), (len(target), 1))
    ideal = point + place
    frame = machine.chain.index('F')
    for where, letter in reversed(list(enumerate(machine.chain))):
        if letter == 'F':
            continue
        axis = AXES.index(letter)

        def value(name: str, axis: int = axis) -> np.ndarray:
            return np.interp(1e3 * place[:, axis], *curves[name]) if name in curves else np.zeros(len(target))
        shift = np.stack([1e-3 * value(f'E{m}{letter}') for m in AXES], 1)
        shift[:, axis] += place[:, axis]
        turn = np.stack([value(f'E{m}{letter}') for m in 'ABC'], 1)
        if where < frame:
            point = shift + point
            point = point + np.cross(turn, point)
        else:
            point = shift + point + np.cross(turn, point)
    return target - (point - ideal)


def isg(files: Mapping[str, str], target: np.ndarray, direction: int, machine: Machine, **more) -> np.ndarray:
    curves = {}
    for text in files.values():
        lines = [line for line in text.splitlines() if not line.startswith('//')]
        table = dict(zip(lines[0].split(), rows('\n'.join(lines[1:])).T, strict=True))
        curves |= {name: (table[lines[0][0]], v) for name, v in table.items() if name != lines[0][0]}
    return model(curves, target, machine, **more)


def etalon(files: Mapping[str, str], target: np.ndarray, direction: int, machine: Machine, **more) -> np.ndarray:
    curves, name = {}, ''
    for line in files['errors.txt'].splitlines():
        line = line.split('//')[0].strip()
        if line.startswith('['):
            name = line.strip('[]')
            curves[name] = ([], [])
        elif line and line[0] in '-0123456789':
            for column, text in zip(curves[name], line.split(), strict=True):
                column.append(float(text))
    return model(curves, target, machine, **more)


APPLIED: dict[str, Callable] = {'linuxcnc': linuxcnc, 'linuxcnc-matrix': linuxcnc_matrix,
                                'linuxcnc-volume': linuxcnc_volume, 'sinumerik': sinumerik, 'heidenhain': heidenhain,
                                'etalon': etalon, 'isg': isg}


def grid(count: int = 7) -> np.ndarray:
    axes = [np.linspace(0.0, v, count) for v in VOLUME]
    return np.stack(np.meshgrid(*axes, indexing='ij'), -1).reshape(-1, 3)


def drawn(count: int = 300, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3)) * VOLUME
