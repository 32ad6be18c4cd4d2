"""The forward model: its derivatives, and the contract's closed forms from another road."""

import numpy as np
import pytest

from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.parameters import curve_matrices, parameters_of
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment

THREE = ((0.0, 0.0), (0.03, 0.0), (0.0, 0.03))


def model_of(description, directions=(1, -1)):
    table = planned_table(description, directions=directions)
    parameters = parameters_of(description, table)
    return table, parameters, ForwardModel(description, table, parameters)


def drawn_unknowns(parameters, rng):
    theta = rng.normal(0.0, 1e-5, parameters.size)
    theta[parameters.offset_first:] = rng.uniform(-1.0, 1.0, parameters.size - parameters.offset_first)
    first = min(parameters.setup_first.values())
    theta[first:parameters.offset_first] = rng.normal(0.0, 1e-3, parameters.offset_first - first)
    return theta


@pytest.mark.parametrize('chain', ['FXYZ', 'XFYZ', 'XYFZ', 'XYZF', 'ZXFY'])
@pytest.mark.parametrize('beams', [((0.0, 0.0),), THREE])
def test_jacobian_is_the_slope_of_the_readings(plan_of, chain, beams):
    description = plan_of(2, 1, beams, chain)
    table, parameters, model = model_of(description, (1,))
    rng = np.random.default_rng(7)
    theta = drawn_unknowns(parameters, rng)
    readings, jacobian, _ = model.jacobian(theta)
    np.testing.assert_array_equal(readings, model.predict(theta))
    for _ in range(12):
        direction = rng.normal(size=parameters.size)
        step = 2e-6
        slope = (model.predict(theta + step * direction)
                 - model.predict(theta - step * direction)) / (2.0 * step)
        # Third derivatives reach 1e3 along such a direction, times step² = 4e-12; rounding 1e-10.
        assert np.abs(jacobian @ direction - slope.ravel()).max() < 5e-9


def test_every_column_on_its_own(plan_of):
    table, parameters, model = model_of(plan_of(2, 1), (1,))
    theta = drawn_unknowns(parameters, np.random.default_rng(1))
    _, jacobian, _ = model.jacobian(theta)
    dense = jacobian.toarray()
    for column, label in enumerate(parameters.labels()):
        unit = np.zeros(parameters.size)
        unit[column] = 1e-6
        slope = (model.predict(theta + unit) - model.predict(theta - unit)).ravel() / 2e-6
        np.testing.assert_allclose(dense[:, column], slope, atol=3e-9, err_msg=label)


def test_arrival_derivatives(plan_of):
    """A shift of the mirror's point, and a turn about it, as the closed-form sensor sees them."""
    description = plan_of(2, 1)
    table, parameters, model = model_of(description, (1,))
    _, _, arrival = model.local_derivatives(np.zeros(parameters.size))
    n, beams = table.displacement.shape
    zero, perfect = np.zeros((n, 3)), GeometricErrors.zero()
    from stepdiag_ros.model.path import local_triad, setup_direction

    triads = np.array([local_triad(setup_direction(description.machine, table.setup_names[s]))
                       for s in table.setup])
    later = np.flatnonzero(table.index > 0)
    for k in range(5):
        moved = []
        for sign in (1e-6, -1e-6):
            shift, turn = zero.copy(), zero.copy()
            if k < 2:
                turn[later] = sign * triads[later, k]
            else:
                shift[later, k - 2] = sign
            moved.append(observe(description, table, perfect, shift=shift, turn=turn))
        slope = (moved[0] - moved[1]) / 2e-6
        np.testing.assert_allclose(arrival[k][later], slope[later], atol=1e-8)


@pytest.mark.parametrize('chain', ['FXYZ', 'YFXZ'])
@pytest.mark.parametrize('beams', [((0.0, 0.0),), THREE])
def test_readings_are_those_of_the_contract(plan_of, draw_errors, misaligned, chain, beams):
    """The unknowns of a known machine, put into the model, give the readings of its own pose and sensor."""
    description = plan_of(4, 1, beams, chain)
    errors = draw_errors(description.machine, 4, framed=False)
    # Squareness is no unknown of its own: it is a slope of a straightness curve.
    straight = dict(errors.curves)
    for name, square, sign in (('EXY', 'EC0Y', -1.0), ('EXZ', 'EB0Z', 1.0), ('EYZ', 'EA0Z', -1.0)):
        curve = straight[name]
        straight[name] = Curve(curve.position, curve.value + sign * errors.square[square] * curve.position)
    table, parameters, model = model_of(description)
    misalignments = misaligned(description, 1e-3)
    theta = np.zeros(parameters.size)
    for name in CURVES:
        knots = parameters.knots[name]
        theta[parameters.slice(name)] = straight[name](knots)[1:]
    for name, m in misalignments.items():
        first = parameters.setup_first[name]
        theta[first:first + 4] = (*m.laser, *m.mirror)
    got = model.predict(theta)
    want = observe(description, table, errors, misalignments)
    width = len(beams)
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        got[rows, :width] -= got[rows[0], :width]
    assert np.abs(got - want).max() < 5e-15


def test_a_stop_between_knots_takes_part_in_both(plan_of):
    description = plan_of(4, 1)
    _, parameters, _ = model_of(description)
    matrix = curve_matrices(parameters, np.array([[0.25, 0.0, 0.5]]))
    row = matrix[CURVES.index('EAX')].toarray()[0]
    first = parameters.first['EAX']
    np.testing.assert_allclose(row[first:first + 2], [0.75, 0.25])
    assert matrix[CURVES.index('EAY')].nnz == 0   # position 0 is zero by definition
    assert matrix[CURVES.index('EAZ')].toarray()[0, parameters.first['EAZ'] + 3] == 1.0


def test_three_beams_have_an_offset_each(plan_of):
    _, parameters, model = model_of(plan_of(2, 1, THREE))
    theta = np.zeros(parameters.size)
    before = model.predict(theta)
    theta[parameters.offset_first + 1] = 0.125    # run 0, beam 1
    change = model.predict(theta) - before
    assert np.all(change[:7, 1] == 0.125)
    change[:7, 1] = 0.0
    assert not change.any()


def test_labels_and_reporting_cover_everything(plan_of):
    description = plan_of(4, 1)
    table, parameters, _ = model_of(description)
    assert len(parameters.labels()) == parameters.size
    names, matrix = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    assert len(names) == len(matrix) == 18 * 5 + 3
    assert not matrix[:, min(parameters.setup_first.values()):].any()


def test_a_setup_alone_can_be_fitted(plan_of, draw_errors):
    description = plan_of(3, 2, names=('ppp',))
    table = planned_table(description)
    readings = observe(description, table, draw_errors(description.machine, 3), {'ppp': Misalignment()})
    result = fit(description, filled(table, readings))
    assert result.converged
    assert np.abs(result.residual).max() < 1e-7
