"""Prediction: its covariance against differences, held-out points of a virtual machine, compensation."""

from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.prediction import (
    compensated_command,
    deviation,
    predict,
    volumetric_map,
    without_rigid_motion,
)
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).parents[3] / 'cells' / 'demo.yaml'


def machine(chain='FXYZ'):
    return Machine('m', chain, (0.8, 0.6, 0.5), (0.02, -0.01, -0.15))


def solution(seed=1, knots=4, drop=()):
    rng = np.random.default_rng(seed)
    positions, names, value = {}, [], []
    for name in CURVES:
        if name in drop:
            continue
        length = machine().volume['XYZ'.index(name[2])]
        positions[name] = np.linspace(0.0, length, knots)
        names += [(name, i) for i in range(knots)]
        value += list(rng.normal(0, 5e-6 if name[1] in 'XYZ' else 2e-5, knots))
    names += [(name, -1) for name in SQUARENESS]
    value += list(rng.normal(0, 1e-5, 3))
    root = rng.normal(0, 1e-7, (len(names), len(names)))
    return Solution('test', positions, tuple(names), np.array(value), root @ root.T / len(names))


def points(n=40, seed=2, beyond=0.0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-beyond, 1.0 + beyond, (n, 3)) * machine().volume


@pytest.mark.parametrize('chain', ['FXYZ', 'XFYZ', 'XYFZ', 'ZYXF'])
@pytest.mark.parametrize('drop', [(), ('ECX', 'EYZ')])
def test_covariance_is_that_of_the_differentiated_chain(chain, drop):
    given, where = solution(drop=drop), points(12, beyond=0.1)
    prediction = predict(given, machine(chain), where)
    zero = Solution('zero', given.positions, given.names, np.zeros_like(given.value), given.covariance)
    jacobian = np.empty((len(where), 3, len(given.names)))
    for column in range(len(given.names)):
        both = []
        for size in (1e-5, -1e-5):
            value = np.zeros_like(given.value)
            value[column] = size
            moved = Solution('moved', zero.positions, zero.names, value, zero.covariance)
            both.append(deviation(moved.errors, machine(chain), where))
        jacobian[:, :, column] = (both[0] - both[1]) / 2e-5
    want = jacobian @ given.covariance @ np.swapaxes(jacobian, 1, 2)
    np.testing.assert_allclose(prediction.covariance_m2, want, rtol=1e-6, atol=1e-9 * want.max())
    np.testing.assert_array_equal(prediction.deviation_m, deviation(given.errors, machine(chain), where))


def test_blocks_of_points_do_not_show(monkeypatch):
    given, where = solution(), points(50)
    whole = predict(given, machine(), where)
    monkeypatch.setattr('stepdiag_ros.estimate.prediction.BLOCK', 7)
    np.testing.assert_allclose(predict(given, machine(), where).covariance_m2, whole.covariance_m2, rtol=1e-12)


def test_another_tool_predicts_another_deviation():
    given, where = solution(), points(5)
    tool = np.array([0.0, 0.1, -0.3])
    prediction = predict(given, machine(), where, tool)
    np.testing.assert_array_equal(prediction.deviation_m, deviation(given.errors, machine(), where, tool))
    assert np.abs(prediction.deviation_m - predict(given, machine(), where).deviation_m).max() > 1e-7


def test_length_and_its_sigma():
    given, where = solution(), points(30)
    prediction = predict(given, machine(), where)
    rng = np.random.default_rng(3)
    for i in (0, 7, 19):
        draws = rng.multivariate_normal(prediction.deviation_m[i], prediction.covariance_m2[i], 20000)
        assert np.std(np.linalg.norm(draws, axis=1)) == pytest.approx(prediction.size_sigma_m[i], rel=0.05)


def test_held_out_points_of_a_virtual_machine():
    """Points that no run visited: what is predicted is the truth within its own uncertainty."""
    cell = load_cell(DEMO)
    found = evaluate(simulate_log(cell, rate=500.0, in_motion=False))
    held_out = np.random.default_rng(4).uniform(0, 1, (400, 3)) * cell.description.machine.volume
    prediction = predict(found, cell.description.machine, held_out)
    truth = deviation(to_reference_lines(cell.geometry), cell.description.machine, held_out)
    off = prediction.deviation_m - truth
    assert np.mean(np.abs(off) <= 2.0 * prediction.sigma_m) > 0.90
    assert np.abs(off).max() < 0.2 * np.abs(truth).max()
    # The command that cancels the prediction leaves of the true machine what the prediction missed.
    command = compensated_command(found.errors, cell.description.machine, held_out)
    left = command + deviation(to_reference_lines(cell.geometry), cell.description.machine, command) - held_out
    np.testing.assert_allclose(left, -off, atol=2e-9)
    # In the truth's own frame the same holds but for a rigid motion, which nobody could see.
    raw = deviation(cell.geometry, cell.description.machine, held_out)
    free = without_rigid_motion(held_out, prediction.deviation_m - raw)
    assert np.abs(free).max() < 0.2 * np.abs(raw).max()


@pytest.mark.parametrize('chain', ['FXYZ', 'XYFZ'])
def test_compensation_cancels_the_deviation(chain):
    given, where = solution(), points(200)
    command = compensated_command(given.errors, machine(chain), where)
    left = command + deviation(given.errors, machine(chain), command) - where
    assert np.abs(left).max() < 3e-16
    assert np.abs(command - where).max() > 1e-6


def test_compensation_with_the_wrong_sign_would_double_the_error():
    given, where = solution(), points(200)
    before = deviation(given.errors, machine(), where)
    command = compensated_command(given.errors, machine(), where)
    # To first order the command is the point minus its deviation.
    assert np.abs(command - (where - before)).max() < 1e-3 * np.abs(before).max()


def test_compensation_of_a_folding_machine_is_refused():
    fold = GeometricErrors({'EXX': Curve(np.linspace(0, 0.8, 9), np.tile([0.0, -0.3], 5)[:9])}, {})
    with pytest.raises(ValueError, match='does not settle'):
        compensated_command(fold, machine(), points(50))


def test_map_covers_the_volume_and_names_the_worst_point():
    chart = volumetric_map(solution(), machine(), per_axis=5)
    assert chart.shape == (5, 5, 5)
    where = chart.prediction.points
    np.testing.assert_array_equal(where.min(axis=0), 0.0)
    np.testing.assert_array_equal(where.max(axis=0), machine().volume)
    assert chart.prediction.size_m[chart.worst] == chart.prediction.size_m.max()
    answer = chart.to_json_dict()
    assert answer['largest_m'] == chart.prediction.size_m.max()
    assert answer['range_m'] == list(np.ptp(chart.prediction.deviation_m, axis=0))


def test_rigid_motion_is_all_that_is_taken_out():
    where = points(60)
    turn, shift = np.array([2e-6, -1e-6, 3e-6]), np.array([1e-6, 2e-6, -1e-6])
    rigid = shift + np.cross(turn, where)
    assert np.abs(without_rigid_motion(where, rigid)).max() < 1e-20
    bent = 1e-5 * where[:, :1]**2 * [1.0, 0.0, 0.0]
    np.testing.assert_allclose(without_rigid_motion(where, bent + rigid), without_rigid_motion(where, bent),
                               atol=1e-20)
