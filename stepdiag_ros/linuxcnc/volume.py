"""The volumetric compensation that LinuxCNC's kinematics module ``stepdiagkins`` carries out.

The machine's own error of the tool point at joint positions ``q`` is ``e(q) = p(q) − q − τ`` with the
rigid-body pose ``p`` and the tool vector τ (:func:`stepdiag_ros.model.machine.tool_pose`).  The module
takes the axes for where the tool point is: ``x = q + e(q)`` forward, exactly, and backward by the fixed
point ``q ← x − e(q)``, which gains a factor of the error's slope (some 1e-4) in each turn.  Positions
outside the volume have the error of the nearest place inside.

The solution file is text: a first line with the version, the values in mm and rad, and a check sum
(FNV-1a) in the last line, so that half a file is never taken for a whole one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, Curve, GeometricErrors, tool_pose

VOLUME_HAL = """\
# The volumetric compensation ([KINS]KINEMATICS = stepdiagkins); written by stepdiag.
# Without these lines, or before all joints are homed, nothing is compensated.
addf stepdiagkins.update servo-thread
setp stepdiagkins.slew 0.1
net stepdiag-homed motion.is-all-homed => stepdiagkins.enable
"""
FIRST_LINE = 'stepdiag-volume 1'
MOST_KNOTS = 200
MOST_M = 1.0e-3
"""No larger correction is written; the module refuses it too."""
STEEPEST = 0.01
"""No steeper change of the error with position is written; the module refuses it too."""


def field(errors: GeometricErrors, joints: np.ndarray, tool: Sequence[float], travel: Sequence[float],
          chain: str = 'FXYZ') -> np.ndarray:
    """Error (n, 3) [m] of the tool point at joint positions (n, 3) [m] from the volume's corner."""
    inside = np.clip(np.atleast_2d(np.asarray(joints, float)), 0.0, np.asarray(travel, float))
    point, _ = tool_pose(errors, inside, np.asarray(tool, float), chain)
    return point - inside - np.asarray(tool, float)


def inverse(errors: GeometricErrors, axes: np.ndarray, tool: Sequence[float], travel: Sequence[float],
            chain: str = 'FXYZ', turns: int = 8) -> np.ndarray:
    """Joint positions (n, 3) [m] that put the tool point at ``axes`` (n, 3) [m]."""
    axes = np.atleast_2d(np.asarray(axes, float))
    joints = axes
    for _ in range(turns):
        joints = axes - field(errors, joints, tool, travel, chain)
    return joints


def knots(errors: GeometricErrors, travel: Sequence[float]) -> list[np.ndarray]:
    """Positions [m] of each axis at which the file gives its six curves: all that any curve has."""
    grids = []
    for axis, letter in enumerate(AXES):
        places = [curve.position for name, curve in errors.curves.items() if name[2] == letter]
        grid = np.unique(np.concatenate([[0.0, float(travel[axis])], *places]))
        # Positions that differ by rounding alone are one.
        keep = np.concatenate([[True], np.diff(grid) > 1.0e-9])
        grid = grid[keep]
        grids.append(grid[(grid >= -1.0e-9) & (grid <= float(travel[axis]) + 1.0e-9)])
    return grids


def volume_file(errors: GeometricErrors, machine: str, tool: Sequence[float], travel: Sequence[float],
                origin: Sequence[float] = (0.0, 0.0, 0.0), chain: str = 'FXYZ',
                limit: float | None = None) -> str:
    """The text of a solution file; ``limit`` [m] of each coordinate, without it twice the largest error.

    ``origin`` (3,) [m]: machine coordinates of the volume's lower corner.
    """
    grids = knots(errors, travel)
    for letter, grid in zip(AXES, grids, strict=True):
        if len(grid) > MOST_KNOTS:
            raise StepdiagError(f'the errors of {letter} have {len(grid)} positions; the volumetric component '
                                f'takes {MOST_KNOTS} at most')
    largest = largest_error(errors, tool, travel, chain)
    if limit is None:
        limit = min(MOST_M, max(1.0e-6, 2.0 * largest))
    if not largest <= limit <= MOST_M:
        raise StepdiagError(f'the largest error is {1e6 * largest:.1f} µm and the limit {1e6 * limit:.1f} µm; the '
                            f'volumetric component corrects at most its limit, which is at most {1e6 * MOST_M:g} µm')
    steepest = steepest_change(errors, tool, travel, chain)
    if steepest > STEEPEST:
        raise StepdiagError(f'the error changes by up to {1e3 * steepest:.1f} µm a millimetre between two positions; '
                            f'the volumetric component takes {1e3 * STEEPEST:g} at most; measure again, and look for '
                            'an outlier there')
    lines = [FIRST_LINE, f'# machine {_word(machine)}: 21 geometric errors, mm and rad, written by stepdiag',
             f'chain {chain}', 'origin ' + _row(1e3 * np.asarray(origin, float)),
             'tool ' + _row(1e3 * np.asarray(tool, float)),
             'square ' + _row([errors.square.get(name, 0.0) for name in SQUARENESS]),
             f'limit {1e3 * limit:.9g}']
    for axis, (letter, grid) in enumerate(zip(AXES, grids, strict=True)):
        lines.append(f'axis {letter} {len(grid)}')
        plain = GeometricErrors(errors.curves, {})
        shift, turn = plain.motions(axis, grid)
        shift[:, axis] -= grid
        lines += [_row([1e3 * place, *(1e3 * s), *t]) for place, s, t in zip(grid, shift, turn, strict=True)]
    text = '\n'.join(lines) + '\n'
    return text + f'end {check_sum(text):08x}\n'


def largest_error(errors: GeometricErrors, tool: Sequence[float], travel: Sequence[float],
                  chain: str = 'FXYZ') -> float:
    """Largest component [m] of the error in the volume; it is at a crossing of knots."""
    return float(np.max(np.abs(_at_knots(errors, tool, travel, chain))))


def steepest_change(errors: GeometricErrors, tool: Sequence[float], travel: Sequence[float],
                    chain: str = 'FXYZ') -> float:
    """Steepest change [m/m] of a component of the error from one knot of an axis to the next."""
    values = _at_knots(errors, tool, travel, chain)
    return max(float(np.max(np.abs(np.moveaxis(np.diff(values, axis=axis), axis, -1) / np.diff(grid))))
               for axis, grid in enumerate(knots(errors, travel)))


def _at_knots(errors: GeometricErrors, tool: Sequence[float], travel: Sequence[float], chain: str) -> np.ndarray:
    """Error (kx, ky, kz, 3) [m] at the crossings of the axes' knots."""
    grid = np.stack(np.meshgrid(*knots(errors, travel), indexing='ij'), -1)
    return field(errors, grid.reshape(-1, 3), tool, travel, chain).reshape(grid.shape)


@dataclass(frozen=True)
class Volume:
    """A solution file read back: errors in m and rad, ``tool``, ``origin``, ``travel`` (3,) [m], ``chain``."""

    errors: GeometricErrors
    chain: str
    tool: tuple[float, float, float]
    origin: tuple[float, float, float]
    travel: tuple[float, float, float]

    def taken_off(self, axes: np.ndarray) -> np.ndarray:
        """What the component moves the joints by (n, 3) [m], axes less joints, at axis positions (n, 3) [m]."""
        axes = np.atleast_2d(np.asarray(axes, float))
        return axes - inverse(self.errors, axes, self.tool, self.travel, self.chain)


def read_volume(text: str, source: str = 'volume.txt') -> Volume:
    """A solution file as the component takes it; :class:`StepdiagError` where the component would refuse it."""
    body, _, end = text.rpartition('end ')
    if not text.startswith(FIRST_LINE + '\n') or end.strip() != f'{check_sum(body):08x}':
        raise StepdiagError(f'{source}: is no whole solution file of the volumetric component; write it again')
    lines = iter([line.split() for line in body.splitlines()[1:] if not line.startswith('#')])
    said: dict[str, list[str]] = {}
    curves: dict[str, Curve] = {}
    for key, *values in lines:
        if key != 'axis':
            said[key] = values
            continue
        letter, count = values[0], int(values[1])
        rows = np.array([[float(v) for v in next(lines)] for _ in range(count)])
        for column, motion in enumerate('XYZABC'):
            curves[f'E{motion}{letter}'] = Curve(1e-3 * rows[:, 0], rows[:, 1 + column] * (1e-3 if column < 3 else 1.0))

    def metres(key: str) -> tuple[float, float, float]:
        x, y, z = (1e-3 * float(v) for v in said[key])
        return x, y, z

    square = dict(zip(SQUARENESS, map(float, said['square']), strict=True))
    x, y, z = (float(curves[f'EX{letter}'].position[-1]) for letter in AXES)
    return Volume(GeometricErrors({name: curves[name] for name in CURVES}, square), said['chain'][0], metres('tool'),
                  metres('origin'), (x, y, z))


def check_sum(text: str) -> int:
    """FNV-1a over the text's bytes, 32 bits."""
    total = 2166136261
    for byte in text.encode('utf-8'):
        total = ((total ^ byte) * 16777619) & 0xFFFFFFFF
    return total


def _row(values: Sequence[float]) -> str:
    return ' '.join(f'{float(v) + 0.0:.12g}' for v in values)


def _word(name: str) -> str:
    """A machine's name without what would end the line."""
    return ''.join(c if c.isprintable() else '?' for c in name)[:80]
