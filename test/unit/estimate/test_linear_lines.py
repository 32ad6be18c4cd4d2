"""Three lines with Abbe offsets (Wang & Liotto, eqs. 23–25), exact and through the traced scene."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.linear_lines import Lines, design, evaluate, names, printed_solution
from stepdiag_ros.estimate.readings import Sight, closed_form
from stepdiag_ros.model.machine import compose, tool_pose
from stepdiag_ros.model.sensor import Misalignment

PLACE = np.linspace(0.0, 0.8, 9)
OFFSETS = ((0.0, 0.0), (0.6, 0.0), (0.0, 0.5))
"""The lines along X: bottom edge, side edge, top edge [m]."""


def lines_along_x(machine, errors, measure):
    """X run along three edges of the volume, the reflector at the tool, Y and Z standing still."""
    arms, deviations = [], []
    for y, z in OFFSETS:
        positions = np.stack([PLACE, np.full(9, y), np.full(9, z)], axis=1)
        sight = Sight('lin', np.array([1.0, 0.0, 0.0]), positions, np.zeros(9, int), 0.1)
        point, attitude = tool_pose(errors, positions, machine.tool, machine.chain)
        length = measure(sight, machine, Misalignment(), point, attitude)[0][:, 0]
        deviations.append(length - length[0] - PLACE)
        arms.append(np.array([0.0, y, z]) + machine.tool)
    return Lines(PLACE, np.array(arms), np.array(deviations), 1e-7)


@pytest.mark.parametrize('sensor', ['closed form', 'traced'])
def test_three_edges_of_the_volume(machine, draw_errors, traced, sensor):
    errors = draw_errors(machine, 8)
    found = evaluate({'X': lines_along_x(machine, errors, traced if sensor == 'traced' else closed_form)})
    # A flat mirror that tilts adds angle times sideways motion: micrometres times 10 µrad.
    for name in ('EXX', 'EBX', 'ECX'):
        np.testing.assert_allclose(found.curve(name)[1], errors.curves[name].value, atol=2e-9)


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_design_is_the_chains_own_derivative(axis):
    """Exact: the reading of each line from the chain, all axes, with tools as arms of Y and Z."""
    rng = np.random.default_rng(axis)
    turn, shift = rng.normal(0, 1e-5, 3), 3e-6
    arms = rng.normal(0, 0.3, (4, 3))
    readings = []
    for tool in arms:
        shifts, turns = np.zeros((3, 1, 3)), np.zeros((3, 1, 3))
        shifts[axis, 0, axis], turns[axis, 0] = shift, turn
        point, _ = compose('FXYZ', shifts, turns, tool)
        readings.append(point[0, axis] - tool[axis])
    truth = {f'E{"XYZ"[axis] * 2}': shift} | {f'E{k}{"XYZ"[axis]}': turn[i] for i, k in enumerate('ABC')}
    expected = design(axis, arms) @ [truth[n] for n in names(axis)]
    np.testing.assert_allclose(readings, expected, atol=1e-15)
    data = np.stack([np.zeros(4), readings], axis=1)
    found = evaluate({'XYZ'[axis]: Lines(np.array([0.0, 1.0]), arms, data)})
    for name in names(axis):
        assert found.curve(name)[1][1] == pytest.approx(truth[name], abs=1e-14)


def test_printed_solution_has_names_and_signs_exchanged():
    """Put D = Dx + m·Ay + p·Az in; out come Az, −Ay and −Dx under the names Ay, Az and Dx."""
    m, p = np.array([0.0, 0.5, 0.1]), np.array([0.1, 0.0, 0.6])
    dx, ay, az = 4e-6, 1e-5, -2e-5
    printed = printed_solution(dx + m * ay + p * az, m, p)
    np.testing.assert_allclose(printed, (-dx, az, -ay), rtol=1e-9)


def test_uncertainty_is_repeatability_over_offset():
    """The paper's example: 2.5 µm over 500 mm is 5 µrad (for the difference of two, √2 more)."""
    arms = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]])
    found = evaluate({'X': Lines(np.array([0.0, 0.5]), arms, np.zeros((3, 2)), 2.5e-6 / np.sqrt(2.0))})
    # A reading and the reset count both: √2 · 2.5/√2 µm a line, two lines a difference.
    assert found.curve('EBX')[2][1] == pytest.approx(np.sqrt(2.0) * 5e-6)
    assert found.curve('EBX')[2][0] == 0.0


def test_more_lines_are_averaged(machine, draw_errors):
    errors = draw_errors(machine, 8)
    three = lines_along_x(machine, errors, closed_form)
    six = Lines(PLACE, np.tile(three.arm_m, (2, 1)), np.tile(three.deviation_m, (2, 1)), 1e-7)
    one, two = evaluate({'X': three}), evaluate({'X': six})
    np.testing.assert_allclose(two.value, one.value, atol=1e-15)
    np.testing.assert_allclose(two.sigma, one.sigma / np.sqrt(2.0))


@pytest.mark.parametrize('arms', [[[0, 0, 0], [0, 1, 0], [0, 2, 0]], [[0, 0, 0], [0, 1, 0]]])
def test_lines_in_one_plane_are_refused(arms):
    with pytest.raises(StepdiagError, match='lie in one line'):
        evaluate({'X': Lines(np.array([0.0, 1.0]), np.array(arms, float), np.zeros((len(arms), 2)))})


def test_bad_input_is_named():
    with pytest.raises(StepdiagError, match='unknown axis'):
        evaluate({'W': Lines(np.zeros(1), np.zeros((3, 3)), np.zeros((3, 1)))})
    with pytest.raises(StepdiagError, match='deviations'):
        evaluate({'X': Lines(np.zeros(2), np.eye(3), np.zeros((3, 1)))})
    with pytest.raises(StepdiagError, match='no axis'):
        evaluate({})
