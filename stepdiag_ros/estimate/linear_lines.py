"""Three parallel lines an axis with Abbe offsets: positioning, pitch and yaw.

An axis turned by θ moves a tool point that stands off it by the arm l by ``θ × l``.  Along
the axis, say X, a linear measurement on a line with arm (·, l_y, l_z) reads

    D = EXX(x) + l_z · EBX(x) − l_y · ECX(x)                              (23)
    D = EYY(y) + l_x · ECY(y) − l_z · EAY(y)                              (24)
    D = EZZ(z) + l_y · EAZ(z) − l_x · EBZ(z)                              (25)

that is ``D = E + e_a·(θ × l)``.  Three lines whose arms are not in line give all three
curves at each position; more are taken by least squares.

The arm runs from the axis's carriage to the tool point: for FXYZ it is (·, y, z) + τ for X,
(·, ·, z) + τ for Y (a line shifted in x is a longer tool, not another x), and τ for Z.

Against the printed form: the text names m and p of ``D = Dx + m·Ay + p·Az`` the offsets in
y and z "respectively", the geometry has the offset in z with pitch (m) and the one in y
with yaw (p), and yaw's sign is minus.  The closed solution that follows in the paper gives
``Az`` under the name of ``Ay``, ``−Ay`` under that of ``Az``, and ``−Dx``; checked in the tests.

Assumes: the other axes stand still; the axis's line is the one the reset refers to.
Cannot see: roll, straightness, squareness.  The angles are as good as repeatability over
offset: 2.5 µm over 0.5 m is 5 µrad.

Source: Wang & Liotto 2003, eqs. 23–25.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.model.machine import AXES

MINIMUM_SPREAD = 1e-6
"""Lines whose arms span less than this (relative) cannot separate pitch from yaw."""


@dataclass(frozen=True)
class Lines:
    """Linear measurements of one axis along parallel lines.

    ``position_m`` (n,) of the axis, from 0; ``arm_m`` (k, 3) [m] from the axis's carriage to the tool
    point on each line; ``deviation_m`` (k, n) reading less travel, zero at position 0;
    ``sigma_m`` one standard deviation of a reading.
    """

    position_m: np.ndarray
    arm_m: np.ndarray
    deviation_m: np.ndarray
    sigma_m: float = 0.0


def design(axis: int, arm_m: np.ndarray) -> np.ndarray:
    """Rows (k, 3): what a line reads of (positioning, first, second rotation of :func:`names`)."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    # e_a · (θ × l) = θ_b l_c − θ_c l_b for cyclic (a, b, c)
    arm = np.asarray(arm_m, float)
    return np.stack([np.ones(len(arm)), arm[:, c], -arm[:, b]], axis=1)


def names(axis: int) -> tuple[str, str, str]:
    """``EXX EBX ECX`` for X, ``EYY ECY EAY`` for Y, ``EZZ EAZ EBZ`` for Z."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    return (f'E{AXES[axis] * 2}', f'E{"ABC"[b]}{AXES[axis]}', f'E{"ABC"[c]}{AXES[axis]}')


def evaluate(lines: Mapping[str, Lines]) -> Solution:
    """Positioning, pitch and yaw of the axes named ``X``, ``Y``, ``Z``."""
    positions, order, values, blocks = {}, [], [], []
    for letter, given in lines.items():
        if letter not in AXES:
            raise StepdiagError(f'linear_lines: unknown axis {letter!r}; name X, Y or Z')
        axis = AXES.index(letter)
        matrix, data = design(axis, given.arm_m), np.asarray(given.deviation_m, float)
        if data.shape != (len(matrix), len(given.position_m)):
            raise StepdiagError(f'linear_lines: axis {letter}: deviations {data.shape} for {len(matrix)} '
                                f'lines and {len(given.position_m)} positions')
        spread = np.linalg.svd(matrix[:, 1:] - matrix[:, 1:].mean(axis=0), compute_uv=False)
        if len(matrix) < 3 or spread[-1] < MINIMUM_SPREAD * max(spread[0], 1.0):
            raise StepdiagError(f'linear_lines: axis {letter}: {len(matrix)} lines whose offsets lie in '
                                'one line; give three that span both directions across')
        inverse = np.linalg.pinv(matrix)
        answer = inverse @ (data - data[:, :1])
        each = inverse @ inverse.T * given.sigma_m ** 2
        n = len(given.position_m)
        # The reading at position 0 is subtracted: it is common to all others.
        common = np.ones((n, n)) + np.eye(n)
        common[0, :] = common[:, 0] = 0.0
        for row, name in enumerate(names(axis)):
            positions[name] = np.asarray(given.position_m, float)
            order += [(name, i) for i in range(n)]
            values.append(answer[row])
        blocks.append(np.kron(each, common))
    if not order:
        raise StepdiagError('linear_lines: no axis given')
    total = len(order)
    covariance, first = np.zeros((total, total)), 0
    for block in blocks:
        covariance[first:first + len(block), first:first + len(block)] = block
        first += len(block)
    return Solution('linear_lines', positions, tuple(order), np.concatenate(values), covariance,
                    gauge='positioning on the line through the carriage (arm zero)',
                    unidentifiable=(Unidentifiable(('roll', 'straightness', 'squareness'),
                                                   'a linear measurement does not react to them'),))


def printed_solution(d: np.ndarray, m: np.ndarray, p: np.ndarray) -> tuple[float, float, float]:
    """The paper's closed solution (Dx, Ay, Az) for three lines as printed, to be set beside ours."""
    (d1, d2, d3), (m1, m2, m3), (p1, p2, p3) = d, m, p
    below = (m3 - m1) * (p2 - p1) - (m2 - m1) * (p3 - p1)
    ay = ((m3 - m1) * (d2 - d1) - (m2 - m1) * (d3 - d1)) / below
    az = ((p3 - p1) * (d2 - d1) - (p2 - p1) * (d3 - d1)) / below
    dx = (d1 * (m2 * p3 - m3 * p2) + d2 * (m3 * p1 - m1 * p3) + d3 * (m1 * p2 - m2 * p1)) / below
    return dx, ay, az
