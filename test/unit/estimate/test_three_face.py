"""Three-face step diagonal: right with a misaligned mirror, wrong with angles, right again with tilts."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.readings import face_sight, simulate
from stepdiag_ros.estimate.three_face import FACES, angles_of, evaluate
from stepdiag_ros.model.machine import GeometricErrors, tool_pose
from stepdiag_ros.model.sensor import Misalignment

OFF = {f'{f}_p': Misalignment(mirror=(1e-4, 3e-4)) for f in FACES}


def edges(machine, errors, steps):
    """Linear runs along the three edges from the origin."""
    linear = {}
    for axis, length in enumerate(machine.volume):
        positions = np.zeros((steps + 1, 3))
        positions[:, axis] = np.linspace(0.0, length, steps + 1)
        point, _ = tool_pose(errors, positions, machine.tool, machine.chain)
        linear[f'E{"XYZ"[axis] * 2}'] = point[:, axis] - point[0, axis] - positions[:, axis]
    return linear


def faces(machine, errors, steps, **more):
    return simulate(machine, steps, [face_sight(machine, f, 'p', steps, 0.3) for f in FACES], errors, **more)


@pytest.mark.parametrize('sensor', ['closed form', 'traced'])
def test_misaligned_mirrors_do_not_matter(machine, draw_errors, deviation, square_deviation, traced, sensor):
    errors = draw_errors(machine, 10, angles=False)
    more = {'measure': traced} if sensor == 'traced' else {}
    found = evaluate(faces(machine, errors, 10, misalignments=OFF, **more), edges(machine, errors, 10))
    # Left is mirror times the diagonal's own turn, 300 µrad · 20 µrad · 1 m.
    assert deviation(found, errors) < 1e-8
    assert square_deviation(found, errors) < 3e-8


def test_angles_spoil_it_and_tilts_mend_it(machine, draw_errors, deviation, square_deviation):
    errors = draw_errors(machine, 10)
    cell, linear = faces(machine, errors, 10, misalignments=OFF), edges(machine, errors, 10)
    without, with_tilts = evaluate(cell, linear), evaluate(cell, linear, tilts=True)
    assert deviation(without, errors, 'XYZ') > 1e-6
    assert square_deviation(without, errors) > 2e-6
    assert not without.has('EAX')
    assert deviation(with_tilts, errors, 'XYZ') < 3e-8
    assert deviation(with_tilts, errors, 'ABC') < 2e-7
    assert square_deviation(with_tilts, errors) < 5e-8


def test_every_angle_is_seen_from_two_faces(machine, draw_errors):
    errors = draw_errors(machine, 6)
    found = angles_of(faces(machine, errors, 6))
    for name, curve in found.curves.items():
        np.testing.assert_allclose(curve.value, errors.curves[name].value, atol=2e-9)
    assert len(found.curves) == 9


@pytest.mark.parametrize('tilts', [False, True])
def test_propagation_against_draws(machine, tilts):
    rng = np.random.default_rng(11)
    zero = GeometricErrors.zero()
    cell = simulate(machine, 3, [face_sight(machine, f, 'p', 3, 0.3) for f in FACES], zero, sigma_m=1e-7)
    linear = dict.fromkeys(('EXX', 'EYY', 'EZZ'), np.zeros(4))
    values = []
    for _ in range(150):
        noisy = {n: replace(s, displacement_m=s.displacement_m + rng.normal(0, 1e-7, s.displacement_m.shape),
                            spot_m=s.spot_m + rng.normal(0, 1e-7, s.spot_m.shape))
                 for n, s in cell.setups.items()}
        values.append(evaluate(replace(cell, setups=noisy), linear, tilts).value)
    stated = evaluate(cell, linear, tilts).sigma
    moving = stated > 1e-12
    assert moving.sum() > (40 if tilts else 15)
    ratio = np.std(values, axis=0)[moving] / stated[moving]
    assert np.mean(ratio ** 2) == pytest.approx(1.0, abs=0.12)
    assert np.abs(ratio - 1).max() < 0.35


def test_bad_input_is_named(machine, draw_errors):
    errors = draw_errors(machine, 4)
    cell, linear = faces(machine, errors, 4), edges(machine, errors, 4)
    with pytest.raises(StepdiagError, match='xz_p is missing'):
        evaluate(cell.without('xz_p'), linear)
    with pytest.raises(StepdiagError, match='EZZ must be given'):
        evaluate(cell, {n: v for n, v in linear.items() if n != 'EZZ'})
