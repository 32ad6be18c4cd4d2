"""Face diagonals, plain and stepped (Wang & Liotto, eqs. 17–22)."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.face_diagonal import SQUARE, displacement_test, evaluate
from stepdiag_ros.estimate.readings import face_sight, simulate
from stepdiag_ros.estimate.step_diagonal import angular_effect
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import Curve, GeometricErrors


def faces(machine, plane, steps, errors, **more):
    return simulate(machine, steps, [face_sight(machine, plane, s, steps, 0.2) for s in 'pn'], errors, **more)


@pytest.mark.parametrize('sensor', ['closed form', 'traced'])
@pytest.mark.parametrize('plane', SQUARE)
def test_exact_on_its_assumptions(machine, draw_errors, deviation, square_deviation, traced, plane, sensor):
    errors = draw_errors(machine, 9, angles=False)
    found = evaluate(faces(machine, plane, 9, errors,
                           **({'measure': traced} if sensor == 'traced' else {})), plane)
    assert len({n for n, _ in found.names}) == 5
    assert deviation(found, errors) < 1e-14
    assert square_deviation(found, errors) < 1e-14


def test_known_angles_are_taken_off(machine, draw_errors, deviation):
    errors = draw_errors(machine, 9)
    cell = faces(machine, 'xy', 9, errors)
    assert deviation(evaluate(cell, 'xy'), errors) > 1e-6
    angles = GeometricErrors({n: c for n, c in errors.curves.items() if n[1] in 'ABC'}, {})
    assert deviation(evaluate(cell, 'xy', angles), errors) < 3e-9


def test_yaw_enters_as_in_equation_17_and_stays(draw_errors):
    """−ECX(x)·x·b/r at every corner of pp, +… of np from its own start; no step takes it back."""
    machine = Machine('m', 'FXYZ', (0.8, 0.6, 0.5), (0.0, 0.0, 0.0))
    place = np.linspace(0.0, 0.8, 9)
    errors = GeometricErrors({'ECX': Curve(place, 3e-5 * np.sin(4 * place))}, {})
    cell = faces(machine, 'xy', 8, errors)
    effect = angular_effect(cell, 'xy_p', errors)[::2, 0]
    b_over_r = 0.6
    np.testing.assert_allclose(effect, -3e-5 * np.sin(4 * place) * place * b_over_r, atol=3e-9)


def test_e_of_the_face(machine):
    """10 µrad of squareness stretches one diagonal and shortens the other by S·XY/r."""
    errors = GeometricErrors({}, {'EC0Y': -10e-6})
    result = displacement_test(faces(machine, 'xy', 4, errors), 'xy')
    assert result.diagonals['xy_p'].forward_m[-1] == pytest.approx(10e-6 * 0.8 * 0.6 / 1.0, rel=1e-9)
    assert result.diagonals['xy_n'].forward_m[-1] == pytest.approx(-10e-6 * 0.8 * 0.6 / 1.0, rel=1e-9)
    assert result.Ed == pytest.approx(4.8e-6, rel=1e-9)
    assert result.Bd is None


def test_bad_input_is_named(machine):
    cell = faces(machine, 'xy', 3, GeometricErrors.zero())
    with pytest.raises(StepdiagError, match='xy_n is missing'):
        evaluate(cell.without('xy_n'))
    with pytest.raises(StepdiagError, match="plane 'zx'"):
        evaluate(cell, 'zx')
    with pytest.raises(StepdiagError, match='no setup xz_p'):
        displacement_test(cell, 'xz')
