"""Sequential step diagonal, the vector method of Wang (conventional evaluation).

On each body diagonal the axes move one at a time; after every step the distance to
a flat mirror is read.  Taking the laser and mirror to be aligned to the nominal
diagonal and the machine to be free of angular motions, the mirror's sideways travel
does not matter and the step of axis a in setup s reads (eqs. 5–16 without their
angular terms)

    s_a ΔL − |d_a| h = d_s · Δt_a,k

with the change ``Δt = (ΔEXa, ΔEYa, ΔEZa)`` of the axis's translation errors.  Three
diagonals give the three components, four give one redundancy: with the matrix D of
the diagonals' directions, ``Δt = D⁺ y``.  For signs s the four rows
``(s_x, s_y, s_z)`` are orthogonal in pairs up to one, so that no component is
badly determined.  Slopes of the straightness curves are squareness.

Angular motions.  With mirror and lever in the contract's geometry a rotation θ of
the tool at a stop adds ``(θ_X × l_X + θ_Y × l_Y + θ_Z × τ)·d + (Σθ × d)·w`` to the
reading, ``l`` being the arms from each axis's carriage to the tool point and ``w`` how
far the stop lies beside the beam.  Given the angles (from other measurements, as
Wang & Liotto propose) they are computed exactly and taken off.  The angular terms
printed in eqs. 5–16 are not used: those of one diagonal's three steps sum to zero,
while eq. 1 of the same paper keeps a sum, and neither agrees with the exact model
(see docs/papers).

``slopes='removed'`` is the evaluation that practice falls back on: a straight line
in the steps of each axis and setup is ascribed to the mirror, and only the diagonal's
total is kept and spread over the axes with the smallest correction.  Of the six slopes
the totals tell as many combinations as there are diagonals: four diagonals tell the
squareness errors, three do not.  What they leave open stays as it is taken (zero), with
the uncertainty of not knowing it.

Assumes: no mirror and laser misalignment (or slopes removed), no angular motions (or
angles given).  Cannot see: angles.  A mirror at μ mixes the axes' positioning
slopes: it adds μ·h·sin φ a step on one axis and takes it off another.

Source: Wang & Liotto 2003, eqs. 5–16; the criticism is Chapman's, Soons' and Ibaraki's.
"""

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.readings import CellReadings, observe
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.estimate.stepwise import accumulate, increments, knots, solution, translation_names
from stepdiag_ros.model.machine import GeometricErrors

BLIND = (Unidentifiable(('EAX', 'EBX', 'ECX', 'EAY', 'EBY', 'ECY', 'EAZ', 'EBZ', 'ECZ'),
                        'the vector method reads distances only and takes angles for zero'),
         Unidentifiable(('EXX slope', 'EYY slope', 'EZZ slope', 'mirror', 'laser'),
                        'a constant misalignment of a mirror looks like slopes of the '
                        'positioning errors'))

OPEN_SLOPE = 1e-3
"""Standard deviation [m/m, rad] of a slope that nothing tells: wider than any machine's, as in the full model."""
_PLACES = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""The six slopes, (axis, component): EXX, EYY, EZZ, EXY, EXZ, EYZ."""


def angular_effect(cell: CellReadings, name: str, angles: GeometricErrors) -> np.ndarray:
    """How much given angular motions change the readings of a setup, (n, beams) [m]."""
    sight = cell.setups[name].sight
    bent, _ = observe(sight, cell.machine, angles)
    straight, _ = observe(sight, cell.machine, GeometricErrors.zero())
    return (bent - bent[0]) - (straight - straight[0])


def vector_steps(directions: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Changes of translation (axes, n, 3, …) from steps (setups, axes, n, …) less their nominal part.

    ``directions`` (setups, 3): the gradients g.
    """
    inverse = np.linalg.pinv(directions)
    return np.moveaxis(np.tensordot(inverse, steps, axes=(1, 0)), 0, 2)


def nominal_steps(cell: CellReadings, directions: np.ndarray) -> np.ndarray:
    """What error-free steps read, (setups, 3, 1) [m]."""
    step = np.array(cell.machine.volume) / cell.steps
    return (directions * step)[..., None]


def evaluate(cell: CellReadings, angles: GeometricErrors | None = None,
             slopes: str = 'kept') -> Solution:
    """The nine translation curves and three squareness errors by the vector method.

    ``angles``: known angular motions, taken off first.  ``slopes``: ``kept`` or ``removed``.
    """
    if slopes not in ('kept', 'removed'):
        raise StepdiagError(f"step_diagonal: slopes={slopes!r}; give 'kept' or 'removed'")
    names = cell.diagonals('step_diagonal')
    directions = np.array([cell.setups[n].sight.direction for n in names])
    readings, counts, variance = [], [], []
    for name in names:
        setup = cell.setups[name]
        value = setup.displacement_m[:, 0]
        if angles is not None:
            value = value - angular_effect(cell, name, angles)[:, 0]
        readings.append(value)
        counts.append(len(value))
        variance.append(setup.displacement_sigma_m ** 2)
    total = sum(counts)
    # The readings and the unit vectors of every reading go through one linear evaluation: the
    # first column gives the values, the others the sensitivities for the propagation.
    steps, first = [], 0
    for name, value, count in zip(names, readings, counts, strict=True):
        block = np.zeros((count, 1 + total))
        block[:, 0] = value
        block[:, 1 + first:1 + first + count] = np.eye(count)
        steps.append(increments(cell.setups[name].sight, block, cell.steps))
        first += count
    steps = np.array(steps)
    steps[..., 0] -= nominal_steps(cell, directions)
    if slopes == 'removed':
        steps = _without_slopes(directions, steps, np.array(cell.machine.volume))
        variance.append(np.full(len(_PLACES), OPEN_SLOPE**2))
    curves = accumulate(vector_steps(directions, steps))
    positions, values, sensitivity = {}, {}, {}
    for axis, place in enumerate(knots(cell.machine, cell.steps)):
        for component, name in enumerate(translation_names(axis)):
            positions[name] = place
            values[name] = curves[axis, :, component, 0]
            sensitivity[name] = curves[axis, :, component, 1:]
    return solution('step_diagonal', positions, values, sensitivity, np.concatenate(variance),
                    unidentifiable=BLIND)


def _without_slopes(directions: np.ndarray, steps: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Mean steps replaced by the smallest machine errors that explain the diagonals' totals.

    Unknown are the slopes of EXX, EYY, EZZ and the three squareness errors (the mean of Δt with
    the frame's X along the X line, Y in the XY plane); a mirror moves reading between the axes
    of one setup but leaves the sum of a whole XYZ step.  Six columns are appended: what slopes of
    one that the totals do not tell would add to the steps.
    """
    mean, step = steps.mean(axis=2), volume / steps.shape[2]
    signs = np.sign(directions)
    total = np.einsum('sa,sa...->s...', signs, mean)
    # Slopes (per metre) → diagonal's total a step.
    matrix = np.stack([signs[:, axis] * directions[:, part] * step[axis] for axis, part in _PLACES], axis=1)
    inverse = np.linalg.pinv(matrix)
    told = np.tensordot(inverse, total, axes=(1, 0))
    model = _steps_of(directions, step, told) - mean
    left_open = _steps_of(directions, step, np.eye(len(_PLACES)) - inverse @ matrix)
    return np.concatenate([steps + model[:, :, None],
                           np.broadcast_to(left_open[:, :, None], (*steps.shape[:3], len(_PLACES)))], axis=-1)


def _steps_of(directions: np.ndarray, step: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Readings of the mean steps (setups, axes, columns) [m] by the six slopes (6, columns)."""
    model = np.zeros((*directions.shape, slopes.shape[1]))
    for (axis, part), value in zip(_PLACES, slopes, strict=True):
        model[:, axis] += np.multiply.outer(directions[:, part], step[axis] * value)
    return model
