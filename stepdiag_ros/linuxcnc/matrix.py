"""Squareness and linear scale as the 3×3 matrix of LinuxCNC's kinematics module ``matrixkins``.

``joint = C · axis`` (matrixkins(9), in LinuxCNC after 2.9.0~pre1).  The machine puts the tool point at
``p = (I + M) · joint`` with the scales and squareness errors of the model in ``M``, so that
``C = (I + M)⁻¹`` puts it where the axes say.  The matrix acts on machine coordinates: with the volume's
corner elsewhere than at zero it shifts the whole volume by a constant, which no measurement of lengths sees.
"""

import numpy as np

from stepdiag_ros.model.machine import SQUARENESS_SHIFT, GeometricErrors

LETTERS = 'xyz'


def matrix(errors: GeometricErrors, scale: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """C (3, 3) for the squareness errors and the ``scale`` errors [m/m] of X, Y, Z."""
    error = np.diag(np.asarray(scale, float))
    for name, (axis, per_metre) in SQUARENESS_SHIFT.items():
        error[:, axis] += errors.square.get(name, 0.0) * per_metre
    return np.linalg.inv(np.eye(3) + error)


def matrixkins_hal(c: np.ndarray) -> str:
    """HAL lines that set the parameters of ``matrixkins``."""
    lines = ['# Squareness and linear scale, written by stepdiag; [KINS] KINEMATICS = matrixkins.']
    lines += [f'setp matrixkins.C_{row}{column} {c[i, j]:.12f}'
              for i, row in enumerate(LETTERS) for j, column in enumerate(LETTERS)]
    return '\n'.join(lines) + '\n'
