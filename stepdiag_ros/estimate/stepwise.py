"""What all step methods share: a reading's change, step by step, and the way back to curves.

Let a setup look along ``d`` and its axis ``a`` move by one step from knot k to k + 1.
Divided by the direction of travel, the reading's change is

    s · ΔL = g · (h e_a + Δt_k),      g = m/(b·m)

where ``h`` is the step, ``Δt_k`` the change of the axis's translation error (three
components) and ``g`` the setup's *gradient*: the reciprocal of the mirror's normal
``m`` along the beam ``b``.  Nothing is linearised here; without angular motions ``g``
is constant in a setup, and with perfect alignment it is ``d``.  The methods differ in
what they take for ``g``.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from stepdiag_ros.estimate.gauge import GAUGE, SLOPES, STRAIGHTNESS, slope_weights
from stepdiag_ros.estimate.readings import Sight, observe
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment


def travel_signs(sight: Sight) -> np.ndarray:
    """Direction of travel (3,) of each axis along the setup: +1, −1, or 0 (does not move)."""
    return np.sign(sight.positions[-1] - sight.positions[0])


def increments(sight: Sight, values: np.ndarray, steps: int) -> np.ndarray:
    """Changes ``s · ΔL`` (3, steps, …) by moving axis and interval from readings (n, …).

    Intervals are counted from the machine's origin, whichever way the setup ran.
    Axes that do not move in the setup get NaN.
    """
    change = np.diff(values, axis=0)
    moved, signs = sight.axis[1:], travel_signs(sight)
    out = np.full((3, steps, *values.shape[1:]), np.nan, values.dtype)
    for axis in range(3):
        own = change[moved == axis]
        if len(own):
            out[axis] = own if signs[axis] > 0 else -own[::-1]
    return out


def accumulate(steps: np.ndarray) -> np.ndarray:
    """Curves (axes, n + 1, …) from changes (axes, n, …): zero at position 0."""
    zero = np.zeros_like(steps[:, :1])
    return np.concatenate([zero, np.cumsum(steps, axis=1)], axis=1)


def knots(machine: Machine, steps: int) -> np.ndarray:
    """Positions (3, steps + 1) [m] of the plan."""
    return np.array([np.linspace(0.0, length, steps + 1) for length in machine.volume])


def solution(method: str, positions: Mapping[str, np.ndarray], curves: Mapping[str, np.ndarray],
             sensitivity: Mapping[str, np.ndarray] | None = None,
             variance: np.ndarray | None = None, square: Sequence[str] = SQUARENESS,
             unidentifiable: tuple[Unidentifiable, ...] = (),
             misalignments: Mapping[str, Misalignment] | None = None, **more) -> Solution:
    """A :class:`Solution` in the reference lines of ISO 230-1 from raw curves.

    ``curves``: name → (k,) values, squareness still in the slopes.  ``sensitivity``: name →
    (k, readings), how the values follow from independent readings of ``variance`` (readings,).
    ``square`` names the squareness errors whose two straightness curves are at hand.
    """
    order = [name for name in CURVES if name in curves]
    names, values, rows, slopes = [], [], [], {}
    for name in order:
        position = np.asarray(positions[name])
        # Value and sensitivities go through the same linear map, as columns of one matrix.
        block = np.asarray(curves[name], float)[:, None]
        if sensitivity is not None:
            block = np.concatenate([block, sensitivity[name]], axis=1)
        if name in STRAIGHTNESS:
            slopes[name] = slope_weights(position) @ block
            # The line passes through the knot at coordinate 0, where curves are zero by definition.
            origin = position[np.argmin(np.abs(position))]
            block = block - np.outer(position - origin, slopes[name])
        names += [(name, i) for i in range(len(position))]
        values.append(block[:, 0])
        rows.append(block[:, 1:])
    for name in square:
        slope = sum(sign * slopes[curve] for curve, sign in SLOPES[name])
        names.append((name, -1))
        values.append(slope[:1])
        rows.append(slope[None, 1:])
    value = np.concatenate(values)
    matrix = np.concatenate(rows)
    spread = np.zeros(matrix.shape[1]) if variance is None else variance
    with np.errstate(invalid='ignore', over='ignore'):   # of readings beyond all numbers the uncertainty is none
        covariance = (matrix * spread) @ matrix.T
    return Solution(method, {n: np.asarray(positions[n]) for n in order}, tuple(names), value,
                    covariance, gauge=GAUGE, unidentifiable=unidentifiable,
                    misalignments=misalignments or {}, **more)


@lru_cache(maxsize=64)
def angle_effect(sight: Sight, machine: Machine) -> np.ndarray:
    """Distance of beam 0 by each of the nine angles of the axes (EAX … ECZ) at each stop, (n, 9) [m/rad], to read."""
    small, effect = 1e-5, []
    for axis in range(3):
        for name in rotation_names(axis):
            sides = [observe(sight, machine, GeometricErrors(
                {name: Curve(np.zeros(1), np.full(1, turn))}, {}))[0][:, 0] for turn in (small, -small)]
            effect.append((sides[0] - sides[1]) / (2.0 * small))
    table = np.stack(effect, axis=1)
    table.flags.writeable = False
    return table


def at_stops(sight: Sight, machine: Machine, curves: np.ndarray) -> np.ndarray:
    """Nine curves (axis, component, knots, c) at a setup's stops (n, 9, c), straight between knots."""
    steps, out = curves.shape[2] - 1, []
    for axis in range(3):
        place = sight.positions[:, axis] / machine.volume[axis] * steps
        low = np.clip(np.floor(place + 1e-6).astype(int), 0, steps - 1)
        part = (place - low)[:, None]
        out.append(curves[axis][:, low] * (1.0 - part) + curves[axis][:, low + 1] * part)
    return np.moveaxis(np.concatenate(out), 0, 1)


def translation_names(axis: int) -> tuple[str, str, str]:
    """``EXa EYa EZa`` of axis number ``axis``."""
    return tuple(f'E{motion}{AXES[axis]}' for motion in 'XYZ')


def rotation_names(axis: int) -> tuple[str, str, str]:
    """``EAa EBa ECa`` of axis number ``axis``."""
    return tuple(f'E{motion}{AXES[axis]}' for motion in 'ABC')


def analytic_jacobian(function, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (p,) and Jacobian (p, r) of an analytic function of batches (b, r) → (b, p).

    By a complex step: exact to rounding, since nothing is subtracted.  The function may use
    arithmetic, roots and solves, but no absolute value and no conjugate.
    """
    tiny = 1e-30
    value = function(reading[None])[0]
    bent = function(reading + 1j * tiny * np.eye(reading.size))
    return value.real, (bent.imag / tiny).T


def least_squares(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``(MᵀM)⁻¹ Mᵀ r`` for batches of well-conditioned matrices (…, m, n), (…, m); analytic."""
    transposed = np.swapaxes(matrix, -1, -2)
    return np.linalg.solve(transposed @ matrix, (transposed @ right[..., None]))[..., 0]


def linear_ends(cell, axis: int) -> float | None:
    """EXX at X (or EYY at Y, EZZ at Z) from a linear setup's readings [m]; None where there is none.

    A run that ends short of the volume is continued by its mean slope.
    """
    setup = cell.setups.get(f'lin_{"xyz"[axis]}')
    if setup is None:
        return None
    travel = setup.sight.positions[-1, axis] - setup.sight.positions[0, axis]
    return (setup.displacement_m[-1, 0] - travel) * cell.machine.volume[axis] / travel
