"""The enhanced method as a whole: noise-free data give the truth back, drawn noise gives honest intervals."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.blind.visibility import true_parameters
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.dense import factored
from stepdiag_ros.estimate.enhanced import fit, prior_precision
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.noise import NoiseModel, whiteners
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.machine import CURVES, SQUARENESS

THREE = ((0.0, 0.0), (0.03, 0.0), (0.0, 0.03))


def pulls(solution, truth):
    """(estimate − truth)/σ of everything that is not zero by definition."""
    true, rows = to_reference_lines(truth), []
    for name in CURVES:
        position, value, sigma = solution.curve(name)
        rows.append(((value - true.curves[name](position)) / np.where(sigma > 0, sigma, 1.0))[1:])
    rows.append([(solution.squareness(n)[0] - true.square[n]) / solution.squareness(n)[1]
                 for n in SQUARENESS])
    return np.concatenate(rows)


@pytest.mark.parametrize(('chain', 'beams', 'size'), [
    ('FXYZ', ((0.0, 0.0),), 3e-4), ('FXYZ', ((0.0, 0.0),), 1e-3),
    ('XFYZ', ((0.0, 0.0),), 1e-3), ('FXYZ', THREE, 1e-3)])
def test_noise_free_data_give_the_machine_back(plan_of, draw_errors, misaligned, silent, deviation,
                                               square_deviation, chain, beams, size):
    description = plan_of(4, 2, beams, chain)
    truth = draw_errors(description.machine, 4, framed=False)
    table = planned_table(description)
    misalignments = misaligned(description, size)
    table = silent(filled(table, observe(description, table, truth, misalignments)))
    result = fit(description, table)
    found = solution_of(result, table)
    assert result.converged
    assert not found.unidentifiable
    assert deviation(found, truth, 'XYZ') < 1e-12
    assert deviation(found, truth, 'ABC') < 1e-12
    assert square_deviation(found, truth) < 1e-12
    for name, m in misalignments.items():
        np.testing.assert_allclose(found.misalignments[name].laser, m.laser, atol=1e-9)
        np.testing.assert_allclose(found.misalignments[name].mirror, m.mirror, atol=1e-9)


def drawn_log(description, truth, misalignments, rng, position=3e-7, angle=2e-7):
    """Readings with drawn arrival errors and sensor noise, through the model's own covariance."""
    table = planned_table(description)
    sensor = np.full((len(table), table.displacement.shape[1] + 2), 5e-10)
    sensor[:, -2:] = 2e-8
    parameters = parameters_of(description, table)
    clean = observe(description, table, truth, misalignments)
    arrival = ForwardModel(description, table, parameters).jacobian(np.zeros(parameters.size))[2]
    noise = NoiseModel(position, angle, sensor, 'drawn')
    noisy = clean.ravel().copy()
    for white in whiteners(table, noise, arrival, np.isfinite(clean)):
        noisy[white.rows] += white.factor @ rng.standard_normal(len(white.rows))
    table = filled(table, noisy.reshape(clean.shape))
    scatter = sensor * np.sqrt(table.displacement_count)[:, None]
    return replace(table, displacement_scatter=scatter[:, :-2], spot_scatter=scatter[:, -2:])


@pytest.mark.long
def test_coverage_of_the_intervals(plan_of, draw_errors, misaligned):
    """Over 60 logs the share within k = 2 must be that of a normal, χ² that of its degrees of freedom."""
    description = plan_of(2, 2)
    truth = draw_errors(description.machine, 2, framed=True)
    # The linear setups' lasers are aligned; theirs is a budget's matter (cosine), not the log's.
    misalignments = misaligned(description, 3e-4)
    rng = np.random.default_rng(11)
    every, chi2 = [], []
    for _ in range(60):
        table = drawn_log(description, truth, misalignments, rng)
        result = fit(description, table, linear_laser=1e-4)
        every.append(pulls(solution_of(result, table), truth))
        chi2.append(result.chi2 / result.dof)
    every = np.array(every)
    within = np.mean(np.abs(every) < 2.0)
    # Parameters of one log go together: some ten independent ones a log count for the limit.
    assert abs(within - 0.9545) < 3.0 * np.sqrt(0.9545 * 0.0455 / 600)
    assert 0.85 < np.std(every) < 1.15
    # No single parameter is always off: binomial(60, 0.9545), below this once in 1e5.
    assert np.mean(np.abs(every) < 2.0, axis=0).min() > 0.80
    assert 0.93 < np.mean(chi2) < 1.07


def test_the_same_log_gives_the_same_bits(plan_of, draw_errors, misaligned):
    description = plan_of(3, 2)
    table = drawn_log(description, draw_errors(description.machine, 3), misaligned(description, 3e-4),
                      np.random.default_rng(5))
    one, two = fit(description, table), fit(description, table)
    assert one.theta.tobytes() == two.theta.tobytes()
    assert one.covariance.tobytes() == two.covariance.tobytes()


def test_covariance_is_that_of_the_dense_problem(plan_of, draw_errors, misaligned):
    """Normal equations run by run against one dense least-squares problem, prior rows and all."""
    description = plan_of(2, 2)
    table = drawn_log(description, draw_errors(description.machine, 2), misaligned(description, 3e-4),
                      np.random.default_rng(2))
    result = fit(description, table)
    dense = result.jacobian.toarray()
    rows = np.concatenate([white(dense) for white in result.whiteners])
    normal = rows.T @ rows + prior_precision(result.parameters)
    scale = 1.0 / np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal * scale[:, None] * scale) * scale[:, None] * scale
    sigma = np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(result.covariance / sigma[:, None] / sigma,
                               inverse / sigma[:, None] / sigma, atol=5e-4)


def test_missing_readings_are_left_out(plan_of, draw_errors, misaligned, silent, deviation):
    description = plan_of(3, 2)
    truth = draw_errors(description.machine, 3)
    table = planned_table(description)
    readings = observe(description, table, truth, misaligned(description, 3e-4))
    rng = np.random.default_rng(4)
    holes = rng.random(readings.shape) < 0.15
    found = solution_of(fit(description, silent(filled(table, np.where(holes, np.nan, readings)))), table)
    assert deviation(found, truth) < 1e-11
    # Whole stops missing, the first of a run among them.
    kept = (rng.random(len(table)) > 0.1) & (table.time_s > 2.0)
    part = silent(filled(table, readings)).select(kept)
    assert deviation(solution_of(fit(description, part), part), truth) < 1e-11


def test_a_single_repeat_falls_back_on_belief(plan_of, draw_errors, misaligned):
    description = plan_of(3, 1)
    table = drawn_log(description, draw_errors(description.machine, 3), misaligned(description, 3e-4),
                      np.random.default_rng(8))
    result = fit(description, table)
    assert result.noise.source == 'belief'
    assert result.noise.position == description.noise.position_repeatability
    assert 0.7 < result.chi2 / result.dof < 1.3


def test_three_beams_without_a_detector(plan_of, draw_errors, misaligned):
    """Layout a: the tilts come from the beams; the intervals hold the truth."""
    description = plan_of(3, 2, THREE)
    truth = draw_errors(description.machine, 3)
    table = drawn_log(description, truth, misaligned(description, 3e-4), np.random.default_rng(6))
    table = replace(table, spot=np.full_like(table.spot, np.nan))
    result = fit(description, table)
    assert result.converged
    assert np.mean(np.abs(pulls(solution_of(result, table), truth)) < 2.0) > 0.9


def test_no_reading_at_all(plan_of):
    description = plan_of(2, 1)
    with pytest.raises(StepdiagError, match='no readings'):
        fit(description, planned_table(description))


def test_a_bent_valley_is_followed_to_its_end():
    """Turns of beams and mirror act to second order: from an ideal machine the same is found as from the truth."""
    made = make(Order('sealed', 20261131, 93, 'null'))
    table = reduce_log(made.log)
    truth = true_parameters(made.cell, parameters_of(made.log.description, table))
    far, near = (fit(made.log.description, table, theta=start, settled=1e-2) for start in (None, truth))
    least = [f.chi2 + f.theta @ f.precision @ f.theta for f in (far, near)]
    assert far.converged and near.converged
    assert least[0] == pytest.approx(least[1], abs=0.2)


def test_a_step_to_where_nothing_can_be_predicted_is_not_taken(plan_of, draw_errors, misaligned, monkeypatch):
    description = plan_of(2, 1)
    table = planned_table(description)
    seen = observe(description, table, draw_errors(description.machine, 2), misaligned(description, 3e-4))
    table = filled(table, seen)
    begin = np.zeros(parameters_of(description, table).size)
    monkeypatch.setattr(ForwardModel, 'predict', lambda self, theta: np.full((len(table), self.beams + 2), np.nan))
    np.testing.assert_array_equal(fit(description, table, theta=begin).theta, begin)


def test_widths_hold_to_the_centre(plan_of, draw_errors, misaligned):
    """What the data leave open stays where it was."""
    description = plan_of(2, 1, names=('lin_x',))
    table = planned_table(description)
    readings = observe(description, table, draw_errors(description.machine, 2), misaligned(description, 3e-4))
    parameters = parameters_of(description, table)
    centre = np.zeros(parameters.size)
    centre[parameters.slice('EZZ')] = 3e-6          # Z does not move here
    found = fit(description, filled(table, readings), theta=centre, centre=centre)
    np.testing.assert_allclose(found.theta[parameters.slice('EZZ')], 3e-6, rtol=1e-6)
    found = fit(description, filled(table, readings), theta=centre)
    np.testing.assert_allclose(found.theta[parameters.slice('EZZ')], 0.0, atol=1e-9)


def test_factor_survives_rounding_and_refuses_nonsense():
    rng = np.random.default_rng(0)
    basis = rng.normal(size=(6, 3))
    factor, scale = factored(basis @ basis.T)       # singular, and a little negative by rounding
    back = factor @ factor.T / scale[:, None] / scale
    np.testing.assert_allclose(back, basis @ basis.T, atol=1e-6)
    with pytest.raises(StepdiagError, match='cannot be solved'):
        factored(np.array([[1.0, 2.0], [2.0, 1.0]]))
