"""Decisions, uncertainty of the largest deviation, tables held back: each against a second way."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.compensate.approach import sides, sizes
from stepdiag_ros.compensate.compensation import K, compensation, worsened
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.document import document, predicted_of
from stepdiag_ros.compensate.harmless import held_back
from stepdiag_ros.compensate.largest import largest
from stepdiag_ros.compensate.taken import Trim
from stepdiag_ros.compensate.verified import CONFORMS, FAILS, UNDECIDED, decided, verified
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.prediction import Prediction, deviation, predict
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.guard.jsontext import to_json

from .applied import ORIGIN, grid, machine_of, made


def test_decision_by_iso_14253_1():
    assert decided(8.0, 1.0, 9.0) == CONFORMS
    assert decided(8.1, 1.0, 9.0) == UNDECIDED
    assert decided(10.0, 1.0, 9.0) == UNDECIDED
    assert decided(10.1, 1.0, 9.0) == FAILS


def drawn_from(solution: Solution, seed: int) -> Solution:
    """Another estimate of the same machine, off by what its covariance says."""
    noise = np.random.default_rng(seed).standard_normal(len(solution.value)) * solution.sigma
    return Solution(solution.method, solution.positions, solution.names, solution.value + noise, solution.covariance)


def test_the_largest_deviation_lies_inside_its_uncertainty():
    """Machines drawn around an estimate: of 200 about 190 have a largest deviation within U."""
    machine, solution = machine_of(), made(4, sigma=3e-7)
    field = predict(solution, machine, grid(6))
    size, spread, _ = largest(solution, machine, np.asarray(machine.tool), field)
    true = [np.linalg.norm(deviation(drawn_from(solution, s).errors, machine, field.points), axis=1).max()
            for s in range(200)]
    assert 175 <= np.sum(np.abs(np.array(true) - size) <= spread) <= 199
    # A machine without errors, as far as is known: nothing is reported as zero.
    none = Solution('made', solution.positions, solution.names, 0.0 * solution.value, solution.covariance)
    _, floor, _ = largest(none, machine, np.asarray(machine.tool), predict(none, machine, grid(6)))
    assert floor > 2.0 * np.sqrt(predict(none, machine, grid(6)).size_sigma_m.max() * 1e-9)


def test_a_place_is_reached_from_its_worst_side():
    """Against all eight sides one by one; what is drawn of a lost motion that is known is the same, and of one that is
    only known to be small it is no more than that."""
    rng = np.random.default_rng(8)
    off, lost = 1e-6 * rng.standard_normal((40, 3)), {'X': (4e-6, 2e-7), 'Z': (-1e-6, 1e-7)}
    every = np.linalg.norm(off[None] + sides(lost)[:, None], axis=2)
    assert len(every) == 4 and np.allclose(every.max(axis=0), sizes(off, lost), rtol=1e-12)
    assert sides({}).tolist() == [[0.0, 0.0, 0.0]]
    machine, solution = machine_of(), made(4, sigma=1e-9)
    field = predict(solution, machine, grid(4))
    size, spread, place = largest(solution, machine, np.asarray(machine.tool), field, lost)
    row = np.flatnonzero((field.points == place).all(axis=1))[0]
    assert size == sizes(field.deviation_m, lost)[row] == sizes(field.deviation_m, lost).max()
    assert 1e-8 < spread < 2e-7 and largest(solution, machine, np.asarray(machine.tool), field)[1] < spread


def test_no_side_becomes_worse_where_lost_motion_stays():
    """A table that takes off along Y and adds along X would be safe, did not X lose motion: |(9, 0)| < |(0, 10)|, but
    from the worst side (19, 0) is more than (10, 10)."""
    points, off = np.zeros((1, 3)), np.array([[0.0, 1e-5, 0.0]])
    after = np.array([[9e-6, 0.0, 0.0]])
    sharp = [Prediction(points, deviation_, 1e-18 * np.eye(3)[None]) for deviation_ in (off, after)]
    lost = {'X': (2e-5, 0.0)}
    assert worsened(*sharp)[0] < 0.0 < worsened(*sharp, lost, lost)[0]
    assert worsened(*sharp, lost, {})[0] < 0.0


def test_what_lost_motion_leaves_is_held_back_too():
    machine, solution = machine_of('YXFZ'), made(31, sigma=2e-8)
    lost = {'X': (1.5e-5, 1e-7), 'Y': (-1e-5, 1e-7)}
    found = compensation(solution, machine, replace(CONTROLS['sinumerik'], reverses=False), ORIGIN, reversal=lost)
    assert found.reversal_left == lost and found.worst_before[0] > 1e-5
    found.checked()
    for side in sides(lost):
        then = np.linalg.norm(found.after.deviation_m + side, axis=1)
        allowed = sizes(found.before.deviation_m, lost) + K * found.before.size_sigma_m
        assert np.all(then <= allowed + 1e-9)


def test_a_curve_is_decided_at_each_of_its_positions():
    """The largest value is known well, a smaller one poorly: one place inside by U does not speak for the others."""
    machine, solution = machine_of(), made(4, sigma=1e-7)
    rows = [i for i, (name, _) in enumerate(solution.names) if name == 'EXX']
    value, spread = solution.value.copy(), np.diag(solution.covariance).copy()
    value[rows], spread[rows] = 1e-6, 1e-14
    value[rows[2]], spread[rows[-1]] = 8e-6, (9e-6)**2
    bent = Solution(solution.method, solution.positions, solution.names, value, np.diag(spread))
    found = verified(bent, bent, machine, {'EXX': 15e-6})
    shown = next(f for f in found.figures if f.name == 'EXX')
    assert shown.after == 8e-6 and shown.after + shown.after_spread < 15e-6
    assert shown.decision == found.decision == UNDECIDED
    assert verified(bent, bent, machine, {'EXX': 20e-6}).decision == CONFORMS


def test_held_back_tables_hold_at_all_places():
    rng = np.random.default_rng(3)
    points = grid(5)
    off = rng.normal(0.0, 4e-6, (len(points), 3))
    off[0] = 0.0, 3e-5, 0.0    # the largest, which must not grow, is none of X
    position = np.linspace(0.0, 0.4, 9)
    wanted = {'EXX': Trim(position, 5e-6 * np.arange(9) / 8.0, 5e-6 * np.arange(9) / 8.0)}
    room = np.full(len(points), 3e-7)
    held = held_back(wanted, points, off, room)['EXX']
    left = off.copy()
    left[:, 0] -= np.interp(points[:, 0], position, held.mean)
    assert np.all(np.linalg.norm(left, axis=1) <= np.linalg.norm(off, axis=1) + room + 1e-9)
    assert held.mean[0] == 0.0 and np.abs(held.mean).max() > 1e-8
    free = held_back(wanted, points, off, np.full(len(points), 1e-5))['EXX']
    assert free.mean == pytest.approx(wanted['EXX'].mean, abs=1e-15)


def test_of_all_tables_that_harm_nobody_the_nearest_is_taken():
    """One axis, one row: the condition at each place is a quadratic that can be solved by hand."""
    points = np.array([[0.4, 0.0, 0.0], [0.4, 0.3, 0.0], [0.0, 0.3, 0.0]])
    off = np.array([[2e-6, 1e-6, 0.0], [-1e-6, 3e-6, 0.0], [9e-6, 0.0, 0.0]])
    wanted = {'EXX': Trim(np.array([0.0, 0.4]), np.array([0.0, 2e-6]), np.array([0.0, 2e-6]))}
    room = np.full(3, 1e-7)
    # |(−1 − g, 3)| ≤ |(−1, 3)| + 0.1, in µm: the largest g.
    limit = np.hypot(1.0, 3.0) + 0.1
    most = np.sqrt(limit**2 - 9.0) - 1.0
    assert held_back(wanted, points, off, room)['EXX'].mean[1] == pytest.approx(1e-6 * most, rel=2e-3)


def test_the_largest_deviation_gets_no_room():
    """And the tables that serve the whole volume leave less in the mean than those of any line."""
    points = np.array([[0.4, 0.0, 0.0]])
    wanted = {'EXX': Trim(np.array([0.0, 0.4]), np.array([0.0, 2e-6]), np.array([0.0, 2e-6]))}
    held = held_back(wanted, points, np.array([[-1e-6, 0.0, 0.0]]), np.array([5e-7]))
    assert held['EXX'].mean[1] <= 1e-10
    machine, solution = machine_of(), made(12, sigma=1e-6)
    means = [np.mean(compensation(solution, machine, CONTROLS['sinumerik'], ORIGIN, volume=volume).after.size_m**2)
             for volume in (False, True)]
    assert means[1] < means[0]


def test_a_measurement_is_held_against_the_prediction():
    machine = machine_of()
    before = made(31, sigma=2e-7)
    found = compensation(before, machine, CONTROLS['heidenhain'], ORIGIN).checked()
    predicted = predicted_of(to_json(document(found, 'log')), 'prediction.json')
    values = [found.predicted.square[n] if k < 0 else found.predicted.curves[n].value[k] for n, k in before.names]
    after = Solution('made', before.positions, before.names, np.array(values), before.covariance)
    good = verified(before, drawn_from(after, 1), machine, {'volumetric': 1e-5}, predicted=predicted)
    assert good.agreement.agrees and good.decision == CONFORMS
    wrong_sign = verified(before, made(31, sigma=2e-7), machine, {'volumetric': 1e-5}, predicted=predicted)
    assert not wrong_sign.agreement.agrees and 'EXX' in wrong_sign.agreement.off
    assert {f.name for f in good.figures} >= {'volumetric', 'EXX', 'ECZ', 'EA0Z'}


@pytest.mark.parametrize('text', ['', '[1]', '{"schema": 1}', '{"schema": 2, "written": true}', '[' * 100_000,
                                  '{"schema": 1, "written": false}'])
def test_what_is_no_prediction_costs_one_line(text):
    with pytest.raises(StepdiagError) as caught:
        predicted_of(text, 'prediction.json')
    assert str(caught.value).startswith('prediction.json: ') and '\n' not in str(caught.value)


def test_a_figure_that_the_log_does_not_give_cannot_be_decided():
    with pytest.raises(StepdiagError, match='does not give it'):
        verified(made(1), made(1), machine_of(), {'E': 1e-6})
