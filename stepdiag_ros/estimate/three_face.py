"""Three-face step diagonal: the diagonals of three faces, all from one corner.

Bui et al. step along the diagonals of the XY, XZ and YZ faces that meet in the origin; the
laser stays in one corner and is only turned.  Each face is a plane problem, and a constant
mirror angle is removed mathematically.  Their text was not at hand; what Renishaw and
Dahlem tell of it fits the plane form of the new formulation
(:func:`~stepdiag_ros.estimate.new_formulation.evaluate_plane`), which is used here: with EXX, EYY, EZZ
from linear runs along the edges, a face's one diagonal gives its squareness (the
diagonal's length) and its two straightness curves (the single steps), whatever the angle
of the mirror.  Six curves and three squarenesses from three setups and three lines.

With tilts (the modification announced by Dahlem et al.) the angles come first: every step
of an axis is seen from two faces, two tilts each, four equations for three rotations
(:func:`angles_of`).  Their effect on the distances is computed and taken off, and the rest
goes on as before.

Assumes: the laser along each face's diagonal; no angular motions, or tilts measured.
Cannot see: angles, without tilts.  Then even small ones spoil it: pitch over a face of
half a metre is half a micrometre for each microradian, in the straightness and squareness.

Source: Bui, Hwang, Lee, Park 2012 as described by Renishaw 2016 and by Dahlem et al. 2018.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import new_formulation
from stepdiag_ros.estimate.readings import CellReadings, SetupReadings
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from stepdiag_ros.estimate.step_diagonal import angular_effect
from stepdiag_ros.estimate.stepwise import (
    accumulate,
    analytic_jacobian,
    angle_effect,
    at_stops,
    increments,
    knots,
    rotation_names,
    solution,
)
from stepdiag_ros.model.machine import Curve, GeometricErrors

FACES = ('xy', 'xz', 'yz')


def evaluate(cell: CellReadings, linear: Mapping[str, np.ndarray], tilts: bool = False) -> Solution:
    """Nine translation curves and three squareness errors; with ``tilts`` the angular curves too.

    ``cell`` holds the setups ``xy_p``, ``xz_p``, ``yz_p``; ``linear`` EXX, EYY, EZZ (n + 1,) [m] at the plan's
    positions, as read on the edges through the origin with the tool of the machine (zero at 0).
    """
    missing = [f'{f}_p' for f in FACES if f'{f}_p' not in cell.setups]
    if missing:
        raise StepdiagError(f'three_face: setup {", ".join(missing)} is missing')
    given = {}
    for name in ('EXX', 'EYY', 'EZZ'):
        if name not in linear:
            raise StepdiagError(f'three_face: {name} must be given from a linear run')
        given[name] = np.asarray(linear[name], float)
    angles, plain = None, cell
    if tilts:
        angles = angles_of(cell)
        cell = replace(cell, setups={n: _without_angles(cell, n, angles) for n in cell.setups})
        given = {name: value - _edge_effect(cell, axis, angles)
                 for axis, (name, value) in enumerate(given.items())}
    places, n = knots(cell.machine, cell.steps), cell.steps + 1
    step = np.array(cell.machine.volume) / cell.steps
    setups = [cell.setups[f'{f}_p'] for f in FACES]
    sizes = [len(s.displacement_m) for s in setups]

    def curves(batch: np.ndarray) -> np.ndarray:
        parts = np.split(batch, np.cumsum([*sizes, n, n]), axis=1)
        out = [*parts[3:]]
        for face, setup, part in zip(FACES, setups, parts[:3], strict=True):
            axes = tuple('xyz'.index(letter) for letter in face)
            own = np.concatenate([part, parts[3 + axes[0]], parts[3 + axes[1]]], axis=1)
            out.append(new_formulation.plane_curves([setup], axes, cell.steps, step, own))
        return np.concatenate(out, axis=1)

    value, jacobian = analytic_jacobian(
        curves, np.concatenate([*(s.displacement_m[:, 0] for s in setups), *given.values()]))
    names = ['EXX', 'EYY', 'EZZ', 'EYX', 'EXY', 'EZX', 'EXZ', 'EZY', 'EYZ']
    positions = {name: places['XYZ'.index(name[2])] for name in names}
    values = dict(zip(names, value.reshape(-1, n), strict=True))
    variance = np.concatenate([*(s.displacement_sigma_m ** 2 for s in setups), np.zeros(3 * n)])
    if angles is not None:
        by_tilt, turn, tilt_variance = _tilt_sensitivity(plain)
        jacobian = np.concatenate([jacobian, jacobian @ by_tilt], axis=1)
        variance = np.concatenate([variance, tilt_variance])
    sensitivity = dict(zip(names, jacobian.reshape(9, n, -1), strict=True))
    blind = (Unidentifiable(('EAX', 'EBX', 'ECX', 'EAY', 'EBY', 'ECY', 'EAZ', 'EBZ', 'ECZ'),
                            'angular motions are taken for zero; measure the tilt'),)
    if angles is not None:
        blind = (Unidentifiable(('laser',), 'a laser off the face\'s diagonal shortens it in '
                                'second order'),)
        for k, (name, curve) in enumerate(angles.curves.items()):
            positions[name], values[name] = curve.position, curve.value
            lengths = np.zeros((n, jacobian.shape[1] - turn.shape[-1]))
            sensitivity[name] = np.concatenate([lengths, turn[k // 3, k % 3]], axis=1)
    return solution('three_face', positions, values, sensitivity, variance, unidentifiable=blind)


def angles_of(cell: CellReadings) -> GeometricErrors:
    """The nine angular curves from the spots of the three faces.

    Each axis steps in two faces; ``(α, β) = (y, −x)/2L`` of each, four equations for three rotations.
    """
    tilts = {f: _tilts(cell.setups[f'{f}_p'])[..., None] for f in FACES}
    turn, places = _turns(cell, tilts)[..., 0], knots(cell.machine, cell.steps)
    return GeometricErrors({name: Curve(places[axis], turn[axis, k])
                            for axis in range(3) for k, name in enumerate(rotation_names(axis))}, {})


def _turns(cell: CellReadings, tilts: Mapping[str, np.ndarray]) -> np.ndarray:
    """Angular curves (axis, component, knot, c) from tilts (stops, 2, c) of each face."""
    seen = {f: increments(cell.setups[f'{f}_p'].sight, tilts[f], cell.steps) for f in FACES}
    turns = []
    for axis in range(3):
        faces = [f for f in FACES if 'xyz'[axis] in f]
        matrix = np.concatenate([cell.setups[f'{f}_p'].sight.triad[:2] for f in faces])
        right = np.concatenate([np.moveaxis(seen[f][axis], 1, 0) for f in faces])
        turns.append(accumulate(np.tensordot(np.linalg.pinv(matrix), right, axes=(1, 0))))
    return np.array(turns)


def _tilts(setup: SetupReadings) -> np.ndarray:
    """(α, β) (stops, 2) [rad] of a face."""
    if setup.spot_m is None:
        raise StepdiagError(f'three_face: setup {setup.sight.name} has no spots; tilts need a PSD')
    return np.stack([setup.spot_m[:, 1], -setup.spot_m[:, 0]], axis=1) / (2.0 * _lengths(setup)[:, None])


def _lengths(setup: SetupReadings) -> np.ndarray:
    sight = setup.sight
    length = sight.standoff + (sight.positions - sight.positions[0]) @ sight.direction
    if length.min() <= 0.0:
        raise StepdiagError(f'three_face: setup {sight.name} has no standoff; the spot needs a length')
    return length


def _tilt_sensitivity(cell: CellReadings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By unit tilts (c of them, α and β of each stop of each face): the corrected inputs of the plane
    forms (distances and positioning curves, c), the angular curves (3, 3, n + 1, c); the tilts'
    variances (c,) [rad²]."""
    setups = [cell.setups[f'{f}_p'] for f in FACES]
    counts = [len(s.displacement_m) for s in setups]
    total, first = 2 * sum(counts), 0
    tilts, variance = {}, []
    for face, setup, count in zip(FACES, setups, counts, strict=True):
        unit = np.zeros((count, 2, total))
        for k in range(2):
            unit[np.arange(count), k, first + k * count + np.arange(count)] = 1.0
        tilts[face], first = unit, first + 2 * count
        variance += [(setup.spot_sigma_m / (2.0 * _lengths(setup))) ** 2] * 2
    turn = _turns(cell, tilts)
    rows = []
    for setup in setups:
        change = -np.einsum('nk,nkc->nc', angle_effect(setup.sight, cell.machine),
                            at_stops(setup.sight, cell.machine, turn))
        rows.append(change - change[:1])
    tool = np.array(cell.machine.tool)
    for axis in range(3):
        rows.append(-np.moveaxis(np.cross(np.moveaxis(turn[axis], 0, -1), tool), -1, 0)[axis])
    return np.concatenate(rows), turn, np.concatenate(variance)


def _without_angles(cell: CellReadings, name: str, angles: GeometricErrors) -> SetupReadings:
    setup = cell.setups[name]
    return replace(setup, displacement_m=setup.displacement_m - angular_effect(cell, name, angles))


def _edge_effect(cell: CellReadings, axis: int, angles: GeometricErrors) -> np.ndarray:
    """What the angles add to a linear run along the edge: the tool's arm, ``e_a · (θ × τ)``."""
    turn = np.array([angles.curves[name].value for name in rotation_names(axis)])
    return np.cross(turn.T, np.array(cell.machine.tool))[:, axis]
