"""Face diagonals and step face diagonals in one plane.

The plane's two diagonals are body diagonals of a box without height (eqs. 17, 18), and E
and B follow as in :mod:`~stepdiag_ros.estimate.body_diagonal`.  Stepped, each setup gives
one reading for each axis and interval (eqs. 19–22 without their angular terms)

    s_a ΔL − |d_a| h = d · Δt_a,k        in the plane:  Δt = (ΔEXa, ΔEYa)

two setups, two unknowns, solved exactly.  In the XY plane that is EXX, EYX, EXY, EYY and
EC0Y (from the slopes).

Angles.  The paper's angular terms ``∓ h·b·Az(x)``, with the factor ``h² = (4a² + b²)/b²``, appear
with opposite signs in the X and the Y step and so cancel over a step, while its own
eqs. 17, 18 keep ``Az(x)·ab/r``.  With the contract's geometry (flat mirror, FXYZ) the reading at a
stop (x, y) of a diagonal from the origin contains ``−x·d_y·ECX(x)``, exactly the term of
eq. 17, and it is not taken back in the Y step.  Known angles can be given.

Assumes: mirror and laser aligned, no angular motions unless given.  Cannot see: angles;
positioning slopes against the mirror's angle; whatever leaves the plane.

Source: Wang & Liotto 2003, eqs. 17–22.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.body_diagonal import DiagonalTest, diagonal
from stepdiag_ros.estimate.readings import CellReadings
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.estimate.step_diagonal import angular_effect
from stepdiag_ros.estimate.stepwise import accumulate, increments, knots, solution
from stepdiag_ros.model.machine import AXES, GeometricErrors

SQUARE = {'xy': 'EC0Y', 'xz': 'EB0Z', 'yz': 'EA0Z'}
PLANES = tuple(SQUARE)


def displacement_test(cell: CellReadings, plane: str) -> DiagonalTest:
    """E of the plane's diagonals from the stops that lie on them (eqs. 17, 18)."""
    found = {}
    for sign in 'pn':
        setup = cell.setups.get(f'{plane}_{sign}')
        if setup is None:
            continue
        along = (setup.sight.positions - setup.sight.positions[0]) @ setup.sight.direction
        found[f'{plane}_{sign}'] = diagonal(along[::2], (setup.displacement_m[:, 0] - along)[::2])
    if not found:
        raise StepdiagError(f'face_diagonal: no setup {plane}_p or {plane}_n')
    return DiagonalTest(found, 'face_diagonal')


def evaluate(cell: CellReadings, plane: str = 'xy', angles: GeometricErrors | None = None) -> Solution:
    """Four curves and the squareness of a plane from setups ``xy_p`` and ``xy_n`` (plane ``xy``).

    ``angles``: known angular motions, taken off first.
    """
    if plane not in SQUARE:
        raise StepdiagError(f'face_diagonal: plane {plane!r}; choose from {", ".join(PLANES)}')
    names = [f'{plane}_{sign}' for sign in 'pn']
    missing = [n for n in names if n not in cell.setups]
    if missing:
        raise StepdiagError(f'face_diagonal: setup {", ".join(missing)} is missing; '
                            'both diagonals of the face are needed')
    setups = [cell.setups[n] for n in names]
    axes = ['xyz'.index(letter) for letter in plane]
    count = len(setups[0].displacement_m)
    steps = []
    for place, (name, setup) in enumerate(zip(names, setups, strict=True)):
        value = setup.displacement_m[:, 0]
        if angles is not None:
            value = value - angular_effect(cell, name, angles)[:, 0]
        block = np.zeros((count, 1 + 2 * count))
        block[:, 0] = value
        block[:, 1 + place * count:1 + (place + 1) * count] = np.eye(count)
        steps.append(increments(setup.sight, block, cell.steps)[axes])
    steps = np.array(steps)
    directions = np.array([s.sight.direction[axes] for s in setups])
    steps[..., 0] -= (directions * (np.array(cell.machine.volume) / cell.steps)[axes])[..., None]
    curves = accumulate(np.moveaxis(np.tensordot(np.linalg.inv(directions), steps, axes=(1, 0)), 0, 2))
    places, positions, values, sensitivity = knots(cell.machine, cell.steps), {}, {}, {}
    for i, axis in enumerate(axes):
        for j, component in enumerate(axes):
            name = f'E{AXES[component]}{AXES[axis]}'
            positions[name] = places[axis]
            values[name], sensitivity[name] = curves[i, :, j, 0], curves[i, :, j, 1:]
    variance = np.concatenate([s.displacement_sigma_m ** 2 for s in setups])
    found = solution('face_diagonal', positions, values, sensitivity, variance, [SQUARE[plane]])
    return replace(found, unidentifiable=(
        Unidentifiable(('EAX', 'EBX', 'ECX', 'EAY', 'EBY', 'ECY'), 'angles are taken for zero'),
        Unidentifiable((f'E{plane[0].upper() * 2} slope', f'E{plane[1].upper() * 2} slope', 'mirror'),
                       'a constant mirror angle looks like slopes of the positioning errors')))
