"""New formulation of the step diagonal: linear errors from elsewhere, mirror and laser unknown.

The vector method fails with a misaligned mirror or laser, and they can only be aligned by
the machine that is to be measured.  Ibaraki et al. take the positioning errors as known
from direct linear measurement and use of each step diagonal what does not depend on the
alignment: the length of the machine's own diagonal, to which the laser was aligned, and
how single steps differ from the mean step.

**Two dimensions, as printed** (:func:`ibaraki_2006`).  With step sizes a, b, readings
R_x, R_y of block i and R = R_x + R_y

    Ê⁰_x(y) = √(R² − (b + E_y(y))²) − (a + E_x(x))                        (3)
    sin α = (a + E_x(x)) cos α₂ / (R/2 − δ(1)),     δ = R/2 − R_x          (4)
    Ê_y(x)(i) = −(sin α / sin α₂) (δ(i) − δ(1))                            (5)
    Ê_x(y) = Ê⁰_x(y) cos δ' − (b + E_y(y)) sin δ',  δ' = atan(Ê_y(x)/(a + E_x(x)))   (6)

The step R_x of a mirror whose normal stands at α₂ against X, read by a beam that meets the
mirror at α, is ``((a + E_x) cos α₂ + E_y sin α₂)/sin α``; (4) follows from the first block, where
E_y(x) is zero.  The paper prints (4) with a minus sign, which together with (5) would turn E_y(x)
round, and (6) with ``(b + E_y) cos δ + Ê⁰ sin δ``, which gives b for a perfect machine; both are
read here as the geometry wants them (rotating both steps by δ' keeps the diagonal).  And (5)
compares R/2 − R_x, which is E_y(x) only while R stays as in the first block: it finds
``½ (ΔE_x(x) + E_y(x) − ΔE_x(y) − ΔE_y(y))``.  The step itself has no such condition,

    Ê_y(x)(i) = (sin α · R_x(i) − (a + E_x(x)(i)) cos α₂)/sin α₂           (5')

which is (5) where R and E_x(x) do not change; it is the default.

**Plane and space, one step exact** (:func:`evaluate_plane`, :func:`evaluate`).  Without
angular motions a setup's reading changes by ``g·Δp`` with a constant vector g = m/(b·m)
(:mod:`~stepdiag_ros.estimate.stepwise`): whatever laser and mirror do is in g.  Let
D_X, D_Y, D_Z be the mean steps in the frame whose X is the X line and whose XY plane holds
the Y line,

    D_X = (h_x + ε_x, 0, 0)   D_Y = (p, h_y + ε_y, 0)   D_Z = (q, r, h_z + ε_z)

with the positioning errors ε known from linear runs.  The laser lies along the machine's
diagonal, so the total reading is its length:

    |Σ s_a D_a| · n = R_s          one equation a diagonal, unknown p, q, r

(four equations, Gauss–Newton), and the mean steps of a setup then give its g from
``g_s · D_a = ȳ_s,a`` (three equations, three unknowns).  With g known each step is solved
like in the vector method, now right: ``Δt = G⁺ y − h``.  In the plane E_x(x) and E_y(y) are
taken step by step from the linear runs and one setup is enough.

Assumes: no angular motions at all (neither of mirror nor of the tool point), the laser along
the machine's diagonal.  A laser that is λ off, with a mirror μ off, changes the length by
``λ²/2 − λμ``, of second order: 0.5 µm a metre at 1 mrad.  Cannot see: angles, which go
straight into straightness; positioning, which it is given.

Source: Ibaraki, Goto, Matsubara 2006, eqs. 1–6; the extension to space is derived above
after the idea of Ibaraki & Hata 2010, whose text was not at hand.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.readings import CellReadings, SetupReadings
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.estimate.step_diagonal import angular_effect
from stepdiag_ros.estimate.stepwise import (
    accumulate,
    analytic_jacobian,
    increments,
    knots,
    least_squares,
    linear_ends,
    solution,
    translation_names,
    travel_signs,
)
from stepdiag_ros.model.machine import GeometricErrors

ITERATIONS = 5
"""Gauss–Newton steps for the mean steps; each gains some four digits."""
BLIND = (Unidentifiable(('EAX', 'EBX', 'ECX', 'EAY', 'EBY', 'ECY', 'EAZ', 'EBZ', 'ECZ'),
                        'the new formulation takes angular motions for zero'),
         Unidentifiable(('diagonal length', 'laser'),
                        'a laser off the machine\'s diagonal shortens it in second order'))


def conventional_2006(step: tuple[float, float], pp: np.ndarray, np_: np.ndarray) -> np.ndarray:
    """Eq. 1 with nominal directions: E_x(x), E_y(x), E_x(y), E_y(y) of one block (4,).

    ``pp``, ``np_``: readings (R_x, R_y) of the two setups; any unit, errors come in the same.
    """
    a, b = step
    r = np.hypot(a, b)
    matrix = np.array([[a, b, 0, 0], [0, 0, a, b], [a, -b, 0, 0], [0, 0, -a, b]]) / r
    values = np.linalg.solve(matrix, [pp[0], pp[1], np_[0], np_[1]])
    return values - [a, 0.0, 0.0, b]


def ibaraki_2006(step: tuple[float, float], r_x: np.ndarray, r_y: np.ndarray, e_xx: np.ndarray,
                 e_yy: np.ndarray, alpha_2: float | None = None,
                 printed: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Eqs. 3–6: E_y(x) and E_x(y) of each block (n,) from a pp measurement.

    ``r_x``, ``r_y`` (n,) readings, ``e_xx``, ``e_yy`` (n,) the step's linear errors, known; ``alpha_2``
    the nominal angle of the mirror's normal against X, by default that of the diagonal.
    ``printed``: eq. 5 as it stands instead of (5').
    """
    a, b = step
    alpha_2 = np.arctan2(b, a) if alpha_2 is None else alpha_2
    r_x, r_y = np.asarray(r_x, float), np.asarray(r_y, float)
    length = r_x + r_y
    plain = np.sqrt(length ** 2 - (b + e_yy) ** 2) - (a + e_xx)
    delta = 0.5 * length - r_x
    sine = (a + np.ravel(e_xx)[0]) * np.cos(alpha_2) / (0.5 * length[0] - delta[0])
    if printed:
        e_yx = -sine / np.sin(alpha_2) * (delta - delta[0])
    else:
        e_yx = (sine * r_x - (a + e_xx) * np.cos(alpha_2)) / np.sin(alpha_2)
    turn = np.arctan(e_yx / (a + e_xx))
    return e_yx, (a + e_xx + plain) * np.cos(turn) - (b + e_yy) * np.sin(turn) - (a + e_xx)


# ---- space ------------------------------------------------------------------------------------

def evaluate(cell: CellReadings, linear_ends_m: Mapping[str, float] | None = None,
             angles: GeometricErrors | None = None) -> Solution:
    """The nine translation curves and three squareness errors from four diagonals and linear runs.

    ``linear_ends_m``: EXX(X), EYY(Y), EZZ(Z) by name where no linear setups are in ``cell``.
    ``angles``: known angular motions, whose effect is taken off first.
    """
    names = cell.diagonals('new_formulation', 4)
    known = {}
    for axis, name in enumerate(('EXX', 'EYY', 'EZZ')):
        value = (linear_ends_m or {}).get(name, linear_ends(cell, axis))
        if value is None:
            raise StepdiagError(f'new_formulation: {name} must be known from direct measurement; '
                                f'the log has no lin_{"xyz"[axis]} run')
        known[name] = value
    setups = [cell.setups[n] for n in names]
    signs = np.array([travel_signs(s.sight) for s in setups])
    step = np.array(cell.machine.volume) / cell.steps
    sizes = [len(s.displacement_m) for s in setups]
    readings = [s.displacement_m[:, 0] for s in setups]
    if angles is not None:
        readings = [r - angular_effect(cell, n, angles)[:, 0]
                    for r, n in zip(readings, names, strict=True)]
    ends = np.array(list(known.values()))
    if angles is not None:
        ends = ends - _linear_angular(cell, angles)

    def curves(batch: np.ndarray) -> np.ndarray:
        """(b, Σ readings + 3 linear ends) → (b, 9 (n + 1)) curves [axis, component, knot]."""
        parts = np.split(batch, np.cumsum(sizes), axis=1)
        y = np.stack([np.moveaxis(increments(s.sight, p.T, cell.steps), -1, 0)
                      for s, p in zip(setups, parts[:-1], strict=True)], axis=1)
        mean = y.mean(axis=3)
        steps = _mean_steps(step + parts[-1] / cell.steps, signs, np.einsum('sa,bsa->bs', signs, mean))
        gradient = np.linalg.solve(steps[:, None], mean[..., None])[..., 0]
        moved = least_squares(gradient[:, None, None], np.moveaxis(y, 1, 3))
        error = moved - np.eye(3)[:, None, :] * step
        return np.moveaxis(accumulate(error.reshape(-1, *error.shape[2:])).reshape(
            len(batch), 3, cell.steps + 1, 3), 2, 3).reshape(len(batch), -1)

    value, jacobian = analytic_jacobian(curves, np.concatenate([*readings, ends]))
    variance = np.concatenate([*(s.displacement_sigma_m ** 2 for s in setups),
                               [_end_variance(cell, axis) for axis in range(3)]])
    return _pack('new_formulation', cell, value, jacobian, variance)


def _mean_steps(diagonal: np.ndarray, signs: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Mean steps (b, 3, 3) with rows D_X, D_Y, D_Z from known ``diagonal`` (b, 3) and totals (b, s)."""
    steps = diagonal[..., None] * np.eye(3)
    for _ in range(ITERATIONS):
        vector = np.einsum('sa,bac->bsc', signs, steps)
        length = np.sqrt(np.sum(vector ** 2, axis=-1))
        # d|V_s| by p = D_Y[0], q = D_Z[0], r = D_Z[1].
        by = np.stack([signs[:, 1] * vector[..., 0], signs[:, 2] * vector[..., 0],
                       signs[:, 2] * vector[..., 1]], axis=-1) / length[..., None]
        change = least_squares(by, total - length)
        steps = steps + np.stack([
            np.zeros_like(change),
            np.stack([change[:, 0], 0 * change[:, 0], 0 * change[:, 0]], -1),
            np.stack([change[:, 1], change[:, 2], 0 * change[:, 0]], -1)], axis=1)
    return steps


def _linear_angular(cell: CellReadings, angles: GeometricErrors) -> np.ndarray:
    effects = np.zeros(3)
    for axis in range(3):
        name = f'lin_{"xyz"[axis]}'
        if name in cell.setups:
            effects[axis] = angular_effect(cell, name, angles)[-1, 0]
    return effects


def _end_variance(cell: CellReadings, axis: int) -> float:
    setup = cell.setups.get(f'lin_{"xyz"[axis]}')
    return 0.0 if setup is None else float(2.0 * setup.displacement_sigma_m[-1] ** 2)


def _pack(method: str, cell: CellReadings, value: np.ndarray, jacobian: np.ndarray,
          variance: np.ndarray) -> Solution:
    value = value.reshape(3, 3, cell.steps + 1)
    jacobian = jacobian.reshape(3, 3, cell.steps + 1, -1)
    positions, curves, sensitivity = {}, {}, {}
    for axis, place in enumerate(knots(cell.machine, cell.steps)):
        for component, name in enumerate(translation_names(axis)):
            positions[name], curves[name] = place, value[axis, component]
            sensitivity[name] = jacobian[axis, component]
    return solution(method, positions, curves, sensitivity, variance, unidentifiable=BLIND)


# ---- one plane --------------------------------------------------------------------------------

def plane_curves(setups: list[SetupReadings], axes: tuple[int, int], steps: int, step: np.ndarray,
                 batch: np.ndarray) -> np.ndarray:
    """The two cross curves of a plane: (b, readings) → (b, 2 (n + 1)).

    ``batch`` holds the readings of each setup, then the two positioning curves at the plan's
    positions.  First the second component of the first axis (EYX of plane xy), then the first
    component of the second axis (EXY).
    """
    sizes = [len(s.displacement_m) for s in setups] + [steps + 1]
    parts = np.split(batch, np.cumsum(sizes), axis=1)
    along = [step[axis] + np.diff(curve, axis=1)
             for axis, curve in zip(axes, parts[-2:], strict=True)]
    y = np.stack([np.moveaxis(increments(s.sight, p.T, steps)[list(axes)], -1, 0)
                  for s, p in zip(setups, parts[:-2], strict=True)], axis=1)
    signs = np.array([travel_signs(s.sight)[list(axes)] for s in setups])
    mean = y.mean(axis=3)
    total = np.einsum('sa,bsa->bs', signs, mean)
    first, second = (a.mean(axis=1) for a in along)
    shear = np.zeros_like(first)
    for _ in range(ITERATIONS):
        vector = np.stack([signs[:, 0] * first[:, None] + signs[:, 1] * shear[:, None],
                           signs[:, 1] * second[:, None] + 0 * shear[:, None]], axis=-1)
        length = np.sqrt(np.sum(vector ** 2, axis=-1))
        by = signs[:, 1] * vector[..., 0] / length
        shear = shear + np.sum(by * (total - length), 1) / np.sum(by * by, 1)
    rows = np.stack([np.stack([first, 0 * first], -1), np.stack([shear, second], -1)], axis=1)
    gradient = np.linalg.solve(rows[:, None], mean[..., None])[..., 0]
    curves = []
    for own, other in ((0, 1), (1, 0)):
        rest = y[:, :, own] - gradient[:, :, own, None] * along[own][:, None]
        part = gradient[:, :, other, None]
        curves.append(np.sum(part * rest, axis=1) / np.sum(part * part, axis=1))
    zero = np.zeros_like(curves[0][:, :1])
    return np.concatenate([np.concatenate([zero, np.cumsum(c, axis=1)], axis=1) for c in curves], 1)


def evaluate_plane(cell: CellReadings, plane: str, linear: Mapping[str, np.ndarray]) -> Solution:
    """Straightness and squareness in one plane from one or two stepped face diagonals.

    ``cell`` holds setups ``xy_p`` and/or ``xy_n`` (for plane ``xy``); ``linear`` the two positioning
    curves (n + 1,) [m] by name, e.g. ``EXX`` and ``EYY``, zero at position 0.
    """
    axes = tuple('xyz'.index(letter) for letter in plane)
    setups = [cell.setups[f'{plane}_{s}'] for s in 'pn' if f'{plane}_{s}' in cell.setups]
    if not setups:
        raise StepdiagError(f'new_formulation: no stepped face diagonal {plane}_p or {plane}_n')
    given = [np.asarray(linear[name], float) for name in (f'E{p}{p}' for p in plane.upper())]
    step = np.array(cell.machine.volume) / cell.steps
    reading = np.concatenate([*(s.displacement_m[:, 0] for s in setups), *given])
    value, jacobian = analytic_jacobian(
        lambda batch: plane_curves(setups, axes, cell.steps, step, batch), reading)
    variance = np.concatenate([*(s.displacement_sigma_m ** 2 for s in setups),
                               np.zeros(2 * (cell.steps + 1))])
    letters, places = plane.upper(), knots(cell.machine, cell.steps)
    names = (f'E{letters[1]}{letters[0]}', f'E{letters[0]}{letters[1]}')
    n = cell.steps + 1
    return solution('new_formulation', {names[0]: places[axes[0]], names[1]: places[axes[1]]},
                    {names[0]: value[:n], names[1]: value[n:]},
                    {names[0]: jacobian[:n], names[1]: jacobian[n:]}, variance,
                    square=[{'xy': 'EC0Y', 'xz': 'EB0Z', 'yz': 'EA0Z'}[plane]], unidentifiable=BLIND)
