"""ISO 230-6 / B5.54: E, B, Ed, Bd, and the cancellations that Chapman warned of."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.body_diagonal import (
    deviations_of,
    diagonal,
    diagonal_length,
    evaluate_runs,
    worst_deviation,
)
from stepdiag_ros.model.description import DIAGONALS, Machine
from stepdiag_ros.model.machine import Curve, GeometricErrors


def scaled(machine, x=0.0, y=0.0, z=0.0):
    """A machine whose axes over-travel by x, y, z [m/m]."""
    curves = {f'E{a}{a}': Curve(np.array([0.0, length]), np.array([0.0, slope * length]))
              for a, length, slope in zip('XYZ', machine.volume, (x, y, z), strict=True)}
    return GeometricErrors(curves, {})


def ed_of(machine, errors, targets=11):
    return evaluate_runs({n: (*deviations_of(errors, machine, n, targets), None) for n in DIAGONALS})


def test_length_of_the_published_machine():
    machine = Machine('m', 'FXYZ', (2.0, 1.0, 0.5), (0.0, 0.0, 0.0))
    for name in DIAGONALS:
        assert diagonal_length(GeometricErrors.zero(), machine, name) == pytest.approx(2.291288, abs=5e-7)


def test_opposite_errors_of_two_axes_leave_the_diagonal():
    machine = Machine('m', 'FXYZ', (2.0, 1.0, 0.5), (0.0, 0.0, 0.0))
    errors = scaled(machine, 25e-6, -100e-6)
    for name in DIAGONALS:
        change = (diagonal_length(errors, machine, name)
                  - diagonal_length(GeometricErrors.zero(), machine, name))
        assert 0.0 < abs(change) < 0.1e-6
    assert ed_of(machine, errors).Ed < 0.1e-6
    assert worst_deviation(errors, machine) > 100e-6


@pytest.mark.parametrize(('slopes', 'diagonal_um', 'volumetric_um'),
                         [((50e-6, 0.0, 0.0), 28.9, 50.0), ((100e-6, -50e-6, -25e-6), 14.4, 115.0)],
                         ids=['machine A', 'machine B'])
def test_machines_a_and_b(slopes, diagonal_um, volumetric_um):
    machine = Machine('m', 'FXYZ', (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    errors = scaled(machine, *slopes)
    assert ed_of(machine, errors).Ed * 1e6 == pytest.approx(diagonal_um, abs=0.05)
    assert worst_deviation(errors, machine) * 1e6 == pytest.approx(volumetric_um, abs=0.5)


def test_e_and_b_by_hand():
    result = diagonal([0.0, 1.0, 2.0], [[0.0, 2.0, 4.0], [0.0, 4.0, 6.0]], [[1.0, 0.0, 5.0], [3.0, 0.0, 5.0]])
    # Means up 0 3 5, down 2 0 5.
    assert result.E == 5.0
    assert list(result.reversal_m) == [-2.0, 3.0, 0.0]
    assert result.B == 3.0


def test_overall_values_are_the_worst_diagonal():
    one, two = np.array([0.0, 1.0]), np.array([0.0, 3.0])
    result = evaluate_runs({'ppp': (one, one, one + 0.5), 'npp': (one, two, None)})
    assert (result.Ed, result.Bd) == (3.0, 0.5)
    assert result.to_json_dict()['diagonals']['npp']['B_m'] is None


def test_angles_of_the_chain_reach_the_diagonal_through_their_arms():
    """Yaw of X on FXYZ: eq. 1 has −Az·ab/r; on the real machine that is −x·ECX(x)·d_y along ppp."""
    machine = Machine('m', 'FXYZ', (0.8, 0.6, 0.5), (0.0, 0.0, 0.0))
    place = np.linspace(0.0, 0.8, 5)
    errors = GeometricErrors({'ECX': Curve(place, 1e-5 * place)}, {})
    _, deviation = deviations_of(errors, machine, 'ppp', 5)
    d = np.array(machine.volume) / np.linalg.norm(machine.volume)
    np.testing.assert_allclose(deviation, -place * 1e-5 * place * d[1], atol=1e-15)


def test_bad_input_is_named():
    with pytest.raises(StepdiagError, match='forward runs have 2 targets'):
        diagonal([0.0, 1.0, 2.0], [[0.0, 1.0]])
    with pytest.raises(StepdiagError, match='not a number'):
        diagonal([0.0, 1.0], [[0.0, np.nan]])
    with pytest.raises(StepdiagError, match='need diagonals'):
        evaluate_runs({'ppn': ([0.0], [0.0], None)})
