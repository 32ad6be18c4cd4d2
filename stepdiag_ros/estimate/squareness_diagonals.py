"""Squareness of two axes from the lengths of crossing diagonals.

A face of sides X, Y with the angle ``90° − S`` at its origin has diagonals
``D1² = X² + Y² + 2XY sin S`` (from the origin) and ``D2² = X² + Y² − 2XY sin S``.
Subtracting, ``(D1 − D2)(D1 + D2) = 4XY sin S``, and with ``D1 + D2 ≈ 2 D0``

    S = D0 (D1 − D2) / (2XY)

For body diagonals the two that overlap when looked at along the third axis are
averaged to D1, the other two to D2, and ``D0 = √(X² + Y² + Z²)``.

Signs.  S counts the angle that is missing to 90°: with S > 0 the axes close in and
the diagonal from the origin is the longer one.  In the terms of ISO 230-1 used here
(contract: ``t_Y`` has −EC0Y·y along x, ``t_Z`` has +EB0Z·z along x and −EA0Z·z along
y) that is

    EC0Y = −S_XY        EB0Z = +S_XZ        EA0Z = −S_YZ

Assumes: straightness and angular motions leave the ends of the diagonals alone; a
bow of a guideway and its yaw do so on average, a slope of a straightness error *is*
squareness.  A linear error stretches both diagonals alike and drops out.  Cannot
see: positioning, straightness, angles.  A yaw that grows along an axis shears the
face like a squareness error does, and is reported as one.

Source: Renishaw 2016, section on squareness analysis; the formula is exact to
second order in S, and is rederived above.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import DIAGONALS, Machine

PLANES = {'EC0Y': (0, 1, -1.0), 'EB0Z': (0, 2, 1.0), 'EA0Z': (1, 2, -1.0)}
"""Squareness error → its two axes and its sign against S."""


def face_squareness(x_m: float, y_m: float, d1_m: np.ndarray, d2_m: np.ndarray) -> np.ndarray:
    """S [rad] of a face of programmed sides from the lengths of its diagonals (d1 from the origin).

    Lengths or deviations from the nominal length serve alike; arrays broadcast.
    """
    return np.hypot(x_m, y_m) * (np.asarray(d1_m) - np.asarray(d2_m)) / (2.0 * x_m * y_m)


def body_squareness(machine: Machine, lengths_m: Mapping[str, float],
                    sigma_m: Mapping[str, float] | None = None) -> Solution:
    """The three squareness errors from the four body diagonals' lengths or deviations [m].

    ``lengths_m`` by setup name (ppp, npp, pnp, nnp); ``sigma_m`` their standard deviations.
    """
    missing = [name for name in DIAGONALS if name not in lengths_m]
    if missing:
        raise StepdiagError(f'squareness_diagonals: diagonal {", ".join(missing)} is missing; '
                            'all four body diagonals are needed')
    lengths = np.array([lengths_m[name] for name in DIAGONALS], float)
    volume = np.array(machine.volume)
    signs = np.array([[1.0 if s == 'p' else -1.0 for s in name] for name in DIAGONALS])
    rows = []
    for a, b, sign in PLANES.values():
        # Two diagonals overlap in the plane where their signs multiply alike.
        pair = signs[:, a] * signs[:, b]
        rows.append(sign * np.linalg.norm(volume) * pair / 2.0 / (2.0 * volume[a] * volume[b]))
    matrix = np.array(rows)
    sigma = np.zeros(4) if sigma_m is None else np.array([sigma_m[n] for n in DIAGONALS], float)
    return Solution('squareness_diagonals', {}, tuple((name, -1) for name in PLANES),
                    matrix @ lengths, (matrix * sigma ** 2) @ matrix.T,
                    gauge='squareness between the lines that the ends of the diagonals define')
