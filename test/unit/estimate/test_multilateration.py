"""Multilateration in the plane and in space: truth, stations and dead paths come back."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import multilateration as ml
from stepdiag_ros.model.machine import tool_pose

STATIONS = np.array([[-0.3, -0.3, -0.2], [1.1, -0.2, -0.1], [0.4, 0.9, -0.3], [-0.2, 0.3, 0.9]])
TOOLS = np.array([[0.0, 0.0, -0.15], [0.1, 0.0, -0.15], [0.0, 0.1, -0.2], [-0.08, -0.08, -0.1]])


def grid(machine, knots):
    axes = [np.linspace(0.0, length, knots) for length in machine.volume]
    return np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)


def distances(errors, machine, points, stations, tools):
    """Displacements and dead paths of a tracker at each station, from the exact chain."""
    readings, dead = [], []
    for station, tool in zip(stations, tools, strict=True):
        place, _ = tool_pose(errors, points, tool, machine.chain)
        length = np.linalg.norm(place - station, axis=1)
        readings.append(length - length[0])
        dead.append(length[0])
    return readings, np.array(dead)


@pytest.mark.parametrize('chain', ['FXYZ', 'XFYZ'])
def test_space_gives_back_everything(machine, draw_errors, deviation, square_deviation, chain):
    from dataclasses import replace
    machine = replace(machine, chain=chain)
    errors = draw_errors(machine, 4)
    points = grid(machine, 5)
    readings, dead = distances(errors, machine, points, STATIONS, TOOLS)
    guess = STATIONS + np.random.default_rng(1).normal(0.0, 0.01, STATIONS.shape)
    found = ml.evaluate([points] * 4, readings, guess, TOOLS, chain=chain)
    assert found.status == 'ok'
    assert found.unidentifiable == ()
    # The method's kinematic model is of first order; what it leaves out is angle times angle.
    assert deviation(found, errors, 'XYZ') < 3e-9
    assert deviation(found, errors, 'ABC') < 2e-8
    assert square_deviation(found, errors) < 3e-9
    np.testing.assert_allclose(found.extra['stations_m'], STATIONS, atol=1e-8)
    np.testing.assert_allclose(found.extra['dead_path_m'], dead, atol=1e-8)


def plane_case(seed=2):
    """Readings of three stations on the method's own model (eq. 2): exact to rounding."""
    rng = np.random.default_rng(seed)
    x, y = np.linspace(0.0, 0.8, 6), np.linspace(0.0, 0.6, 5)
    points = np.stack(np.meshgrid(x, y, indexing='ij'), axis=-1).reshape(-1, 2)
    motions = ml.plane_motions(x, y)
    theta = rng.normal(0.0, 5e-6, motions.size)
    stations = np.array([[-0.4, -0.3], [1.3, -0.1], [0.5, 1.2]])
    place = points + np.einsum('ndp,p->nd', ml.plane_kinematics(motions, points), theta)
    lengths = [np.linalg.norm(place - s, axis=1) for s in stations]
    return points, motions, theta, stations, [length - length[0] for length in lengths], \
        [length[0] for length in lengths]


def test_plane_gives_back_everything():
    points, motions, theta, stations, readings, dead = plane_case()
    found = ml.evaluate_plane([points] * 3, readings, stations + 0.02)
    np.testing.assert_allclose(found.extra['stations_m'], stations, atol=1e-12)
    np.testing.assert_allclose(found.extra['dead_path_m'], dead, atol=1e-12)
    np.testing.assert_allclose(found.curve('EXX')[1], motions.curve_rows('EXX') @ theta, atol=1e-12)
    np.testing.assert_allclose(found.curve('ECX')[1], motions.curve_rows('ECX') @ theta, atol=1e-12)


def test_jacobian_against_differences():
    points, motions, theta, stations, readings, _ = plane_case()
    problem = ml.Problem(np.tile(points, (3, 1)), np.tile(ml.plane_kinematics(motions, points), (3, 1, 1)),
                         np.repeat(np.arange(3), len(points)), np.concatenate(readings),
                         np.ones(3 * len(points)), stations, np.ones((3, 2), bool))
    unknown = problem.initial()
    unknown[:motions.size] = theta
    jacobian = problem.jacobian(unknown)
    for k in range(problem.size):
        step = np.zeros(problem.size)
        step[k] = 1e-6
        by = (problem.predict(unknown + step) - problem.predict(unknown - step)) / 2e-6
        np.testing.assert_allclose(jacobian[:, k], by, atol=1e-9)


def test_one_tool_leaves_the_last_axis_turns_open(machine, draw_errors):
    errors = draw_errors(machine, 2)
    points = grid(machine, 3)
    tools = np.tile(TOOLS[0], (4, 1))
    readings, _ = distances(errors, machine, points, STATIONS, tools)
    found = ml.evaluate([points] * 4, readings, STATIONS, tools)
    assert len(found.unidentifiable) == 1
    assert 'EBZ' in found.unidentifiable[0].names
    # What can be seen is right: the predicted points agree.
    place, _ = tool_pose(errors, points, tools[0])
    again, _ = tool_pose(found.errors, points, tools[0])
    off = (again - again[0]) - (place - place[0])
    # … up to a turn of the whole frame, which is what the gauge is for.
    turn = np.linalg.lstsq(np.concatenate([np.cross(e, points - points[0])[:, :, None] for e in np.eye(3)], 2)
                           .reshape(-1, 3), off.ravel(), rcond=None)[0]
    assert np.abs(off - np.cross(turn, points - points[0])).max() < 5e-9


def test_monte_carlo_agrees_with_propagation():
    points, motions, _, stations, readings, _ = plane_case()
    problem = ml.Problem(np.tile(points, (3, 1)), np.tile(ml.plane_kinematics(motions, points), (3, 1, 1)),
                         np.repeat(np.arange(3), len(points)), np.concatenate(readings),
                         np.full(3 * len(points), 1e-6), stations, np.ones((3, 2), bool))
    answer = ml.solve(problem)
    drawn = ml.monte_carlo(problem, answer, 3000, np.random.default_rng(0))
    ratio = drawn.std(axis=0) / np.sqrt(np.diag(answer.covariance))
    assert np.abs(ratio - 1).max() < 0.07


def test_chord_draws_are_solved_draws():
    points, motions, _, stations, readings, _ = plane_case()
    from dataclasses import replace
    problem = ml.Problem(np.tile(points, (3, 1)), np.tile(ml.plane_kinematics(motions, points), (3, 1, 1)),
                         np.repeat(np.arange(3), len(points)), np.concatenate(readings),
                         np.full(3 * len(points), 1e-6), stations, np.ones((3, 2), bool))
    answer = ml.solve(problem)
    drawn = ml.monte_carlo(problem, answer, 2, np.random.default_rng(4), chords=4)
    noise = np.random.default_rng(4).standard_normal((2, 3 * len(points))) * 1e-6
    for row in range(2):
        full = ml.solve(replace(problem, reading=problem.predict(answer.unknown) + noise[row]))
        # A chord keeps the Jacobian of the answer: the normal equations differ by residual times curvature.
        assert np.abs(drawn[row] - full.unknown).max() < 1e-9


def test_bad_input_is_named(machine):
    points = grid(machine, 3)
    with pytest.raises(StepdiagError, match='a plane needs three'):
        ml.evaluate_plane([points[:, :2]] * 2, [np.zeros(27)] * 2, np.zeros((2, 2)))
    with pytest.raises(StepdiagError, match='space needs four'):
        ml.evaluate([points] * 3, [np.zeros(27)] * 3, STATIONS[:3], TOOLS[:3])
    with pytest.raises(StepdiagError, match='do not match'):
        ml.evaluate([points] * 4, [np.zeros(26)] * 4, STATIONS, TOOLS)
    motions = ml.plane_motions(np.array([0.0, 0.4]), np.array([0.0, 0.4]))
    with pytest.raises(StepdiagError, match=r'no knot at 0\.1'):
        ml.plane_kinematics(motions, np.array([[0.1, 0.0]]))
