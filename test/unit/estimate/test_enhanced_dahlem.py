"""Dahlem's closed form on the set-up of fig. 5, by the closed sensor and by ray tracing."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced_dahlem import evaluate
from stepdiag_ros.estimate.readings import simulate
from stepdiag_ros.estimate.step_diagonal import evaluate as evaluate_vector
from stepdiag_ros.model.description import DIAGONALS
from stepdiag_ros.model.machine import GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

LASER = dict.fromkeys(DIAGONALS, (7e-4, 1e-3))
OFF = {n: Misalignment((7e-4, 1e-3), (1e-4, 3e-4)) for n in DIAGONALS}
"""Fig. 5: mirror 100/300 µrad, laser 700/1000 µrad."""


@pytest.mark.parametrize('sensor', ['closed form', 'traced'])
@pytest.mark.parametrize('layout', ['a', 'b'])
def test_figure_5_within_a_picometre(machine, draw_errors, cell_sights, traced, deviation,
                                     square_deviation, layout, sensor):
    errors = draw_errors(machine, 50)
    more = {'measure': traced} if sensor == 'traced' else {}
    cell = simulate(machine, 50, cell_sights(machine, 50), errors, OFF, **more)
    found = evaluate(cell, layout, LASER)
    assert found.status == 'ok'
    assert deviation(found, errors, 'XYZ') < 1e-12
    assert deviation(found, errors, 'ABC') < 1e-12
    assert square_deviation(found, errors) < 1e-12
    # The conventional evaluation of the same readings is off by a tenth of a millimetre.
    assert deviation(evaluate_vector(cell), errors, 'XYZ') > 9e-5


def test_misalignments_are_found(machine, draw_errors, cell_sights):
    errors = draw_errors(machine, 10)
    found = evaluate(simulate(machine, 10, cell_sights(machine, 10), errors, OFF))
    for name in DIAGONALS:
        np.testing.assert_allclose(found.misalignments[name].mirror, OFF[name].mirror, atol=1e-12)
        np.testing.assert_allclose(found.misalignments[name].laser, OFF[name].laser, atol=1e-12)


def test_three_diagonals_give_all_angles(machine, draw_errors, cell_sights, deviation):
    errors = draw_errors(machine, 6)
    cell = simulate(machine, 6, cell_sights(machine, 6), errors).without('nnp')
    assert deviation(evaluate(cell), errors, 'ABC') < 1e-9


def test_layout_a_bears_the_laser_in_second_order(machine, draw_errors, cell_sights, deviation,
                                                  square_deviation):
    """Its angle does not show in three lengths: λ²/2 − λμ of scale, 5e-7, is left if it is not given."""
    errors = draw_errors(machine, 10)
    found = evaluate(simulate(machine, 10, cell_sights(machine, 10), errors, OFF), 'a')
    assert 1e-9 < max(deviation(found, errors), square_deviation(found, errors)) < 3e-6


def test_layout_a_finds_the_lasers_in_quiet_readings(machine, draw_errors, cell_sights, deviation,
                                                     square_deviation):
    """Nothing given but distances: four lasers apart, found from an effect of ten nanometres."""
    errors = draw_errors(machine, 12)
    off = {n: Misalignment((7e-4 * (1 - 0.3 * i), 1e-3 * (-1) ** i), (1e-4, 3e-4))
           for i, n in enumerate(DIAGONALS)}
    cell = simulate(machine, 12, cell_sights(machine, 12), errors, off)
    blind = {n: replace(s, spot_m=None) for n, s in cell.setups.items()}
    found = evaluate(replace(cell, setups=blind), laser='find')
    assert found.extra['layout'] == 'a'
    for name in DIAGONALS:
        np.testing.assert_allclose(found.misalignments[name].laser, off[name].laser, atol=1e-8)
    assert deviation(found, errors) < 1e-12
    assert square_deviation(found, errors) < 1e-11
    with pytest.raises(StepdiagError, match="give angles by setup, or 'find'"):
        evaluate(cell, 'a', 'guess')


def test_zero_of_the_psd(machine, draw_errors, cell_sights, deviation):
    """Fig. 5, 3a and 3b: a zero off by 1.5/2 mm is a tilt that falls with 1/L; it ruins the angles."""
    errors = draw_errors(machine, 50)
    cell = simulate(machine, 50, cell_sights(machine, 50), errors, spot_zero_m=(1.5e-3, 2e-3))
    found = evaluate(cell)
    assert deviation(found, errors, 'ABC') > 1e-4
    assert deviation(found, errors, 'XYZ') > 1e-5


def test_without_linear_setups_the_slopes_are_open(machine, draw_errors, cell_sights, deviation):
    errors = draw_errors(machine, 6)
    straight = simulate(machine, 6, cell_sights(machine, 6, DIAGONALS), errors)
    found = evaluate(straight)
    assert deviation(found, errors, 'XYZ') < 1e-8
    assert any('EXX slope' in u.names for u in found.unidentifiable)
    crooked = simulate(machine, 6, cell_sights(machine, 6, DIAGONALS), errors, OFF)
    found = evaluate(crooked)
    # Mirrors taken for aligned: their angle times the motions' is left.
    assert deviation(found, errors, 'ABC') < 5e-7
    place, value, _ = found.curve('EXX')
    left = value - np.interp(place, errors.curves['EXX'].position, errors.curves['EXX'].value)
    assert np.abs(left).max() > 1e-5
    assert np.abs(left - left[-1] * place / place[-1]).max() < 1e-7


@pytest.mark.parametrize('chain', ['XFYZ', 'XYFZ', 'YXFZ'])
def test_other_chains(machine, draw_errors, cell_sights, deviation, chain):
    turned = replace(machine, chain=chain)
    errors = draw_errors(turned, 6)
    found = evaluate(simulate(turned, 6, cell_sights(turned, 6), errors, OFF))
    assert found.status == 'ok'
    assert deviation(found, errors) < 1e-9


@pytest.mark.parametrize('layout', ['a', 'b'])
def test_propagation_against_draws(machine, cell_sights, layout):
    rng = np.random.default_rng(7)
    cell = simulate(machine, 2, cell_sights(machine, 2), GeometricErrors.zero(), sigma_m=1e-7)
    values = []
    for _ in range(50):
        noisy = {n: replace(s, displacement_m=s.displacement_m + rng.normal(0, 1e-7, s.displacement_m.shape),
                            spot_m=s.spot_m + rng.normal(0, 1e-7, s.spot_m.shape))
                 for n, s in cell.setups.items()}
        values.append(evaluate(replace(cell, setups=noisy), layout).value)
    stated = evaluate(cell, layout).sigma
    moving = stated > 1e-12
    ratio = np.std(values, axis=0)[moving] / stated[moving]
    assert np.mean(ratio ** 2) == pytest.approx(1.0, abs=0.15)
    # Of 50 draws a standard deviation is known to a tenth, the worst of 80 to some three of them.
    assert np.abs(ratio - 1).max() < 0.45


def test_bad_input_is_named(machine, cell_sights):
    cell = simulate(machine, 3, cell_sights(machine, 3, beams=((0.0, 0.0), (0.02, 0.0), (0.04, 0.0))),
                    GeometricErrors.zero())
    with pytest.raises(StepdiagError, match='do not span a plane'):
        evaluate(cell, 'a')
    blind = {n: replace(s, spot_m=None) for n, s in cell.setups.items()}
    with pytest.raises(StepdiagError, match='has no psd/spot; layout b needs it'):
        evaluate(replace(cell, setups=blind), 'b')
    with pytest.raises(StepdiagError, match='needs 3 body diagonals'):
        evaluate(cell.without('ppp', 'npp'))
