"""The rigid-body machine: 18 error curves, 3 squareness errors, one tool pose.

The chain is read from workpiece to tool, ``F`` being the machine frame.  Walking
it backwards from the tool vector ``τ``, an axis on the tool's side turns and then
shifts what it carries, ``q ← t + R q``; an axis that carries the workpiece is
passed through its inverse motion, ``q ← R (t + q)``.  Error motions are those of
the tool relative to the workpiece in both cases, so that their signs do not
depend on the chain.  For ``FXYZ`` this is the contract's

    p = t_X + R_X (t_Y + R_Y (t_Z + R_Z τ)),    R = R_X R_Y R_Z

with ``R_a = I + [(EAa, EBa, ECa)]×`` to first order and the squareness errors in
``t_Y`` and ``t_Z``.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

AXES = 'XYZ'
CURVES = tuple(f'E{motion}{axis}' for axis in AXES for motion in 'XYZABC')
"""``EXX EYX EZX EAX EBX ECX EXY … ECZ``: three translations [m], three rotations [rad] an axis."""
SQUARENESS = ('EC0Y', 'EB0Z', 'EA0Z')

SQUARENESS_SHIFT = {'EC0Y': (1, np.array([-1.0, 0.0, 0.0])),
                    'EB0Z': (2, np.array([1.0, 0.0, 0.0])),
                    'EA0Z': (2, np.array([0.0, -1.0, 0.0]))}
"""Squareness error → (axis number, shift of the tool per radian and metre of that axis)."""


@dataclass(frozen=True)
class Curve:
    """One error motion at knots: ``position`` (k,) [m] rising, ``value`` (k,) [m or rad].

    Between knots it is straight; outside it goes on as at the nearest knot.
    """

    position: np.ndarray
    value: np.ndarray

    def __call__(self, position: np.ndarray) -> np.ndarray:
        return np.interp(position, self.position, self.value)


@dataclass(frozen=True)
class GeometricErrors:
    """The 21 errors: ``curves`` by ISO 230-1 name, ``square`` [rad] by name.

    A curve that is not named is zero.
    """

    curves: Mapping[str, Curve]
    square: Mapping[str, float]

    @classmethod
    def zero(cls) -> 'GeometricErrors':
        return cls({}, {})

    def motions(self, axis: int, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Translation and rotation of axis number ``axis`` at ``position`` (n,): two (n, 3) [m], [rad].

        The commanded travel itself and the squareness errors are included in the translation.
        """
        position = np.asarray(position, float)
        both = np.zeros((2, position.size, 3))
        for k, motion in enumerate('XYZABC'):
            curve = self.curves.get(f'E{motion}{AXES[axis]}')
            if curve is not None:
                both[k // 3, :, k % 3] = curve(position)
        shift, turn = both
        shift[:, axis] += position
        for name, (number, per_metre) in SQUARENESS_SHIFT.items():
            if number == axis and self.square.get(name):
                shift += self.square[name] * position[:, None] * per_metre
        return shift, turn


def rotation(angles: np.ndarray) -> np.ndarray:
    """First-order rotation matrices ``I + [angles]×``: (n, 3) [rad] → (n, 3, 3)."""
    a, b, c = np.moveaxis(np.asarray(angles, float), -1, 0)
    matrix = np.zeros((*np.shape(a), 3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = matrix[..., 2, 2] = 1.0
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -c, b, -a
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = c, -b, a
    return matrix


def chain_from_tool(chain: str) -> list[tuple[int, bool]]:
    """Axis numbers from the tool outwards, with whether the axis carries the workpiece."""
    frame = chain.index('F')
    return [(AXES.index(letter), place < frame)
            for place, letter in reversed(list(enumerate(chain))) if letter != 'F']


def compose(chain: str, shifts: np.ndarray, turns: np.ndarray,
            tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose from each axis's motion: ``shifts``, ``turns`` (3, n, 3) [m, rad] → p (n, 3), R (n, 3, 3)."""
    matrices = rotation(turns)
    n = shifts.shape[1]
    point = np.broadcast_to(np.asarray(tool, float), (n, 3))
    attitude = np.broadcast_to(np.eye(3), (n, 3, 3))
    for axis, carries_workpiece in chain_from_tool(chain):
        if carries_workpiece:
            point = np.einsum('nij,nj->ni', matrices[axis], shifts[axis] + point)
        else:
            point = shifts[axis] + np.einsum('nij,nj->ni', matrices[axis], point)
        attitude = matrices[axis] @ attitude
    return point, attitude


def carried(chain: str, position: np.ndarray, shifts: np.ndarray, turns: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """By what the tool point (n, 3) [m] is shifted at ``position`` (n, 3) [m] where each axis shifts and turns what it
    carries besides: ``shifts``, ``turns`` (3, n, 3) [m, rad]."""
    travel = position.T[:, :, None] * np.eye(3)[:, None]
    return compose(chain, travel + shifts, turns, tool)[0] - compose(chain, travel, np.zeros_like(turns), tool)[0]


def tool_pose(errors: GeometricErrors, position: np.ndarray, tool: np.ndarray,
              chain: str = 'FXYZ') -> tuple[np.ndarray, np.ndarray]:
    """Where the mirror's reference point is and how the mirror is turned.

    ``position`` (n, 3) [m] commanded, ``tool`` (3,) [m].  Returns ``p`` (n, 3) [m] in the
    machine frame and ``R`` (n, 3, 3).
    """
    position = np.atleast_2d(np.asarray(position, float))
    parts = [errors.motions(axis, position[:, axis]) for axis in range(3)]
    return compose(chain, np.array([shift for shift, _ in parts]),
                   np.array([turn for _, turn in parts]), tool)
