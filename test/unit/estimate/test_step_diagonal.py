"""The vector method: exact on its own assumptions, and how it fails off them."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.readings import closed_form, face_sight, simulate
from stepdiag_ros.estimate.step_diagonal import angular_effect, evaluate
from stepdiag_ros.estimate.stepwise import increments
from stepdiag_ros.model.description import DIAGONALS, Machine
from stepdiag_ros.model.machine import Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

CUBE = Machine('c', 'FXYZ', (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def test_exact_on_its_assumptions(machine, draw_errors, cell_sights, deviation, square_deviation):
    errors = draw_errors(machine, 12, angles=False, framed=False)
    found = evaluate(simulate(machine, 12, cell_sights(machine, 12, DIAGONALS), errors))
    assert deviation(found, errors) < 1e-14
    assert square_deviation(found, errors) < 1e-14


def test_three_diagonals_are_enough(machine, draw_errors, cell_sights, deviation):
    errors = draw_errors(machine, 6, angles=False)
    cell = simulate(machine, 6, cell_sights(machine, 6, DIAGONALS), errors).without('pnp')
    assert deviation(evaluate(cell), errors) < 1e-14
    with pytest.raises(StepdiagError, match='needs 3 body diagonals'):
        evaluate(cell.without('ppp'))


def test_the_traced_scene_says_the_same(machine, draw_errors, cell_sights, traced, deviation):
    errors = draw_errors(machine, 5, angles=False)
    cell = simulate(machine, 5, cell_sights(machine, 5, DIAGONALS), errors, measure=traced)
    assert deviation(evaluate(cell), errors) < 1e-14


def test_known_angles_are_taken_off(machine, draw_errors, cell_sights, deviation):
    errors = draw_errors(machine, 8)
    cell = simulate(machine, 8, cell_sights(machine, 8, DIAGONALS), errors)
    assert deviation(evaluate(cell), errors, 'XYZ') > 1e-6
    angles = GeometricErrors({n: c for n, c in errors.curves.items() if n[1] in 'ABC'}, {})
    # What is left is of second order: angle times angle times a metre.
    assert deviation(evaluate(cell, angles), errors, 'XYZ') < 3e-9


@pytest.mark.parametrize('sensor', ['closed form', 'traced'])
def test_mirror_of_published_example(sensor, traced):
    """0.2 mm/m on the 1:1 XZ face, 50 mm steps: 7 µm a step, ±140 µm/m, opposite on Z."""
    measure = traced if sensor == 'traced' else closed_form
    sight = face_sight(CUBE, 'xz', 'p', 20, standoff=0.1)
    # About Y, the normal of the XZ face: in the setup's triad that is ±u.
    about_y = sight.triad[0] @ [0.0, 1.0, 0.0]
    assert abs(about_y) == pytest.approx(1.0)
    cell = simulate(CUBE, 20, [sight], GeometricErrors.zero(),
                    {'xz_p': Misalignment(mirror=(0.2e-3 * about_y, 0.0))}, measure)
    reading = cell.setups['xz_p'].displacement_m
    extra = increments(sight, reading, 20)[[0, 2], :, 0] - 0.05 / np.sqrt(2.0)
    np.testing.assert_allclose(np.abs(extra), 7.07e-6, rtol=2e-3)
    np.testing.assert_allclose(extra[0], -extra[1], rtol=1e-3)
    assert np.abs(extra.sum(axis=1)) == pytest.approx(141e-6, rel=5e-3)


def test_mirror_spoils_the_slopes_of_positioning(machine, cell_sights, deviation):
    """All setups' mirrors off by 0.2 mm/m: an error-free machine seems to have errors of 100 µm/m."""
    mirrors = {n: Misalignment(mirror=(0.2e-3, 0.0)) for n in DIAGONALS}
    cell = simulate(machine, 10, cell_sights(machine, 10, DIAGONALS), GeometricErrors.zero(), mirrors)
    found = evaluate(cell)
    slope = [found.curve(n)[1][-1] / length
             for n, length in zip(('EXX', 'EYY', 'EZZ'), machine.volume, strict=True)]
    assert np.abs(slope).max() > 80e-6
    # … and a straight line in every curve, nothing else.
    for name in ('EXX', 'EYY', 'EZZ'):
        place, value, _ = found.curve(name)
        assert np.abs(value - value[-1] * place / place[-1]).max() < 1e-8


def test_machine_c_is_spread_over_three_axes(cell_sights):
    """Z + 100 µm/m: diagonals of 1.732109 m; slopes removed, 33 µm/m on each axis."""
    place = np.array([0.0, 1.0])
    errors = GeometricErrors({'EZZ': Curve(place, 100e-6 * place)}, {})
    cell = simulate(CUBE, 10, cell_sights(CUBE, 10, DIAGONALS), errors)
    for name in DIAGONALS:
        assert cell.setups[name].displacement_m[-1, 0] == pytest.approx(1.732109, abs=5e-7)
    found = evaluate(cell, slopes='removed')
    for name in ('EXX', 'EYY', 'EZZ'):
        assert found.curve(name)[1][-1] * 1e6 == pytest.approx(33.3, abs=0.1)
    assert evaluate(cell).curve('EZZ')[1][-1] == pytest.approx(100e-6, rel=1e-6)


def test_slopes_that_totals_do_not_tell_are_as_uncertain_as_unknown(cell_sights):
    """Four diagonals tell the squareness errors and one sum of the scales; with three only combinations are told.
    The answer is off by what was put in and covered by U, and no U shrinks by a diagonal less."""
    place = np.array([0.0, 1.0])
    errors = GeometricErrors({'EZZ': Curve(place, 300e-6 * place)}, {'EA0Z': 200e-6, 'EC0Y': -100e-6})
    cell = simulate(CUBE, 10, cell_sights(CUBE, 10, DIAGONALS), errors, sigma_m=1e-7)
    four = evaluate(cell, slopes='removed')
    assert four.curve('EZZ')[2][-1] > 5e-4 and four.squareness('EA0Z')[1] < 1e-6
    assert four.squareness('EA0Z')[0] == pytest.approx(200e-6, abs=1e-6)
    for name in DIAGONALS:
        three = evaluate(replace(cell, setups={n: s for n, s in cell.setups.items() if n != name}), slopes='removed')
        assert np.all(three.sigma >= (1.0 - 1e-9) * four.sigma), name
        for square, true in (('EA0Z', 200e-6), ('EC0Y', -100e-6), ('EB0Z', 0.0)):
            value, sigma = three.squareness(square)
            assert sigma > 1e-4 and abs(value - true) < 2.0 * sigma, (name, square)


def test_printed_angular_terms_cancel_but_the_true_ones_do_not(cell_sights):
    """Eqs. 5–7 take back in Z what X brought in; the exact model keeps x (c·EBX − b·ECX)/r."""
    place = np.linspace(0.0, 1.0, 11)
    angles = GeometricErrors({'EBX': Curve(place, 2e-5 * place), 'ECX': Curve(place, -1e-5 * place)}, {})
    cell = simulate(CUBE, 10, cell_sights(CUBE, 10, ['ppp']), angles)
    effect = angular_effect(cell, 'ppp', angles)[:, 0]
    corners = effect[::3]
    np.testing.assert_allclose(corners, place * (2e-5 + 1e-5) * place / np.sqrt(3.0), atol=1e-9)


def test_propagation_against_draws(machine, cell_sights):
    rng = np.random.default_rng(5)
    sights = cell_sights(machine, 4, DIAGONALS)
    cell = simulate(machine, 4, sights, GeometricErrors.zero(), sigma_m=1e-6)
    found = evaluate(cell)
    values = []
    for _ in range(400):
        noisy = {n: replace(s, displacement_m=s.displacement_m + rng.normal(0, 1e-6, s.displacement_m.shape))
                 for n, s in cell.setups.items()}
        values.append(evaluate(replace(cell, setups=noisy)).value)
    drawn, stated = np.std(values, axis=0), found.sigma
    moving = stated > 0
    assert np.abs(drawn[moving] / stated[moving] - 1).max() < 0.2
    assert np.abs(drawn[~moving]).max() < 1e-15


def test_unknown_option():
    with pytest.raises(StepdiagError, match="give 'kept' or 'removed'"):
        evaluate(None, slopes='some')
