"""Logs on which methods of the literature fail are named, others are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate.cautions import ANGLES, cautions
from stepdiag_ros.estimate.readings import sight_of, simulate
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


def test_diagonals_with_ways_of_their_own_need_lines_too():
    cell = readings(BOX, uneven(BOX), lines=())
    own = {f'body_{n}': replace(cell.setups[n], sight=replace(cell.setups[n].sight, kind='body diagonal'))
           for n in DIAGONALS}
    found = cautions(replace(cell, setups=own), None)
    assert len(found) == 1 and found[0].startswith('no linear setup of X, Y, Z:')
