"""A budget through the enhanced method: linear propagation against the fit itself and against refits."""

import numpy as np
import pytest

from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.estimate.prediction import predict
from stepdiag_ros.estimate.propagate import (
    HELD,
    Conditions,
    Setting,
    coverage_factor,
    gain,
    propagate,
)
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.budget import Budget
from stepdiag_ros.model.standard_budget import standard_budget

SCALES = (21.0, 20.5, 22.0)


@pytest.fixture
def case(plan_of, draw_errors, misaligned):
    description = plan_of(3, 2)
    table = planned_table(description)
    readings = observe(description, table, draw_errors(description.machine, 3), misaligned(description, 3e-4))
    table = filled(table, readings)
    sensor = np.full(readings.shape, 5e-10)
    sensor[:, -2:] = 2e-8
    result = fit(description, table, NoiseModel(3e-7, 2e-7, sensor, 'repeats', (40, 40)), linear_laser=1e-4)
    solution = solution_of(result, table)
    setting = Setting.of_fit(description, table, result, Conditions(20.0, 1e5, 0.5, SCALES))
    return description, table, result, solution, setting


def only(*kinds):
    whole = standard_budget()
    return Budget(tuple(c for c in whole.contributors if c.kind in kinds))


def test_noise_alone_is_the_covariance_of_the_fit(case):
    description, table, result, solution, setting = case
    budget = only('position_repeatability', 'angle_repeatability', 'interferometer_noise', 'psd_noise')
    found = propagate(budget, setting, result, solution)
    scale = np.where(solution.sigma > 0, solution.sigma, 1.0)
    gap = (found.solution.covariance - solution.covariance) / scale[:, None] / scale
    assert np.abs(gap).max() < 2e-3
    shares = found.shares()
    assert found.names[-1] == HELD
    np.testing.assert_allclose(np.sqrt(np.sum(shares**2, axis=0)), found.solution.sigma, rtol=1e-9)


@pytest.mark.parametrize('kind', ['scale', 'air_temperature', 'air_pressure', 'humidity', 'dead_path',
                                  'psd_gain', 'psd_zero', 'psd_rotation', 'cosine'])
def test_each_systematic_effect_is_what_a_refit_says(case, kind):
    """The effect added to the readings and everything solved anew, against the linear map."""
    description, table, result, solution, setting = case
    found = propagate(only(kind), setting, result, solution)
    columns = found.causes[0].readings.toarray()
    rng = np.random.default_rng(1)
    unit = rng.choice([-1.0, 1.0], columns.shape[1])
    moved = setting.readings + 0.1 * (columns @ unit).reshape(setting.readings.shape)
    again = fit(description, filled(table, moved), result.noise, theta=result.theta, linear_laser=1e-4,
                settled=1e-14)
    shift = (solution_of(again, table).value - solution.value) / 0.1
    linear = found.effects[0] @ unit
    size = np.abs(linear).max()
    assert size > 0.0
    assert np.abs(shift - linear).max() < 0.03 * size + 1e-10


def test_signs_and_sizes_known_by_hand(case):
    description, table, result, solution, setting = case
    found = propagate(only('scale'), setting, result, solution)
    end = [i for i, (name, k) in enumerate(solution.names) if name == 'EXX'][-1]
    assert found.effects[0][end, 0] == pytest.approx(0.8 * 2.5e-8, rel=1e-3)
    # A temperature read too high makes the index too small and lengths too long.
    found = propagate(only('air_temperature'), setting, result, solution)
    slope = float(refractive_index(20.5, 1e5, 0.5) - refractive_index(19.5, 1e5, 0.5))
    assert slope == pytest.approx(-9.3e-7, rel=0.05)
    assert found.effects[0][end, 0] == pytest.approx(-slope * 0.8 * 0.1 / np.sqrt(3.0), rel=1e-2)
    found = propagate(only('scale_temperature'), setting, result, solution)
    assert found.effects[0][end] == pytest.approx([0.8 * 1.15e-5 * 0.1 / np.sqrt(3.0), 0.0, 0.0])
    found = propagate(only('expansion_coefficient'), setting, result, solution)
    assert found.effects[0][end] == pytest.approx([0.8 * 1e-6 / np.sqrt(3.0), 0.0, 0.0])
    # A linear beam at ε to its axis, about two axes: L ε², as far as lin_x decides against the diagonals.
    found = propagate(only('cosine'), setting, result, solution)
    assert found.effects[0].shape[1] == 3
    assert 0.4 < found.effects[0][end, 0] / (-0.8 * (2e-4)**2) < 1.0


def test_points_add_up_with_correlations(case):
    description, _, result, solution, setting = case
    found = propagate(standard_budget(), setting, result, solution)
    points = np.array([[0.4, 0.3, 0.25], [0.8, 0.6, 0.5], [0.11, 0.22, 0.33]])
    at = found.at(description.machine, points)
    want = predict(found.solution, description.machine, points).sigma_m
    np.testing.assert_allclose(np.sqrt(np.sum(at**2, axis=0)), want, rtol=1e-9)


def test_degrees_of_freedom(case):
    _, _, result, solution, setting = case
    found = propagate(only('psd_gain'), setting, result, solution)
    shares = found.shares()
    shares[-1] = 0.0
    live = shares[0] > 0
    np.testing.assert_allclose(found.effective_dof(shares)[live], 10.0)
    assert coverage_factor(np.array([10.0]))[0] == pytest.approx(2.28, abs=0.01)
    assert coverage_factor(np.array([np.inf]))[0] == pytest.approx(2.0, abs=1e-3)


def test_gain_of_absent_readings_is_zero(case, plan_of):
    description, table, result, _, setting = case
    holes = setting.readings.copy()
    holes[3] = np.nan
    again = fit(description, filled(table, holes), result.noise, linear_laser=1e-4)
    matrix = gain(again).reshape(result.theta.size, *holes.shape)
    assert not matrix[:, 3].any()
    assert matrix[:, 2].any()
