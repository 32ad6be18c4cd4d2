"""Logs on which methods of the literature fail are named, others are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate import face_diagonal
from stepdiag_ros.estimate.cautions import ANGLES, cautions
from stepdiag_ros.estimate.of_ways import faces
from stepdiag_ros.estimate.readings import face_sight, sight_of, simulate
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.step_diagonal import evaluate
from stepdiag_ros.estimate.stepwise import increments
from stepdiag_ros.model.description import DIAGONALS, LINEAR, Description, Machine, Plan, Setup
from stepdiag_ros.model.machine import Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

CUBE = Machine('cube', 'FXYZ', (0.4, 0.4, 0.4), (0.0, 0.0, 0.0))
BOX = Machine('box', 'FXYZ', (0.4, 0.3, 0.5), (0.0, 0.0, 0.0))
STEPS = 4


def readings(machine, errors, mirrors=None, lines=LINEAR):
    setups = {n: Setup(n, 0.2, (0.02, 0.0), ((0.0, 0.0),), machine.volume['xyz'.index(n[-1])] if n in LINEAR else None,
                       2 if n in LINEAR else None) for n in (*DIAGONALS, *lines)}
    description = Description(machine, Plan(STEPS, 'XYZ', 1), setups)
    return simulate(machine, STEPS, [sight_of(description, n) for n in setups], errors, mirrors, sigma_m=1e-7)


def uneven(machine):
    return GeometricErrors({f'E{a}{a}': Curve(np.array([0.0, v]), np.array([0.0, e])) for a, v, e in zip(
        'XYZ', machine.volume, (30e-6, -10e-6, 4e-6), strict=True)}, {})


def sums(cell, name):
    setup = cell.setups[name]
    return np.abs(increments(setup.sight, setup.displacement_m[:, 0], STEPS).sum(axis=1))


def squared(machine, errors):
    """Mirrors turned until X, Y and Z read alike in every diagonal, by Newton's method."""
    turns = dict.fromkeys(DIAGONALS, (0.0, 0.0))
    for _ in range(3):
        own = readings(machine, errors, {n: Misalignment(mirror=t) for n, t in turns.items()})
        for name in DIAGONALS:
            def apart(cell, name=name):
                x, y, z = sums(cell, name)
                return np.array([x - y, y - z])
            slopes = [(apart(readings(machine, errors, {name: Misalignment(mirror=tuple(
                np.array(turns[name]) + 1e-5 * unit))})) - apart(own)) / 1e-5 for unit in np.eye(2)]
            turns[name] = tuple(np.array(turns[name]) - np.linalg.solve(np.array(slopes).T, apart(own)))
    return {n: Misalignment(mirror=t) for n, t in turns.items()}


def test_mirrors_squared_to_the_diagonals_are_named():
    errors = uneven(CUBE)
    mirrors = squared(CUBE, errors)
    cell = readings(CUBE, errors, mirrors)
    found = cautions(cell, None)
    assert len(found) == 3 and all('read alike in every diagonal' in text for text in found)
    # What the caution says of the vector method: the mean of all axes, whatever was put in.
    ends = [evaluate(cell).curve(n)[1][-1] for n in ('EXX', 'EYY', 'EZZ')]
    assert ends == pytest.approx([8e-6] * 3, abs=2e-8)


def test_the_same_machine_with_mirrors_as_they_fall_is_not():
    errors = uneven(CUBE)
    turned = {n: Misalignment(mirror=(2e-4, -1e-4)) for n in DIAGONALS}
    assert cautions(readings(CUBE, errors, turned), None) == ()
    assert cautions(readings(CUBE, errors), None) == ()


def test_axes_with_steps_of_their_own_are_never_alike():
    assert cautions(readings(BOX, GeometricErrors.zero()), None) == ()


def test_missing_lines_are_named():
    found = cautions(readings(BOX, uneven(BOX), lines=('lin_x',)), None)
    assert len(found) == 1 and found[0].startswith('no linear setup of Y, Z:') and 'machine_c.md' in found[0]


def solution_with(yaw, sigma):
    place = np.linspace(0.0, 0.4, STEPS + 1)
    names = tuple((name, k) for name in ANGLES for k in range(len(place)))
    value = np.array([yaw * place[k] / 0.4 if name == 'ECX' else 0.0 for name, k in names])
    return Solution('enhanced', dict.fromkeys(ANGLES, place), names, value, sigma**2 * np.eye(len(names)))


def test_angles_beyond_their_uncertainty_are_named():
    errors = solution_with(40e-6, 0.0).errors
    cell = readings(BOX, errors)
    found = cautions(cell, solution_with(40e-6, 1e-7))
    assert len(found) == 2 and 'the angular motions found move' in found[0]
    # The yaw at the end, half of it on average along X.
    assert re.search(r'shear the volume as a squareness EC0Y of (19\.99|20\.00)\d ± \d', found[1]), found[1]
    moved = max(abs(cell.setups[n].displacement_m[:, 0]
                    - readings(BOX, GeometricErrors.zero()).setups[n].displacement_m[:, 0]).max() for n in DIAGONALS)
    assert f'{1e6 * moved:.3f} ±' in found[0]
    assert cautions(cell, solution_with(40e-6, 1e-4)) == ()
    assert cautions(cell, solution_with(0.0, 1e-7)) == ()


def test_a_log_without_angles_says_that_they_are_unseen():
    cell = readings(BOX, GeometricErrors.zero())
    blind = replace(cell, setups={n: replace(s, spot_m=None) for n, s in cell.setups.items()})
    found = cautions(blind, solution_with(0.0, 1e-7))
    assert len(found) == 1 and 'the log shows no angles' in found[0]


def under_own_names(cell, stops=slice(None)):
    """The same readings as those of setups with ways of their own, at all stops or at some."""
    own = {}
    for name, setup in cell.setups.items():
        kind = 'line' if name in LINEAR else 'body step diagonal' if stops == slice(None) else 'body diagonal'
        cut = slice(None) if name in LINEAR else stops
        sight = replace(setup.sight, name=f'own_{name}', kind=kind, positions=setup.sight.positions[cut],
                        axis=setup.sight.axis[cut])
        own[sight.name] = replace(setup, sight=sight, displacement_m=setup.displacement_m[cut],
                                  displacement_sigma_m=setup.displacement_sigma_m[cut], spot_m=setup.spot_m[cut])
    return replace(cell, setups=own)


def test_what_is_said_does_not_depend_on_how_the_log_calls_its_setups():
    mirrors = squared(CUBE, uneven(CUBE))
    solution = solution_with(40e-6, 1e-7)
    for cell, given in ((readings(CUBE, uneven(CUBE), mirrors), None), (readings(BOX, solution.errors), solution),
                        (readings(BOX, uneven(BOX), lines=('lin_x',)), None)):
        said = cautions(cell, given)
        assert said and cautions(under_own_names(cell), given) == tuple(text.replace(' (k = 2; ', ' (k = 2; own_')
                                                                        .replace('own_own_', 'own_') for text in said)


def test_diagonals_in_one_motion_need_lines_and_do_not_see_what_a_yaw_hides():
    found = cautions(under_own_names(readings(BOX, uneven(BOX), lines=()), slice(None, None, 3)), None)
    assert len(found) == 1 and found[0].startswith('no linear setup of X, Y, Z:')
    solution = solution_with(40e-6, 1e-7)
    [sheared] = cautions(under_own_names(readings(BOX, solution.errors), slice(None, None, 3)), solution)
    assert 'shear the volume as a squareness EC0Y of' in sheared


def plate(x_m, y_m, turns):
    """Both face diagonals of a plate under names of a user's own, mirrors turned in the plane [rad], and the lines."""
    sights = [face_sight(CUBE, 'xy', sign, STEPS, 0.2) for sign in 'pn']
    mirrors = {s.name: Misalignment(mirror=tuple(turn * (s.triad[:2] @ [0.0, 0.0, 1.0])))
               for s, turn in zip(sights, turns, strict=True)}
    errors = GeometricErrors({f'E{a}{a}': Curve(np.array([0.0, 0.4]), np.array([0.0, e]))
                              for a, e in (('X', x_m), ('Y', y_m))}, {})
    cell = simulate(CUBE, STEPS, sights, errors, mirrors, sigma_m=1e-7)
    lines = {name: setup for name, setup in readings(CUBE, errors).setups.items() if name in LINEAR}
    own = {f'plate_{name}': replace(setup, sight=replace(setup.sight, name=f'plate_{name}', kind='face step diagonal'))
           for name, setup in cell.setups.items()}
    return replace(cell, setups=own | lines)


def test_a_mirror_squared_to_the_diagonal_of_a_face_is_named():
    """The case of 2006 itself: a plate, its two diagonals, under any name."""
    def apart(turns):
        changes = [(np.diff(s.displacement_m[:, 0]), s.sight.axis[1:])
                   for s in plate(30e-6, -10e-6, turns).setups.values() if s.sight.kind]
        return np.array([abs(c[a == 0].sum()) - abs(c[a == 1].sum()) for c, a in changes])
    turns = -apart((0.0, 0.0)) * 1e-5 / (apart((1e-5, 1e-5)) - apart((0.0, 0.0)))
    [found] = cautions(plate(30e-6, -10e-6, turns), None)
    assert found.startswith('X and Y read alike in every face diagonal') and 'mirror_squared.md' in found
    ends = [face_diagonal.evaluate(faces(plate(30e-6, -10e-6, turns))).curve(n)[1][-1] for n in ('EXX', 'EYY')]
    assert ends == pytest.approx([10e-6] * 2, abs=2e-8)
    assert cautions(plate(30e-6, -10e-6, (0.0, 0.0)), None) == ()
    # One mirror of two turned: the other still tells the axes apart.
    assert cautions(plate(30e-6, -10e-6, (turns[0], 0.0)), None) == ()
