"""Squareness from crossing diagonals: the formula, its signs, its limits."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.body_diagonal import deviations_of, diagonal_length
from stepdiag_ros.estimate.squareness_diagonals import body_squareness, face_squareness
from stepdiag_ros.model.description import DIAGONALS, Machine
from stepdiag_ros.model.machine import Curve, GeometricErrors, tool_pose

BOX = Machine('m', 'FXYZ', (0.8, 0.6, 0.5), (0.0, 0.0, 0.0))
ONE = Machine('m', 'FXYZ', (1.0, 1.0, 0.0001), (0.0, 0.0, 0.0))


def face_length(errors, start, end):
    point, _ = tool_pose(errors, np.array([start, end]), np.zeros(3))
    return np.linalg.norm(point[1] - point[0])


def test_face_of_one_metre_with_ten_micrometres():
    """Fig. 10: 1 m by 1 m, 10 µm/m: the diagonals differ by 2·10·√½ µm and S is 10 µrad."""
    errors = GeometricErrors({}, {'EC0Y': -10e-6})
    d1 = face_length(errors, (0, 0, 0), (1, 1, 0))
    d2 = face_length(errors, (1, 0, 0), (0, 1, 0))
    assert d1 - d2 == pytest.approx(2 * 10e-6 / np.sqrt(2.0), rel=1e-6)
    assert face_squareness(1.0, 1.0, d1, d2) == pytest.approx(10e-6, rel=1e-6)


@pytest.mark.parametrize('angle', [1e-5, -3e-5])
@pytest.mark.parametrize('name', ['EC0Y', 'EB0Z', 'EA0Z'])
def test_signs_by_exact_lengths(name, angle):
    errors = GeometricErrors({}, {name: angle})
    found = body_squareness(BOX, {n: diagonal_length(errors, BOX, n) for n in DIAGONALS})
    for other in ('EC0Y', 'EB0Z', 'EA0Z'):
        assert found.squareness(other)[0] == pytest.approx(angle if other == name else 0.0, abs=2e-9)


def test_linear_errors_drop_out_and_deviations_serve_like_lengths():
    slopes = {f'E{a}{a}': Curve(np.array([0.0, s]), np.array([0.0, 30e-6 * s]))
              for a, s in zip('XYZ', BOX.volume, strict=True)}
    errors = GeometricErrors(slopes, {'EB0Z': 2e-5})
    found = body_squareness(BOX, {n: deviations_of(errors, BOX, n, 2)[1][-1] for n in DIAGONALS})
    assert found.squareness('EB0Z')[0] == pytest.approx(2e-5, rel=1e-9)
    assert found.squareness('EC0Y')[0] == pytest.approx(0.0, abs=1e-12)


def test_growing_yaw_is_taken_for_squareness():
    """What the docstring says it cannot tell apart."""
    place = np.array([0.0, 0.8])
    errors = GeometricErrors({'ECX': Curve(place, 2e-5 * place)}, {})
    found = body_squareness(BOX, {n: diagonal_length(errors, BOX, n) for n in DIAGONALS})
    assert found.squareness('EC0Y')[0] > 5e-6


def test_propagation():
    found = body_squareness(BOX, dict.fromkeys(DIAGONALS, 0.0), dict.fromkeys(DIAGONALS, 1e-6))
    expected = np.linalg.norm(BOX.volume) / (2 * 0.8 * 0.6) * 1e-6
    assert found.squareness('EC0Y')[1] == pytest.approx(expected)


def test_needs_all_four():
    with pytest.raises(StepdiagError, match='nnp is missing'):
        body_squareness(BOX, dict.fromkeys(('ppp', 'npp', 'pnp'), 0.0))
