"""Ibaraki's new formulation: Table 1, misaligned mirrors and lasers, plane and space."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.new_formulation import (
    conventional_2006,
    evaluate,
    evaluate_plane,
    ibaraki_2006,
)
from stepdiag_ros.estimate.readings import face_sight, simulate
from stepdiag_ros.estimate.step_diagonal import evaluate as evaluate_vector
from stepdiag_ros.model.description import DIAGONALS, LINEAR
from stepdiag_ros.model.machine import GeometricErrors, tool_pose
from stepdiag_ros.model.path import local_triad
from stepdiag_ros.model.sensor import Misalignment

STEP = 10.0
"""Side of the block [mm]; Table 1 does not say it, its second-order entries of 0.0002 want ten."""
#        given E_x(x), E_y(x), E_x(y), E_y(y)      conventional, as printed
TABLE_1 = {'a': ((0.0, 0.0, 0.0, 0.1), (-0.05, 0.0, 0.0, 0.15)),
           'b': ((0.1, 0.0, 0.0, 0.1), (0.1, 0.0, 0.0, 0.1)),
           'c': ((0.0, 0.0, 0.1, 0.0), (-0.0002, 0.0, 0.1000, 0.0002))}


def block(given):
    """Readings (R_x, R_y) of pp and np, laser along the machine's diagonal, mirror square to it."""
    e_xx, e_yx, e_xy, e_yy = given
    x, y = np.array([STEP + e_xx, e_yx]), np.array([e_xy, STEP + e_yy])
    readings = []
    for sign in (1.0, -1.0):
        laser = (sign * x + y) / np.linalg.norm(sign * x + y)
        readings.append((sign * x @ laser, y @ laser))
    return readings


def turned(estimate):
    """Rotated until E_y(x) is zero, as the table's caption says."""
    e_xx, e_yx, e_xy, e_yy = estimate
    angle = np.arctan2(e_yx, STEP + e_xx)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    x, y = rotation @ [STEP + e_xx, e_yx], rotation @ [e_xy, STEP + e_yy]
    return np.array([x[0] - STEP, x[1], y[0], y[1] - STEP])


@pytest.mark.parametrize('case', TABLE_1)
def test_table_1_conventional(case):
    given, printed = TABLE_1[case]
    np.testing.assert_allclose(turned(conventional_2006((STEP, STEP), *block(given))), printed,
                               atol=6e-4 if case == 'a' else 6e-5)


@pytest.mark.parametrize('case', TABLE_1)
def test_table_1_new_formulation_is_right_in_all(case):
    e_xx, _, e_xy, e_yy = TABLE_1[case][0]
    (r_x, r_y), _ = block(TABLE_1[case][0])
    e_yx, found = ibaraki_2006((STEP, STEP), [r_x], [r_y], np.array([e_xx]), np.array([e_yy]))
    assert e_yx[0] == pytest.approx(0.0, abs=1e-12)
    assert found[0] == pytest.approx(e_xy, abs=1e-12)


def blocks_2d(seed=3):
    """Six blocks of 10 mm as in the case study, errors below a micrometre, mirror 1 mrad, laser 0.2 mrad off."""
    rng = np.random.default_rng(seed)
    e_xx, e_yx, e_xy, e_yy = rng.normal(0, 2e-4, (4, 6))
    e_yx[0] = 0.0
    laser, normal = (np.array([np.cos(t), np.sin(t)]) for t in (np.pi / 4 + 2e-4, np.pi / 4 + 1e-3))
    gradient = normal / (normal @ laser)
    return e_xx, e_yx, e_xy, e_yy, gradient @ [STEP + e_xx, e_yx], gradient @ [e_xy, STEP + e_yy]


def test_straightness_from_block_to_block():
    e_xx, e_yx, e_xy, e_yy, r_x, r_y = blocks_2d()
    found_yx, found_xy = ibaraki_2006((STEP, STEP), r_x, r_y, e_xx, e_yy)
    # Mirror times error: 1 mrad of 0.2 µm; laser times mirror on 14 mm in the length.
    np.testing.assert_allclose(found_yx, e_yx, atol=2e-6)
    np.testing.assert_allclose(found_xy, e_xy, atol=6e-6)


def test_equation_5_as_printed_holds_while_the_diagonal_keeps_its_length():
    e_xx, e_yx, e_xy, e_yy, r_x, r_y = blocks_2d()
    printed, _ = ibaraki_2006((STEP, STEP), r_x, r_y, e_xx, e_yy, printed=True)
    assert np.abs(printed - e_yx).max() > 5e-5
    stated = 0.5 * (e_xx - e_xx[0] + e_yx - (e_xy - e_xy[0]) - (e_yy - e_yy[0]))
    np.testing.assert_allclose(printed, stated, atol=2e-6)


def test_space_is_right_without_misalignment(machine, draw_errors, cell_sights, deviation,
                                             square_deviation):
    errors = draw_errors(machine, 10, angles=False)
    found = evaluate(simulate(machine, 10, cell_sights(machine, 10), errors))
    assert deviation(found, errors) < 1e-9
    assert square_deviation(found, errors) < 1e-9


@pytest.mark.parametrize('layout', ['closed form', 'traced'])
def test_space_is_insensitive_where_the_vector_method_fails(machine, draw_errors, cell_sights, traced,
                                                           deviation, square_deviation, layout):
    errors = draw_errors(machine, 10, angles=False)
    off = {n: Misalignment((7e-4, 1e-3), (1e-4, 3e-4)) for n in DIAGONALS}
    more = {'measure': traced} if layout == 'traced' else {}
    cell = simulate(machine, 10, cell_sights(machine, 10), errors, off, **more)
    assert deviation(evaluate_vector(cell), errors) > 5e-5
    assert deviation(evaluate(cell), errors) < 5e-9
    # The length of the diagonal keeps λ²/2 − λμ, 5e-7 at most here; it is common to all diagonals.
    assert square_deviation(evaluate(cell), errors) < 1e-6


def test_exact_with_any_mirror_when_the_laser_follows_the_machine(machine, draw_errors, cell_sights,
                                                                  diagonal_corners, deviation,
                                                                  square_deviation):
    errors = draw_errors(machine, 10, angles=False)
    off = {}
    for i, name in enumerate(DIAGONALS):
        ends, _ = tool_pose(errors, diagonal_corners(machine, name), machine.tool)
        true = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        start = diagonal_corners(machine, name)
        u, v, d = local_triad((start[1] - start[0]) / np.linalg.norm(start[1] - start[0]))
        # d turned by (α, β) is d − α v + β u, of unit length
        off[name] = Misalignment((-(true @ v) / (true @ d), (true @ u) / (true @ d)), (3e-4 * i, -5e-4))
    found = evaluate(simulate(machine, 10, cell_sights(machine, 10), errors, off))
    assert deviation(found, errors) < 1e-13
    assert square_deviation(found, errors) < 1e-13


def test_angles_go_straight_into_straightness(machine, draw_errors, cell_sights, deviation):
    errors = draw_errors(machine, 10, angles=True)
    cell = simulate(machine, 10, cell_sights(machine, 10), errors)
    assert deviation(evaluate(cell), errors, 'XYZ') > 1e-6
    angles = GeometricErrors({n: c for n, c in errors.curves.items() if n[1] in 'ABC'}, {})
    assert deviation(evaluate(cell, angles=angles), errors, 'XYZ') < 5e-9


@pytest.mark.parametrize('signs', ['p', 'pn'])
@pytest.mark.parametrize('plane', ['xy', 'xz', 'yz'])
def test_plane(machine, draw_errors, deviation, square_deviation, plane, signs):
    errors = draw_errors(machine, 8, angles=False)
    sights = [face_sight(machine, plane, s, 8, 0.2) for s in signs]
    cell = simulate(machine, 8, sights, errors, {s.name: Misalignment(mirror=(1e-4, 3e-4)) for s in sights})
    linear = {n: errors.curves[n].value for n in ('EXX', 'EYY', 'EZZ')}
    found = evaluate_plane(cell, plane, linear)
    # The laser is along the nominal, not the machine's diagonal: mirror times 20 µrad is left.
    assert deviation(found, errors) < 1e-8
    assert square_deviation(found, errors) < 5e-8


def test_propagation_against_draws(machine, cell_sights):
    from dataclasses import replace
    rng = np.random.default_rng(5)
    cell = simulate(machine, 3, cell_sights(machine, 3), GeometricErrors.zero(), sigma_m=1e-6)
    values = []
    for _ in range(300):
        noisy = {}
        for name, setup in cell.setups.items():
            noise = rng.normal(0, 1e-6, setup.displacement_m.shape)
            # A linear run's end counts against its start: both are read.
            noisy[name] = replace(setup, displacement_m=setup.displacement_m + noise
                                  - (noise[:1] if name in LINEAR else 0.0))
        values.append(evaluate(replace(cell, setups=noisy)).value)
    found = evaluate(cell)
    moving = found.sigma > 1e-12
    assert moving.sum() > 25
    assert np.abs(np.std(values, axis=0)[moving] / found.sigma[moving] - 1).max() < 0.25


def test_needs_the_linear_errors(machine, cell_sights):
    cell = simulate(machine, 3, cell_sights(machine, 3, DIAGONALS), GeometricErrors.zero())
    with pytest.raises(StepdiagError, match='EXX must be known from direct measurement'):
        evaluate(cell)
    found = evaluate(cell, {'EXX': 0.0, 'EYY': 0.0, 'EZZ': 0.0})
    assert np.abs(found.value).max() < 1e-14
    with pytest.raises(StepdiagError, match='no stepped face diagonal'):
        evaluate_plane(cell, 'xy', {})


def test_linear_errors_may_come_by_name(machine, draw_errors, cell_sights, deviation):
    errors = draw_errors(machine, 6, angles=False)
    cell = simulate(machine, 6, cell_sights(machine, 6, DIAGONALS), errors)
    ends = {n: float(errors.curves[n].value[-1]) for n in ('EXX', 'EYY', 'EZZ')}
    assert deviation(evaluate(cell, ends), errors) < 1e-9
    wrong = ends | {'EZZ': ends['EZZ'] + 1e-5}
    assert deviation(evaluate(cell, wrong), errors) > 5e-6
